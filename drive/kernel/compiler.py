"""Compile the blocks of an entry without the steps of Numba that only other code needs.

Linking. Numba makes a library of each function. When it finishes a library, it copies everything
that the function calls into it, optimises it, and generates machine code. A block nested ten deep
is thus optimised ten times, and most of the machine code is never called. A `Library` of this file
keeps its own code until its machine code is needed: by Python, which calls an entry, or by a
library of another kind, which copies it. Only then is everything below linked and optimised at
once, as code without other callers, so that blocks are inlined and common code is shared.

Optimising. This gains more than LLVM's higher levels do (`PASSES`), which take twice as long to
optimise loops over arrays that do not occur here. A `rare` block is placed out of line.

Passes. A `Pipeline` leaves out the passes that find nothing in a block, and the log of all passes.

Loading. Numba imports all of SciPy's linear algebra before it loads or compiles anything, only to
check that it exists, which takes 0.2 s at each start. `without_linear_algebra` checks whether SciPy
is installed instead.

While an entry is compiled (`compiling`), Numba skips expensive work that does not change the code:
writing out the type of a record with its hundreds of fields for each pass and each field access;
resolving ``+`` among all its implementations again for each addition; computing variable lifetimes
after each pass, which are needed once; and collecting garbage. The optimised code stays the same.
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
    """Accepts the environment that only code that calls Python needs; blocks do not."""

    @staticmethod
    def set_env(name: str, environment: object) -> None:
        """Ignore the environment of a function."""


class Library(JITCodeLibrary):
    """The code of one function, linked with its callees when it is needed as machine code."""

    @property
    def codegen(self) -> Any:
        """Numba's code generator; without machine code, environments are ignored."""
        return self._codegen if self._finalized else _NoEnvironment

    def add_linking_library(self, library):
        """Note a library that this one calls."""
        if not isinstance(library, Library):
            library._ensure_finalized()
        self._linking_libraries.append(library)

    def finalize(self):
        """Link and optimise everything that is called, directly or not; generate machine code."""
        below: dict[Any, None] = {}
        self._gather(below)
        below.pop(self, None)
        self._linking_libraries = [_Part(library) for library in below]
        super().finalize()

    def _optimize_functions(self, module):
        """Simplify each function early, so that less code is kept until everything is linked."""
        module.data_layout = self._codegen._data_layout
        for function in module.functions:
            passes, builder = self._codegen._function_pass_manager(**PASSES)
            passes.run(function, builder)

    def _optimize_final_module(self):
        """Optimise the linked code, which has no other callers, so that blocks can be inlined."""
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
        """Return the address of a function, 0 if this library lacks it; needs machine code."""
        if not self._finalized:
            here = {function.name for function in self.get_defined_functions()}
            if name not in here:
                return 0
        return super().get_pointer_to_function(name)


class _Part:
    """The contribution of a library to one that links it together with all others."""

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
                # several libraries may hold it, and its callers may be linked later
                function.linkage = "weak_odr"
        return module


class _Passes(PassManager):
    """Runs passes without the log that Numba writes of each one."""

    def run(self, state):
        """Run the passes in order on the function that is being compiled."""
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
    """Rewrites of typed code: operations on whole arrays, and strings as keys."""

    _name = "servogym_array_rewrites"

    def run_pass(self, state):
        """Run only if the function has such operations."""
        for signature in state.calltypes.values():
            kinds = signature and (signature.return_type, *signature.args)
            if kinds and any(isinstance(kind, types.Array | types.StringLiteral) for kind in kinds):
                return super().run_pass(state)
        return False


class Pipeline(CompilerBase):
    """Numba's passes without reports, and without those for closures if there are none."""

    _passes: ClassVar[dict[bool, _Passes]] = {}

    def define_pipelines(self):
        """Return the passes for the function; they are stateless, so they are created once."""
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
    """Numba's clean-up after a pass; variable lifetimes are computed only when they are used."""
    function = self.func_ir
    if emit_dels or function.is_generator:
        return _process(self, emit_dels, extend_lifetimes)
    function.blocks = transforms.canonicalize_cfg(function.blocks)
    function.variable_lifetime = postproc.VariableLifetime(function.blocks)  # computed lazily
    function.generator_info = None


def _remembering() -> Any:
    """Return a `get_call_type` that resolves each combination of number types once."""
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
    """Replace an attribute temporarily."""
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
    """Load Numba's array functions; code that uses linear algebra imports SciPy when compiled."""
    from numba.np import linalg

    with _instead(linalg, "ensure_blas", _has_blas):
        from numba.np import arraymath  # noqa: F401


@contextlib.contextmanager
def _no_collection() -> Iterator[None]:
    """Suspend garbage collection: the compiler's objects live on, so a search finds nothing."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextlib.contextmanager
def compiling(codegen: Any) -> Iterator[None]:
    """Compile as this file describes; the caller holds the compiler lock."""
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
