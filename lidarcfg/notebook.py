"""What notebooks show of a result: `lidarcfg.report.notebook` draws it, which is loaded when a result is shown."""

from importlib import import_module


class Shown:
    """A result that a notebook shows as tables and pictures."""

    def _repr_html_(self) -> str:
        shown: str = import_module("lidarcfg.report.notebook").html(self)
        return shown
