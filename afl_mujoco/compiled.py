"""The decorators of compiled functions, and access to memory by address in compiled code.

`kernel` is called from Python and kept on disk; `jitable` is called from compiled code, where
either is a part of its caller. What belongs to a user (equations, controllers in Python, what rates
of parameters do) has an address, a `Callback`, that compiled code jumps to by `call`: the loops are
compiled once, whoever's functions they call, and `watched` raises what these raised.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import multiprocessing
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import caching, sigutils
from numba.core.ccallback import CFunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering, NativeParforLowering
from numba.extending import intrinsic, register_jitable

from afl_mujoco.errors import AflMujocoWarning

_ROOT = Path(__file__).parents[1]
_IMPORT = re.compile(r"^\s*(?:from|import) ([\w.]+)(?: import (\([^)]*\)|[^\n]*))?", re.MULTILINE)


@functools.cache
def _imported(file: Path) -> frozenset[Path]:
    """Return the files of the package, or of that of a file beside it, that the file imports."""
    own = {Path(__file__).parent.name, file.relative_to(_ROOT).parts[0]}
    found = set()
    for module, names in _IMPORT.findall(file.read_text(encoding="utf-8")):
        parts = module.split(".")
        if parts[0] in own:
            path = _ROOT.joinpath(*parts)
            for part in (path, *(path / word for word in re.findall(r"\w+", names))):
                found |= {part.with_suffix(".py"), part / "__init__.py"}
    return frozenset(path for path in found if path.is_file())


@functools.cache
def _needed(file: Path) -> frozenset[Path]:
    needed, waiting = {file}, [file]
    while waiting:
        fresh = _imported(waiting.pop()) - needed
        needed |= fresh
        waiting += fresh
    return frozenset(needed)


@functools.cache
def _fingerprint(file: Path) -> str:
    """Return a hash of everything that the compiled functions of a file depend on."""
    digest = hashlib.blake2b(digest_size=16)
    for source in sorted(_needed(file)):  # with names: compiled code refers to its modules
        digest.update(str(source.relative_to(_ROOT)).encode() + source.read_bytes())
    return digest.hexdigest()


class _Stamped:
    """A cache locator for which compiled code is stale as soon as a source it depends on changes.

    Numba looks only at the file of the compiled function, not at those of the functions it calls:
    after an edit of an equation in another file it would still run the old one.
    """

    _py_file: str

    def get_source_stamp(self) -> str:
        """Return what the cached code was compiled from."""
        return _fingerprint(Path(self._py_file))


# the folder that ``NUMBA_CACHE_DIR`` names, else that of the source, else the user's own
_FOLDERS = (
    caching.UserProvidedCacheLocator,
    caching.InTreeCacheLocator,
    caching.UserWideCacheLocator,
)


class _CacheImplementation(caching.CompileResultCacheImpl):
    _locator_classes: list[Any] = [type(one.__name__, (_Stamped, one), {}) for one in _FOLDERS]  # noqa: RUF012 (as the base class declares it)


class _Cache(caching.FunctionCache):
    _impl_class = _CacheImplementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return compiled code from the cache, None if there is none that can be read.

        Code compiled from an older source may refer to modules that are gone; numba fails on this
        before it compares the stamps.
        """
        try:
            return super().load_overload(sig, target_context)
        except (ImportError, AttributeError):
            self.flush()
            return None


class _PartLibrary(JITCodeLibrary):
    """Code that is only linked into that of its callers.

    Numba optimises each function, and makes machine code of it, before it does both again in each
    that calls it: more than half of the time of a first run.
    """

    @property
    def codegen(self) -> Any:
        """The code generator; there is no machine code whose environment it could set."""
        return _NoEnvironment(self._codegen)

    def _optimize_final_module(self) -> None:
        """Leave it to the callers."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return that there is no machine code."""
        self._ensure_finalized()
        return 0


class _NoEnvironment:
    """A code generator that sets no environment."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing."""


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    """Lower a function into a library without machine code."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


class _PartCompiler(Compiler):
    """Numba's compiler with that pass."""

    def define_pipelines(self) -> list[Any]:
        found: list[Any] = super().define_pipelines()
        for one in found:
            one.passes = [
                (_PartLowering if kind in (NativeLowering, NativeParforLowering) else kind, why)
                for kind, why in one.passes
            ]
        return found


