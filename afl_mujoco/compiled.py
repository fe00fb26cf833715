"""The decorator of every compiled function."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import caching


@functools.cache
def _fingerprint() -> str:
    """Return a hash of the package's whole source."""
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()


class _Stamped:
    """A cache locator that calls compiled code stale as soon as any source of the package changes.

    Numba looks only at the file of the compiled function, not at those of the functions it calls:
    after an edit of an equation in another file it would go on running the old one.
    """

    def get_source_stamp(self) -> str:
        """Return what the cached code was compiled from."""
        return _fingerprint()


class _InTree(_Stamped, caching.InTreeCacheLocator):
    """The cache beside the source, where that can be written."""


class _UserWide(_Stamped, caching.UserWideCacheLocator):
    """The user's cache elsewhere."""


class _UserProvided(_Stamped, caching.UserProvidedCacheLocator):
    """The cache that ``NUMBA_CACHE_DIR`` names."""


class _CacheImplementation(caching.CompileResultCacheImpl):
    _locator_classes: list[Any] = [_UserProvided, _InTree, _UserWide]  # noqa: RUF012 (as the base class declares it)


class _Cache(caching.FunctionCache):
    _impl_class = _CacheImplementation


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of floats and arrays on first use, and keep the result on disk.

    Parameters
    ----------
    function
        What to compile; it releases the interpreter lock and divides as NumPy does.

    Returns
    -------
    Any
        The compiled function.
    """
    dispatcher: Any = njit(nogil=True, error_model="numpy")(function)
    dispatcher._cache = _Cache(dispatcher.py_func)  # type: ignore[no-untyped-call]
    return dispatcher
