"""Shortcuts through numba: what it does with every function that it compiles, and nobody needs.

They take a quarter off compiling and change nothing of what is compiled. They replace methods inside numba; where these
are not as known, numba works as ever.
"""

from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

NOT_ENTERED_FROM_C = ("numba.", "lidarcfg.")  # modules whose functions nobody passes to other compiled functions


@cache
def take() -> None:
    """Take them from now on."""
    for module, kind, method, shortcut in (
        ("targetconfig", "TargetConfig", "__eq__", _same_flags),
        ("targetconfig", "TargetConfig", "__hash__", _any_flags),
        ("codegen", "CPUCodeLibrary", "_optimize_functions", _optimise_defined),
        ("lowering", "Lower", "create_cfunc_wrapper", _wrap_what_c_enters),
    ):
        of: Any = getattr(import_module(f"numba.core.{module}"), kind, None)
        usual = getattr(of, method, None)
        if usual:
            setattr(of, method, shortcut(usual))


def _same_flags(usual: Any) -> Any:
    """Flags are compared wherever a function is looked up: by those that are set, not by all forty."""

    def same(self: Any, other: Any) -> Any:
        if type(self) is not type(other):
            return usual(self, other)
        mine, others = self._values, other._values
        return mine == others or all(getattr(self, name) == getattr(other, name) for name in {*mine, *others})

    return same


def _any_flags(_: Any) -> Any:
    """Their hash was that of their names."""
    return lambda self: hash(type(self))


def _optimise_defined(usual: Any) -> Any:
    """Passes over single functions also went over each function that is only declared, as all are that it calls."""

    def optimise(self: Any, module: Any) -> None:
        module.data_layout = self._codegen._data_layout
        usual(self, SimpleNamespace(functions=[one for one in module.functions if not one.is_declaration]))

    return optimise


def _wrap_what_c_enters(usual: Any) -> Any:
    """A second way in, for C, was compiled for each function."""

    def wrap(self: Any) -> None:
        if not self.fndesc.modname.startswith(NOT_ENTERED_FROM_C):
            usual(self)

    return wrap
