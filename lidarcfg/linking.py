"""Code that only compiled loops call is optimised with them, and not also by itself.

numba optimises every function and generates machine code for it, and again in every function that calls it: for the
innermost of ten nested loops ten times. Most of what this makes serves calls from Python alone, which inner loops do
not get. Here their code waits until a function that can be called from Python takes it in; it waits in the cache, too,
where several such functions, or several processes, need it. This extends a class inside numba; where that is not as
known, numba works as ever: as right, and slower to start.
"""

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


@cache
def link_late() -> bool:
    """Have it so from now on. Returns whether this numba allows for it."""
    codegen: Any = import_module("numba.core.codegen")
    parse_bitcode: Any = import_module("llvmlite.binding").parse_bitcode
    if not all(hasattr(getattr(codegen, name, None), method) for name, methods in KNOWN.items() for method in methods):
        return False
    waiting: dict[str, Any] = {}  # environments of functions without machine code, by their names in it
    set_env = codegen.JITCPUCodegen.set_env

    class Library(codegen.JITCodeLibrary):  # type: ignore[misc]  # numba has no types
        """Functions, and those that they call."""

        _waits = False

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

        def get_pointer_to_function(self, name: str) -> Any:
            """As numba's: 0 for what this does not define."""
            if self._waits and name in {function.name for function in self.get_defined_functions()}:
                self._waits = False
                self._optimize_final_module()
                self._finalize_final_module()
            return super().get_pointer_to_function(name)

        def serialize_using_object_code(self) -> Any:
            """As numba's, for the cache; of code that waits, what waits."""
            if self._waits:
                return self.name, WAITING, self._final_module.as_bitcode()
            return super().serialize_using_object_code()

        @classmethod
        def _unserialize(cls, codegen: Any, state: Any) -> Any:
            name, kind, data = state
            if kind != WAITING:
                return super()._unserialize(codegen, state)
            library = codegen.create_library(name)
            library._final_module = parse_bitcode(data)
            library._finalized = library._waits = True
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
