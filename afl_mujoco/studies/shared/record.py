"""A result as files: JSON with what made it, an npz of its arrays, figures and text beside it."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from afl_mujoco.errors import FileError, reading
from afl_mujoco.files import (
    array_names,
    atomic_file,
    parse_json,
    read_arrays,
    read_utf8,
    remove_file,
    write_text,
)
from afl_mujoco.pool import interrupts_put_off
from afl_mujoco.report.blocks import Figure, Replay, Report, Section, drawn_of, without_figures
from afl_mujoco.report.markdown import code, plain, to_markdown
from afl_mujoco.report.style import write_figure
from afl_mujoco.studies.shared.arrays import packed, unpacked
from afl_mujoco.studies.shared.contract import Progress, Study, compute, silent, studies

PACKAGES = ("afl_mujoco", "control", "dm_control", "mujoco", "numpy", "scipy", "numba")
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A result with what made it."""

    study: Study
    result: Any
    command: str  # as typed into a shell
    versions: Mapping[str, str] = field(default_factory=versions)  # of `PACKAGES` and of Python
    inputs: Mapping[str, str] = field(default_factory=dict)  # digests of what was run

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
) -> list[Path]:
    """Write a record in place of an older one of its study, and return what was written.

    The numbers come first: a figure that cannot be drawn, or a Ctrl-C meanwhile, costs none.
    """
    study, report = record.study, record.report
    shown = report.blocks if figures else without_figures(report.blocks)
    result, arrays = packed(record.result)
    headline = f"{report.word}: " * bool(report.word) + plain(report.headline)
    text = [headline, *shown, f"Made by {code(record.command)}."]
    paths = [folder / f"{study.stem}{suffix}" for suffix in (".json", ".md", ".npz")]
    path, markdown, npz = paths
    files = {}
    with interrupts_put_off():
        remove_record(study, folder)
        if arrays:
            with atomic_file(npz) as file, file.open("wb") as stream:
                np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
            files[npz.name] = _digest(npz)
        write_text(markdown, to_markdown([Section(report.title, study.name, text)]))
        write_text(path, _as_json(record, result, files))
        others = study.write_files(record.result, folder)
    drawn = drawn_of(shown)
    compute(partial(_write, folder=folder), drawn, "drawing", progress, workers)
    names = (name for one in drawn for name in one.files.values())
    return [path, markdown, *[npz] * bool(arrays), *(folder / name for name in names), *others]


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
    again = f"run {study.command}"
    with reading(path, f"is not a result of {study.command}", again):
        data = json.loads(read_utf8(path), parse_constant=_no_number)
        found = (data["study"], data["schema"])
        if found != (study.name, study.schema):
            rule = f"it must be of {study.name!r} and have schema {study.schema}"
            raise ValueError(f"{rule}, got {found[0]!r} and {found[1]!r}")
        named = {field.name for field in fields(Header)}
        own = {key: value for key, value in data.items() if key in named}
        header = parse_json(json.dumps(own), Header)
        if npz.exists() and header.files.get(npz.name) != _digest(npz):
            raise ValueError(f"{npz.name} beside it must be unchanged since it was written")
        arrays = read_arrays(npz, array_names(npz)) if npz.exists() else {}
        given = {key: value for key, value in data.items() if key not in named}
        result = unpacked(study.parts.Result, given, arrays)
    return Record(
        study=study, result=result, command=header.command, versions=header.versions,
        inputs=header.inputs,
    )  # fmt: skip


def load_records(folder: Path, *, leave_out: str = "") -> list[Record]:
    """Return every record in a folder but one study's."""
    there = (one for one in studies().values() if (folder / f"{one.stem}.json").is_file())
    return [load_record(one, folder) for one in there if one.name != leave_out]


def remove_record(study: Study, folder: Path) -> None:
    """Remove an older record, its figures, and the page made of it."""
    names = [f"{study.stem}.json", PAGE, f"{study.stem}.md", f"{study.stem}.npz"]
    with suppress(FileError):  # of what cannot be read nobody knows the figures
        drawn = drawn_of(load_record(study, folder).report.blocks)
        names += [name for one in drawn for name in one.files.values()]
    for name in names:  # first the list of all others
        remove_file(folder / name)


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")
