"""Scenario files: TOML in, the resolved scenario out."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import tomli_w

from afl_mujoco.errors import AflMujocoError, FileError, InvalidValueError, UnknownNameError
from afl_mujoco.files import write_text
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.disturbances import ForcePulse, Impulse
from afl_mujoco.scenario.realism import IDEAL, realism_from_table, realism_to_table
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import (
    Schedule,
    constant,
    joined,
    piecewise_linear,
    step,
    trapezoid,
)

Table = Mapping[str, Any]

_SHAPES: dict[str, tuple[Callable[..., Schedule], tuple[str, ...]]] = {
    "constant": (constant, ("value",)),
    "step": (step, ("times", "values")),
    "trapezoid": (trapezoid, ("times", "low", "high")),
    "piecewise-linear": (piecewise_linear, ("times", "values")),
    "joined": (joined, ("starts", "pieces")),
}
_DISTURBANCES: dict[str, tuple[Callable[..., ForcePulse | Impulse], tuple[str, ...]]] = {
    "pulse": (ForcePulse, ("force", "start", "duration")),
    "impulse": (Impulse, ("momentum", "time")),
}
_SCALARS = ("pole_mass", "gravity", "duration")
_LISTS = ("times", "values", "starts", "pieces")

REPLAY = ("controller", "integrator")
"""Keys of ``[replay]``: how a scenario was run, as `afl-mujoco simulate` takes it."""


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a TOML file.

    Parameters
    ----------
    path
        The file. `docs/notation.md` lists its keys; whatever it leaves out is nominal.

    Returns
    -------
    Scenario
        The same dataclass as those of `SCENARIOS`.

    Raises
    ------
    AflMujocoError
        If the file cannot be read or breaks a rule; the message names file, key and value.
    """
    path = Path(path)
    table = _read(path)
    try:
        return scenario_from_table(table, default_name=path.stem)
    except AflMujocoError as error:
        raise error.within(f"{path}: ") from None


def find_replay(name: str) -> dict[str, str]:
    """Return how a scenario's file says that it was run: its ``[replay]``, empty for most.

    Parameters
    ----------
    name
        As of `find_scenario`, which raises at what is wrong with the file.

    Returns
    -------
    dict
        Some of `REPLAY`, by name.
    """
    if name in SCENARIOS:
        return {}
    return _replay(_read(Path(name)))