_PART: dict[str, Any] = {
    "pipeline_class": _PartCompiler,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


def jitable(function: Callable[..., Any]) -> Any:
    """Let compiled code call a function of Python, which stays one for the interpreter."""
    return register_jitable(**_PART)(function)


def inlined_jitable(function: Callable[..., Any]) -> Any:
    """Do the same, and inline it into each function that calls it."""
    return register_jitable(**_PART, forceinline=True)(function)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of floats and arrays on first use, and keep the result on disk."""
    return _compiled(function)


def borrowing_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that only borrows its arrays, as `kernel` does.

    Numba counts a reference to every array at every call, with two atomic instructions: too slow
    for functions that are called many times in a microsecond. This decorator turns that off, so the
    function may neither make an array nor return one, and its caller must keep the arrays alive.
    """
    return _compiled(function, _nrt=False)


def inlined_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function as `borrowing_kernel` does, into each function that calls it.

    What is called in every step has many arrays, and to hand them over takes longer than its work.
    """
    return _compiled(function, _nrt=False, forceinline=True)


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    """Return a compiled function whose code is kept on disk.

    What compiled code calls is another copy, a part of its caller.
    """
    settings = {"nogil": True, "error_model": "numpy", **options}
    compiling: Any = njit
    dispatcher, called = (compiling(**one)(function) for one in (settings, settings | _PART))
    _keep(dispatcher, function)
    ordinary, unliteral = called.get_call_template, cast(Any, types.unliteral)

    def typed(arguments: Any, named: Any) -> Any:
        """Type a call by the types of its constants: numba would compile once for each of them."""
        return ordinary([unliteral(one) for one in arguments], named)

    dispatcher.get_call_template, dispatcher.get_overload = typed, called.get_overload
    return dispatcher


def _keep(compiled: Any, function: Callable[..., Any]) -> None:
    """Let numba keep compiled code on disk, if a folder can be written."""
    try:
        compiled._cache = _Cache(function)
    except RuntimeError as error:
        if "no locator" not in str(error):  # of a folder that can be written
            raise
        _warn_of_no_cache()


@functools.cache
def _warn_of_no_cache() -> None:
    """Warn, once and not in every worker, that compiled code cannot be kept."""
    if multiprocessing.parent_process() is not None:
        return
    warnings.warn(
        "no folder for compiled code can be written: every command compiles anew; "
        "set NUMBA_CACHE_DIR to a folder that can",
        AflMujocoWarning,
        stacklevel=2,
    )


_NUMBERS = types.CPointer(types.float64)
_CALLED = types.void(types.float64, _NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS)
_IN_PYTHON = ctypes.CFUNCTYPE(None, ctypes.c_double, *[ctypes.c_size_t] * 4)


class Callback:
    """A function (time, x, u, p, out) that compiled code calls by its address, to fill `out`.

    Whose function it is does not change the code that calls it, so that this compiles once.
    """

    def __init__(self, function: Any, sizes: tuple[int, int, int, int] | None = None) -> None:
        """Take a function of Python and the sizes of its arrays, or one for numba to compile.

        Numba hands pointers to the latter. What the former raises is kept for `watched`.
        """
        self._error: BaseException | None = None
        if sizes is None:
            signature = sigutils.normalize_signature(_CALLED)
            options = {"nopython": True, "error_model": "numpy"}
            made: Any = CFunc(function, signature, {}, options)
            _keep(made, function)
            made.compile()
            self._called, self.address = made, int(made.address)
            return
        kinds: Any = [ctypes.c_double * size for size in sizes]

        def called(time: float, *addresses: int) -> None:
            if self._error is not None:
                return
            try:
                pairs = zip(kinds, addresses, strict=True)
                function(
                    time, *(np.ndarray(k._length_, buffer=k.from_address(a)) for k, a in pairs)
                )
            except BaseException as error:
                self._error = error

        self._called = _IN_PYTHON(called)
        self.address = int(ctypes.cast(self._called, ctypes.c_void_p).value or 0)

    @contextlib.contextmanager
    def watched(self) -> Iterator[None]:
        """Run compiled code that calls it, then raise what it raised, or a Ctrl-C before it."""
        usual = sys.unraisablehook

        def keep(event: Any) -> None:
            if isinstance(event.exc_value, KeyboardInterrupt):
                self._error = event.exc_value
            else:
                usual(event)

        sys.unraisablehook = keep
        try:
            yield
        finally:
            sys.unraisablehook = usual
        if self._error is not None:
            error, self._error = self._error, None
            raise error


_DOUBLE = ir.DoubleType()


def _load(typingctx: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(builder.inttoptr(arguments[0], _DOUBLE.as_pointer()), typ=_DOUBLE)

    return types.float64(types.int64), generate


def _store(typingctx: Any, address: Any, value: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[1], builder.inttoptr(arguments[0], _DOUBLE.as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64, types.float64), generate


def _call(typingctx: Any, address: Any, time: Any, x: Any, u: Any, p: Any, out: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place, now, *arrays = arguments
        kinds = signature.args[2:]
        pairs = zip(kinds, arrays, strict=True)
        numbers = [context.make_array(kind)(context, builder, array).data for kind, array in pairs]
        pointer_to = _DOUBLE.as_pointer()
        function = ir.FunctionType(ir.VoidType(), [_DOUBLE, *[pointer_to] * 4])
        builder.call(builder.inttoptr(place, function.as_pointer()), [now, *numbers])
        return context.get_dummy_value()

    return types.void(types.int64, types.float64, x, u, p, out), generate


load: Any = intrinsic(_load)  # compiled code only: ``load(address)`` is the double at `address`

call: Any = intrinsic(_call)
"""Compiled code only: ``call(address, time, x, u, p, out)`` calls a `Callback`; arrays are
contiguous."""

store: Any = intrinsic(_store)  # compiled code only: ``store(address, value)`` writes a double
