"""The command of every study, made from its options, and the page of a folder."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from afl_mujoco.cli.terminal import (
    CHECK_FAILED,
    FILMS,
    RESULTS,
    SUCCESS,
    CallLimit,
    say,
    separated,
    study_progress,
    typed,
)
from afl_mujoco.errors import FileError
from afl_mujoco.pool import kept_processes, require_address, require_workers
from afl_mujoco.report.blocks import REPLAY, Block, Section, code
from afl_mujoco.studies.shared.contract import Interrupted, Study

if TYPE_CHECKING:
    from afl_mujoco.studies.shared.record import Record

TITLE = "Controllers in MuJoCo"

DRAWN = (".svg", ".png", REPLAY)  # endings of the files of figures and replays


def require_films(folder: Path) -> None:
    """Raise if a folder of films that was asked for is not there."""
    if folder != FILMS and not folder.is_dir():
        raise FileError(f"films {folder}", "must be a folder that is there: run afl-mujoco render")


def require_page(folder: Path, films: Path, *, leave_out: str = "") -> None:
    """Raise if something but one study, to be replaced, could not be put into a page."""
    from afl_mujoco.files import require_no_folder
    from afl_mujoco.films.listing import load_listing
    from afl_mujoco.studies.shared.record import PAGE, load_records

    require_no_folder(folder, (PAGE,))
    require_films(films)
    for place in dict.fromkeys((films, folder)):
        load_listing(place)
    load_records(folder, leave_out=leave_out)


def write_page(folder: Path, films: Path) -> Path:
    """Write the page of a folder, completely or not at all; nothing is computed."""
    from afl_mujoco.files import write_text
    from afl_mujoco.films.listing import sections as film_sections
    from afl_mujoco.report.page import to_html
    from afl_mujoco.studies.shared.record import PAGE, load_records

    records = load_records(folder)
    if not records:
        raise FileError(str(folder), "must hold a result: run afl-mujoco validate")
    reports = {record.study.name: record.report for record in records}
    # films beside a page may be of results that were there before
    commands = [record.command for record in records]
    inputs = {pair for record in records for pair in record.inputs.items()}
    shown = film_sections(folder, inputs, commands) if folder != films else []
    last = [*(shown or film_sections(films, inputs)), _reproduce(records)]
    files = {name for record in records for name in record.files}
    write_text(folder / PAGE, to_html(TITLE, reports, folder, last, files))
    return folder / PAGE


def _reproduce(records: Sequence[Record]) -> Section:
    blocks: list[Block] = []
    found: dict[str, dict[str, str]] = {}
    for record in records:
        for name, digest in record.inputs.items():
            found.setdefault(name, {}).setdefault(digest, f"{record.study.stem}.json")
    for name, places in found.items():
        if len(places) > 1:
            blocks.append(f"**{name} is not the same in {' and '.join(places.values())}.**")
    for record in records:
        made_by = ", ".join(f"{name} {number}" for name, number in record.versions.items())
        made = code(f"{record.study.stem}.json")
        blocks.append(f"{code(record.command)} made {made}, with {made_by}.")
    blocks.append("The same inputs give the same bytes, with any number of workers.")
    return Section("Reproduce", "reproduce", blocks)


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
        study, kind = self.study, self.study.parts.Options
        given = {field.name: separated(getattr(self, field.name)) for field in fields(kind)}
        configuration = kind(**given)
        who = {name: getattr(self, name) for name in ("workers", "cluster") if study.takes(name)}
        request = study.parts.prepare(configuration)  # what is quick to check comes first
        require_workers(who.get("workers", 1))
        if who.get("cluster") is not None:
            require_address(who["cluster"])

        from afl_mujoco.files import output_folder, require_no_folder
        from afl_mujoco.report.terminal import print_report
        from afl_mujoco.studies.shared.record import PAGE, Record, save_partial, save_record

        names = (f"{study.stem}{suffix}" for suffix in (".json", ".md", ".npz"))
        require_no_folder(self.out, (*names, PAGE))
        if self.page:
            require_page(self.out, self.films, leave_out=study.name)
        if require := getattr(study.parts, "require_files", None):
            require(self.out)
        folder = output_folder(self.out)
        inputs = inputs_of(request)
        command = typed(study.name, configuration)
        if (limit := getattr(self, "call_limit", None)) is not None:
            command += f" --call-limit {limit:g}"
        with study_progress() as progress, kept_processes():
            try:
                result = study.parts.run(request, progress=progress, **who)
            except Interrupted as early:
                record = Record(study=study, result=early.result, command=command, inputs=inputs)
                say(f"interrupted: wrote {save_partial(record, folder, early.done)}")
                raise
            record = Record(study=study, result=result, command=command, inputs=inputs)
            files = save_record(record, folder, figures=self.page, progress=progress)
        if getattr(request, "film", False):
            from afl_mujoco.films.video import make_films

            files += make_films(study.parts.films(request, result, command), folder)
        if self.page:
            files.append(write_page(folder, self.films))
        say(f"wrote {_told(files)}")
        print_report(report := record.report)
        return CHECK_FAILED if report.passed is False else SUCCESS


Workers = Annotated[
    int,
    tyro.conf.arg(
        help="Number of processes or threads that share the work; the results do not depend on it."
    ),
]
Cluster = Annotated[
    str | None,
    tyro.conf.arg(help="Share the work among the workers of a Dask cluster: tcp://host:port."),
]
CORES = min(2, os.cpu_count() or 1)
SHARED = {"workers": (Workers, CORES), "cluster": (Cluster, None)}
"""Options of a study that shares its work, by the name that its run has for them."""


def inputs_of(request: Any) -> dict[str, str]:
    """Return digests of the scenarios and controllers that a study runs."""

    def run(option: str) -> list[Any]:
        one, several = (getattr(request, name, None) for name in (option, f"{option}s"))
        return [*(several or ()), *([] if one is None else [one])]

    scenarios, controllers = run("scenario"), run("controller")
    if not (scenarios or controllers):
        return {}  # without the time that importing controllers takes
    from afl_mujoco.control.catalogue import digests

    return digests(scenarios, controllers)


def _told(files: Sequence[Path]) -> str:
    """Return files in a line, figures only counted."""
    told = [str(file) for file in files if not file.name.endswith(DRAWN)]
    figures = len(files) - len(told)
    return ", ".join(told) + (f" and {figures} files of figures" if figures else "")


def study_command(study: Study) -> Any:
    """Return the command of a study: its configuration's options, then those of every study."""
    own: list[Any] = [(name, *option) for name, option in SHARED.items() if study.takes(name)]
    if "controllers" in (field.name for field in fields(study.parts.Options)):
        own.insert(0, ("call_limit", CallLimit, None))
    return make_dataclass(
        f"{study.parts.Options.__name__}Command", own, bases=(StudyCommand, study.parts.Options),
        namespace={"__doc__": study.parts.Options.__doc__, "__module__": __name__, "study": study},
        frozen=True, kw_only=True,
    )  # fmt: skip
