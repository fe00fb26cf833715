"""Code of the user's: imported and called, whatever it raises told in one line."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import os
import signal
import site
import struct
import sys
import sysconfig
import threading
import time as clock
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import chdir, contextmanager, suppress
from functools import cache
from importlib.util import cache_from_source, resolve_name
from pathlib import Path
from types import ModuleType
from typing import Any

import afl_mujoco
from afl_mujoco.errors import AflMujocoError, InvalidValueError, meant, told

LIMIT = 60.0  # how long an import, or a call of what is called again and again, may take [s]

_PLACES = [sysconfig.get_path(x) for x in ("stdlib", "platstdlib", "purelib", "platlib")]
_PLACES += [*site.getsitepackages(), site.getusersitepackages(), str(Path(__file__).parent)]
INSTALLED = tuple(f"{place}/" for place in _PLACES)
"""How the paths of files begin that do not change between two runs; the last of our own."""


class Overrun(BaseException):
    """Interrupts a call that takes too long; ``except Exception`` in the call does not catch it."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise `Overrun` if the block takes longer: during the block where signals allow it."""
    in_main = threading.current_thread() is threading.main_thread()
    if not (in_main and hasattr(signal, "setitimer")):
        start = clock.perf_counter()
        yield
        if clock.perf_counter() - start > seconds:
            raise Overrun
        return

    rang = under_way = False

    def ring(number: int, frame: object) -> None:
        nonlocal rang
        if under_way:
            rang = True
            raise Overrun

    before = signal.signal(signal.SIGALRM, ring)
    left, interval = signal.setitimer(signal.ITIMER_REAL, seconds)
    start = clock.perf_counter()
    try:
        under_way = True
        yield
    finally:
        under_way = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before or signal.SIG_DFL)
        if left > 0.0:  # restart an alarm that the program had set
            remaining = max(left - (clock.perf_counter() - start), 1e-6)
            signal.setitimer(signal.ITIMER_REAL, remaining, interval)
    if rang:  # the user's function caught the exception that interrupted it
        raise Overrun


@contextmanager
def told_of(thing: str, did: str = "raised", *, given: Any = None) -> Iterator[None]:
    """Turn whatever code of the user's raises in the block into an error of one line.

    given: The parameters by name that the code was given; a name that it lacks gets a hint.
    """
    try:
        with limited(LIMIT):
            yield
    except AflMujocoError as error:  # it called the package wrongly
        frames = traceback.extract_tb(error.__traceback__)
        lines = [f":{frame.lineno}" for frame in frames if frame.filename == thing]
        raise error.within(f"{thing}{''.join(lines[-1:])}: ") from None
    except KeyboardInterrupt:
        raise
    except Overrun:
        raise InvalidValueError(thing, f"must be done within {LIMIT:g} s, but is not") from None
    except BaseException as error:
        rule = f"{did} {type(error).__name__}: {told(error)}"
        if given is not None and isinstance(error, AttributeError) and error.obj is given:
            rule += f"; p has {', '.join(vars(given))}{meant(error.name, list(vars(given)))}"
        raise InvalidValueError(thing, rule) from error


@contextmanager
def importing(thing: str) -> Iterator[None]:
    """Do the same around an import, after which the working folder is what it was."""
    with told_of(thing, "cannot be imported:"), chdir(os.curdir):
        yield


def look_in(folder: str | Path) -> None:
    """Find modules in a folder too; last, so that no user file hides an installed module."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


_ran: dict[str, tuple[bytes, object]] = {}
"""Of what was loaded by name or path: a digest of the user's files behind it, and its spec."""

_loading = threading.RLock()


def files_behind(folder: Path, names: Iterable[str]) -> dict[str, tuple[Path, bytes]]:
    """Return the user's files that imports of some modules run, and their texts, by module.

    Raises if an import would not get the file of the folder, but one of another folder's: a process
    has one module of a name. An installed one has it before any folder.
    """
    found: dict[str, tuple[Path, bytes]] = {}
    waiting = [*names]
    for name in waiting:  # which grows
        file = None if name in found else _file_of(folder, name)
        if file is None:
            continue
        if "." not in name or not _file_of(folder, name.rpartition(".")[0]):  # else of its package
            if taken := of_another(file, name):
                rule = f"must be of {file}: give one of the two another name"
                raise InvalidValueError(f"import of {name}", rule, taken)
        text = file.read_bytes() if file.is_file() else b"# is gone"
        found[name] = file, text
        waiting += imported_by(text, name, file.name == "__init__.py")
    return found


def _joined(files: Mapping[str, tuple[Path, bytes]]) -> bytes:
    return b"\0".join(text for _, text in files.values())


def _noted(key: str, text: bytes) -> None:
    spec = getattr(sys.modules.get(key), "__spec__", None)
    _ran[key] = hashlib.sha256(text).digest(), spec


