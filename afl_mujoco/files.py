"""Files written whole or not at all; JSON files read into dataclasses or refused in one line."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import shutil
import stat
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import NO_NUL, FileError, reading, writing

if TYPE_CHECKING:
    from pydantic import TypeAdapter

Content = TypeVar("Content")

_NUMBERS = re.compile(r"\[\s+([^][{}\"]*?)\s+\]")


@contextmanager
def hidden_folder(folder: Path, kind: str) -> Iterator[Path]:
    """Yield a hidden folder inside a folder, for files that move when they are complete."""
    with writing(f"output folder {folder}"):
        hidden = tempfile.mkdtemp(dir=folder, prefix=f".{kind}-")
    try:
        yield Path(hidden)
    finally:
        for wait in (0.0, 0.1, 0.2, 0.4, 0.8, 1.6):  # the encoder of a worker that was stopped may
            time.sleep(wait)  # just be making its file
            shutil.rmtree(hidden, ignore_errors=True)
            if not os.path.exists(hidden):
                break


def inside(folder: Path, name: str) -> Path:
    """Return a file of a folder, or raise if its name or a link leads out of the folder."""
    path, real = folder / name, os.path.realpath(folder / name)
    if not Path(real).is_relative_to(os.path.realpath(folder)):
        raise FileError(str(path), "must lie in its folder, but leads out of it", real)
    return path


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside `path` to write, and rename it to `path` on success.

    The folder must exist; one that cannot be written raises a `FileError`.
    """
    if "\0" in str(path):
        raise FileError(str(path), NO_NUL)
    if os.path.isdir(path):  # False, and no error, where it cannot be looked at
        raise FileError(str(path), "must be a file to write, not a folder")
    with writing(path):
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".afl_mujoco-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        with writing(path):
            yield temporary
            umask = os.umask(0)
            os.umask(umask)
            temporary.chmod(0o666 & ~umask)
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def remove_file(path: Path) -> None:
    """Remove a file if it is there."""
    with writing(path):
        path.unlink(missing_ok=True)


def require_no_folder(folder: Path, names: Iterable[str]) -> None:
    """Raise if a folder stands where a file belongs."""
    for name in names:
        if (folder / name).is_dir():
            raise FileError(str(folder / name), "must be a file, but is a folder")


def output_folder(path: str | Path) -> Path:
    """Return `path` as a folder that exists and can be written, made with its parents if missing.

    Anything else raises a `FileError`.
    """
    folder = Path(path)
    if "\0" in str(path):
        raise FileError(f"output folder {folder}", NO_NUL)
    with writing(f"output folder {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(f"output folder {folder}", "cannot be written: permission denied")
    return folder


MOST_TEXT = 500_000_000  # largest text file that is read [bytes]: results of a day are smaller
MOST_TOML = 10_000_000  # largest size of a TOML file that is read [bytes]: they are written by hand


def require_regular(path: str | Path, most: int = MOST_TEXT) -> None:
    """Raise if a path is that of a device, a pipe or a socket, or of a file that is too large.

    One of these may have no end, or never begin. What is not there is for the reader to say.
    """
    if "\0" in str(path):
        raise FileError(str(path), NO_NUL)
    with contextlib.suppress(OSError):
        found = os.stat(path)
        if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
            raise FileError(str(path), "must be a file, but is a device, a pipe or a socket")
        if found.st_size > most:
            rule = f"must be at most {most / 1e6:g} MB, has {_megabytes(found.st_size)}"
            raise FileError(str(path), rule)


def _megabytes(size: int) -> str:
    """Return a size, rounded up, so that what is too large reads so."""
    return f"{math.ceil(size / 1e5) / 10:g} MB"


def read_utf8(path: str | Path | Traversable, most: int = MOST_TEXT) -> str:
    """Return the text of a file, without the mark with which some editors begin it."""
    if isinstance(path, str | Path):
        require_regular(path, most)
        path = Path(path)
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("not UTF-8 text: save it as UTF-8") from None


MOST_ARRAYS = 800_000_000  # largest arrays read from a file [bytes]: a run of ten million steps


def array_names(path: Path) -> list[str]:
    """Return the names of the arrays of an npz."""
    require_regular(path)
    with zipfile.ZipFile(path) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist()]


