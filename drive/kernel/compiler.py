"""Compile the blocks of an entry without what Numba does for other code.

Linking. Numba makes a library of each function. When the library is finished, all that the function
calls is copied into it, optimised with it and made machine code. A block nested ten deep is so
optimised ten times and most of the machine code never called. A `Library` of this file only keeps
its own code until somebody needs the machine code of it: Python, which calls an entry, or a library
of another kind, which copies it. Then everything below is linked, and optimised at once, as code
that nobody else calls: blocks go into their callers, and what all calls have in common goes away.

Optimising. That gains more than LLVM's higher levels do (`PASSES`), which take twice as long, for
loops over arrays that are not here. A `rare` block stays out of the way of what runs each cycle.

Passes. A `Pipeline` leaves out those that would find nothing in a block, and their protocol.

Loading. Numba imports all of SciPy's linear algebra before it loads or compiles anything, only to
see that it is there: 0.2 s of each start. `without_linear_algebra` asks whether it is installed.

While an entry is compiled (`compiling`), Numba does without what costs much and leaves the code as
it is: writing out the type of a record, hundreds of fields, for each pass and each field that is
read; asking all implementations of ``+`` again for each addition; working out after each pass where
variables die, which is needed once; looking for garbage. The optimised code stays the same.
"""

import contextlib
import functools
import gc
import importlib.util
from collections.abc import Iterator
from types import CodeType
from typing import Any, ClassVar

import llvmlite.binding as llvm
from numba import types
from numba.core import errors, postproc, transforms
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, _pass_registry, register_pass
from numba.core.typed_passes import AnnotateTypes, NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes

PASSES = {"opt": 1, "loop_vectorize": False, "slp_vectorize": False}  # of LLVM


class _NoEnvironment:
    """Takes what only code that calls Python needs: compiled blocks do not."""

    @staticmethod
    def set_env(name: str, environment: object) -> None:
        """Called for each function when it is compiled."""


class Library(JITCodeLibrary):
    """The code of one function, linked with what it calls when it is to be run."""

    @property
    def codegen(self) -> Any:
        """Numba's; nothing can be written into what is not machine code yet."""
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

    def _optimize_functions(self, module):
        """Tidy up each function as it comes: less to keep until all are linked."""
        module.data_layout = self._codegen._data_layout
        for function in module.functions:
            passes, builder = self._codegen._function_pass_manager(**PASSES)
            passes.run(function, builder)

    def _optimize_final_module(self):
        """Optimise what is linked, which nobody else calls: each block then fits its caller."""
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.weak_odr:
                function.linkage = "internal"
        passes, builder = self._codegen._module_pass_manager(**PASSES)
        passes.run(self._final_module, builder)

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
                # several may hold it; taken over even if what calls it is linked later
                function.linkage = "weak_odr"
        return module


class _Passes(PassManager):
    """Runs passes; Numba's own also words a protocol of each, whether somebody reads it or not."""

    def run(self, state):
        """One pass after the other, on the function that is compiled."""
        for kind, description in self.passes:
            step = _pass_registry.get(kind).pass_inst
            step.analysis = self._analysis
            try:
                step.run_initialization(state)
                step.run_pass(state)
                step.run_finalizer(state)
            except errors.NumbaError as error:
                where = f"Failed in {self.pipeline_name} mode pipeline (step: {description})"
                raise self._patch_error(where, error) from error


@register_pass(mutates_CFG=True, analysis_only=False)
class _ArrayRewrites(NopythonRewrites):
    """What is rewritten when types are known: operations on whole arrays, words as keys."""

    _name = "servogym_array_rewrites"

    def run_pass(self, state):
        """Look for them only where there are any."""
        for signature in state.calltypes.values():
            kinds = signature and (signature.return_type, *signature.args)
            if kinds and any(isinstance(kind, types.Array | types.StringLiteral) for kind in kinds):
                return super().run_pass(state)
        return False


class Pipeline(CompilerBase):
    """Numba's passes but those for closures, where there are none, and for its reports."""

    _passes: ClassVar[dict[bool, _Passes]] = {}

    def define_pipelines(self):
        """The passes for the function that is compiled: made once, they keep nothing of it."""
        constants = self.state.func_id.code.co_consts
        closures = any(isinstance(constant, CodeType) for constant in constants)
        if closures not in self._passes:
            passes = self._passes[closures] = _Passes("nopython")
            left_out = {AnnotateTypes} if closures else {AnnotateTypes, InlineClosureLikes}
            for kind, text in DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
                if kind not in left_out:
                    passes.add_pass(_ArrayRewrites if kind is NopythonRewrites else kind, text)
            passes.finalize()
        return [self._passes[closures]]


_process = postproc.PostProcessor.run
_call_type = types.BaseFunction.get_call_type


def _process_once(self, emit_dels=False, extend_lifetimes=False):
    """Numba's clean-up after a pass: where variables die is worked out when it is written down."""
    function = self.func_ir
    if emit_dels or function.is_generator:
        return _process(self, emit_dels, extend_lifetimes)
    function.blocks = transforms.canonicalize_cfg(function.blocks)
    function.variable_lifetime = postproc.VariableLifetime(function.blocks)  # when it is asked
    function.generator_info = None


def _remembering() -> Any:
    """`get_call_type` of Numba's functions, which is asked once for each kind of numbers."""
    known: dict[tuple, Any] = {}

    def get_call_type(self, context, args, kws):
        if kws or not all(isinstance(kind, types.Number | types.Boolean) for kind in args):
            return _call_type(self, context, args, kws)
        key = self, tuple(args)
        if key not in known:
            known[key] = _call_type(self, context, args, kws)
        return known[key]

    return get_call_type


@contextlib.contextmanager
def _instead(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Give an attribute another value for a while."""
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


def _has_blas() -> None:
    if importlib.util.find_spec("scipy") is None:
        raise ImportError("scipy is required for linear algebra")


@functools.cache
def without_linear_algebra() -> None:
    """Load what Numba has for arrays; a function that needs SciPy imports it when compiled."""
    from numba.np import linalg

    with _instead(linalg, "ensure_blas", _has_blas):
        from numba.np import arraymath  # noqa: F401


@contextlib.contextmanager
def _no_collection() -> Iterator[None]:
    """Collect no garbage: what a compiler makes is kept, and looked through in vain."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextlib.contextmanager
def compiling(codegen: Any) -> Iterator[None]:
    """Compile meanwhile as this file says; the caller holds the compiler lock."""
    if codegen._library_class is Library:  # an entry within an entry
        yield
        return
    with contextlib.ExitStack() as changed:
        for owner, name, value in (
            (codegen, "_library_class", Library),
            (types.Record, "__repr__", types.Type.__repr__),  # its name, made once
            (types.BaseFunction, "get_call_type", _remembering()),
            (postproc.PostProcessor, "run", _process_once),
        ):
            changed.enter_context(_instead(owner, name, value))
        changed.enter_context(_no_collection())
        yield
