"""Files written whole or not at all, and JSON files read into dataclasses or refused in a line."""

from __future__ import annotations

import json
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import FileError, reading

if TYPE_CHECKING:
    from pydantic import TypeAdapter

Content = TypeVar("Content")

_NUMBERS = re.compile(r"\[\s+([^][{}\"]*?)\s+\]")
_MISSING = object()


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a temporary file beside `path` to write, and rename it onto `path` on success.

    The folder must exist; one that cannot be written is a `FileError`.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=path.suffix)
    except OSError as error:
        raise FileError.cannot_be("written", path, error) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except OSError as error:
        raise FileError.cannot_be("written", path, error) from None
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def output_folder(path: str | Path) -> Path:
    """Return `path` as a folder that exists and can be written, made with its parents if missing.

    Anything else is a `FileError`.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError.cannot_be("written", f"output folder {folder}", error) from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(f"output folder {folder}", "cannot be written: permission denied")
    return folder


# JSON: dataclasses are their own schema


def write_json(path: Path, content: object, *, indent: int | None = 1) -> None:
    """Write a dataclass as JSON, whole or not at all; a list of numbers stands on one line.

    A number that is not finite is a ValueError; NaN in a `FloatArray` is null in the file.
    """
    plain = _adapter(type(content)).dump_python(content, mode="json")
    text = json.dumps(plain, indent=indent, allow_nan=False, ensure_ascii=False)
    if indent is not None:
        text = _NUMBERS.sub(lambda match: f"[{' '.join(match[1].split())}]", text)
    write_text(path, text + "\n")


def read_json(path: Path | Traversable, kind: type[Content], wrong: str, then: str = "") -> Content:
    """Read a JSON file into a dataclass; unknown keys, NaN and values of other types are refused.

    The `FileError` names file, key, rule and value: ``"table.json is not a gain table: seed must be
    a valid integer, got 'x'"``, of which `wrong` is ``"is not a gain table"``; `then` says what to
    do about it.
    """
    with reading(path, wrong, then):
        return parse_json(path.read_text(encoding="utf-8"), kind)


def parse_json(text: str, kind: type[Content]) -> Content:
    """Return what a text of JSON says, as `read_json` does, or raise ValueError."""
    from pydantic import ValidationError

    try:
        content: Content | None = _adapter(kind).validate_json(text)
    except ValidationError as error:
        raise ValueError(_in_one_line(error)) from None
    if content is None:
        raise ValueError("must be an object, got null")
    return content


def _in_one_line(error: Any) -> str:
    """Return the first complaint of a pydantic ValidationError: key, rule and value."""
    first = error.errors(include_url=False)[0]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"])
    rule = {
        "missing": "is missing",
        "missing_argument": "is missing",
        "unexpected_keyword_argument": "is not a known key",
        "json_invalid": first["msg"],
    }.get(first["type"])
    if rule is None:  # "Input should be a valid integer"; "Value error, upper must be above lower"
        said = first["msg"].removeprefix("Value error, ").replace("Input should", "must", 1)
        own = first["type"] == "value_error"  # names its value by itself
        rule = said if own else f"{said}, got {_shortened(first['input'])}"
    return f"{key.removeprefix('.')} {rule}".strip()


def _shortened(value: object) -> str:
    """Return a value as a message can hold it."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:60]}..."


def _adapter(kind: type[Any]) -> TypeAdapter[Any]:
    """Return what reads and writes a dataclass."""
    from pydantic import ConfigDict, TypeAdapter

    optional: Any = kind | None  # for a bare dataclass, pydantic takes no configuration
    return TypeAdapter(
        optional,
        config=ConfigDict(
            extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants", strict=True
        ),
    )


class _NestedLists:
    """How pydantic reads and writes an array: as nested lists, NaN as null."""

    @staticmethod
    def __get_pydantic_core_schema__(source: object, handler: object) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(
            _array,
            serialization=core_schema.plain_serializer_function_ser_schema(_nested_lists),
        )


FloatArray = Annotated[NDArray[np.float64], _NestedLists]
"""An array of floats as a field of a dataclass that is kept in a file."""


def _array(value: object) -> NDArray[np.float64]:
    """Return nested lists as an array, None as NaN."""
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError("must be numbers in lists of equal lengths") from None


def _nested_lists(array: NDArray[np.float64]) -> Any:
    """Return an array as nested lists, NaN as None."""
    unknown = np.isnan(array)
    return (np.where(unknown, None, array) if unknown.any() else array).tolist()  # type: ignore[call-overload]


def differences(there: Any, here: Any, place: str = "") -> list[str]:
    """Say in what two pieces of plain data differ, each part by its name."""
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        parts = [
            (there.get(name, _MISSING), here.get(name, _MISSING), f"{place}.{name}")
            for name in dict.fromkeys((*here, *there))
        ]
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        parts = [(*pair, f"{place}[{i}]") for i, pair in enumerate(zip(there, here, strict=True))]
    elif there == here and type(there) is type(here):
        return []
    else:
        was, now = ("missing" if x is _MISSING else _shortened(x) for x in (there, here))
        return [f"{place.removeprefix('.')} is {was} there and {now} here"]
    return [line for part in parts for line in differences(*part)]
