"""Code of the user's: imported and called, whatever it raises told in one line."""

from __future__ import annotations

import ast
import importlib.util
import os
import signal
import site
import sys
import sysconfig
import threading
import time as clock
import traceback
import warnings
from collections.abc import Iterable, Iterator
from contextlib import chdir, contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakKeyDictionary

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


_ran = WeakKeyDictionary[ModuleType, bytes]()
"""What stood in the files of the user's modules when these were run."""


def renew(folder: Path, names: Iterable[str], known: dict[str, bool]) -> bool:
    """Run what imports would get of a folder again where a file changed; return whether one did.

    Raises if an import would not get the file of the folder, but one of another folder's: a process
    has one module of a name. An installed one has it before any folder.

    known: What was found of names before.
    """
    for name in names:
        if name not in known:
            known[name] = False  # for imports in a circle
            known[name] = _renewed(folder, name, known)
    return any(known[name] for name in names)


def _renewed(folder: Path, name: str, known: dict[str, bool]) -> bool:
    file = _file_of(folder, name)
    if file is None:
        return False
    if "." not in name or not _file_of(folder, name.rpartition(".")[0]):  # else of its package
        if taken := of_another(file, name):
            rule = f"must be of {file}: give one of the two another name"
            raise InvalidValueError(f"import of {name}", rule, taken)
    below = renew(folder, imported_by(file), known)
    module = sys.modules.get(name)
    if module is None or not _is_of(module, file) or _is_under_way(module):
        return False
    if module not in _ran and file.stat().st_mtime < afl_mujoco.STARTED:
        _ran[module] = file.read_bytes()  # whoever imported it
    if below or _ran.get(module) != file.read_bytes():
        run_in(module, file)
        return True
    return False


def _noted(folder: Path, names: Iterable[str]) -> None:
    """Note the files of a folder that have just been run."""
    for name in names:
        module, file = sys.modules.get(name), _file_of(folder, name)
        if module and file and _is_of(module, file):
            _ran.setdefault(module, file.read_bytes())


def _file_of(folder: Path, name: str) -> Path | None:
    """Return the user's file of a folder in which a module of a name would be."""
    base = folder.joinpath(*name.split("."))
    both = (base / "__init__.py", base.with_name(f"{base.name}.py"))
    found = (x for x in both if x.is_file() and not str(x).startswith(INSTALLED))
    return next(found, None)


def _is_of(module: ModuleType, file: Path) -> bool:
    return os.path.realpath(getattr(module, "__file__", None) or "") == os.path.realpath(file)


def _is_under_way(module: ModuleType) -> bool:
    """Return whether a module is being imported: it called us."""
    return bool(getattr(module.__spec__, "_initializing", False))


def of_another(file: Path, name: str) -> str:
    """Return the file of a user's that an import of a name gets in place of a file, if any."""
    with suppress(ValueError, ImportError):  # as `__main__` has no spec
        spec = importlib.util.find_spec(name)
        found = (spec and spec.origin) or ""
        if found.endswith(".py") and not found.startswith(INSTALLED):
            return found if os.path.realpath(found) != os.path.realpath(file) else ""
    return ""


def imported_by(file: Path) -> list[str]:
    """Return the modules that a file imports anywhere, each after the packages that it is in."""
    found = []
    with suppress(SyntaxError), warnings.catch_warnings(action="ignore"):  # told by who runs it
        for node in ast.walk(ast.parse(file.read_bytes(), str(file))):
            if isinstance(node, ast.Import):
                found += [one.name for one in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found += [f"{node.module}.{one.name}" for one in node.names]
    split = [name.split(".") for name in found]
    return [".".join(parts[: n + 1]) for parts in split for n in range(len(parts))]


def run_in(module: ModuleType, path: Path) -> None:
    """Run a file as a module, whatever Python's cache has: it knows no half seconds."""
    _ran[module] = text = path.read_bytes()
    try:
        exec(compile(text, str(path), "exec", dont_inherit=True), vars(module))
    except BaseException:
        _ran[module] = b""
        raise


ASIDE = "_aside_"
"""How the name of a module begins whose own name another file has."""


def run_file(path: Path, name: str) -> ModuleType:
    """Return the module of a file, executed anew, which imports from its folder."""
    known = sys.modules.get(name)
    if of_another(path, name) or (known and getattr(known, "__file__", None) != str(path)):
        name = ASIDE + name
    made = importlib.util.spec_from_file_location(name, path)
    assert made is not None  # it ends in .py
    sys.modules[name] = module = importlib.util.module_from_spec(made)
    beside = dict[str, bool]()
    try:
        renew(path.parent, imported_by(path), beside)
        run_in(module, path)
    except BaseException:
        del sys.modules[name]
        raise
    _noted(path.parent, beside)
    return module


def home_of(name: str) -> Path:
    """Return the folder from which an import gets a module, as another process did."""
    with suppress(ValueError, ImportError):  # as `__main__` has no spec
        spec = importlib.util.find_spec(name.partition(".")[0])
        origin = Path((spec and spec.origin) or "")
        if origin.suffix == ".py":
            return origin.parents[origin.name == "__init__.py"]
    return Path.cwd()


def import_from(folder: Path, name: str, thing: str, *, own: bool = False) -> ModuleType:
    """Return a module that is installed or in a folder, or raise in one line.

    own: Whether a file of the folder is run aside where another folder's has its name.
    """
    look_in(folder)
    with importing(thing):
        file, known = folder / f"{name}.py", dict[str, bool]()
        if own and file.is_file() and of_another(file, name):
            return run_file(file, name)
        renew(folder, (name.partition(".")[0], name), known)
        try:
            module = importlib.import_module(name)
            _noted(folder, known)
            return module
        except ModuleNotFoundError as error:
            if error.name not in (name, name.split(".")[0]):
                rule = f"needs a module: {error}"
            else:
                rule = f"must be in a module that is installed or in {folder}: {error}"
            missing: Any = InvalidValueError(thing, rule)
    raise missing
