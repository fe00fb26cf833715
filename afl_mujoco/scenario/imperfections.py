"""Departures from the ideal loop, each declared once.

The declaration of a field of `Imperfections` holds all that a study, a table of the documentation
or a scenario file needs to know about it; `simulation` implements what it does in the loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, NamedTuple

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.belief import ERRORS, require_error
from afl_mujoco.scenario.parameters import (
    require_finite,
    require_positive,
    require_type,
    short_repr,
)

BELIEVED = ("parameter_delay", *ERRORS)
"""What changes only what controllers are told of the plant."""

LARGEST_SEED = 2**63 - 1
"""What a TOML file can hold."""

FINEST_STEP = 1e-12
"""Finest step of an encoder [m, rad]: a position divided by a much finer step overflows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Imperfection:
    """One departure from the ideal loop, and how much of it good laboratory hardware has."""

    name: str  # name in files and on the command line
    title: str  # name in words
    unit: str  # unit in which a level is shown
    # fields of `Imperfections` that it sets, each to the level times its factor
    fields: Mapping[str, float]
    reference: float  # level of the reference hardware, good but ordinary in a laboratory
    # ends of the range in which the threshold is searched; ``benign > harsh`` where less is worse
    benign: float
    harsh: float
    scale: float = 1.0  # factor from a level to its shown value
    switches: tuple[str, ...] = ()  # fields that it switches on at every level
    # whether it draws random numbers, so that the loop must survive several seeds
    seeded: bool = False
    quantum: float = 0.0  # levels are multiples of this; 0 for any level

    def options(self, level: float) -> dict[str, Any]:
        """Return the fields of `Imperfections` at a level."""
        values = {name: factor * level for name, factor in self.fields.items()}
        return {**values, **dict.fromkeys(self.switches, True)}

    @property
    def of_belief(self) -> bool:
        """Whether it changes what controllers assume, and nothing else."""
        return bool(self.fields) and all(name in BELIEVED for name in self.fields)

    @property
    def adds(self) -> bool:
        """Whether a level is added to what a scenario has itself, rather than the total."""
        return bool(self.fields) and all(name in ERRORS for name in self.fields)

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
    """How a field is drawn for random hardware: uniformly from a range."""

    # position among the fields that are drawn. The samples of a seed depend on it: a new field
    # takes the next number
    axis: int
    range: tuple[float, float]  # least and largest value
    why: str  # what hardware the two ends stand for
    # name with unit for the comparison of failed and surviving runs by this field alone, and the
    # factor to that unit; without a label they are those of the field's threshold
    label: str = ""
    scale: float = 1.0


class Declaration(NamedTuple):
    """What is known about a field of `Imperfections` besides its default and meaning."""

    # ``rule(name, value)`` returns the value as it is stored, or raises
    rule: Callable[[str, Any], Any]
    unit: str  # SI unit of the value
    # imperfections whose thresholds are searched and whose first field is this one
    swept: tuple[Imperfection, ...]
    why: str  # where their reference level comes from
    drawn: Draw | None  # how it is drawn for random hardware; None if it stays ideal there


def _declared(
    default: Any,
    rule: Callable[[str, Any], Any],
    unit: str = "",
    *swept: Imperfection,
    why: str = "",
    drawn: Draw | None = None,
) -> Any:
    """Return a field of `Imperfections`; arguments as in `Declaration`."""
    declaration = Declaration(rule, unit, swept, why, drawn)
    return field(default=default, metadata={"declaration": declaration})


def _optional(name: str, value: Any) -> float | None:
    return None if value is None else require_positive(name, value)


def _not_negative(name: str, value: Any) -> float:
    number = require_finite(name, value)
    if number < 0.0:
        raise InvalidValueError(name, "must not be negative", number)
    return number


def _resolution(name: str, value: Any) -> float:
    number = _not_negative(name, value)
    if 0.0 < number < FINEST_STEP:
        raise InvalidValueError(name, f"must be 0 or at least {FINEST_STEP:g}", number)
    return number


def _share(name: str, value: Any) -> float:
    number = _not_negative(name, value)
    if number >= 1.0:
        raise InvalidValueError(name, "must be below 1", number)
    return number


def _switch(name: str, value: Any) -> Any:
    require_type(name, value, bool)
    return value


def _seed(name: str, value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int):
        raise InvalidValueError(name, "must be a whole number", repr(value))
    if not 0 <= value <= LARGEST_SEED:
        raise InvalidValueError(name, "must lie in 0 to 2**63 - 1", value)
    return value


