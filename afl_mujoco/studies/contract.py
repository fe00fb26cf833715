"""What every study is: a configuration, a run, a result that is kept as JSON, sections.

A study is a package of this folder:

``study.py``
    Its configuration, a frozen dataclass: the fields are the options of the command, each with a
    default, ``quick`` among them in what ``make robustness`` runs; their docstrings are its help,
    that of the class has an example. ``check`` raises at what breaks a rule, before anything slow;
    ``run`` returns the result. `STUDY` names them. It is imported by ``--help``: what is slow to
    import is imported inside the functions.
``result.py``
    ``Result``, a frozen dataclass of types that pydantic supports, and of `Array`.
``sections.py``
    ``sections(result)``: the only place that puts the study into words; ``verdict(result)`` for a
    study that judges, whose command ends with it and fails where it does; ``opening(result)`` for
    one that runs controllers on scenarios: what a page shows of them before anything else.
``films.py``
    Only for a study that can film what it ran: ``films(result, command)`` returns what to film,
    once the result has been written; films of an earlier run go, for they would stand beside
    numbers that are not theirs.
``files.py``
    Only for a study that writes more than figures: ``require(folder)`` raises before the run,
    ``write(result, folder)`` returns what it wrote.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from afl_mujoco.control.names import KNOWN

if TYPE_CHECKING:
    from afl_mujoco.document.blocks import Block, Section, Verdict

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many parts of it are done, and how many there are."""

ScenarioNames = Annotated[
    tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO ...")
]
"""Scenarios by name or file, before the options."""

ScenarioName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")]
"""A scenario by name or file, before the options."""

ScenarioIfAny = Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[SCENARIO]")]
"""The same, which may be left out."""

ControllerNames = Annotated[tuple[str, ...], tyro.conf.arg(help=f"Controllers by name: {KNOWN}")]
"""Controllers by name."""


def silent(doing: str, done: int, total: int) -> None:
    """Report no progress."""


def counted(progress: Progress, doing: str, total: int) -> Callable[[object], None]:
    """Return what reports one part more at each call, whatever it is called with."""
    done = itertools.count(1)
    return lambda _: progress(doing, next(done), total)


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A study, as the command line, the report and the tests see it.

    Attributes
    ----------
    name
        Of its command.
    title
        In the contents of a report.
    order
        Place among the studies, the least first.
    schema
        Of its result: raised whenever an older file can no longer be read.
    stem
        How the names of its files begin; its name by default.
    configuration
        The dataclass of its options.
    check
        ``check(configuration)`` raises at what breaks a rule, before anything slow.
    run
        ``run(configuration, progress=..., workers=..., cluster=...)`` returns the result; the
        command has those of the options ``--workers`` and ``--cluster`` that it takes.
    """

    name: str
    title: str
    order: int
    schema: int
    configuration: type
    check: Callable[[Any], None]
    run: Callable[..., Any]
    stem: str = ""

    def __post_init__(self) -> None:
        """Name the files after the study where nothing else is said."""
        object.__setattr__(self, "stem", self.stem or self.name)

    @property
    def command(self) -> str:
        """What makes its result."""
        return f"afl-mujoco {self.name}"

    def takes(self, option: str) -> bool:
        """Return whether its run has an option."""
        return option in inspect.signature(self.run).parameters

    @property
    def result_type(self) -> type:
        """The dataclass of its result."""
        found: type = self._module("result").Result
        return found

    def sections(self, result: Any) -> Sequence[Section]:
        """Return what a report says of a result."""
        found: Sequence[Section] = self._module("sections").sections(result)
        return found

    def verdict(self, result: Any) -> Verdict | None:
        """Return whether what a result judges holds; None if it judges nothing."""
        judge = getattr(self._module("sections"), "verdict", None)
        return judge(result) if judge else None

    def opening(self, result: Any) -> Sequence[Block]:
        """Return what a page opens with, nothing if the study has no such thing."""
        show = getattr(self._module("sections"), "opening", None)
        return show(result) if show else ()

    def require_folder(self, folder: Path) -> None:
        """Raise if what the folder holds would be lost, or is in the way of its files."""
        if self._has("files"):
            self._module("files").require(folder)
        if self._has("films"):
            from afl_mujoco.films.listing import REMOVE, load_listing

            load_listing(folder, REMOVE)

    def write_files(self, result: Any, folder: Path) -> list[Path]:
        """Write what it has besides its figures; return what that is."""
        return list(self._module("files").write(result, folder)) if self._has("files") else []

    def write_films(self, result: Any, folder: Path, command: str) -> list[Path]:
        """Film what was run, if the study does and it was asked for; return the films.

        Parameters
        ----------
        command
            What made the result, and so the films.
        """
        if not self._has("films"):
            return []
        from afl_mujoco.films.listing import unlist_films

        unlist_films(folder, lambda entry: entry.command.startswith(self.command))
        films = self._module("films").films(result, command)
        if not films:
            return []
        from afl_mujoco.films.renderer import make_films

        return list(make_films(films, folder))

    def _has(self, module: str) -> bool:
        """Return whether its package has a module."""
        return importlib.util.find_spec(f"{self._package}.{module}") is not None

    def _module(self, name: str) -> ModuleType:
        """Return a module of its package, imported when it is needed."""
        return importlib.import_module(f"{self._package}.{name}")

    @property
    def _package(self) -> str:
        """The package of its modules."""
        return self.configuration.__module__.rpartition(".")[0]
