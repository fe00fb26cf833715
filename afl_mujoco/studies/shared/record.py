"""A result as files: JSON with what made it, an npz of its arrays, figures and text beside it."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from afl_mujoco.errors import FileError, reading
from afl_mujoco.files import (
    array_names,
    atomic_file,
    hidden_folder,
    inside,
    parse_json,
    read_arrays,
    read_utf8,
    remove_file,
    require_no_folder,
    write_text,
)
from afl_mujoco.pool import interrupts_put_off, is_interrupt, waiting_workers
from afl_mujoco.report.blocks import (
    Figure,
    Replay,
    Report,
    Section,
    code,
    drawn_of,
    plain,
    to_markdown,
    without_figures,
)
from afl_mujoco.report.figures import write_figure
from afl_mujoco.studies.shared.arrays import packed, unpacked
from afl_mujoco.studies.shared.contract import Progress, Study, compute, silent, studies

PACKAGES = ("afl_mujoco", "dm_control", "mujoco", "numpy", "scipy", "numba")
"""Packages whose versions are recorded."""

PAGE = "report.html"
"""The page of a folder, removed with an old result: beside a new one it would mislead."""


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # dm_control, beyond Python 3.12
            found[name] = "not installed"
    return {**found, "python": platform.python_version()}


@dataclass(frozen=True, kw_only=True)
class Record:
    """A result with what made it."""

    study: Study
    result: Any
    command: str  # as typed into a shell
    versions: Mapping[str, str] = field(default_factory=versions)  # of `PACKAGES` and of Python
    inputs: Mapping[str, str] = field(default_factory=dict)  # digests of what was run
    files: tuple[str, ...] = ()  # beside its JSON, if it was read from a folder

    @cached_property
    def report(self) -> Report:
        """What is shown of it."""
        return self.study.report(self.result)


def save_record(
    record: Record,
    folder: Path,
    *,
    figures: bool = True,
    progress: Progress = silent,
) -> list[Path]:
    """Write a record in place of an older one of its study, and return what was written.

    Every file is complete before the older record is removed; the JSON, which names the others, is
    moved last. A Ctrl-C before that leaves the older record as it was, or writes the numbers where
    there is none. If a figure cannot be drawn, the rest is written before the error is raised.
    """
    study, report = record.study, record.report
    shown = report.blocks if figures else without_figures(report.blocks)
    result, arrays = packed(record.result)
    path, failure = folder / f"{study.stem}.json", None
    with hidden_folder(folder, "results") as staging:
        try:
            write = partial(_write, folder=staging)
            compute(write, drawn_of(shown), "drawing", progress, waiting_workers())
        except BaseException as error:
            if is_interrupt(error) and path.is_file():
                raise
            failure = error
            for drawn in staging.iterdir():
                drawn.unlink()
        headline = f"{report.word}: " * bool(report.word) + plain(report.headline)
        text = [headline, *shown, f"Made by {code(record.command)}."]
        section = Section(report.title, study.name, text)
        write_text(staging / f"{study.stem}.md", to_markdown([section]))
        if arrays:
            with atomic_file(staging / f"{study.stem}.npz") as file, file.open("wb") as stream:
                np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
        staged = {one.name: _digest(one) for one in sorted(staging.iterdir())}
        write_text(staging / path.name, _as_json(record, result, staged))
        require_no_folder(folder, (path.name, PAGE, *staged))
        with interrupts_put_off():
            others = study.write_files(record.result, folder)
            remove_record(study, folder)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """What precedes the fields of a result in its file."""

    schema: int
    study: str
    command: str
    versions: dict[str, str]
    inputs: dict[str, str] = field(default_factory=dict)  # an older file has none
    files: dict[str, str]


def load_record(study: Study, folder: Path) -> Record:
    """Return the record of a study in a folder."""
    path, npz = (folder / f"{study.stem}{suffix}" for suffix in (".json", ".npz"))
    with reading(path, f"is not a result of {study.command}", f"run {study.command}"):
        data = json.loads(read_utf8(path), parse_constant=_no_number)
        if not isinstance(data, dict):
            raise ValueError("must be an object")
        found = (data["study"], data["schema"])
        if found != (study.name, study.schema):
            rule = f"it must be of {study.name!r} and have schema {study.schema}"
            raise ValueError(f"{rule}, got {found[0]!r} and {found[1]!r}")
        named = {field.name for field in fields(Header)}
        own = {key: value for key, value in data.items() if key in named}
        header = parse_json(json.dumps(own), Header)
        if npz.exists() and npz.name not in header.files:
            raise ValueError(f"{npz.name} beside it must be listed")
        for name, digest in header.files.items():
            if _is_of(study, name) and (folder / name).is_file():
                if _digest(inside(folder, name)) != digest:
                    raise ValueError(f"{name} beside it must be unchanged since it was written")
        arrays = read_arrays(npz, array_names(npz)) if npz.exists() else {}
        given = {key: value for key, value in data.items() if key not in named}
        record = Record(
            study=study, result=unpacked(study.parts.Result, given, arrays), command=header.command,
            versions=header.versions, inputs=header.inputs, files=tuple(header.files),
        )  # fmt: skip
        drawn_of(record.report.blocks)  # raises unless its parts fit together
    return record


def load_records(folder: Path, *, leave_out: str = "") -> list[Record]:
    """Return every record in a folder but one study's."""
    there = (one for one in studies().values() if (folder / f"{one.stem}.json").is_file())
    return [load_record(one, folder) for one in there if one.name != leave_out]


def remove_record(study: Study, folder: Path) -> None:
    """Remove an older record: its JSON, its files beside it as it wrote them, the page made of it.

    Only what the record itself would write again is removed, not whatever its JSON lists: a file of
    a user's may be named there.
    """
    path = folder / f"{study.stem}.json"
    try:
        with reading(path, "is not a record"):
            wrote = dict(json.loads(read_utf8(path))["files"])
            shown = drawn_of(load_record(study, folder).report.blocks)
            drawn = {name for one in shown for name in one.files.values()}
    except FileError:
        wrote, drawn = {}, set()
    own = drawn | {f"{study.stem}.md", f"{study.stem}.npz"}
    ours = [name for name in wrote if _is_of(study, name) and name in own]
    early = f"{study.stem}-partial.json"
    for old in (path, *(folder / name for name in (PAGE, early, *ours))):  # the list first
        remove_file(old)


def _is_of(study: Study, name: str) -> bool:
    """Return whether a name is that of a file of a study, beside its JSON."""
    return Path(name).name == name and name.split(".")[0].split("-")[0] == study.stem


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")