def _read(path: Path) -> dict[str, Any]:
    """Return the table of a TOML file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else None
        reason = why.lower() if why else "not UTF-8 text"
        raise FileError(str(path), f"cannot be read: {reason}") from None
    except tomllib.TOMLDecodeError as error:
        raise FileError(str(path), f"is not valid TOML: {error}") from None
    except RecursionError:
        raise FileError(str(path), "is nested too deeply") from None


def _replay(table: Table) -> dict[str, str]:
    """Return the table that says how a scenario was run, which no scenario needs."""
    replay = _table("replay", table.get("replay", {}))
    try:
        _require_keys(replay, REPLAY)
        for key, value in replay.items():
            if not isinstance(value, str):
                raise InvalidValueError(key, "must be text", repr(value))
    except AflMujocoError as error:
        raise error.within("replay.") from None
    return dict(replay)


def save_scenario(
    scenario: Scenario, path: str | Path, *, replay: Mapping[str, str] | None = None
) -> None:
    """Write a scenario to a TOML file, every default but an ideal `realism` written out.

    Parameters
    ----------
    scenario
        The scenario; `load_scenario` of the file equals it.
    path
        The file to write.
    replay
        How it was run, some of `REPLAY`: what `afl-mujoco simulate` does unless told otherwise.

    Raises
    ------
    FileError
        If it cannot be written.
    """
    table = scenario_to_table(scenario) | ({"replay": dict(replay)} if replay else {})
    write_text(Path(path), tomli_w.dumps(table))


def find_scenario(name: str) -> Scenario:
    """Return a scenario of the catalogue, or the one in the TOML file of that name.

    Parameters
    ----------
    name
        A key of `SCENARIOS`, or a path that ends in ``.toml``.

    Raises
    ------
    UnknownNameError
        If `name` is neither.
    """
    if name in SCENARIOS:
        return SCENARIOS[name]
    if name.endswith(".toml"):
        return load_scenario(name)
    raise UnknownNameError.among("scenario", name, (*SCENARIOS, "a .toml file"))


def scenario_from_table(table: Table, default_name: str) -> Scenario:
    """Build a scenario from the table of a TOML file.

    Parameters
    ----------
    table
        The parsed file.
    default_name
        The name to give it if it has none.
    """
    _require_keys(
        table,
        ("name", *_SCALARS, "initial_state", "schedule", "disturbances", "realism", "replay"),
    )
    _replay(table)
    schedules = _table("schedule", table.get("schedule", {}))
    try:
        _require_keys(schedules, ("cart_mass", "half_length"))
    except AflMujocoError as error:
        raise error.within("schedule.") from None
    fields: dict[str, Any] = {key: table[key] for key in _SCALARS if key in table}
    for key, value in schedules.items():
        try:
            fields[key] = _schedule(value)
        except AflMujocoError as error:
            raise error.within(f"schedule.{key}.") from None
    if "initial_state" in table:
        fields["initial_state"] = _list("initial_state", table["initial_state"])
    listed = _list("disturbances", table.get("disturbances", []))
    fields["disturbances"] = tuple(_disturbance(i, entry) for i, entry in enumerate(listed))
    options = _table("realism", table.get("realism", {}))
    try:
        fields["realism"] = realism_from_table(options)
    except AflMujocoError as error:
        raise error.within("realism.") from None
    name = table.get("name", default_name)
    if not isinstance(name, str):
        raise InvalidValueError("name", "must be text", repr(name))
    return Scenario(name=name, **fields)


def scenario_to_table(scenario: Scenario) -> dict[str, Any]:
    """Return the resolved scenario as the table of a TOML file.

    Every default is written out, but for `realism`, of which only what is not ideal.

    Parameters
    ----------
    scenario
        The scenario; ``scenario_from_table`` of the result equals it.
    """
    schedules = {"cart_mass": scenario.cart_mass, "half_length": scenario.half_length}
    return {
        "name": scenario.name,
        **{key: getattr(scenario, key) for key in _SCALARS},
        "initial_state": list(scenario.initial_state),
        "schedule": {
            key: {
                "shape": "piecewise-linear",
                "times": list(schedule.times),
                "values": list(schedule.values),
            }
            for key, schedule in schedules.items()
        },
        "disturbances": [
            {"shape": shape, **{key: getattr(disturbance, key) for key in keys}}
            for disturbance in scenario.disturbances
            for shape, (kind, keys) in _DISTURBANCES.items()
            if type(disturbance) is kind
        ],
        **({} if scenario.realism == IDEAL else {"realism": realism_to_table(scenario.realism)}),
    }


def _schedule(value: object) -> Schedule:
    """Build a schedule from a number or from a table with a ``shape``."""
    if not isinstance(value, Mapping):
        return constant(value)  # type: ignore[arg-type]
    build, keys = _shape(value, _SHAPES)
    arguments = {key: _list(key, value[key]) if key in _LISTS else value[key] for key in keys}
    if "pieces" in arguments:
        arguments["pieces"] = [_piece(i, piece) for i, piece in enumerate(arguments["pieces"])]
    schedule: Schedule = build(**arguments)
    return schedule


def _piece(index: int, value: object) -> Schedule:
    """Build one piece of a joined schedule."""
    try:
        return _schedule(value)
    except AflMujocoError as error:
        raise error.within(f"pieces[{index}].") from None


def _disturbance(index: int, value: object) -> ForcePulse | Impulse:
    """Build a disturbance from its table."""
    table = _table(f"disturbances[{index}]", value)
    try:
        build, keys = _shape(table, _DISTURBANCES)
        disturbance: ForcePulse | Impulse = build(**{key: table[key] for key in keys})
        return disturbance
    except AflMujocoError as error:
        raise error.within(f"disturbances[{index}].") from None


def _shape(table: Table, known: dict[str, tuple[Callable[..., Any], tuple[str, ...]]]) -> Any:
    """Return builder and keys of the shape that `table` names, its keys checked."""
    shape = table.get("shape")
    if not isinstance(shape, str) or shape not in known:
        raise UnknownNameError.among("shape", shape, known)
    _, keys = known[shape]
    _require_keys(table, ("shape", *keys))
    for key in keys:
        if key not in table:
            raise InvalidValueError(key, f"must be given for shape {shape!r}")
    return known[shape]


def _require_keys(table: Table, known: tuple[str, ...]) -> None:
    """Raise if `table` has a key that is not `known`."""
    for key in table:
        if key not in known:
            raise InvalidValueError(key, f"is not a known key; known are {', '.join(known)}")


def _list(thing: str, value: object) -> list[Any]:
    """Return `value` if it is a list, or raise."""
    if not isinstance(value, list):
        raise InvalidValueError(thing, "must be a list", repr(value))
    return value


def _table(thing: str, value: object) -> Table:
    """Return `value` if it is a table, or raise."""
    if not isinstance(value, Mapping):
        raise InvalidValueError(thing, "must be a table", repr(value))
    return value
