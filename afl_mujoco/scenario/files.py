"""Scenario files: TOML in, the resolved scenario out; the scenario's own classes check it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tomli_w

from afl_mujoco.errors import FileError, InvalidValueError, UnknownNameError
from afl_mujoco.files import read_toml, shortened, write_text
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.plant import Parameter, Plant, known_as, load_plant
from afl_mujoco.scenario.catalogue import LABORATORY, SCENARIOS
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.parameters import COORDINATES, STATE
from afl_mujoco.scenario.ranges import ranges_to_table
from afl_mujoco.scenario.requirements import Requirements
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import (
    ForcePulse,
    Impulse,
    Schedule,
    constant,
    joined,
    piecewise_linear,
    staircase,
    trapezoid,
)
from afl_mujoco.values import (
    Checked,
    Positive,
    Text,
    called_with,
    departures,
    require_finite,
    require_known,
    require_table,
    require_type,
    within,
)

_SCHEDULES: Mapping[str, Callable[..., Any]] = {
    "constant": constant,
    "staircase": staircase,
    "trapezoid": trapezoid,
    "piecewise-linear": piecewise_linear,
    "joined": joined,
}
_DISTURBANCES: Mapping[str, Callable[..., Any]] = {"pulse": ForcePulse, "impulse": Impulse}


@dataclass(frozen=True, kw_only=True)
class Replay(Checked):
    """How a scenario was run: the defaults of `afl-mujoco simulate` for it."""

    controller: Text | None = None
    integrator: Text | None = None
    timestep: Positive | None = None
    control_period: Positive | None = None


_KEYS = (
    *("name", "plant", "duration", "initial_state", "schedule", "disturbances"),
    *("imperfections", "requirements", "belief", "ranges", "replay"),
)
_ABSENT_WHERE_EMPTY = ("plant", "imperfections", "requirements", "belief", "ranges")


_NAMED = {**SCENARIOS, LABORATORY.name: LABORATORY}


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a TOML file.

    Parameters
    ----------
    path
        The file. `docs/reference/scenario_files.md` lists its keys; what it leaves out is nominal.

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
    with within(f"{path}: "):
        return _scenario(table, default_name=path.stem, folder=path.parent)


def find_replay(name: str) -> Replay:
    """Return how a scenario was run, from the table ``[replay]`` of its file."""
    table = _read(Path(name)) if is_toml(name) else {}
    return called_with(Replay, "replay", table.get("replay", {}))


def save_scenario(
    scenario: Scenario,
    path: str | Path,
    *,
    replay: Replay | None = None,
    moves_to: Path | None = None,
) -> None:
    """Write a scenario to a TOML file, its defaults written out.

    Parameters
    ----------
    scenario
        The scenario; `load_scenario` reads an equal one from the file.
    path
        The file to write.
    replay
        How it was run.
    moves_to
        The folder from which it will be read, if another: the file of its plant is named from
        there.

    Raises
    ------
    InvalidValueError
        If it is no scenario.
    FileError
        If the file cannot be written.
    """
    require_type("scenario", scenario, Scenario)
    table = scenario_to_table(scenario)
    if not scenario.is_cart_pole:
        if not scenario.plant.origin:
            rule = "must be loaded from a file, as FILE.py:NAME, to be named in one"
            raise InvalidValueError(f"plant {scenario.plant.name!r}", rule)
        folder = Path(path).parent if moves_to is None else moves_to
        table["plant"] = _relative(scenario.plant.origin, folder.absolute())
    if replay is not None:
        table["replay"] = {name: value for name, value in asdict(replay).items() if value}
    write_text(Path(path), tomli_w.dumps(table))


def _relative(origin: str, folder: Path) -> str:
    """Return the origin of a plant as a file in a folder names it."""
    place, _, attribute = origin.rpartition(":")
    if not place.endswith(".py"):
        return origin
    try:
        return f"{Path(os.path.relpath(place, folder)).as_posix()}:{attribute}"
    except ValueError:  # on another drive
        return origin


def is_toml(name: str) -> bool:
    """Return whether a name is that of a TOML file."""
    return name.lower().endswith(".toml")


def find_scenario(name: str) -> Scenario:
    """Return a scenario of the catalogue, or the one in the TOML file of that name.

    Parameters
    ----------
    name
        A key of `SCENARIOS`, ``laboratory``, or a path that ends in ``.toml``.

    Raises
    ------
    UnknownNameError
        If `name` is neither.
    """
    if name in _NAMED:
        return _NAMED[name]
    if is_toml(name):
        return load_scenario(name)
    if Path(f"{name}.toml").is_file():
        rule = "must be in the catalogue or end in .toml"
        raise InvalidValueError("scenario", rule, f"{name!r}; did you mean {name}.toml?")
    raise UnknownNameError.among("scenario", name, (*_NAMED, "a .toml file"))


def as_scenario(scenario: Scenario | str | Path) -> Scenario:
    """Return a scenario as it is, or the one that `find_scenario` finds by its name or path."""
    return scenario if isinstance(scenario, Scenario) else find_scenario(str(scenario))


def as_scenarios(
    scenarios: Scenario | str | Path | Sequence[Scenario | str | Path],
) -> list[Scenario]:
    """Return scenarios from one or several, each as `as_scenario` takes it."""
    if isinstance(scenarios, Iterable) and not isinstance(scenarios, str):
        return [as_scenario(one) for one in scenarios]
    return [as_scenario(scenarios)]  # whatever else it is, it is refused as one


def scenario_from_table(table: Mapping[str, Any]) -> Scenario:
    """Return the scenario of the table of a TOML file, which has to name it."""
    return _scenario(require_table("scenario", table), default_name="")


def scenario_to_table(scenario: Scenario) -> dict[str, Any]:
    """Return the resolved scenario as the table of a TOML file.

    Every default is written out, except in `imperfections`, `requirements`, `belief` and `ranges`,
    which contain only the values that differ from their defaults.
    """
    s = scenario
    shapes = {builder: shape for shape, builder in _DISTURBANCES.items()}
    acting = [{"shape": shapes[type(d)], **asdict(d)} for d in s.disturbances]
    found = {
        "name": s.name,
        "plant": None if s.is_cart_pole else _plant_to_table(s.plant),
        "duration": s.duration,
        "initial_state": dict(zip(s.plant.states, s.initial_state, strict=True)),
        "schedule": {name: _knots(one) for name, one in s.schedule.items()},
        "disturbances": [{k: x for k, x in one.items() if x != ""} for one in acting],
        "imperfections": departures(s.imperfections),
        "requirements": departures(s.requirements),
        "belief": s.belief.table,
        "ranges": ranges_to_table(s.ranges),
    }
    return {key: value for key, value in found.items() if value or key not in _ABSENT_WHERE_EMPTY}


def _plant_to_table(plant: Plant) -> dict[str, Any]:
    found = {name: getattr(plant, name) for name in ("name", "origin", "upright", "start")}
    found |= {name: [*getattr(plant, name)] for name in ("coordinates", "inputs", "wraps")}
    nominal = {name: one.value for name, one in plant.parameters.items()}
    for end in ("low", "high"):
        found[end] = {name: getattr(one, end) for name, one in plant.parameters.items()}
    found |= {"parameters": nominal, "units": dict(plant.units)}
    found |= {"signals": [*plant.signals], "ends_at": dict(plant.ends_at)}
    return {name: value for name, value in found.items() if value not in (None, "", [], {})}


def _plant(given: Any, folder: Path | None) -> Plant:
    """Return the plant of a file, loaded; of a result its names, which cannot be simulated."""
    if given in (None, CART_POLE.name):
        return CART_POLE
    if isinstance(given, str):
        return load_plant(given, folder)
    if folder is not None:
        raise InvalidValueError("plant", 'must be "FILE.py:NAME"', shortened(given))
    table = dict(require_table("plant", given))
    units, origin = dict(table.pop("units", {})), str(table.pop("origin", ""))
    low, high = (require_table(f"plant: {end}", table.pop(end, {})) for end in ("low", "high"))
    values = {  # an older result says nothing of bounds
        name: Parameter(x, units.get(name, ""), low.get(name, -1e300), high.get(name, 1e300))
        for name, x in given.get("parameters", {}).items()
    }
    names = dict.fromkeys(table.get("signals", ()), float)
    with within("plant: "):
        known = Plant(**{**table, "parameters": values, "signals": names}, model="<mujoco/>")
    object.__setattr__(known, "units", units)
    return known_as(known, origin)


def _knots(schedule: Schedule) -> Any:
    """Return a schedule as the value of its key: a number if it never changes."""
    if schedule == constant(schedule.values[0]):
        return schedule.values[0]
    times, values = [*schedule.times], [*schedule.values]
    return {"shape": "piecewise-linear", "times": times, "values": values}


def _read(path: Path) -> dict[str, Any]:
    table = read_toml(path)
    if not table:  # a file that was never filled in would run as the nominal scenario
        raise FileError(str(path), "must have at least one key: it is empty or all comments")
    _require_new_spelling(path, table)
    return table


_MOVED: Mapping[str, str] = {
    **{name: f"[schedule] {name}" for name in CART_POLE.parameters},
    "imperfections.actuator_lag": "lag",
    "imperfections.force_limit": "input_limit",
    **{
        f"imperfections.{field}_{name}": f"{field} = {{ {name} = ... }}"
        for field, names in (("noise", STATE), ("encoder_step", COORDINATES))
        for name in names
    },
    **{
        f"imperfections.{place}_{old}": f"{field} = {{ {name} = ... }}"
        for place, name in (("rail", "z"), ("hinge", "phi"))
        for old, field in (
            ("damping", "damping"),
            ("friction", "dry_friction"),
            ("armature", "armature"),
            ("half_length", "end_stops"),
        )
    },
    **{
        f"requirements.{old}": f"{field} = {{ {name} = ... }}"
        for old, field, name in (
            ("max_position", "max", "z"),
            ("max_angle", "max", "phi"),
            ("max_force", "max", "force"),
            ("max_command", "max", "force_command"),
            ("position_band", "bands", "z"),
            ("angle_band", "bands", "phi"),
        )
    },
}
"""What older files spelled otherwise, and how it is spelled now."""


def _require_new_spelling(path: Path, table: Mapping[str, Any]) -> None:
    """Raise if a file has a key as it was spelled before keys went by the plant's names."""
    for name, value in table.items():
        keys = [f"{name}.{key}" for key in value] if isinstance(value, Mapping) else [name]
        for key in keys:
            told = key.replace("ranges.", "imperfections.")
            if now := _MOVED.get(told):
                raise InvalidValueError(f"{path}: {key}", f"is not a known key; it is now {now}")


