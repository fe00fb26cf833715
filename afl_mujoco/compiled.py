"""The decorator of every compiled function, and access to memory by address in compiled code."""

from __future__ import annotations

import functools
import hashlib
import multiprocessing
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import caching
from numba.extending import intrinsic

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
    """Return a file and every file that it depends on."""
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


class _InTree(_Stamped, caching.InTreeCacheLocator):
    """The cache beside the source, if it can be written."""


class _UserWide(_Stamped, caching.UserWideCacheLocator):
    """The cache in the user's own cache folder."""


class _UserProvided(_Stamped, caching.UserProvidedCacheLocator):
    """The cache that ``NUMBA_CACHE_DIR`` names."""


class _CacheImplementation(caching.CompileResultCacheImpl):
    _locator_classes: list[Any] = [_UserProvided, _InTree, _UserWide]  # noqa: RUF012 (as the base class declares it)


class _Cache(caching.FunctionCache):
    _impl_class = _CacheImplementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return compiled code from the cache, None if there is none that can be read.

        Code compiled from an older source may refer to modules that are gone; numba fails on this
        before it compares the stamps.
        """
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except (ImportError, AttributeError):
            self.flush()  # type: ignore[no-untyped-call]
            return None


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
    """Return a compiled function whose code is kept on disk."""
    dispatcher: Any = njit(nogil=True, error_model="numpy", **options)(function)
    try:
        dispatcher._cache = _Cache(dispatcher.py_func)  # type: ignore[no-untyped-call]
    except RuntimeError as error:
        if "no locator" not in str(error):  # of a folder that can be written
            raise
        _warn_of_no_cache()
    return dispatcher


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


_DOUBLE = ir.DoubleType()


def _load(typingctx: Any, address: Any) -> Any:
    """Return the double at `address`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(builder.inttoptr(arguments[0], _DOUBLE.as_pointer()), typ=_DOUBLE)

    return types.float64(types.int64), generate


def _store(typingctx: Any, address: Any, value: Any) -> Any:
    """Write the double `value` to `address`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[1], builder.inttoptr(arguments[0], _DOUBLE.as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64, types.float64), generate


def _pointer(typingctx: Any, address: Any) -> Any:
    """Return `address` as a pointer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), generate


load: Any = intrinsic(_load)
"""Compiled code only: ``load(address)`` is the double at `address`."""

store: Any = intrinsic(_store)
"""Compiled code only: ``store(address, value)`` writes the double `value` to `address`."""

pointer: Any = intrinsic(_pointer)
"""Compiled code only: ``pointer(address)`` is what numba's `carray` takes."""
