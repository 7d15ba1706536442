"""Link the blocks of an entry once: what Numba does at every call, on the whole of what is below.

Numba makes a library of each function. When the library is finished, all that the function calls is
copied into it, optimised with it and made machine code. A block nested ten deep is so optimised ten
times and most of the machine code never called. A `Library` of this file only keeps its own code
until somebody needs the machine code of it: Python, which calls an entry, or a library of another
kind, which copies it. Then everything below is linked, and optimised at once.
"""

import contextlib
from collections.abc import Iterator
from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary


class _NoEnvironment:
    """Takes what only code that calls Python needs: compiled blocks do not."""

    @staticmethod
    def set_env(name: str, environment: object) -> None:
        """Called for each function when it is compiled."""


class Library(JITCodeLibrary):
    """The code of one function, linked with what it calls when it is to be run."""

    @property
    def codegen(self) -> Any:
        """Numba's; nothing can be written into what is no machine code yet."""
        return self._codegen if self._finalized else _NoEnvironment

    def add_linking_library(self, library):
        """Take note of a library that this one calls."""
        if not isinstance(library, Library):
            library._ensure_finalized()
        self._linking_libraries.append(library)

    def finalize(self):
        """Link all that is called, directly or not, optimise it and make machine code."""
        below: dict[Any, None] = {}
        self._gather(below)
        below.pop(self, None)
        self._linking_libraries = [_Part(library) for library in below]
        super().finalize()

    def _gather(self, below: dict[Any, None]) -> None:
        for library in self._linking_libraries:
            if library not in below:
                below[library] = None
                if isinstance(library, Library) and not library._finalized:
                    library._gather(below)

    def get_pointer_to_function(self, name):
        """Address of a function, 0 where it is not here; now machine code is needed."""
        if not self._finalized:
            here = {function.name for function in self.get_defined_functions()}
            if name not in here:
                return 0
        return super().get_pointer_to_function(name)


class _Part:
    """What a library contributes to one that links it and all the others itself."""

    def __init__(self, library):
        self._library = library
        self._reload_init = library._reload_init

    def _get_module_for_linking(self):
        library = self._library
        if library._finalized:
            return library._get_module_for_linking()
        module = library._final_module.clone()
        for function in module.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = "linkonce_odr"  # several may hold it, unused it is left out
        return module


@contextlib.contextmanager
def linking_once(codegen: Any) -> Iterator[None]:
    """Make all that is compiled meanwhile a `Library`; the caller holds the compiler lock."""
    before = codegen._library_class
    codegen._library_class = Library
    try:
        yield
    finally:
        codegen._library_class = before
