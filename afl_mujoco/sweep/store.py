"""The finished units of a sweep in a folder, one file a unit, and what the sweep is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from afl_mujoco.errors import FileError, InvalidValueError
from afl_mujoco.files import output_folder, write_text

SCHEMA = 1
SHOWN = 3
"""Differences between two sweeps that a message tells."""

_MISSING = object()


class Store:
    """A folder that holds the finished units of one sweep and takes more.

    ``sweep.json`` says what the sweep is, ``unit-0042.json`` holds a result. Each is written whole
    or not at all.

    Parameters
    ----------
    folder
        The folder; made if missing.
    fingerprint
        What the results depend on, as plain data.
    units
        How many units the sweep has.

    Raises
    ------
    AflMujocoError
        If the folder holds another sweep, or cannot be read or written.
    """

    def __init__(self, folder: Path, fingerprint: Mapping[str, Any], units: int) -> None:
        here = {"schema": SCHEMA, "units": units, "fingerprint": dict(fingerprint)}
        here = plain("fingerprint", here)
        self._folder = output_folder(folder)
        self._units = units
        self._digest = sha256(json.dumps(here, sort_keys=True).encode()).hexdigest()
        path = self._folder / "sweep.json"
        if not path.exists():
            write_text(path, json.dumps(here, indent=1) + "\n")
            return
        try:
            there = json.loads(_read(path))
        except (ValueError, RecursionError) as error:
            raise FileError(str(path), f"is not valid JSON: {error}") from None
        if found := _differences(there, here):
            more = f", and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
            rule = f"holds another sweep: {', '.join(found[:SHOWN])}{more}; name another folder"
            raise FileError(str(folder), rule)

    def finished(self) -> dict[int, Any]:
        """Return the results that the folder holds, by the index of the unit.

        Raises
        ------
        FileError
            If a file is not the finished unit of this sweep that its name says.
        """
        there = {path.name for path in self._folder.iterdir()}
        paths = {index: self._path(index) for index in range(self._units)}
        return {i: self._result(i, path) for i, path in paths.items() if path.name in there}

    def keep(self, index: int, result: Any) -> None:
        """Write the result of a unit.

        Parameters
        ----------
        index
            Of the unit.
        result
            From `plain`.
        """
        write_text(self._path(index), self._text(index, result))

    def _path(self, index: int) -> Path:
        """Return the file of a unit."""
        return self._folder / f"unit-{index:04d}.json"

    def _text(self, index: int, result: Any) -> str:
        """Return what the file of a unit holds."""
        check = sha256(json.dumps(result).encode()).hexdigest()
        entry = {"sweep": self._digest, "index": index, "sha256": check, "result": result}
        return json.dumps(entry) + "\n"

    def _result(self, index: int, path: Path) -> Any:
        """Read the file of a unit, which must be as it was written."""
        text = _read(path)
        try:
            result = json.loads(text)["result"]
        except (ValueError, LookupError, TypeError, RecursionError):
            result = None
        if text != self._text(index, result):
            rule = f"is not unit {index} of this sweep as it was written"
            raise FileError(str(path), f"{rule}; delete it to have it computed again")
        return result


def plain(thing: str, value: Any) -> Any:
    """Return a value as JSON gives it back: every float its bits, a tuple as a list.

    Parameters
    ----------
    thing
        What the value is, for the message.
    value
        Plain data.

    Raises
    ------
    InvalidValueError
        If it is something else.
    """
    try:
        return json.loads(json.dumps(value))
    except (TypeError, ValueError, RecursionError) as error:
        raise InvalidValueError(thing, f"must be plain data: {error}") from None


def _differences(there: Any, here: Any, place: str = "") -> list[str]:
    """Say in what two pieces of plain data differ, each part by its name."""
    if isinstance(there, dict) and isinstance(here, dict):
        parts = [
            (there.get(name, _MISSING), here.get(name, _MISSING), f"{place}.{name}")
            for name in there | here
        ]
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        parts = [(*pair, f"{place}[{i}]") for i, pair in enumerate(zip(there, here, strict=True))]
    elif (was := _shown(there)) != (now := _shown(here)):
        name = place.removeprefix(".").removeprefix("fingerprint.")
        return [f"{name or 'it'} is {was} there and {now} here"]
    else:
        return []
    return [line for part in parts for line in _differences(*part)]


def _shown(value: Any) -> str:
    """Return plain data as text, which differs wherever the data do."""
    return "missing" if value is _MISSING else json.dumps(value)


def _read(path: Path) -> str:
    """Return the text of a file; one that is not UTF-8 is a text that no sweep wrote."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise FileError.cannot_be("read", path, error) from None
