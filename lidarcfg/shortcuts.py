"""Shortcuts through numba: what it does with every function that it compiles, and nobody needs.

They take a third off compiling and change nothing of what is compiled but how Python enters it. They replace methods
inside numba; where these are not as known, numba works as ever.
"""

from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

NOT_ENTERED_FROM_C = ("numba.", "lidarcfg.")  # modules whose functions nobody passes to other compiled functions
LONG = "lidarcfg."  # modules whose functions take long, beside what it takes to enter them


@cache
def take() -> None:
    """Take them from now on."""
    for module, kind, method, shortcut in (
        ("targetconfig", "TargetConfig", "__eq__", _same_flags),
        ("targetconfig", "TargetConfig", "__hash__", _any_flags),
        ("codegen", "CPUCodeLibrary", "_optimize_functions", _optimise_defined),
        ("lowering", "Lower", "create_cfunc_wrapper", _wrap_what_c_enters),
        ("callwrapper", "PyCallWrapper", "build", _enter_plainly),
        ("typeinfer", "TypeInferer", "resolve_call", _resolve_once),
        ("postproc", "PostProcessor", "run", _find_lifetimes_when_asked),
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


def _enter_plainly(usual: Any) -> Any:
    """What takes arrays out of Python's tuples was optimised, too, and in some loops it is half of the code."""

    def build(self: Any) -> None:
        usual(self)
        if self.fndesc.modname.startswith(LONG):
            entered = self.module.get_global(self.fndesc.llvm_cpython_wrapper_name).attributes
            entered.add("noinline")  # which the other one asks for
            entered.add("optnone")

    return build


def _resolve_once(usual: Any) -> Any:
    """Types spread through a function in several rounds, in each of which all its operators were looked up."""
    operator: Any = import_module("numba.core.types").Function

    def resolve(self: Any, function: Any, args: Any, kws: Any) -> Any:
        if not isinstance(function, operator):
            return usual(self, function, args, kws)
        known = vars(self).setdefault("_known", {})
        call = function, tuple(args), tuple(kws.items())
        if call not in known:
            known[call] = usual(self, function, args, kws)
        return known[call]

    return resolve


def _find_lifetimes_when_asked(usual: Any) -> Any:
    """After each pass it was found where variables live, which passes ask for that have it found anyway."""
    postproc: Any = import_module("numba.core.postproc")

    def run(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
        function = self.func_ir
        if emit_dels or function.is_generator:
            usual(self, emit_dels, extend_lifetimes)
            return
        function.blocks = postproc.transforms.canonicalize_cfg(function.blocks)
        function.variable_lifetime = postproc.VariableLifetime(function.blocks)  # which finds it when it is asked
        function.generator_info = None

    return run