def read_arrays(path: Path, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Return some arrays of an npz, no others: zeros take a thousandth of their size there."""
    wanted = list(names)
    require_regular(path)
    with zipfile.ZipFile(path) as archive:
        sizes = {one.filename: one.file_size for one in archive.infolist()}
    size = sum(sizes[f"{name}.npy"] for name in wanted)
    if size > MOST_ARRAYS:
        rule = f"must take at most {MOST_ARRAYS / 1e6:g} MB, take {_megabytes(size)}"
        raise ValueError(f"its arrays {rule}")
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return {name: file[name] for name in wanted}


def read_toml(path: str | Path) -> dict[str, Any]:
    """Return the content of a TOML file."""
    with reading(path, "is not valid TOML", 'values are written true, 0.9, [1, 2] or "text"'):
        return tomllib.loads(read_utf8(path, MOST_TOML))


# JSON: dataclasses are their own schema


def write_json(path: Path, content: object, *, indent: int | None = 1) -> None:
    """Write a dataclass as JSON, whole or not at all; a list of numbers takes one line.

    A number that is not finite raises a ValueError.
    """
    text = json.dumps(as_plain(content), indent=indent, allow_nan=False, ensure_ascii=False)
    if indent is not None:
        text = _NUMBERS.sub(lambda match: f"[{' '.join(match[1].split())}]", text)
    write_text(path, text + "\n")


def as_plain(content: object, context: object = None) -> Any:
    """Return a dataclass as plain data; `context` is for fields with their own serialisation."""
    return _adapter(type(content)).dump_python(content, mode="json", context=context)


def read_json(path: Path | Traversable, kind: type[Content], wrong: str, then: str = "") -> Content:
    """Read a JSON file into a dataclass; unknown keys, NaN and values of other types are refused.

    The `FileError` names file, key, rule and value: ``"table.json is not a gain table: seed must be
    a valid integer, got 'x'"``, where `wrong` is ``"is not a gain table"``; `then` says what to do
    about it.
    """
    with reading(path, wrong, then):
        return parse_json(read_utf8(path), kind)


def parse_json(text: str, kind: type[Content], context: object = None) -> Content:
    """Return the content of a JSON text, as `read_json` does, or raise ValueError.

    `context` is for fields with their own validation.
    """
    from pydantic import ValidationError

    try:
        content: Content | None = _adapter(kind).validate_json(text, context=context)
    except ValidationError as error:
        raise ValueError(_in_one_line(error)) from None
    if content is None:
        raise ValueError("must be an object, got null")
    return content


_RULES = {
    "missing": "is missing",
    "missing_argument": "is missing",
    "unexpected_keyword_argument": "is not a known key",
}
"""The rule that a value breaks, by pydantic's name of the error."""


def _in_one_line(error: Any) -> str:
    """Return the first complaint of a pydantic ValidationError: key, rule and value."""
    first = error.errors(include_url=False)[0]
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"])
    said = first["msg"].removeprefix("Value error, ").replace("Input should", "must", 1)
    rule = _RULES.get(first["type"], said)
    without = rule == "is missing" or first["type"] in ("json_invalid", "value_error")
    got = "" if without else f", got {shortened(first['input'])}"
    return f"{''.join(parts).removeprefix('.')} {rule}{got}".strip()


def shortened(value: object) -> str:
    """Return a value as a text that is short enough for a message."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:60]}..."


def _adapter(kind: type[Any]) -> TypeAdapter[Any]:
    from pydantic import ConfigDict, TypeAdapter

    optional: Any = kind | None  # pydantic takes no configuration for a bare dataclass
    return TypeAdapter(
        optional,
        config=ConfigDict(
            extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants", strict=True
        ),
    )
