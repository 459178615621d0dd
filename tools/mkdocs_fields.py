"""For the site's API pages: a field's comment, which has its shape and unit, is its docstring."""

import re

from griffe import Attribute, Docstring, Extension


class FieldComments(Extension):
    """Takes the comment behind a field of a class as its docstring."""

    def on_attribute_instance(self, *, attr: Attribute, **_: object) -> None:
        """Called for each attribute that is found."""
        if attr.docstring or not attr.endlineno or not attr.parent or not attr.parent.is_class:
            return
        line = attr.lines_collection[attr.filepath][attr.endlineno - 1]
        if found := re.search(r"  # (.*)$", line):
            attr.docstring = Docstring(found[1], parent=attr, lineno=attr.endlineno)
