"""The parts of every study: a configuration, a run, a result kept as JSON, and sections.

A study is a package of this folder:

``study.py``
    Its configuration is a frozen dataclass. The fields are the options of the command, each with a
    default; ``quick`` is one of them in the studies that ``make robustness`` runs. Their docstrings
    are the help texts; that of the class has an example. Those called ``scenario``, ``scenarios``,
    ``controller`` and ``controllers`` are names: the record keeps a digest of each. ``check``
    raises if a rule is broken, before anything slow; ``run`` returns the result. `STUDY` names
    them. ``--help`` imports this module, so slow imports belong inside the functions.
``result.py``
    ``Result``, a frozen dataclass of types that pydantic supports, and of `Array`.
``sections.py``
    ``sections(result)`` is the only place that puts the study into words. A study that judges has
    ``verdict(result)``: its command ends with the verdict, and fails if the verdict does. A study
    that runs controllers on scenarios has ``opening(result)``: what a page shows first.
``films.py``
    Only for a study that can film what it ran: ``films(result, command)`` returns what to film,
    once its figures are drawn. Films of an earlier run are removed: they do not belong to
    the new numbers.
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

ControllerNames = Annotated[tuple[str, ...], tyro.conf.arg(help=f"Controllers by name: {KNOWN}")]
"""Controllers by name."""


class Interrupted(KeyboardInterrupt):
    """A Ctrl-C during a study that keeps what it has found until then.

    Attributes
    ----------
    result
        A result of the parts that were done.
    done
        How much that is, in words.
    """

    def __init__(self, result: Any, done: str) -> None:
        super().__init__(done)
        self.result, self.done = result, done


def silent(doing: str, done: int, total: int) -> None:
    """Report no progress."""


def counted(
    progress: Progress, doing: str, total: int, names: Sequence[str] = ()
) -> Callable[[Any], None]:
    """Return a function that reports one more part done at each call.

    Its argument is the name of the part, or its place among the names if there are any.
    """
    done = itertools.count(1)

    def advance(part: Any) -> None:
        name = names[part] if names else part
        what = f"{doing}: {name}" if isinstance(name, str) else doing
        progress(what, next(done), total)

    return advance


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A study, as the command line, the report and the tests see it.

    Attributes
    ----------
    name
        Name of its command.
    title
        Title in the contents of a report.
    order
        Position among the studies, lowest first.
    schema
        Version of its result file, raised whenever an older file can no longer be read.
    stem
        Beginning of its file names; its name by default.
    configuration
        The dataclass of its options.
    check
        ``check(configuration)`` raises if a rule is broken, before anything slow.
    run
        ``run(configuration, progress=..., workers=..., cluster=...)`` returns the result; the
        command has the options ``--workers`` and ``--cluster`` if ``run`` takes them.
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
        """Name the files after the study unless a stem is given."""
        object.__setattr__(self, "stem", self.stem or self.name)

    @property
    def command(self) -> str:
        """The command that makes its result."""
        return f"afl-mujoco {self.name}"

    def takes(self, option: str) -> bool:
        """Return whether its ``run`` takes an option."""
        return option in inspect.signature(self.run).parameters

    @property
    def result_type(self) -> type:
        """The dataclass of its result."""
        found: type = self._module("result").Result
        return found

    def sections(self, result: Any) -> Sequence[Section]:
        """Return what a report says about a result."""
        found: Sequence[Section] = self._module("sections").sections(result)
        return found

    def verdict(self, result: Any) -> Verdict | None:
        """Return the verdict of a result, or None if the study judges nothing."""
        judge = getattr(self._module("sections"), "verdict", None)
        return judge(result) if judge else None

    def opening(self, result: Any) -> Sequence[Block]:
        """Return what a page opens with; empty if the study has no opening."""
        show = getattr(self._module("sections"), "opening", None)
        return show(result) if show else ()

    def require_folder(self, folder: Path) -> None:
        """Raise if the folder holds files that would be lost, or that block the study's files."""
        if self._has("files"):
            self._module("files").require(folder)
        if self._has("films"):
            from afl_mujoco.films.listing import REMOVE, load_listing

            load_listing(folder, REMOVE)

    def write_files(self, result: Any, folder: Path) -> list[Path]:
        """Write the study's files besides its figures, if any, and return their paths."""
        return list(self._module("files").write(result, folder)) if self._has("files") else []

    def make_films(self, result: Any, folder: Path, command: str) -> list[Path]:
        """Film what was run, if the study can and films were asked for; return their paths.

        Parameters
        ----------
        command
            Command that made the result, and so the films.
        """
        films = self._module("films").films(result, command) if self._has("films") else []
        if not films:
            return []
        from afl_mujoco.films.video import make_films

        return list(make_films(films, folder))

    def unlist_films(self, folder: Path, kept: Sequence[Path]) -> None:
        """Remove the films of an earlier run, except those that were just made."""
        if not self._has("films"):
            return
        from afl_mujoco.films.listing import unlist_films

        names = {path.name for path in kept}
        unlist_films(
            folder, lambda one: one.command.startswith(self.command) and one.file not in names
        )

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
