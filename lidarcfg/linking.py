"""Code that only compiled loops call is optimised with them, and not also by itself.

numba optimises every function and generates machine code for it, and again in every function that calls it: for the
innermost of ten nested loops ten times. Most of what this makes serves calls from Python alone, which inner loops do
not get. Here their code waits until a function that can be called from Python takes it in; it waits in the cache, too,
where several such functions, or several processes, need it. Large functions that several others call stay apart: the
others call their machine code. This extends a class inside numba; where that is not as known, numba works as ever: as
right, and slower to start.
"""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

OF_PYTHON = ("_ZN", "cfunc.")  # begin the names that numba makes for functions written in Python
ENTRY = "_ZN7cpython"  # and for what Python calls
WAITING = "waiting"  # a kind of code in the cache, as "object" is one of numba's
KNOWN = {
    "JITCodeLibrary": (
        "finalize", "get_defined_functions", "get_pointer_to_function", "_get_module_for_linking", "_finalize_specific",
        "_finalize_dynamic_globals", "serialize_using_object_code", "_unserialize",
    ),
    "JITCPUCodegen": ("set_env", "_library_class"),
    "JitEngine": ("is_symbol_defined",),
}  # fmt: skip


class OutdatedError(LookupError):
    """Code in the cache calls code that is no longer there."""


@cache
def link_late() -> bool:
    """Have it so from now on. Returns whether this numba allows for it."""
    codegen: Any = import_module("numba.core.codegen")
    llvm: Any = import_module("llvmlite.binding")
    if not all(hasattr(getattr(codegen, name, None), method) for name, methods in KNOWN.items() for method in methods):
        return False
    waiting: dict[str, Any] = {}  # environments of functions without machine code, by their names in it
    set_env = codegen.JITCPUCodegen.set_env

    class Library(codegen.JITCodeLibrary):  # type: ignore[misc]  # numba has no types
        """Functions, and those that they call."""

        _waits = False
        _reload_init: set[Any]
        _needs: set[Any] | None = None  # of what stays apart, what loads the code that it calls

        def finalize(self) -> None:
            """Link what is called; optimise it and generate code where something outside calls this."""
            names = [function.name for function in self.get_defined_functions()]
            if not all(name.startswith(OF_PYTHON) and not name.startswith(ENTRY) for name in names):
                super().finalize()
                return
            for library in dict.fromkeys(self._linking_libraries):
                self._reload_init.update(library._reload_init)
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
            self._finalize_dynamic_globals()  # code that has some is not kept in the cache
            self._finalized = self._waits = True

        def stay_apart(self, load: Callable[[], None]) -> None:
            """Have functions that call these call machine code; `load` has it there when they come from the cache."""
            self._generate()
            self._needs, self._reload_init = self._reload_init, {load}
            self._shared_module = llvm.parse_assembly("")  # what others take in

        def _generate(self) -> None:
            if self._waits:
                self._waits = False
                self._optimize_final_module()
                self._finalize_final_module()

        def get_pointer_to_function(self, name: str) -> Any:
            """As numba's: 0 for what this does not define."""
            if self._waits and name in {function.name for function in self.get_defined_functions()}:
                self._generate()
            return super().get_pointer_to_function(name)

        def serialize_using_object_code(self) -> Any:
            """As numba's, for the cache; of code that waits, what waits. And what is called of what stays apart."""
            if self._waits:
                kind, data = WAITING, self._final_module.as_bitcode()
            else:
                _, kind, data = super().serialize_using_object_code()
            functions, variables = list(self._final_module.functions), list(self._final_module.global_variables)
            defined = [one.name for one in (*functions, *variables) if not one.is_declaration]
            called = [one.name for one in functions if one.is_declaration and one.name.startswith(OF_PYTHON)]
            if kind != WAITING and self._needs is None and not called:  # it may be read without this, by numba alone
                return self.name, kind, data
            needs = self._reload_init if self._needs is None else self._needs
            return self.name, kind, data, defined, called, needs

        @classmethod
        def _unserialize(cls, codegen: Any, state: Any) -> Any:
            name, kind, data, *links = state
            defined, called, needs = links or ((), (), ())  # code that calls nothing apart has none
            if not all(map(codegen._engine.is_symbol_defined, called)):  # numba has loaded what is needed
                raise OutdatedError
            if kind == WAITING:
                library = codegen.create_library(name)
                library._final_module = llvm.parse_bitcode(data)
                library._finalized = library._waits = True
            else:
                library = super()._unserialize(codegen, (name, kind, data))
                codegen._engine._defined_symbols.update(defined)
            library._reload_init.update(needs)
            return library

        def _finalize_specific(self) -> None:
            super()._finalize_specific()
            for variable in self._final_module.global_variables:
                if variable.name in waiting:
                    set_env(self._codegen, variable.name, waiting[variable.name])

    def set_env_late(self: Any, name: str, environment: Any) -> None:
        if self._engine.is_symbol_defined(name):
            set_env(self, name, environment)
        else:
            waiting[name] = environment

    codegen.JITCPUCodegen._library_class, codegen.JITCPUCodegen.set_env = Library, set_env_late
    return True
