"""A report.json, read and held to its form: whatever the page takes from it is there."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from afl_mujoco.errors import FileError

Row = Mapping[str, Any]

AGAIN = "run afl-mujoco validate"
"""What mends a folder that the page cannot be made from."""

TEXT, FLAG, NUMBER, MAYBE = "a text", "true or false", "a number", "a number or null"
TABLE, NUMBERS, PAIR = "a table", "numbers", "two numbers"
"""What a value must be, in the words of the message that says that it is not."""

_PLACE = {"scenario": TEXT, "controller": TEXT}
_SOURCES = dict.fromkeys(
    (
        "total", "model_form", "integrator", "control_hold", "schedule_sampling",
        "disturbance_timing", "residual",
    ),
    NUMBER,
)  # fmt: skip
_LEDGER = dict.fromkeys(
    (
        "work", "energy_of_ramps", "energy_of_jumps", "energy_residual", "impulse",
        "momentum_of_ramps", "momentum_of_jumps", "momentum_residual",
    ),
    NUMBER,
)  # fmt: skip

REQUIRED: Mapping[str, Mapping[str, str]] = {
    "checks": {
        "id": TEXT, **_PLACE, "quantity": TEXT, "unit": TEXT, "value": MAYBE, "limit": NUMBER,
        "passed": FLAG, "reason": TEXT,
    },
    "runs": {**_PLACE, "simulator": TEXT, "outcome": TEXT, "metrics": TABLE},
    "claims": {
        "id": TEXT, "claim": TEXT, "figure": TEXT, "paper": MAYBE, "here": MAYBE, "verdict": TEXT,
        "why": TEXT,
    },
    "error_budgets": {**_PLACE, **_SOURCES, "residual_share": NUMBER, "at_worst": TABLE},
    "ledgers": {**_PLACE, **_LEDGER},
    "omissions": {**_PLACE, "stretching_rod": NUMBER, "momenta_kept": NUMBER},
    "studies": {
        **_PLACE, "study": TEXT, "steps": NUMBERS, "errors": NUMBERS, "order": MAYBE,
        "expected": NUMBER,
    },
}  # fmt: skip
"""Lists of a report, and what every row of each must hold."""

_COMPARISON = {"schedules": NUMBER, "share": NUMBER, "interval": PAIR, "quantiles": TABLE}
_AT_WORST = {"state": TEXT, "time": NUMBER, **_SOURCES}
_TABLES = ("versions", "random_schedules", "decisions", "settings")
_SETTINGS = {"timestep": NUMBER, "control_period": NUMBER}


def load_report(path: Path) -> dict[str, Any]:
    """Read a report that `afl-mujoco validate` wrote."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"), parse_constant=_no_number)
    except OSError as error:
        said = FileError.cannot_be("read", path, error)
        raise FileError(said.thing, f"{said.rule}: {AGAIN}") from None
    except ValueError as error:
        raise FileError(str(path), f"is not a report: {error}: {AGAIN}") from None
    try:
        return require_report(data)
    except ValueError as error:
        raise FileError(str(path), f"is not a report: {error}: {AGAIN}") from None


def require_report(data: object) -> dict[str, Any]:
    """Return data as a report."""
    if not isinstance(data, dict):
        _refuse("it", TABLE, data)
    if data.get("schema") != 1:
        _refuse("schema", "1", data.get("schema"))
    for name, columns in REQUIRED.items():
        rows = data.get(name)
        if not isinstance(rows, list):
            _refuse(name, "a list", rows)
        for index, row in enumerate(rows):
            _require(f"{name}[{index}]", row, columns)
    _require("it", data, dict.fromkeys(_TABLES, TABLE) | {"command": TEXT, "verdict": TEXT})
    _require_depths(data)
    _require_verdict(data["verdict"], data["checks"])
    return data


def _require_depths(data: Row) -> None:
    """Raise unless the tables within the rows hold what they must."""
    for index, row in enumerate(data["error_budgets"]):
        _require(f"error_budgets[{index}].at_worst", row["at_worst"], _AT_WORST)
    for index, row in enumerate(data["runs"]):
        _require(f"runs[{index}].metrics", row["metrics"], dict.fromkeys(row["metrics"], MAYBE))
    for name, row in data["random_schedules"].items():
        _require(f"random_schedules.{name}", row, _COMPARISON)
        quantiles = dict.fromkeys(row["quantiles"], MAYBE)
        _require(f"random_schedules.{name}.quantiles", row["quantiles"], quantiles)
    _require("settings", data["settings"], _SETTINGS)
    for name in ("versions", "decisions"):
        _require(name, data[name], dict.fromkeys(data[name], TEXT))


def _require(place: str, row: object, columns: Mapping[str, str]) -> None:
    """Raise unless a table holds every key, each of its kind."""
    if not isinstance(row, dict):
        _refuse(place, TABLE, row)
    for key, kind in columns.items():
        if not _is(row.get(key), kind) or key not in row:
            _refuse(f"{place}.{key}".removeprefix("it."), kind, row.get(key, "nothing"))


def _is(value: object, kind: str) -> bool:
    """Return whether a value is of a kind."""
    if kind == NUMBERS:
        return isinstance(value, list) and all(_is(x, MAYBE) for x in value)
    if kind == PAIR:
        return isinstance(value, list) and [_is(x, NUMBER) for x in value] == [True, True]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return {
        TEXT: isinstance(value, str),
        FLAG: isinstance(value, bool),
        NUMBER: number,
        MAYBE: number or value is None,
        TABLE: isinstance(value, dict),
    }[kind]


def _require_verdict(verdict: str, checks: Iterable[Row]) -> None:
    """Raise unless the verdict follows from the checks: a page must not contradict itself."""
    outcomes = [check["passed"] for check in checks]
    wanted = "pass" if outcomes and all(outcomes) else "fail"
    if verdict != wanted:
        _refuse("verdict", f"{wanted!r}, as its checks say", repr(verdict))


def _no_number(name: str) -> NoReturn:
    """Refuse what JSON does not know."""
    raise ValueError(f"{name} is no number of JSON")


def _refuse(place: str, rule: str, value: object) -> NoReturn:
    """Raise the error that names place, rule and value."""
    said = str(value) if isinstance(value, str | int | float) else type(value).__name__
    raise ValueError(f"{place} must be {rule}, got {said:.60}")
