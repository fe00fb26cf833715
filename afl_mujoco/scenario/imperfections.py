"""What stands between the ideal loop of the paper and a rig: one documented option each."""

from __future__ import annotations

from dataclasses import dataclass, fields

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import require_finite, require_positive, require_type

_OPTIONAL = ("control_period", "force_limit", "slew_rate", "rail_half_length")
_ERRORS = ("mass_error", "length_error")
_LARGEST_SEED = 2**63 - 1  # what a TOML file can hold
_FINEST_STEP = 1e-12  # of an encoder [m, rad]; a position over one much finer overflows


def _checked(name: str, value: object) -> float | None:
    """Return a number as a float, or raise if it breaks the rule of the field `name`."""
    if name in _OPTIONAL:
        return None if value is None else require_positive(name, value)
    number = require_finite(name, value)
    if name in _ERRORS:
        if number <= -1.0:
            raise InvalidValueError(name, "must be above -1", number)
    elif number < 0.0:
        raise InvalidValueError(name, "must not be negative", number)
    elif name.startswith("encoder_step") and 0.0 < number < _FINEST_STEP:
        raise InvalidValueError(name, f"must be 0 or at least {_FINEST_STEP:g}", number)
    return number


@dataclass(frozen=True, slots=True, kw_only=True)
class Imperfections:
    """Departures from the ideal loop; every default is the ideal.

    At each control tick the sensors are read (noise, then quantisation, then differentiation, then
    filter), the law is told M and l (late, with an error) and commands a force, which passes the
    force limit, the transport delay, the slew limit and the actuator's lag on its way to the cart.

    Attributes
    ----------
    control_period
        Time between two control ticks [s], a multiple of the simulator's timestep; ``None`` for
        that of the simulator.
    force_limit
        Largest force of the actuator [N]; ``None`` for no limit.
    slew_rate
        Largest rate at which the actuator changes its force [N/s]; ``None`` for no limit.
    actuator_lag
        Time constant of the actuator's first-order lag [s].
    delay
        Transport delay from the control tick to the actuator [s]; it may be any part of a step.
    encoder_step_z, encoder_step_phi
        Resolution of the position sensors [m, rad]; readings are rounded to the nearest multiple;
        0 for exact ones, else at least 1e-12.
    noise_z, noise_phi
        Standard deviation of the white noise on the positions at each tick [m, rad].
    noise_z_dot, noise_phi_dot
        The same on the velocity sensors [m/s, rad/s], of which there are none where velocities are
        `differentiated`.
    differentiated
        Whether the law gets as velocity the backward difference of the measured positions over a
        control period (zero at the first tick).
    velocity_filter
        Time constant of the first-order low-pass on the velocities that the law gets [s].
    rail_damping, hinge_damping
        Viscous friction of the cart [N s/m] and the hinge [N m s/rad].
    rail_friction
        Dry (Coulomb) friction of the cart on its rail [N].
    rail_armature, hinge_armature
        Inertia of a drive that moves with the joint [kg, kg m^2].
    rail_half_length
        The cart's travel to either side before it meets an end stop [m]; ``None`` for no end.
    tip_mass_share
        Share of the pole's mass m that sits at its tip, in 0 to below 1 [1]; l stays half the
        length of the rod.
    pole_radius
        Radius of the rod, a solid capsule as MuJoCo draws it [m]; 0 is the slender rod.
    parameter_delay
        How late a law that is told M and l learns of them [s].
    mass_error, length_error
        Relative error of M and l as they are told to the law, above -1 [1].
    seed
        Seed of the noise, 0 to 2**63 - 1; the same seed gives the same noise, whatever else is set.

    Raises
    ------
    InvalidValueError
        If a value breaks its rule.
    """

    control_period: float | None = None
    force_limit: float | None = None
    slew_rate: float | None = None
    actuator_lag: float = 0.0
    delay: float = 0.0
    encoder_step_z: float = 0.0
    encoder_step_phi: float = 0.0
    noise_z: float = 0.0
    noise_phi: float = 0.0
    noise_z_dot: float = 0.0
    noise_phi_dot: float = 0.0
    differentiated: bool = False
    velocity_filter: float = 0.0
    rail_damping: float = 0.0
    hinge_damping: float = 0.0
    rail_friction: float = 0.0
    rail_armature: float = 0.0
    hinge_armature: float = 0.0
    rail_half_length: float | None = None
    tip_mass_share: float = 0.0
    pole_radius: float = 0.0
    parameter_delay: float = 0.0
    mass_error: float = 0.0
    length_error: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Validate every field and store numbers as floats."""
        require_type("differentiated", self.differentiated, bool)
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name not in ("differentiated", "seed"):
                object.__setattr__(self, field.name, _checked(field.name, value))
        if self.tip_mass_share >= 1.0:
            raise InvalidValueError("tip_mass_share", "must be below 1", self.tip_mass_share)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int):
            raise InvalidValueError("seed", "must be a whole number", repr(self.seed))
        if not 0 <= self.seed <= _LARGEST_SEED:
            raise InvalidValueError("seed", "must lie in 0 to 2**63 - 1", self.seed)


IDEAL = Imperfections()
"""The loop of the paper: nothing departs from the ideal."""
