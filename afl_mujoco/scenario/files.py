"""Scenario files: TOML in, the resolved scenario out.

The dataclasses of this module are the schema of the file, which pydantic enforces; the scenario's
own classes check the values.
"""

from __future__ import annotations

import functools
import inspect
import json
import operator
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import tomli_w

from afl_mujoco.errors import FileError, InvalidValueError, UnknownNameError
from afl_mujoco.files import parse_json, toml_as_json, write_text
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.plant import Parameter, Plant, known_as, load_plant
from afl_mujoco.scenario.belief import Belief
from afl_mujoco.scenario.catalogue import LABORATORY, SCENARIOS
from afl_mujoco.scenario.disturbances import ForcePulse, Impulse
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.parameters import COORDINATES, STATE
from afl_mujoco.scenario.ranges import Ranges
from afl_mujoco.scenario.requirements import Requirements
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import (
    Schedule,
    constant,
    joined,
    piecewise_linear,
    staircase,
    trapezoid,
)
from afl_mujoco.values import departures, require_type, within


class _NumberOrTable:
    """How pydantic reads a schedule: a number means a constant schedule."""

    @staticmethod
    def __get_pydantic_core_schema__(source: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic_core import core_schema

        def as_table(value: Any) -> Any:
            if isinstance(value, dict):
                return value
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError(f"must be a number or a table, got {value!r:.60}")
            return {"shape": "constant", "value": value}

        return core_schema.no_info_before_validator_function(as_table, handler(source))


class _ByShape:
    """How pydantic distinguishes the members of a union."""

    @staticmethod
    def __get_pydantic_core_schema__(source: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic import Discriminator

        return handler(Annotated[source, Discriminator("shape")])


_SCHEDULES: Mapping[str, Callable[..., Any]] = {
    "constant": constant,
    "staircase": staircase,
    "trapezoid": trapezoid,
    "piecewise-linear": piecewise_linear,
    "joined": joined,
}
_DISTURBANCES: Mapping[str, Callable[..., Any]] = {"pulse": ForcePulse, "impulse": Impulse}
_BUILDERS = {**_SCHEDULES, **_DISTURBANCES}


def _union(builders: Mapping[str, Callable[..., Any]]) -> Any:
    types = {Sequence[float]: list[float], Sequence[Schedule]: list["_Schedule"]}
    members: list[Any] = []
    for shape, builder in builders.items():
        hints = get_type_hints(builder)
        defaults = {
            name: (one.default,)
            for name, one in inspect.signature(builder).parameters.items()
            if one.default is not one.empty
        }
        keys = [
            (n, types.get(hint, hint), *defaults.get(n, ()))
            for n, hint in hints.items() if n != "return"
        ]  # fmt: skip
        own = {"__module__": __name__}  # where pydantic looks for _Schedule
        table: list[Any] = [("shape", Literal[shape], shape), *keys]
        members.append(make_dataclass(shape, table, frozen=True, kw_only=True, namespace=own))
    return Annotated[functools.reduce(operator.or_, members), _ByShape]


if TYPE_CHECKING:
    _Schedule = Any
    _Disturbance = Any
else:
    _Schedule = Annotated[_union(_SCHEDULES), _NumberOrTable]
    _Disturbance = _union(_DISTURBANCES)


@dataclass(frozen=True, kw_only=True)
class Replay:
    """How a scenario was run: the defaults of `afl-mujoco simulate` for it."""

    controller: str | None = None
    integrator: str | None = None
    timestep: float | None = None


@dataclass(frozen=True, kw_only=True)
class _Names:
    """A plant as a result keeps it: its names, and where it is from; nothing that is executed."""

    name: str
    origin: str = ""
    coordinates: list[str] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    inputs: list[str] = field(default_factory=list)
    parameters: dict[str, float] = field(default_factory=dict)
    wraps: list[str] = field(default_factory=list)
    signals: list[str] = field(default_factory=list)
    upright: list[float] | None = None
    start: list[float] | None = None
    ends_at: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class _File:
    name: str | None = None
    plant: str | _Names | None = None
    duration: float | None = None
    initial_state: Any = None
    schedule: dict[str, _Schedule] = field(default_factory=dict)
    disturbances: list[_Disturbance] = field(default_factory=list)
    imperfections: Imperfections = field(default_factory=Imperfections)
    requirements: Requirements = field(default_factory=Requirements)
    belief: str | dict[str, Any] = field(default_factory=dict)
    ranges: dict[str, Any] = field(default_factory=dict)
    replay: Replay = field(default_factory=Replay)


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
    file = _read(path)
    with within(f"{path}: "):
        return _scenario(file, default_name=path.stem, folder=path.parent)


def find_replay(name: str) -> Replay:
    """Return how a scenario was run, from the table ``[replay]`` of its file."""
    return _read(Path(name)).replay if is_toml(name) else Replay()


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
    if not isinstance(table, Mapping):
        raise InvalidValueError("scenario", "must be a table", repr(table))
    return _scenario(parse_json(json.dumps(table), _File), default_name="")


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
        "ranges": s.ranges.table,
    }
    return {key: value for key, value in found.items() if value or key not in _ABSENT_WHERE_EMPTY}


def _plant_to_table(plant: Plant) -> dict[str, Any]:
    found = {name: getattr(plant, name) for name in ("name", "origin", "upright", "start")}
    found |= {name: [*getattr(plant, name)] for name in ("coordinates", "inputs", "wraps")}
    nominal = {name: one.value for name, one in plant.parameters.items()}
    found |= {"parameters": nominal, "units": dict(plant.units), "signals": [*plant.signals]}
    found |= {"ends_at": dict(plant.ends_at)}
    return {name: value for name, value in found.items() if value not in (None, "", [], {})}


def _plant(given: str | _Names | None, folder: Path | None) -> Plant:
    """Return the plant of a file, loaded; of a result its names, which cannot be simulated."""
    if given in (None, CART_POLE.name):
        return CART_POLE
    if isinstance(given, str):
        return load_plant(given, folder)
    units = given.units
    values = {name: Parameter(x, units.get(name, "")) for name, x in given.parameters.items()}
    table = {one.name: getattr(given, one.name) for one in fields(given)}
    del table["units"], table["origin"]
    names = dict.fromkeys(given.signals, float)
    known = Plant(**{**table, "parameters": values, "signals": names}, model="<mujoco/>")
    object.__setattr__(known, "units", units)
    return known_as(known, given.origin)


def _knots(schedule: Schedule) -> Any:
    """Return a schedule as the value of its key: a number if it never changes."""
    if schedule == constant(schedule.values[0]):
        return schedule.values[0]
    times, values = [*schedule.times], [*schedule.values]
    return {"shape": "piecewise-linear", "times": times, "values": values}


def _read(path: Path) -> _File:
    text = toml_as_json(path)
    if text == "{}":  # a file that was never filled in would run as the nominal scenario
        raise FileError(str(path), "must have at least one key: it is empty or all comments")
    _require_new_spelling(path, json.loads(text))
    try:
        return parse_json(text, _File)
    except ValueError as error:
        raise InvalidValueError(f"{path}:", str(error)) from None


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


def _scenario(file: _File, default_name: str, folder: Path | None = None) -> Scenario:
    """Build the scenario that a file describes; its plant may be relative to a folder."""
    with within("plant: " if isinstance(file.plant, _Names) else ""):
        plant = _plant(file.plant, folder)
    given: dict[str, Any] = {
        name: value
        for name in ("duration", "initial_state")
        if (value := getattr(file, name)) is not None
    }
    schedule = {}
    for name, table in file.schedule.items():
        with within(f"schedule.{name}."):
            schedule[name] = table.value if table.shape == "constant" else _built(table)
    disturbances = []
    for i, disturbance in enumerate(file.disturbances):
        with within(f"disturbances[{i}]."):
            disturbances.append(_built(disturbance))
    with within("belief."):
        belief = Belief.of(file.belief)
    with within("ranges."):
        ranges = Ranges.of(file.ranges)
    return Scenario(
        name=default_name if file.name is None else file.name,
        plant=plant,
        schedule=schedule,
        disturbances=tuple(disturbances),
        imperfections=file.imperfections,
        requirements=file.requirements,
        belief=belief,
        ranges=ranges,
        **given,
    )


def _built(table: Any) -> Any:
    arguments = {f.name: getattr(table, f.name) for f in fields(table) if f.name != "shape"}
    if "pieces" in arguments:
        pieces: list[Schedule] = []
        for i, piece in enumerate(arguments["pieces"]):
            with within(f"pieces[{i}]."):
                pieces.append(_built(piece))
        arguments["pieces"] = pieces
    return _BUILDERS[table.shape](**arguments)
