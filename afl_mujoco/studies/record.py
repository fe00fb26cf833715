"""A result as files: JSON with what made it, an npz of its arrays, figures and text beside it."""

from __future__ import annotations

import json
import platform
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    PlainSerializer,
    PlainValidator,
    SerializationInfo,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
)

from afl_mujoco.document.blocks import Command, Section, figures_of
from afl_mujoco.document.markdown import to_markdown
from afl_mujoco.document.style import write_figures
from afl_mujoco.errors import FileError, reading
from afl_mujoco.files import atomic_file, write_text
from afl_mujoco.studies.contract import Study
from afl_mujoco.studies.registry import studies

PACKAGES = ("afl_mujoco", "control", "mujoco", "numpy", "scipy", "numba")
"""Whose versions are kept."""


def _store(array: NDArray[Any], info: SerializationInfo) -> str:
    """Set an array apart for the npz, and return its name there."""
    context: Any = info.context
    name = f"array-{len(context)}"
    context[name] = np.asarray(array)
    return name


def _fetch(value: Any, info: ValidationInfo) -> NDArray[Any]:
    """Return an array by its name in the npz."""
    arrays: Any = info.context or {}
    if isinstance(value, str) and value in arrays:
        found: NDArray[Any] = arrays[value]
        return found
    raise ValueError(f"must be the name of an array of the npz, got {value!r}")


Array = Annotated[NDArray[Any], PlainValidator(_fetch), PlainSerializer(_store)]
"""A field of a result that is kept in the npz beside the JSON."""


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    return {**{name: version(name) for name in PACKAGES}, "python": platform.python_version()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A result with what made it.

    Attributes
    ----------
    study, result
        The study, and what it found.
    command
        What found it, as typed into a shell.
    versions
        Of the packages that did.
    """

    study: Study
    result: Any
    command: str
    versions: Mapping[str, str] = field(default_factory=versions)

    @property
    def sections(self) -> list[Section]:
        """What a report says of it, with the command that made it."""
        first, *rest = self.study.sections(self.result)
        made = Command("Made by", self.command)
        return [replace(first, blocks=(*first.blocks, made)), *rest]


def save_record(record: Record, folder: Path) -> list[Path]:
    """Write a record in place of an older one of its study, and return what was written.

    Every file is complete before the older record goes; the JSON, which names the others, is last.
    """
    study, sections = record.study, record.sections
    arrays: dict[str, NDArray[Any]] = {}
    adapter: TypeAdapter[Any] = TypeAdapter(study.result_type)
    result = adapter.dump_python(record.result, mode="json", context=arrays)
    with _staging(folder) as staging:
        write_figures(figures_of(sections), staging)
        write_text(staging / f"{study.name}.md", to_markdown(sections))
        if arrays:
            with atomic_file(staging / f"{study.name}.npz") as file, file.open("wb") as stream:
                np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
        staged = sorted(path.name for path in staging.iterdir())
        text = _as_json(record, result, staged)
        remove_record(study, folder)
        others = study.write_files(record.result, folder)
        for name in staged:
            (staging / name).replace(folder / name)
    path = folder / f"{study.name}.json"
    write_text(path, text)  # last: it names the others
    return [path, *(folder / name for name in staged), *others]


def _as_json(record: Record, result: Any, files: Sequence[str]) -> str:
    """Return a record as text, or raise if a number is not finite."""
    data = {
        "schema": record.study.schema,
        "study": record.study.name,
        "command": record.command,
        "versions": dict(record.versions),
        "files": list(files),
        "result": result,
    }
    return json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def load_record(study: Study, folder: Path) -> Record:
    """Return the record of a study in a folder."""
    path, again = folder / f"{study.name}.json", f"run {study.command}"
    with reading(path, f"is no result of {study.command}", again):
        data = json.loads(path.read_text(encoding="utf-8"), parse_constant=_no_number)
        found = (data["study"], data["schema"])
        if found != (study.name, study.schema):
            rule = f"it must be of {study.name!r} and have schema {study.schema}"
            raise ValueError(f"{rule}, got {found[0]!r} and {found[1]!r}")
        if not isinstance(data["command"], str):
            raise ValueError("command must be a text")
        context = _arrays(folder / f"{study.name}.npz")
        try:
            adapter: TypeAdapter[Any] = TypeAdapter(study.result_type)
            result = adapter.validate_python(data["result"], context=context)
        except ValidationError as error:
            raise ValueError(_first(error)) from None
    return Record(study=study, result=result, command=data["command"], versions=data["versions"])


def load_records(folder: Path, *, leave_out: str = "") -> list[Record]:
    """Return every record that a folder holds, but for one study's; the folder may be missing."""
    there = [s for s in studies().values() if (folder / f"{s.name}.json").is_file()]
    return [load_record(study, folder) for study in there if study.name != leave_out]


def remove_record(study: Study, folder: Path) -> None:
    """Remove an older record: its JSON, and the files beside it that it lists as its own."""
    path = folder / f"{study.name}.json"
    try:
        with reading(path, "is no record"):
            listed = [str(name) for name in json.loads(path.read_text(encoding="utf-8"))["files"]]
    except FileError:
        listed = []
    ours = [name for name in listed if _is_of(study, name)]
    for old in (path, *(folder / name for name in ours)):  # the list first: it names the others
        try:
            old.unlink(missing_ok=True)
        except OSError as error:
            raise FileError.cannot_be("written", old, error) from None


def _is_of(study: Study, name: str) -> bool:
    """Return whether a name is that of a file of a study, beside its JSON."""
    return Path(name).name == name and name.split(".")[0].split("-")[0] == study.name


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an npz; none if it is not there."""
    if not path.exists():
        return {}
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _first(error: ValidationError) -> str:
    """Return the first of what pydantic objects to, in one line."""
    said = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in ("result", *said["loc"]))
    return f"{place}: {said['msg'][:1].lower()}{said['msg'][1:]}"


def _no_number(name: str) -> NoReturn:
    """Refuse what JSON does not know."""
    raise ValueError(f"{name} is no number of JSON")


@contextmanager
def _staging(folder: Path) -> Iterator[Path]:
    """Give a folder for files that are moved to `folder` when all of them are written."""
    try:
        made = tempfile.TemporaryDirectory(dir=folder, prefix=".", ignore_cleanup_errors=True)
    except OSError as error:
        raise FileError.cannot_be("written", folder, error) from None
    with made as staging:
        yield Path(staging)