_COUNT = 2.0 * math.pi / 4096.0  # [rad], of an encoder with 4096 counts per turn
_ENCODERS = {"encoder_step_phi": 1.0, "encoder_step_z": 0.1}  # [m/rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class Imperfections:
    """Departures from the ideal loop; every default is ideal.

    At each control tick the sensors are read (noise, then quantisation, then differentiation, then
    filter), the controller assumes M and l (late, with an error) and commands a force, which passes
    the force limit, the transport delay, the slew limit and the actuator's lag on its way to the
    cart. The thresholds study combines the imperfections in the order of the fields.

    Raises
    ------
    InvalidValueError
        If a value breaks its rule.
    """

    control_period: float | None = _declared(
        None, _optional, "s",
        Imperfection(name="control-period", title="control period", unit="ms", scale=1e3,
            fields={"control_period": 1.0}, reference=2e-3, benign=0.5e-3, harsh=50e-3,
            quantum=0.5e-3),
        why="500 Hz",
    )  # fmt: skip
    """Time between two control ticks, a multiple of the simulator's timestep; by default the
    simulator's own setting."""
    delay: float = _declared(
        0.0, _not_negative, "s",
        Imperfection(name="delay", title="transport delay", unit="ms", scale=1e3,
            fields={"delay": 1.0}, reference=2e-3, benign=2e-4, harsh=0.2),
        why="one sample of transport",
        drawn=Draw(9, (0.0, 5e-3), "from none to a slow bus"),
    )  # fmt: skip
    """Transport delay from the control tick to the actuator; it may be a fraction of a step."""
    actuator_lag: float = _declared(
        0.0, _not_negative, "s",
        Imperfection(name="actuator-lag", title="actuator lag", unit="ms", scale=1e3,
            fields={"actuator_lag": 1.0}, reference=2e-3, benign=2e-4, harsh=0.5),
        why="the current loop of a drive",
        drawn=Draw(10, (0.0, 5e-3), "from none to the current loop of a servo drive"),
    )  # fmt: skip
    """Time constant of the actuator's first-order lag."""
    force_limit: float | None = _declared(
        None, _optional, "N",
        Imperfection(name="force-limit", title="force limit", unit="N",
            fields={"force_limit": 1.0}, reference=50.0, benign=1000.0, harsh=1.0),
        why="a strong linear drive",
    )  # fmt: skip
    """Largest force of the actuator."""
    slew_rate: float | None = _declared(
        None, _optional, "N/s",
        Imperfection(name="slew-rate", title="force slew rate", unit="N/s",
            fields={"slew_rate": 1.0}, reference=5e3, benign=1e6, harsh=10.0),
        why="full force in 10 ms",
    )  # fmt: skip
    """Largest rate at which the actuator changes its force."""
    encoder_step_z: float = _declared(
        0.0, _resolution, "m",
        drawn=Draw(4, (0.0, 1e-4), "from exact to a tenth of a millimetre",
            "encoder step of z [mm]", 1e3),
    )  # fmt: skip
    """Resolution of the cart's position sensor: readings are rounded to the nearest multiple; 0 for
    an exact sensor, else at least 1e-12."""
    encoder_step_phi: float = _declared(
        0.0, _resolution, "rad",
        Imperfection(name="encoder", title="encoder step", unit="mrad", scale=1e3,
            fields=_ENCODERS, reference=_COUNT, benign=1e-4, harsh=0.5),
        why="4096 counts per turn; rates measured",
        drawn=Draw(5, (0.0, 2.0 * math.pi / 2048.0), "from exact to 2048 counts per turn",
            "encoder step of φ [mrad]", 1e3),
    )  # fmt: skip
    """The same for the angle."""
    differentiated: bool = _declared(
        False, _switch, "",
        Imperfection(name="differentiated", title="encoder, rates differenced", unit="mrad",
            scale=1e3, fields=_ENCODERS, switches=("differentiated",), reference=_COUNT,
            benign=1e-5, harsh=0.5),
        why="4096 counts per turn; rates differenced without a filter",
    )  # fmt: skip
    """Whether the velocities that the controller gets are backward differences of the measured
    positions over a control period (zero at the first tick)."""
    noise_z: float = _declared(
        0.0, _not_negative, "m",
        drawn=Draw(0, (0.0, 5e-4), "from none to a linear potentiometer", "noise of z [mm]", 1e3),
    )  # fmt: skip
    """Standard deviation of the white noise on the cart's position at each tick."""
    noise_phi: float = _declared(
        0.0, _not_negative, "rad",
        Imperfection(name="noise", title="sensor noise", unit="mrad", scale=1e3,
            fields={"noise_phi": 1.0, "noise_z": 0.1, "noise_phi_dot": 10.0, "noise_z_dot": 1.0},
            reference=5e-4, benign=1e-5, harsh=0.5, seeded=True),
        why="a good analogue sensor",
        drawn=Draw(1, (0.0, 2e-3), "from none to a rotary potentiometer", "noise of φ [mrad]",
            1e3),
    )  # fmt: skip
    """The same on the angle."""
    noise_z_dot: float = _declared(
        0.0, _not_negative, "m/s",
        drawn=Draw(2, (0.0, 1e-2), "from none to a filtered tachometer", "noise of z′ [mm/s]",
            1e3),
    )  # fmt: skip
    """The same on the cart's velocity sensor, which is not used where velocities are
    differentiated."""
    noise_phi_dot: float = _declared(
        0.0, _not_negative, "rad/s",
        drawn=Draw(3, (0.0, 5e-2), "the same", "noise of φ′ [mrad/s]", 1e3),
    )  # fmt: skip
    """The same on the angle's velocity sensor."""
    velocity_filter: float = _declared(0.0, _not_negative, "s")
    """Time constant of the first-order low-pass on the velocities that the controller gets."""
    rail_damping: float = _declared(
        0.0, _not_negative, "N s/m",
        Imperfection(name="rail-damping", title="rail damping", unit="N s/m",
            fields={"rail_damping": 1.0}, reference=5.0, benign=0.05, harsh=500.0),
        why="a geared cart on a rail",
        drawn=Draw(7, (0.0, 2.0), "viscous friction: from an air bearing to dry bushes"),
    )  # fmt: skip
    """Viscous friction of the cart."""
    hinge_damping: float = _declared(
        0.0, _not_negative, "N m s/rad",
        Imperfection(name="hinge-damping", title="hinge damping", unit="mN m s", scale=1e3,
            fields={"hinge_damping": 1.0}, reference=2e-3, benign=2e-5, harsh=2.0),
        why="a ball bearing",
        drawn=Draw(8, (0.0, 1e-3), "from none to a greased bearing",
            "hinge damping [mN m s/rad]", 1e3),
    )  # fmt: skip
    """Viscous friction of the hinge."""
    rail_friction: float = _declared(
        0.0, _not_negative, "N",
        Imperfection(name="rail-friction", title="dry friction", unit="N",
            fields={"rail_friction": 1.0}, reference=1.0, benign=0.01, harsh=100.0),
        why="the geared cart",
        drawn=Draw(6, (0.0, 1.0), "dry friction: from an air bearing to dry bushes"),
    )  # fmt: skip
    """Dry (Coulomb) friction of the cart on its rail."""
    rail_armature: float = _declared(
        0.0, _not_negative, "kg",
        Imperfection(name="rail-armature", title="inertia of the drive", unit="kg",
            fields={"rail_armature": 1.0}, reference=0.3, benign=3e-3, harsh=30.0),
        why="motor and gears, reflected to the cart",
    )  # fmt: skip
    """Inertia of a drive that moves with the cart but has no weight."""
    hinge_armature: float = _declared(
        0.0, _not_negative, "kg m²",
        Imperfection(name="hinge-armature", title="inertia at the hinge", unit="g m²", scale=1e3,
            fields={"hinge_armature": 1.0}, reference=1e-4, benign=1e-6, harsh=1.0),
        why="the encoder's shaft",
    )  # fmt: skip
    """The same at the hinge."""
    tip_mass_share: float = _declared(
        0.0, _share, "1",
        Imperfection(name="tip-mass", title="share of m at the tip", unit="%", scale=1e2,
            fields={"tip_mass_share": 1.0}, reference=0.1, benign=1e-3, harsh=0.95),
        why="not quite a uniform rod",
    )  # fmt: skip
    """Share of the pole's mass m that is a point mass at its tip, from 0 to below 1; l stays half
    the length of the rod."""
    pole_radius: float = _declared(
        0.0, _not_negative, "m",
        Imperfection(name="pole-radius", title="radius of the rod", unit="mm", scale=1e3,
            fields={"pole_radius": 1.0}, reference=5e-3, benign=5e-4, harsh=1.0),
        why="not quite a slender rod",
    )  # fmt: skip
    """Radius of the rod, a solid capsule as MuJoCo draws it; 0 is the slender rod."""
    parameter_delay: float = _declared(
        0.0, _not_negative, "s",
        Imperfection(name="parameter-delay", title="M, l known late", unit="ms", scale=1e3,
            fields={"parameter_delay": 1.0}, reference=50e-3, benign=1e-3, harsh=10.0),
        why="M and l come from elsewhere",
    )  # fmt: skip
    """Delay with which the controller gets M and l."""
    rail_half_length: float | None = _declared(
        None, _optional, "m",
        Imperfection(name="rail", title="rail to either side", unit="m",
            fields={"rail_half_length": 1.0}, reference=1.0, benign=100.0, harsh=0.1),
        why="a table",
    )  # fmt: skip
    """How far the cart can go to either side before it hits an end stop, which gives by a few mm at
    1 m/s."""
    hinge_friction: float = _declared(0.0, _not_negative, "N m")
    """Dry (Coulomb) friction of the hinge."""
    seed: int = _declared(0, _seed)
    """Seed of the noise, 0 to 2**63 - 1; the same seed gives the same noise, whatever else is
    set."""

    def __post_init__(self) -> None:
        """Validate every field and store numbers as floats."""
        for one in fields(self):
            rule = DECLARATIONS[one.name].rule
            object.__setattr__(self, one.name, rule(one.name, getattr(self, one.name)))

    @property
    def noisy(self) -> bool:
        """Whether a run draws random numbers, so that another seed gives another run."""
        seeded = {name for one in IMPERFECTIONS if one.seeded for name in one.fields}
        return any(getattr(self, name) for name in seeded)

    @property
    def drawn(self) -> bool:
        """Whether a run is one draw of many: of its noise, or of its start within encoder steps."""
        return self.noisy or self.encoder_step_z > 0.0 or self.encoder_step_phi > 0.0

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Names of noise that nothing measures, because velocities are differences of positions."""
        return ("noise_z_dot", "noise_phi_dot") if self.differentiated else ()

    __repr__ = short_repr


def require_on_rail(
    thing: str, z: float, rail: float | None, which: str = "rail_half_length"
) -> None:
    """Raise if a position [m] lies at an end of the rail or beyond; None is a rail without ends."""
    if rail is not None and abs(z) >= rail:
        raise InvalidValueError(thing, f"must lie within {which}, {rail:g} m", f"{z:g} m")


_BELIEF: Mapping[str, Declaration] = {
    "cart_mass_error": Declaration(require_error, "1", (
        Imperfection(name="mass-over", title="M assumed too large", unit="%", scale=1e2,
            fields={"cart_mass_error": 1.0}, reference=0.1, benign=0.01, harsh=30.0),
        Imperfection(name="mass-under", title="M assumed too small", unit="%", scale=1e2,
            fields={"cart_mass_error": -1.0}, reference=0.1, benign=0.01, harsh=0.95),
    ), "weighed by hand", None),
    "half_length_error": Declaration(require_error, "1", (
        Imperfection(name="length-over", title="l assumed too large", unit="%", scale=1e2,
            fields={"half_length_error": 1.0}, reference=0.05, benign=0.01, harsh=30.0),
        Imperfection(name="length-under", title="l assumed too small", unit="%", scale=1e2,
            fields={"half_length_error": -1.0}, reference=0.05, benign=0.01, harsh=0.95),
    ), "measured by hand", None),
    **{
        name: Declaration(require_error, "1", (), "", None)
        for name in ERRORS
        if name not in ("cart_mass_error", "half_length_error")
    },
}  # fmt: skip
"""The errors of what controllers assume, which are part of the belief of a scenario."""

_FIELDS = {one.name: one.metadata["declaration"] for one in fields(Imperfections)}

_ORDER = [*_FIELDS]
_ORDER[_ORDER.index("rail_half_length") : _ORDER.index("rail_half_length")] = _BELIEF  # rail last

DECLARATIONS: Mapping[str, Declaration] = MappingProxyType(
    {name: {**_FIELDS, **_BELIEF}[name] for name in _ORDER}
)
"""The declaration of each field, and of each error of the belief."""

IMPERFECTIONS = tuple(one for declared in DECLARATIONS.values() for one in declared.swept)
"""Every imperfection whose thresholds are searched, in the order in which they are combined."""

DRAWS: Mapping[str, Draw] = MappingProxyType(
    dict(
        sorted(
            ((name, one.drawn) for name, one in DECLARATIONS.items() if one.drawn is not None),
            key=lambda item: item[1].axis,
        )
    )
)
"""How each field that varies is drawn for random hardware, in the order of the axes."""

IDEAL = Imperfections()
"""The loop of the paper, without imperfections."""
