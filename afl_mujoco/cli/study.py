"""The command of every study, made from its configuration."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from afl_mujoco.cli.terminal import (
    CHECK_FAILED,
    FILMS,
    RESULTS,
    SUCCESS,
    CallLimit,
    bars,
    plain_help,
    say,
    separated,
    typed,
)
from afl_mujoco.studies.contract import Interrupted, Progress, Study
from afl_mujoco.studies.registry import Listed, find_study, listed

MOST_TOLD = 4
"""Largest number of scenario files in a folder that are named one by one."""


@dataclass(frozen=True, kw_only=True)
class StudyCommand:
    """The run and the options of the command of every study."""

    study: ClassVar[Study]

    page: bool = True
    """Skip the figures and report.html."""
    films: Path = FILMS
    """Folder with films.json, which `afl-mujoco render` writes: films for the page, if any."""
    out: Path = RESULTS
    """Folder for the files."""

    def run(self) -> int:
        """Run the study, write its files, print its sections, make the page."""
        study, configuration = self.study, self.configuration
        from afl_mujoco.execution.dask_cluster import require_address
        from afl_mujoco.execution.executors import require_workers

        who = {name: getattr(self, name) for name in ("workers", "cluster") if study.takes(name)}
        request = study.request(configuration)  # what is quick to check comes first
        require_workers(who.get("workers", 1))
        if who.get("cluster") is not None:
            require_address(who["cluster"])

        from afl_mujoco.cli.page import require_page, write_page
        from afl_mujoco.execution.processes import kept_processes
        from afl_mujoco.files import output_folder, require_no_folder
        from afl_mujoco.report.terminal import print_report
        from afl_mujoco.studies.record import PAGE, Record, save_partial, save_record

        names = (f"{study.stem}{suffix}" for suffix in (".json", ".md", ".npz"))
        require_no_folder(self.out, (*names, PAGE))
        if self.page:
            require_page(self.out, self.films, leave_out=study.name)
        study.require_folder(self.out)
        folder = output_folder(self.out)
        inputs = inputs_of(request)
        films: list[Path] = []
        with study_progress() as progress, kept_processes():
            command = typed(study.name, configuration)
            if (limit := getattr(self, "call_limit", None)) is not None:
                command += f" --call-limit {limit:g}"
            try:
                result = study.run(request, progress=progress, **who)
            except Interrupted as early:
                record = Record(study=study, result=early.result, command=command, inputs=inputs)
                say(f"interrupted: wrote {save_partial(record, folder, early.done)}")
                raise
            record = Record(study=study, result=result, command=command, inputs=inputs)

            def film() -> None:
                films.extend(study.make_films(result, folder, command))

            def finish(staging: Path) -> None:
                study.unlist_films(folder, films)
                if self.page:
                    films.append(write_page(folder, self.films, staging))

            files = save_record(
                record, folder, figures=self.page, workers=who.get("workers", 1),
                progress=progress, film=film, finish=finish,
            )  # fmt: skip
        files += films
        say(f"wrote {_told(files)}")
        print_report(report := record.report)
        return CHECK_FAILED if report.passed is False else SUCCESS

    @property
    def configuration(self) -> Any:
        """The configuration of the study, from the options."""
        kind = self.study.configuration
        return kind(**{field.name: separated(getattr(self, field.name)) for field in fields(kind)})


@dataclass(frozen=True, kw_only=True)
class Workers:
    """Option of a study that shares its work among workers."""

    workers: int = min(2, os.cpu_count() or 1)
    """Number of processes or threads that share the work; the results do not depend on it."""


@dataclass(frozen=True, kw_only=True)
class Limited:
    """Option of a study that runs controllers."""

    call_limit: CallLimit = None


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """Option of a study that can run on a cluster."""

    cluster: str | None = None
    """Share the work among the workers of a Dask cluster: tcp://host:port."""


def study_commands(chosen: str | None = None) -> list[Any]:
    """Return a command for each study, in the form that tyro takes.

    Only that of the chosen study is whole, all if it is None: the others have nothing but their
    name and what the list of commands says of them.
    """
    return [
        _command(find_study(name)) if chosen in (None, name) else _stub(one)
        for name, one in listed().items()
    ]


def _stub(one: Listed) -> Any:
    """Return a command without options."""
    made = make_dataclass(one.name, (), namespace={"__doc__": one.summary})
    return Annotated[made, tyro.conf.subcommand(one.name)]


def inputs_of(request: Any) -> dict[str, str]:
    """Return digests of the scenarios and controllers that a study runs."""
    from afl_mujoco.control.catalogue import find_controller
    from afl_mujoco.control.digests import digests
    from afl_mujoco.scenario.files import find_scenario

    def run(option: str) -> list[Any]:
        one, several = (getattr(request, name, None) for name in (option, f"{option}s"))
        return [*(several or ()), *([] if one is None else [one])]

    controllers = [find_controller(x) if isinstance(x, str) else x for x in run("controller")]
    scenarios = [find_scenario(x) if isinstance(x, str) else x for x in run("scenario")]
    return digests(scenarios, controllers)


def _told(files: Sequence[Path]) -> str:
    """Return files in a line, figures and a folder's many scenario files only counted."""
    figures = [file for file in files if file.suffix in (".svg", ".png")]
    told = [str(file) for file in files if file not in figures and file.suffix != ".toml"]
    scenarios = sorted((file for file in files if file.suffix == ".toml"), key=lambda f: f.parent)
    for folder, group in itertools.groupby(scenarios, key=lambda file: file.parent):
        there = [*map(str, group)]
        many = len(there) > MOST_TOLD
        told += [f"{len(there)} scenario files in {folder}"] if many else there
    return ", ".join(told) + (f" and {len(figures)} files of figures" if figures else "")


@contextmanager
def study_progress() -> Iterator[Progress]:
    """Yield a function that shows a bar for each task of a study."""
    with bars() as shown:
        tasks: dict[str, Callable[[int, str], None]] = {}

        def report(doing: str, done: int, total: int) -> None:
            task = doing.partition(":")[0]
            if task not in tasks:
                tasks[task] = shown(doing, total)
            tasks[task](done, doing)

        yield report


def _command(study: Study) -> Any:
    """Return the command of a study: its configuration's options, then those of every study."""
    mixed: list[type] = [k for k in (Workers, Cluster) if study.takes(k.__name__.lower())]
    if "controllers" in (field.name for field in fields(study.configuration)):
        mixed.insert(0, Limited)
    members: dict[str, Any] = {
        "__doc__": study.configuration.__doc__,
        "__module__": __name__,
        "__annotations__": {},
        "study": study,
    }
    name = f"{study.configuration.__name__}Command"
    made = type(name, (StudyCommand, *mixed, study.configuration), members)
    command: Any = plain_help(dataclass(frozen=True, kw_only=True)(made))
    return Annotated[command, tyro.conf.subcommand(study.name)]