def _forget_edited(key: str, files: Mapping[str, tuple[Path, bytes]]) -> None:
    """Forget the modules of files if one changed since they ran, so that imports run all anew.

    One that the user imported may have been, as `_is_edited` says.
    """
    ours = {name: file for name, (file, _) in files.items() if _is_of(name, file)}
    digest, spec = _ran.get(key, (b"", key))
    if spec is getattr(sys.modules.get(key), "__spec__", None):
        edited = digest != hashlib.sha256(_joined(files)).digest()
    else:
        edited = any(_is_edited(sys.modules[name], file) for name, file in ours.items())
    if edited:
        for name, file in ours.items():
            del sys.modules[name]
            with suppress(OSError):  # of Python's, which knows no edits within a second
                os.unlink(cache_from_source(file))
        importlib.invalidate_caches()


def _is_edited(module: ModuleType, file: Path) -> bool:
    """Return whether a file may have been edited since Python imported it.

    It is not what Python compiled, by size and time, or, where it keeps nothing, newer than us.
    """
    if getattr(getattr(module, "__spec__", None), "_initializing", False):  # it is calling us
        return False
    if not file.is_file():
        return True
    now = file.stat()
    with suppress(OSError, struct.error):
        flags, time, size = struct.unpack("<4xLLL", Path(cache_from_source(file)).read_bytes()[:16])
        return not flags and (time, size) != (int(now.st_mtime) % 2**32, now.st_size % 2**32)
    return now.st_mtime > afl_mujoco.STARTED


def _file_of(folder: Path, name: str) -> Path | None:
    """Return the user's file of a folder in which a module of a name is, or was."""
    base = folder.joinpath(*name.split("."))
    both = (base / "__init__.py", base.with_name(f"{base.name}.py"))
    found = (x for x in both if x.is_file() or _is_of(name, x))
    return next((x for x in found if not str(x).startswith(INSTALLED)), None)


def _is_of(name: str, file: Path) -> bool:
    """Return whether a module that was imported is that of a file."""
    found = getattr(sys.modules.get(name), "__file__", None)
    return found is not None and os.path.realpath(found) == os.path.realpath(file)


def of_another(file: Path, name: str) -> str:
    """Return the file of a user's that an import of a name gets in place of a file, if any."""
    with suppress(ValueError, ImportError):  # as `__main__` has no spec
        spec = importlib.util.find_spec(name)
        found = (spec and spec.origin) or ""
        if found.endswith(".py") and not found.startswith(INSTALLED):
            return found if os.path.realpath(found) != os.path.realpath(file) else ""
    return ""


@cache
def imported_by(text: bytes, name: str, package: bool) -> tuple[str, ...]:
    """Return the modules that a source imports anywhere, each after the packages that it is in."""
    found, here = [], name if package else name.rpartition(".")[0]
    # whoever runs it tells what is wrong with it
    with suppress(SyntaxError, ValueError), warnings.catch_warnings(action="ignore"):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                found += [one.name for one in node.names]
            elif isinstance(node, ast.ImportFrom):
                with suppress(ImportError):
                    base = resolve_name("." * node.level + (node.module or ""), here)
                    found += [f"{base}.{one.name}" for one in node.names]
    split = [name.split(".") for name in found]
    return tuple(".".join(parts[: n + 1]) for parts in split for n in range(len(parts)))


ASIDE = "_aside_"
"""How the name of a module begins whose own name another file has."""


def run_file(path: Path, name: str) -> tuple[ModuleType, bytes]:
    """Return the module of a file, executed anew, and the texts of it and of the files behind it.

    It imports from its folder.
    """
    text = path.read_bytes()
    with _loading:
        beside = files_behind(path.parent, imported_by(text, name, False))
        _forget_edited(str(path), beside)
        known = sys.modules.get(name)
        if of_another(path, name) or (known and getattr(known, "__file__", None) != str(path)):
            name = ASIDE + name
        made = importlib.util.spec_from_file_location(name, path)
        assert made is not None  # it ends in .py
        sys.modules[name] = module = importlib.util.module_from_spec(made)
        try:
            exec(compile(text, str(path), "exec", dont_inherit=True), vars(module))
        except BaseException:
            sys.modules.pop(name, None)
            raise
        _noted(str(path), behind := _joined(beside))
    return module, b"\0".join([text, behind]) if beside else text


def home_of(name: str) -> Path:
    """Return the folder from which an import gets a module."""
    with suppress(ValueError, ImportError):  # as `__main__` has no spec
        spec = importlib.util.find_spec(name.partition(".")[0])
        origin = Path((spec and spec.origin) or "")
        if origin.suffix == ".py":
            return origin.parents[origin.name == "__init__.py"]
    return Path.cwd()


def import_from(
    folder: Path, name: str, thing: str, *, own: bool = False
) -> tuple[ModuleType, bytes]:
    """Return a module, installed or in a folder, and the texts of the user's files behind it.

    own: Whether a file of the folder is run aside where another folder's has its name.
    """
    look_in(folder)
    with importing(thing), _loading:
        file, top = folder / f"{name}.py", name.partition(".")[0]
        if own and file.is_file() and of_another(file, name):
            return run_file(file, name)
        files = files_behind(folder if _file_of(folder, top) else home_of(name), (top, name))
        _forget_edited(name, files)
        try:
            module = importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name not in (name, top):
                rule = f"needs a module: {error}"
            else:
                rule = f"must be in a module that is installed or in {folder}: {error}"
            missing: Any = InvalidValueError(thing, rule)
        else:
            _noted(name, text := _joined(files))
            return module, text
    raise missing
