"""A result as files: JSON with what made it, an npz of its arrays, figures and text beside it."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from afl_mujoco.errors import FileError, reading
from afl_mujoco.files import (
    array_names,
    atomic_file,
    hidden_folder,
    read_arrays,
    read_utf8,
    remove_file,
    require_no_folder,
    write_text,
)
from afl_mujoco.pool import interrupts_put_off, is_interrupt
from afl_mujoco.report.blocks import Figure, Replay, Report, Section, drawn_of, without_figures
from afl_mujoco.report.markdown import code, plain, to_markdown
from afl_mujoco.report.style import write_figure
from afl_mujoco.studies.shared.arrays import packed, unpacked
from afl_mujoco.studies.shared.contract import Progress, Study, compute, silent, studies

PACKAGES = ("afl_mujoco", "control", "dm_control", "mujoco", "numpy", "scipy", "numba")
"""Packages whose versions are recorded."""

PAGE = "report.html"
"""The page of a folder, removed with an old result: beside a new one it would mislead."""

HEADER = ("schema", "study", "command", "versions", "inputs", "files")
"""Keys that precede the fields of a result."""


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # dm_control, beyond Python 3.12
            found[name] = "not installed"
    return {**found, "python": platform.python_version()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A result with what made it."""

    study: Study
    result: Any
    command: str  # as typed into a shell
    versions: Mapping[str, str] = field(default_factory=versions)  # of `PACKAGES` and of Python
    inputs: Mapping[str, str] = field(default_factory=dict)  # digests of what was run
    files: tuple[str, ...] = ()  # beside its JSON, if it was read from a folder

    @property
    def report(self) -> Report:
        """What is shown of it."""
        return self.study.report(self.result)


def save_record(
    record: Record,
    folder: Path,
    *,
    figures: bool = True,
    workers: int = 1,
    progress: Progress = silent,
    film: Callable[[], None] = lambda: None,
    finish: Callable[[Path], None] = lambda staging: None,
) -> list[Path]:
    """Write a record in place of an older one of its study, and return what was written.

    Every file is complete before the older record is removed; the JSON, which names the others, is
    moved last. A Ctrl-C before that leaves the older record as it was, or writes the numbers where
    there is none. If a figure, a film or the page cannot be made, the rest is still written before
    the error is raised.

    `film` is called when all files of the record are complete, `finish` last, with the folder where
    they are: what it writes there moves with them. A Ctrl-C waits from there on.
    """
    study, report = record.study, record.report
    shown = report.blocks if figures else without_figures(report.blocks)
    result, arrays = packed(record.result)
    path = folder / f"{study.stem}.json"
    failure: BaseException | None = None

    def attempt(deed: Callable[[], object]) -> None:
        nonlocal failure
        try:
            if failure is None:
                deed()
        except BaseException as error:
            if is_interrupt(error) and path.is_file():
                raise
            failure = error

    with hidden_folder(folder, "results") as staging:
        write = partial(_write, folder=staging)
        attempt(lambda: compute(write, drawn_of(shown), "drawing", progress, workers))
        if failure is not None:
            for drawn in staging.iterdir():
                drawn.unlink()
        headline = f"{report.word}: " * bool(report.word) + plain(report.headline)
        text = [headline, *shown, f"Made by {code(record.command)}."]
        section = Section(report.title, study.name, text)
        write_text(staging / f"{study.stem}.md", to_markdown([section]))
        if arrays:
            with atomic_file(staging / f"{study.stem}.npz") as file, file.open("wb") as stream:
                np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
        staged = {path.name: _digest(path) for path in sorted(staging.iterdir())}
        write_text(staging / path.name, _as_json(record, result, staged))
        require_no_folder(folder, (path.name, PAGE, *staged))
        attempt(film)
        with interrupts_put_off():
            attempt(lambda: finish(staging))
            remove_record(study, folder)
            others = study.write_files(record.result, folder)
            for one in sorted(staging.iterdir(), key=lambda one: one.name == path.name):
                one.replace(folder / one.name)
    if failure is not None:
        raise failure
    return [path, *(folder / name for name in staged), *others]


