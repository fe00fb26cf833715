"""A file of the units that are done, from which an interrupted computation is resumed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from afl_mujoco.errors import FileError
from afl_mujoco.files import differences, read_json, write_json

SHOWN = 3  # differences that a message names


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    """The content of the file."""

    schema: Literal[1]
    fingerprint: dict[str, Any]
    results: dict[int, Any]


class Store:
    """The results so far, by index of the unit, in a file that is always complete.

    The fingerprint is whatever the results depend on (settings, seeds, versions), as plain data; a
    file with another fingerprint raises a `FileError`. The folder of the file must exist.
    """

    def __init__(self, path: Path, fingerprint: Mapping[str, Any]) -> None:
        here = json.loads(json.dumps(dict(fingerprint)))
        self._path = path
        self._file = _File(schema=1, fingerprint=here, results={})
        if not path.exists():
            write_json(path, self._file)
            return
        there = read_json(path, _File, "is not a store of results", "remove it to start anew")
        if found := differences(there.fingerprint, here):
            more = f", and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
            rule = f"holds other results: {', '.join(found[:SHOWN])}{more}; name another folder"
            raise FileError(str(path), rule)
        self._file = there

    @property
    def results(self) -> Mapping[int, Any]:
        """The results by index of the unit."""
        return self._file.results

    def keep(self, index: int, result: Any) -> None:
        """Add the result of a unit: lists, texts and finite numbers."""
        self._file.results[index] = result
        write_json(self._path, self._file)
