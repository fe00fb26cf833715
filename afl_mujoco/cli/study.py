"""The command of every study, made from its configuration."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, get_type_hints

import tyro

from afl_mujoco.cli.terminal import FILMS, ROBUSTNESS, SUCCESS, VALIDATION, bars, separated
from afl_mujoco.errors import FileError, InvalidValueError
from afl_mujoco.studies.contract import Progress, Study
from afl_mujoco.studies.registry import studies

if TYPE_CHECKING:
    from afl_mujoco.document.blocks import Section


@dataclass(frozen=True, kw_only=True)
class StudyCommand:
    """What the command of every study does and takes."""

    study: ClassVar[Study]

    out: Path = ROBUSTNESS
    """Folder for the files."""
    validation: Path | None = None
    """Folder of a report, whose page is made anew; renders/validation, unless --out is given."""
    films: Path = FILMS
    """Folder with films.json, for that page."""

    def run(self) -> int:
        """Run the study, write its files, print them, put it into the report."""
        study, configuration = self.study, self.configuration
        from afl_mujoco.execution.dask_cluster import require_address

        who = {name: getattr(self, name) for name in ("workers", "cluster") if study.takes(name)}
        study.check(configuration)  # what is quick to check comes first
        if who.get("workers", 1) < 1:
            raise InvalidValueError("workers", "must be at least 1", who["workers"])
        if who.get("cluster") is not None:
            require_address(who["cluster"])

        from afl_mujoco.document.terminal import print_sections
        from afl_mujoco.files import output_folder
        from afl_mujoco.studies.record import Record, save_record

        self._require_report()
        study.require_folder(self.out)
        folder = output_folder(self.out)
        with study_progress() as progress:
            result = study.run(configuration, progress=progress, **who)
        command = command_line(study, configuration)
        record = Record(study=study, result=result, command=command)
        with study_progress() as progress:
            progress("drawing", 0, 1)
            files = save_record(record, folder)
        print_sections(record.sections, folder)
        print(f"wrote {', '.join(str(file) for file in files)}")
        self._write_report()
        return SUCCESS

    @property
    def configuration(self) -> Any:
        """What the study takes of the options."""
        kind = self.study.configuration
        return kind(**{field.name: separated(getattr(self, field.name)) for field in fields(kind)})

    @property
    def _page_folder(self) -> Path | None:
        """Folder of the report; None for none: with --out nothing but that folder is touched."""
        if self.validation is not None:
            return self.validation
        return VALIDATION if self.out == ROBUSTNESS else None

    def _require_report(self) -> None:
        """Raise at what could not be put into the report, before anything slow."""
        from afl_mujoco.reporting.page.folder import REPORT
        from afl_mujoco.reporting.page.inputs.films import load_films
        from afl_mujoco.studies.record import load_records

        path = self.out / f"{self.study.name}.json"
        if path.is_dir():
            raise FileError(str(path), "must be a file, is a folder")
        folder = self._page_folder
        if folder is not None and (folder / REPORT).is_file():
            load_films(self.films, folder)
            load_records(self.out, leave_out=self.study.name)

    def _write_report(self) -> None:
        """Make the report's page anew, if there is a report."""
        from afl_mujoco.reporting.page.folder import REPORT, write_page
        from afl_mujoco.reporting.page.inputs.films import load_films

        folder = self._page_folder
        if folder is None:
            print(f"afl-mujoco report --robustness {self.out} puts it into a report")
        elif not (folder / REPORT).is_file():
            print(f"no {folder / REPORT}: afl-mujoco validate will put the study into its report")
        else:
            films = load_films(self.films, folder)
            page = write_page(folder, films, sections_in(self.out), self.out)
            print(f"wrote {page}")


@dataclass(frozen=True, kw_only=True)
class Workers:
    """For a study that shares its work."""

    workers: int = min(2, os.cpu_count() or 1)
    """Processes or threads to share the work among; the numbers do not depend on it."""


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """For a study whose work can be done elsewhere."""

    cluster: str | None = None
    """Share it among the workers of a Dask cluster: tcp://host:port."""


def study_commands() -> list[Any]:
    """Return a command for each study, as tyro takes them."""
    return [_command(study) for study in studies().values()]


def command_line(study: Study, configuration: Any) -> str:
    """Return what repeats a study, as typed into a shell: options that are not the default."""
    hints = get_type_hints(study.configuration, include_extras=True)
    names: list[str] = []
    options: list[str] = []
    for option in fields(configuration):
        value = getattr(configuration, option.name)
        if tyro.conf.Positional in getattr(hints[option.name], "__metadata__", ()):
            names += value
        elif value != option.default:
            name = option.name.replace("_", "-")
            options.append(f"--no-{name}" if value is False else f"--{name}")
            if not isinstance(value, bool):
                options += [str(x) for x in (value if isinstance(value, tuple) else (value,))]
    return shlex.join(["afl-mujoco", study.name, *names, *options])


def sections_in(folder: Path) -> list[Section]:
    """Return what a report says of the results in a folder; nothing if the default is missing."""
    from afl_mujoco.studies.record import load_records

    if folder != ROBUSTNESS and not folder.is_dir():
        raise FileError(str(folder), "must be a folder of results, is not")
    return [section for record in load_records(folder) for section in record.sections]


@contextmanager
def study_progress() -> Iterator[Progress]:
    """Give what shows a bar for each thing that a study does."""
    with bars() as shown:
        tasks: dict[str, Callable[[int], None]] = {}

        def report(doing: str, done: int, total: int) -> None:
            if doing not in tasks:
                tasks[doing] = shown(doing, total)
            tasks[doing](done)

        yield report


def _command(study: Study) -> Any:
    """Return the command of a study: its configuration's options, then those of every study."""
    mixed = [kind for kind in (Workers, Cluster) if study.takes(kind.__name__.lower())]
    members: dict[str, Any] = {
        "__doc__": study.configuration.__doc__,
        "__module__": __name__,
        "__annotations__": {},
        "study": study,
    }
    name = f"{study.configuration.__name__}Command"
    made = type(name, (StudyCommand, *mixed, study.configuration), members)
    command: Any = dataclass(frozen=True, kw_only=True)(made)
    return Annotated[command, tyro.conf.subcommand(study.name)]