def _scenario(table: Mapping[str, Any], default_name: str, folder: Path | None = None) -> Scenario:
    """Build the scenario that a file describes; its plant may be relative to a folder."""
    require_known(table, _KEYS)
    called_with(Replay, "replay", table.get("replay", {}))  # raises if it is none
    plant = _plant(table.get("plant"), folder)
    schedule = require_table("schedule", table.get("schedule", {}))
    disturbances = table.get("disturbances", [])
    if not isinstance(disturbances, list):
        rule = "must be a list of tables, each of which begins with [[disturbances]]"
        raise InvalidValueError("disturbances", rule, shortened(disturbances))
    return Scenario(
        name=table.get("name", default_name),
        plant=plant,
        schedule={name: _schedule(f"schedule.{name}", one) for name, one in schedule.items()},
        disturbances=tuple(
            _shaped(_DISTURBANCES, f"disturbances[{i}]", one) for i, one in enumerate(disturbances)
        ),
        imperfections=called_with(Imperfections, "imperfections", table.get("imperfections", {})),
        requirements=called_with(Requirements, "requirements", table.get("requirements", {})),
        **{
            key: table[key]
            for key in ("duration", "initial_state", "belief", "ranges")
            if key in table
        },
    )


def _schedule(thing: str, value: Any) -> Schedule:
    if not isinstance(value, Mapping):
        return constant(require_finite(thing, value))
    found: Schedule = _shaped(_SCHEDULES, thing, value)
    return found


def _shaped(builders: Mapping[str, Callable[..., Any]], thing: str, table: Any) -> Any:
    """Return what a table with a shape describes."""
    given = dict(require_table(thing, table))
    if "shape" not in given:
        raise InvalidValueError(thing, f"must have a shape, one of {', '.join(builders)}")
    if (shape := given.pop("shape")) not in [*builders]:
        raise UnknownNameError.among(f"{thing}.shape", shape, builders)
    if isinstance(pieces := given.get("pieces"), list):
        given["pieces"] = [_schedule(f"{thing}.pieces[{i}]", x) for i, x in enumerate(pieces)]
    return called_with(builders[shape], thing, given)
