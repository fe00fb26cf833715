"""Departures from the ideal loop, each declared once.

The type of a field of `Imperfections` says its rule; its declaration holds what else a study or a
table of the documentation needs to know about it; `simulation` implements what it does in the loop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

from afl_mujoco.errors import InvalidValueError, require_count
from afl_mujoco.plants.cartpole import CART_POLE, has_its_names
from afl_mujoco.plants.plant import Plant
from afl_mujoco.scenario.belief import ERROR, is_error
from afl_mujoco.values import (
    EMPTY,
    ByName,
    Checked,
    NotNegative,
    Positive,
    Switch,
    by_name,
    departures,
    require_not_negative,
    require_positive,
    short_repr,
    within,
)

LARGEST_SEED = 2**63 - 1  # what a TOML file can hold
FINEST_STEP = 1e-12  # of an encoder [m, rad]: a position divided by a finer one overflows


@dataclass(frozen=True, slots=True, kw_only=True)
class Imperfection:
    """One departure from the ideal loop, and how much of it good laboratory hardware has."""

    name: str  # the key that it sets, with the sign of an error; on the command line too
    title: str  # name in words
    unit: str  # unit in which a level is shown
    # what it sets, by path, each to the level times its factor
    fields: Mapping[str, float]
    reference: float  # level of the reference hardware, good but ordinary in a laboratory
    # ends of the range in which the threshold is searched; ``benign > harsh`` where less is worse
    benign: float
    harsh: float
    scale: float = 1.0  # factor from a level to its shown value
    switches: tuple[str, ...] = ()  # fields that it switches on at every level
    quantum: float = 0.0  # levels are multiples of this; 0 for any level

    def options(self, level: float) -> dict[str, Any]:
        """Return what it sets at a level, by path."""
        values = {name: factor * level for name, factor in self.fields.items()}
        return {**values, **dict.fromkeys(self.switches, True)}

    @property
    def of_belief(self) -> bool:
        """Whether it changes what controllers assume, and nothing else."""
        return bool(self.fields) and all(
            is_error(name) or name == "parameter_delay" for name in self.fields
        )

    @property
    def adds(self) -> bool:
        """Whether a level is added to what a scenario has itself, rather than the total."""
        return bool(self.fields) and all(map(is_error, self.fields))

    @property
    def less_is_worse(self) -> bool:
        """Whether a smaller level is the harsher one."""
        return self.harsh < self.benign

    def snapped(self, level: float) -> float:
        """Return the nearest level that is allowed."""
        if self.quantum == 0.0:
            return level
        return max(1, round(level / self.quantum)) * self.quantum


class Draw(NamedTuple):
    """How a number is drawn for random hardware: uniformly from a range."""

    # position among the numbers that are drawn. The samples of a seed depend on it: a new one
    # takes the next position
    axis: int
    range: tuple[float, float]  # least and largest value
    why: str  # what hardware the two ends stand for


class Declaration(NamedTuple):
    """What is known about a number of `Imperfections` besides its rule and meaning."""

    unit: str  # SI unit of the value
    # imperfections whose thresholds are searched and whose first number is this one
    swept: tuple[Imperfection, ...] = ()
    why: str = ""  # where their reference level comes from
    drawn: Draw | None = None  # how it is drawn for random hardware; None if it stays ideal there


def require_resolution(thing: str, value: object) -> float:
    """Return a step of an encoder, or raise unless it is 0 or not too fine."""
    number = require_not_negative(thing, value)
    if 0.0 < number < FINEST_STEP:
        raise InvalidValueError(thing, f"must be 0 or at least {FINEST_STEP:g}", number)
    return number


def require_share(thing: str, value: object) -> float:
    """Return a number from 0 to below 1, or raise."""
    number = require_not_negative(thing, value)
    if number >= 1.0:
        raise InvalidValueError(thing, "must be below 1", number)
    return number


def require_seed(thing: str, value: object) -> int:
    """Return a seed, or raise."""
    return require_count(thing, value, 0, LARGEST_SEED)


_Numbers = Annotated[Any, by_name(require_not_negative)]  # one for all, or a table by name
_Limit = Annotated[Any, by_name(require_positive)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Imperfections(Checked):
    """Departures from the ideal loop; every default is ideal.

    At each control tick the sensors are read (noise, then quantisation, then differentiation, then
    filter), the controller assumes M and l (late, with an error) and commands a force, which passes
    the input limit, the transport delay, the slew limit and the actuator's lag on its way to the
    cart. What is said of several coordinates or inputs is one number for all of them, or a table by
    name: ``noise={"phi": 5e-4}``.

    Attributes
    ----------
    control_period
        Time between two control ticks, a multiple of the simulator's timestep; by default the
        simulator's own setting [s].
    delay
        Transport delay from the control tick to the actuator; it may be a fraction of a step [s].
    lag
        Time constant of the actuator's first-order lag [s].
    input_limit
        Largest force of the actuator [N].
    slew_rate
        Largest rate at which the actuator changes its force [N/s].
    encoder_step
        Resolution of the sensor of a coordinate: readings are rounded to the nearest multiple; 0
        for an exact sensor, else at least 1e-12 [m, rad].
    differentiated
        Whether the velocities that the controller gets are backward differences of the measured
        positions over a control period, zero at the first tick.
    noise
        Standard deviation of the white noise on a coordinate, or on its rate (`phi_dot`), at each
        tick; that of rates is not used where velocities are differentiated [m, rad, m/s, rad/s].
    velocity_filter
        Time constant of the first-order low-pass on the velocities that the controller gets [s].
    damping
        Viscous friction of a coordinate: of the cart on its rail, of the hinge [N s/m, N m s/rad].
    dry_friction
        Dry (Coulomb) friction of a coordinate [N, N m].
    armature
        Inertia of a drive that moves with a coordinate but has no weight [kg, kg m²].
    tip_mass_share
        Share of the pole's mass m that is a point mass at its tip, from 0 to below 1; l stays half
        the length of the rod [1].
    pole_radius
        Radius of the rod, a solid capsule as MuJoCo draws it; 0 is the slender rod [m].
    parameter_delay
        Delay with which the controller gets M and l [s].
    end_stops
        How far a coordinate can go to either side of 0 before it hits an end stop, which gives by a
        few mm at 1 m/s [m].
    seed
        Seed of the noise, 0 to 2**63 - 1; the same seed gives the same noise, whatever else is set.

    Raises
    ------
    InvalidValueError
        If a number is negative or not finite, a limit, a period or an end stop not positive, a step
        of an encoder finer than 1e-12, a share not below 1, or the seed no whole number in range.
    """

    control_period: Positive | None = None
    delay: _Numbers = 0.0
    lag: _Numbers = 0.0
    input_limit: _Limit | None = None
    slew_rate: _Limit | None = None
    encoder_step: Annotated[Any, by_name(require_resolution)] = EMPTY
    differentiated: Switch = False
    noise: _Numbers = EMPTY
    velocity_filter: NotNegative = 0.0
    damping: _Numbers = EMPTY
    dry_friction: _Numbers = EMPTY
    armature: _Numbers = EMPTY
    tip_mass_share: Annotated[float, require_share] = 0.0
    pole_radius: NotNegative = 0.0
    parameter_delay: NotNegative = 0.0
    end_stops: _Limit = EMPTY
    seed: Annotated[int, require_seed] = 0

    def at(self, path: str) -> Any:
        """Return a number by its path, ``delay`` or ``noise.phi``; what is ideal where it has none.

        The ideal of an end stop is None: there is none.
        """
        name, _, part = path.partition(".")
        value = getattr(self, name)
        if part and isinstance(value, Mapping):
            return value.get(part, None if name == "end_stops" else 0.0)
        return value

    def departing(self) -> dict[str, Any]:
        """Return what is not ideal, by path."""
        found: dict[str, Any] = {}
        for name, value in departures(self).items():
            if isinstance(value, Mapping):
                found |= {f"{name}.{part}": x for part, x in value.items()}
            else:
                found[name] = value
        return found

    def changed(self, changes: Mapping[str, Any]) -> Imperfections:
        """Return the same with other numbers, by path."""
        found: dict[str, Any] = {}
        for path, value in changes.items():
            name, _, part = path.partition(".")
            if not part:
                found[name] = value
                continue
            table = found.get(name, getattr(self, name))
            if name in IDEAL_INPUT and table == IDEAL_INPUT[name]:
                table = {}
            if not isinstance(table, Mapping):
                rule = f"cannot vary by itself: {name} is one number for all; give it as a table"
                raise InvalidValueError(f"imperfections.{path}", rule, table)
            kept = {n: x for n, x in table.items() if n != part}
            ideal = value == IDEAL_INPUT.get(name, 0.0) or value is None
            found[name] = kept if ideal else {**kept, part: value}
        return replace(self, **found)

    def of_plant(self, plant: Plant) -> Imperfections:
        """Return the same by the names of a plant, what is ideal left out, or raise."""
        found: dict[str, Any] = {}
        for name, known in names_of(plant).items():
            value = getattr(self, name)
            with within(f"imperfections.{name} "):
                table = value if isinstance(value, Mapping) else dict.fromkeys(known, value)
                value = ByName(table).ordered(known)
            found[name] = ByName({n: x for n, x in value.items() if x != 0.0})
        for name in BY_INPUT:
            if isinstance(value := getattr(self, name), Mapping):
                with within(f"imperfections.{name} "):
                    own = ByName(value).ordered(plant.inputs)
                alone = len(plant.inputs) == 1
                found[name] = (*own.values(), IDEAL_INPUT[name])[0] if alone else own
        for name in CART_POLE.details:
            if getattr(self, name) and name not in plant.details:
                rule = f"is of another plant than {plant.name!r}"
                raise InvalidValueError(f"imperfections.{name}", rule)
        return replace(self, **found)

    def of_input(self, name: str, key: str) -> Any:
        """Return a number that is said of inputs for one of them."""
        value = getattr(self, name)
        return value.get(key, IDEAL_INPUT[name]) if isinstance(value, Mapping) else value

    @property
    def longest_delay(self) -> float:
        """The longest transport delay of an input [s]."""
        found = self.delay
        return max(found.values(), default=0.0) if isinstance(found, Mapping) else float(found)

    @property
    def noisy(self) -> bool:
        """Whether a run draws random numbers, so that another seed gives another run."""
        return _some(self.noise)

    @property
    def drawn(self) -> bool:
        """Whether a run is one draw of many: of its noise, or of its start within encoder steps."""
        return self.noisy or _some(self.encoder_step)

    def without_effect(self, path: str) -> bool:
        """Return whether a path is noise of velocities that are differences of positions."""
        return self.differentiated and path.startswith("noise.") and path.endswith("_dot")

    __repr__ = short_repr


def _some(levels: Any) -> bool:
    return any(levels.values()) if isinstance(levels, Mapping) else bool(levels)


def names_of(plant: Plant) -> Mapping[str, tuple[str, ...]]:
    """Return what is said of coordinates, and of which."""
    own = ("encoder_step", "damping", "dry_friction", "armature", "end_stops")
    return {"noise": plant.states, **dict.fromkeys(own, tuple(plant.coordinates))}


IDEAL_INPUT: Mapping[str, float | None] = MappingProxyType(
    {"delay": 0.0, "lag": 0.0, "input_limit": None, "slew_rate": None}
)
"""What is said of inputs, and its ideal."""

BY_INPUT = tuple(IDEAL_INPUT)


def require_within_stop(
    thing: str, x: float, stop: float | None, which: str, unit: str = "m"
) -> None:
    """Raise if a position lies at an end stop or beyond; None is a coordinate without one."""
    if stop is not None and abs(x) >= stop:
        raise InvalidValueError(thing, f"must lie within {which}, {stop:g} {unit}", f"{x:g} {unit}")


_COUNT = 2.0 * math.pi / 4096.0  # [rad], of an encoder with 4096 counts per turn
_ENCODERS = {"encoder_step.phi": 1.0, "encoder_step.z": 0.1}  # [m/rad]

_BELIEF: Mapping[str, Declaration] = {
    "cart_mass_error": Declaration("1", (
        Imperfection(name="cart_mass_error+", title="M assumed too large", unit="%", scale=1e2,
            fields={"cart_mass_error": 1.0}, reference=0.1, benign=0.01, harsh=30.0),
        Imperfection(name="cart_mass_error-", title="M assumed too small", unit="%", scale=1e2,
            fields={"cart_mass_error": -1.0}, reference=0.1, benign=0.01, harsh=0.95),
    ), "weighed by hand"),
    "half_length_error": Declaration("1", (
        Imperfection(name="half_length_error+", title="l assumed too large", unit="%", scale=1e2,
            fields={"half_length_error": 1.0}, reference=0.05, benign=0.01, harsh=30.0),
        Imperfection(name="half_length_error-", title="l assumed too small", unit="%", scale=1e2,
            fields={"half_length_error": -1.0}, reference=0.05, benign=0.01, harsh=0.95),
    ), "measured by hand"),
    "pole_mass_error": Declaration("1"),
    "gravity_error": Declaration("1"),
}  # fmt: skip
"""The errors of what controllers assume, which are part of the belief of a scenario."""

DECLARATIONS: Mapping[str, Declaration] = MappingProxyType({
    "control_period": Declaration("s",
        (Imperfection(name="control_period", title="control period", unit="ms", scale=1e3,
            fields={"control_period": 1.0}, reference=2e-3, benign=0.5e-3, harsh=50e-3,
            quantum=0.5e-3),),
        why="500 Hz"),
    "delay": Declaration("s",
        (Imperfection(name="delay", title="transport delay", unit="ms", scale=1e3,
            fields={"delay": 1.0}, reference=2e-3, benign=2e-4, harsh=0.2),),
        why="one sample of transport",
        drawn=Draw(9, (0.0, 5e-3), "from none to a slow bus")),
    "lag": Declaration("s",
        (Imperfection(name="lag", title="actuator lag", unit="ms", scale=1e3,
            fields={"lag": 1.0}, reference=2e-3, benign=2e-4, harsh=0.5),),
        why="the current loop of a drive",
        drawn=Draw(10, (0.0, 5e-3), "from none to the current loop of a servo drive")),
    "input_limit": Declaration("N",
        (Imperfection(name="input_limit", title="force limit", unit="N",
            fields={"input_limit": 1.0}, reference=50.0, benign=1000.0, harsh=1.0),),
        why="a strong linear drive"),
    "slew_rate": Declaration("N/s",
        (Imperfection(name="slew_rate", title="force slew rate", unit="N/s",
            fields={"slew_rate": 1.0}, reference=5e3, benign=1e6, harsh=10.0),),
        why="full force in 10 ms"),
    "encoder_step.z": Declaration("m",
        drawn=Draw(4, (0.0, 1e-4), "from exact to a tenth of a millimetre")),
    "encoder_step.phi": Declaration("rad",
        (Imperfection(name="encoder_step", title="encoder step", unit="mrad", scale=1e3,
            fields=_ENCODERS, reference=_COUNT, benign=1e-4, harsh=0.5),),
        why="4096 counts per turn; rates measured",
        drawn=Draw(5, (0.0, 2.0 * math.pi / 2048.0), "from exact to 2048 counts per turn")),
    "differentiated": Declaration("",
        (Imperfection(name="differentiated", title="encoder, rates differenced", unit="mrad",
            scale=1e3, fields=_ENCODERS, switches=("differentiated",), reference=_COUNT,
            benign=1e-5, harsh=0.5),),
        why="4096 counts per turn; rates differenced without a filter"),
    "noise.z": Declaration("m",
        drawn=Draw(0, (0.0, 5e-4), "from none to a linear potentiometer")),
    "noise.phi": Declaration("rad",
        (Imperfection(name="noise", title="sensor noise", unit="mrad", scale=1e3,
            fields={"noise.phi": 1.0, "noise.z": 0.1, "noise.phi_dot": 10.0, "noise.z_dot": 1.0},
            reference=5e-4, benign=1e-5, harsh=0.5),),
        why="a good analogue sensor",
        drawn=Draw(1, (0.0, 2e-3), "from none to a rotary potentiometer")),
    "noise.z_dot": Declaration("m/s",
        drawn=Draw(2, (0.0, 1e-2), "from none to a filtered tachometer")),
    "noise.phi_dot": Declaration("rad/s",
        drawn=Draw(3, (0.0, 5e-2), "the same")),
    "velocity_filter": Declaration("s"),
    "damping.z": Declaration("N s/m",
        (Imperfection(name="damping.z", title="rail damping", unit="N s/m",
            fields={"damping.z": 1.0}, reference=5.0, benign=0.05, harsh=500.0),),
        why="a geared cart on a rail",
        drawn=Draw(7, (0.0, 2.0), "viscous friction: from an air bearing to dry bushes")),
    "damping.phi": Declaration("N m s/rad",
        (Imperfection(name="damping.phi", title="hinge damping", unit="mN m s", scale=1e3,
            fields={"damping.phi": 1.0}, reference=2e-3, benign=2e-5, harsh=2.0),),
        why="a ball bearing",
        drawn=Draw(8, (0.0, 1e-3), "from none to a greased bearing")),
    "dry_friction.z": Declaration("N",
        (Imperfection(name="dry_friction.z", title="dry friction", unit="N",
            fields={"dry_friction.z": 1.0}, reference=1.0, benign=0.01, harsh=100.0),),
        why="the geared cart",
        drawn=Draw(6, (0.0, 1.0), "dry friction: from an air bearing to dry bushes")),
    "armature.z": Declaration("kg",
        (Imperfection(name="armature.z", title="inertia of the drive", unit="kg",
            fields={"armature.z": 1.0}, reference=0.3, benign=3e-3, harsh=30.0),),
        why="motor and gears, reflected to the cart"),
    "armature.phi": Declaration("kg m²",
        (Imperfection(name="armature.phi", title="inertia at the hinge", unit="g m²",
            scale=1e3, fields={"armature.phi": 1.0}, reference=1e-4, benign=1e-6, harsh=1.0),),
        why="the encoder's shaft"),
    "tip_mass_share": Declaration("1",
        (Imperfection(name="tip_mass_share", title="share of m at the tip", unit="%", scale=1e2,
            fields={"tip_mass_share": 1.0}, reference=0.1, benign=1e-3, harsh=0.95),),
        why="not quite a uniform rod"),
    "pole_radius": Declaration("m",
        (Imperfection(name="pole_radius", title="radius of the rod", unit="mm", scale=1e3,
            fields={"pole_radius": 1.0}, reference=5e-3, benign=5e-4, harsh=1.0),),
        why="not quite a slender rod"),
    "parameter_delay": Declaration("s",
        (Imperfection(name="parameter_delay", title="parameters known late", unit="ms", scale=1e3,
            fields={"parameter_delay": 1.0}, reference=50e-3, benign=1e-3, harsh=10.0),),
        why="M and l come from elsewhere"),
    **_BELIEF,
    "end_stops.z": Declaration("m",
        (Imperfection(name="end_stops.z", title="rail to either side", unit="m",
            fields={"end_stops.z": 1.0}, reference=1.0, benign=100.0, harsh=0.1),),
        why="a table"),
    "dry_friction.phi": Declaration("N m"),
})  # fmt: skip
"""The declaration of each number by its path, and of each error of the belief; rail last."""


def declarations(plant: Plant) -> Mapping[str, Declaration]:
    """Return the declaration of each number by its path, for a plant."""
    if has_its_names(plant) and plant.details.keys() == CART_POLE.details.keys():
        return DECLARATIONS
    return _declared(plant)


def imperfections_of(plant: Plant) -> tuple[Imperfection, ...]:
    """Return every imperfection of a plant whose thresholds are searched."""
    return tuple(one for declared in declarations(plant).values() for one in declared.swept)


@cache
def _declared(plant: Plant) -> Mapping[str, Declaration]:
    """Return the declarations of a plant of which nobody said what its hardware is like."""
    units, known = plant.units, names_of(plant)
    found = {name: DECLARATIONS[name] for name in ("control_period", "delay", "lag")}
    limit, slew = DECLARATIONS["input_limit"].swept[0], DECLARATIONS["slew_rate"].swept[0]
    found["input_limit"] = Declaration("", (replace(limit, unit="", harsh=0.01),))
    found["slew_rate"] = Declaration("", (replace(slew, unit="", harsh=0.1),))
    if len(plant.inputs) > 1:
        found |= {f"{name}.{x}": Declaration(one.unit) for name, one in found.copy().items()
                  if name in BY_INPUT for x in plant.inputs}  # fmt: skip
    first, encoders = plant.coordinates[0], {f"encoder_step.{x}": 1.0 for x in plant.coordinates}
    noise = {f"noise.{x}": 1.0 for x in plant.coordinates}
    noise |= {f"noise.{x}_dot": 10.0 for x in plant.coordinates}
    unit = ", ".join(dict.fromkeys(f"m{units[x]}" for x in plant.coordinates))
    swept = {
        f"encoder_step.{first}": replace(_swept("encoder_step"), fields=encoders, unit=unit),
        f"noise.{first}": replace(_swept("noise"), fields=noise, unit=unit),
    }
    for name in ("encoder_step", "noise"):
        for part in known[name]:
            path = f"{name}.{part}"
            found[path] = Declaration(units[part], (swept[path],) if path in swept else ())
    for name in ("damping", "dry_friction", "armature"):
        for part in known[name]:
            path, words = f"{name}.{part}", f"{name.replace('_', ' ')} of {part}"
            one = Imperfection(name=path, title=words, unit="",
                fields={path: 1.0}, reference=1e-3, benign=1e-5, harsh=1e3)  # fmt: skip
            found[path] = Declaration("", (one,))
    found |= {f"end_stops.{x}": Declaration(units[x]) for x in known["end_stops"]}
    differenced = replace(_swept("differentiated"), fields=encoders, unit=unit)
    found["differentiated"] = Declaration("", (differenced,))
    found |= {name: DECLARATIONS[name] for name in ("velocity_filter", "parameter_delay")}
    for name in plant.parameters:
        path = f"{name}{ERROR}"
        found[path] = Declaration("1", tuple(
            Imperfection(name=f"{path}{way}", title=f"{name} assumed {words}",
                unit="%", scale=1e2, fields={path: sign}, reference=0.05, benign=0.01, harsh=harsh)
            for way, words, sign, harsh in (
                ("+", "too large", 1.0, 30.0), ("-", "too small", -1.0, 0.95))
        ))  # fmt: skip
    return MappingProxyType(found)


def _swept(name: str) -> Imperfection:
    return next(one for one in IMPERFECTIONS if one.name == name)


IMPERFECTIONS = imperfections_of(CART_POLE)
"""Every imperfection whose thresholds are searched, in the order in which they are combined."""

_DRAWN = {name: one.drawn for name, one in DECLARATIONS.items() if one.drawn is not None}
DRAWS = MappingProxyType(dict(sorted(_DRAWN.items(), key=lambda item: item[1].axis)))
"""How each field that varies is drawn for random hardware, in the order of the axes."""

IDEAL = Imperfections()  # the loop of the paper, without imperfections
