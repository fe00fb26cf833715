"""The parts of every study, and which studies there are.

A study is a module of `afl_mujoco.studies`. Its first line is what the list of commands says of it;
it has

``Options``
    A frozen dataclass, the options of the command, each with a default; ``quick`` is one of them in
    the studies that ``make robustness`` runs. Their docstrings are the help texts; that of the
    class has an example.
``prepare(options)``
    Returns what is run, with `scenarios` and `controllers`, or raises if a rule is broken, before
    anything slow. Nothing is parsed after it.
``run(request)``
    Returns the result; ``progress``, ``workers`` and ``cluster`` are arguments if it takes them.
``Result``
    A frozen dataclass of types that pydantic supports, of `Array` and of `Rows`.
``report(result)``
    The only place that puts the study into words: one headline, one figure, one table.
``films(request, result, command)``
    Only for a study whose request has ``film``: what to film, once its figures are drawn.
``require_files(folder)``, ``write_files(result, folder)``
    Only for a study that writes more than figures: raises before the run; returns what it wrote.

`STUDY` names the module, and is read as text. The list of commands imports no study, and a command
only its own.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import tyro

import afl_mujoco.studies as package
from afl_mujoco.control.names import KNOWN, REFERENCE, SUBJECT
from afl_mujoco.errors import UnknownNameError
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.report.blocks import Report

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many parts of it are done, and how many there are.

Behind a colon, what is being done may name the part that was done last.
"""

ScenarioNames = Annotated[
    tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO ...")
]
"""Scenarios by name or file, before the options."""

ScenarioName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")]
"""A scenario by name or file, before the options."""

ScenarioIfAny = Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[SCENARIO]")]
"""The same, but optional."""


def named_controllers(default: str) -> Any:
    """Return what makes an option that takes controllers by name, and says which it has if none."""
    said = f"Controllers by name: {KNOWN} By default {default}; of another plant lqr."
    return tyro.conf.arg(help=said)


_LONGEST = "by default the longest up to 0.001 that divides the control period."
Timestep = Annotated[float | None, tyro.conf.arg(help=f"Physics step of MuJoCo [s]; {_LONGEST}")]
"""How long a physics step is at most."""

ControllerNames = Annotated[tuple[str, ...], named_controllers(f"{SUBJECT} and {REFERENCE}")]
"""Controllers by name, as `control.names.find_controllers` takes them."""


class Interrupted(KeyboardInterrupt):
    """A Ctrl-C during a study that keeps what it has found: a result, and how much of it."""

    def __init__(self, result: Any, done: str) -> None:
        super().__init__(done)
        self.result, self.done = result, done


def silent(doing: str, done: int, total: int) -> None:
    """Report no progress."""


def counted(
    progress: Progress, doing: str, total: int, names: Sequence[str] = ()
) -> Callable[[Any], None]:
    """Return what reports one more part done, by its name or its place among the names."""
    done = itertools.count(1)

    def advance(part: Any) -> None:
        name = names[part] if names else part
        what = f"{doing}: {name}" if isinstance(name, str) else doing
        progress(what, next(done), total)

    return advance


def compute(
    function: Callable[[Any], Any],
    units: Sequence[Any],
    doing: str,
    progress: Progress,
    workers: int,
    names: Sequence[str] = (),
    cluster: str | None = None,
    kept: dict[int, Any] | None = None,
) -> list[Any]:
    """Return what a function makes of each unit, by its name if it has one, among processes.

    What is done is in `kept` at once, by its place, also if a Ctrl-C ends the rest.
    """
    if not units:
        return []
    progress(doing, 0, len(units))
    with open_executor(min(workers, len(units)), cluster) as executor:
        advance = counted(progress, doing, len(units), names)
        return compute_all(function, units, executor, advance, kept)


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A study, as the command line, the report and the tests see it."""

    module: str  # that has its parts
    name: str  # of its command
    title: str  # in the contents of a report
    order: int  # among the studies, lowest first
    schema: int  # of its result file, raised whenever an older file can no longer be read
    stem: str = ""  # beginning of its file names; its name by default
    summary: str = ""  # the first line of its module

    def __post_init__(self) -> None:
        object.__setattr__(self, "stem", self.stem or self.name)

    @property
    def command(self) -> str:
        """The command that makes its result."""
        return f"afl-mujoco {self.name}"

    @property
    def parts(self) -> Any:
        """The module that has its parts, imported when they are needed."""
        return importlib.import_module(self.module)

    def takes(self, option: str) -> bool:
        """Return whether its ``run`` takes an option."""
        return option in inspect.signature(self.parts.run).parameters

    def report(self, result: Any) -> Report:
        """Return what is shown of a result."""
        found: Report = self.parts.report(result)
        return replace(found, title=found.title or self.title)

    def write_files(self, result: Any, folder: Path) -> list[Path]:
        """Write the study's files besides its figures, if any, and return their paths."""
        write = getattr(self.parts, "write_files", None)
        return list(write(result, folder)) if write else []


# --- which studies there are ---------------------------------------------------------------------

_STUDY = re.compile(r"^STUDY = (Study\(.*?\))$", re.S | re.M)


def studies() -> dict[str, Study]:
    """Return the studies by name, in the order of a report, without importing one."""
    return {one.name: one for one in _found(tuple(package.__path__))}


def find_study(name: str) -> Study:
    """Return a study by its name."""
    if name not in (known := studies()):
        raise UnknownNameError.among("study", name, known)
    return known[name]


@cache
def _found(folders: tuple[str, ...]) -> list[Study]:
    found = []
    for path in (path for folder in folders for path in Path(folder).glob("*.py")):
        text = path.read_text(encoding="utf-8")
        if named := _STUDY.search(text):
            call: Any = ast.parse(named[1], mode="eval").body
            given = {x.arg: ast.literal_eval(x.value) for x in call.keywords if x.arg != "module"}
            module, summary = f"{package.__name__}.{path.stem}", text.splitlines()[0].strip('"')
            found.append(Study(module=module, summary=summary, **given))
    return sorted(found, key=lambda one: one.order)