def save_partial(record: Record, folder: Path, done: str) -> Path:
    """Write how much of an interrupted study was done, beside an older record."""
    result, _ = packed(record.result)
    path = folder / f"{record.study.stem}-partial.json"
    content = {"partial": done, "command": record.command, "versions": dict(record.versions)}
    write_text(path, json.dumps({**content, "result": result}, indent=1) + "\n")
    return path


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _write(shown: Figure | Replay, folder: Path) -> None:
    if isinstance(shown, Figure):
        write_figure(shown, folder)
        return
    (name,) = shown.files.values()
    write_text(folder / name, json.dumps(shown.compute(), allow_nan=False) + "\n")


def _as_json(record: Record, result: Mapping[str, Any], files: Mapping[str, str]) -> str:
    """Return a record as text, each of its rows in a line of its own."""
    data = {
        "schema": record.study.schema,
        "study": record.study.name,
        "command": record.command,
        "versions": dict(record.versions),
        "inputs": dict(record.inputs),
        "files": dict(files),
        **result,
    }
    mark, rows = "\0rows", data.get("rows")
    if isinstance(rows, list):
        data["rows"] = mark
    text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    each = rows if isinstance(rows, list) else []
    lines = (json.dumps(row, ensure_ascii=False, allow_nan=False) for row in each)
    return text.replace(json.dumps(mark), "[\n" + ",\n".join(lines) + "\n ]")


def load_record(study: Study, folder: Path) -> Record:
    """Return the record of a study in a folder."""
    path, again = folder / f"{study.stem}.json", f"run {study.command}"
    with reading(path, f"is not a result of {study.command}", again):
        data = json.loads(read_utf8(path), parse_constant=_no_number)
        found = (data["study"], data["schema"])
        if found != (study.name, study.schema):
            rule = f"it must be of {study.name!r} and have schema {study.schema}"
            raise ValueError(f"{rule}, got {found[0]!r} and {found[1]!r}")
        if not isinstance(data["command"], str):
            raise ValueError("command must be a string")
        header = {"inputs": {}} | data  # an older file has none
        versions, inputs, files = (_texts(header, key) for key in ("versions", "inputs", "files"))
        given = {key: value for key, value in data.items() if key not in HEADER}
        npz = folder / f"{study.stem}.npz"
        arrays = read_arrays(npz, array_names(npz)) if npz.exists() else {}
        result = unpacked(study.result_type, given, arrays)
        for name, digest in files.items():
            if _is_of(study, name) and (folder / name).is_file():
                if _digest(folder / name) != digest:
                    raise ValueError(f"{name} beside it must be unchanged since it was written")
    return Record(
        study=study, result=result, command=data["command"], versions=versions, inputs=inputs,
        files=tuple(files),
    )  # fmt: skip


def _texts(header: Mapping[str, Any], key: str) -> dict[str, str]:
    if not isinstance(header[key], dict):
        raise ValueError(f"{key} must be an object, got {header[key]!r}")
    return {str(name): str(value) for name, value in header[key].items()}


def load_records(folder: Path, *, leave_out: str = "", ahead: Path | None = None) -> list[Record]:
    """Return every record in a folder but one study's; those `ahead` come first."""
    found = []
    for study in studies().values():  # only what is there is imported
        places = [place for place in (ahead, folder) if place is not None]
        there = [place for place in places if (place / f"{study.stem}.json").is_file()]
        if there and study.name != leave_out:
            found.append(load_record(study, there[0]))
    return found


def remove_record(study: Study, folder: Path) -> None:
    """Remove an older record: its JSON, its files beside it as it wrote them, the page made of it.

    Only what the record itself would write again is removed, not whatever its JSON lists: a file of
    a user's may be named there.
    """
    path = folder / f"{study.stem}.json"
    try:
        with reading(path, "is not a record"):
            wrote = dict(json.loads(read_utf8(path))["files"])
            record = load_record(study, folder)
            shown = drawn_of(record.report.blocks)
            drawn = {name for one in shown for name in one.files.values()}
    except FileError:
        wrote, drawn = {}, set()
    own = drawn | {f"{study.stem}.md", f"{study.stem}.npz"}
    ours = [name for name in wrote if _is_of(study, name) and name in own]
    for old in (path, folder / PAGE, *(folder / name for name in ours)):  # the list first
        remove_file(old)


def _is_of(study: Study, name: str) -> bool:
    """Return whether a name is that of a file of a study, beside its JSON."""
    return Path(name).name == name and name.split(".")[0].split("-")[0] == study.stem


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")
