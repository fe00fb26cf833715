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


def require_own(folder: Path, names: Iterable[str]) -> None:
    """Raise if an import would not get the file of a folder, but one of another folder's.

    One process has one module of a name; an installed one has it before any folder.
    """
    waiting = [*names]
    for name in waiting:  # which grows
        base = folder.joinpath(*name.split("."))
        mine = [x for x in (base / "__init__.py", base.with_name(f"{base.name}.py")) if x.is_file()]
        if not mine:
            continue
        if "." not in name or not (base.parent / "__init__.py").is_file():  # else of its package
            if taken := of_another(mine[0], name):
                rule = f"must be of {mine[0]}: give one of the two another name"
                raise InvalidValueError(f"import of {name}", rule, taken)
        waiting += [one for one in imported_by(mine[0]) if one not in waiting]


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
    code = compile(path.read_bytes(), str(path), "exec", dont_inherit=True)
    exec(code, vars(module))


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
    try:
        require_own(path.parent, imported_by(path))
        run_in(module, path)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def import_from(folder: Path | None, name: str, thing: str, *, own: bool = False) -> ModuleType:
    """Return a module that is installed or in a folder, or raise in one line.

    folder: None for what was imported before, from a folder that is known no more.
    own: Whether a file of the folder is run aside where another folder's has its name.
    """
    here = folder or Path.cwd()
    look_in(here)
    with importing(thing):
        if folder is not None:
            file = folder / f"{name}.py"
            if own and file.is_file() and of_another(file, name):
                return run_file(file, name)
            require_own(folder, (name.partition(".")[0], name))
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name not in (name, name.split(".")[0]):
                rule = f"needs a module: {error}"
            else:
                rule = f"must be in a module that is installed or in {here}: {error}"
            missing: Any = InvalidValueError(thing, rule)
    raise missing
