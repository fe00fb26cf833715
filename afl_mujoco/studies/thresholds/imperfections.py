"""The imperfections: one departure from the ideal loop each, and all of them combined."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from afl_mujoco.errors import UnknownNameError
from afl_mujoco.scenario.imperfections import Imperfections

TIMESTEP = 1e-3
"""MuJoCo's step [s], and the control period where the imperfection does not set it."""

FINE_STEP = 0.5e-3
"""MuJoCo's step where the control period itself is varied [s]: periods are multiples of it."""

_Z_PER_PHI, _RATE = 0.1, 10.0  # [m/rad], [1/s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Imperfection:
    """One departure from the ideal loop, and how much of it good laboratory hardware has.

    Attributes
    ----------
    name
        For files and the command line.
    title
        In words.
    unit
        Of a level as it is shown.
    fields
        Fields of `Imperfections` that it sets, each to the level times its factor.
    reference
        Level of the reference hardware, good but ordinary in a laboratory.
    benign, harsh
        Ends of the range on which the threshold is searched; ``benign > harsh`` where less is
        worse.
    scale
        Shown value of a level, as a factor.
    switches
        Fields that it switches on at every level.
    seeded
        Whether it draws random numbers, so that several seeds must be survived.
    quantum
        What levels are multiples of, and with them MuJoCo's step; 0 for any level.
    """

    name: str
    title: str
    unit: str
    fields: Mapping[str, float]
    reference: float
    benign: float
    harsh: float
    scale: float = 1.0
    switches: tuple[str, ...] = ()
    seeded: bool = False
    quantum: float = 0.0

    def options(self, level: float) -> dict[str, Any]:
        """Return the fields of `Imperfections` at a level."""
        values = {name: factor * level for name, factor in self.fields.items()}
        return {**values, **dict.fromkeys(self.switches, True)}

    @property
    def timestep(self) -> float:
        """MuJoCo's step [s]."""
        return self.quantum or TIMESTEP

    @property
    def less_is_worse(self) -> bool:
        """Whether a smaller level is the harsher one."""
        return self.harsh < self.benign

    def snapped(self, level: float) -> float:
        """Return the nearest level that there is."""
        if self.quantum == 0.0:
            return level
        return max(1, round(level / self.quantum)) * self.quantum


_SENSORS = {"encoder_step_phi": 1.0, "encoder_step_z": _Z_PER_PHI}
_NOISE = {
    "noise_phi": 1.0,
    "noise_z": _Z_PER_PHI,
    "noise_phi_dot": _RATE,
    "noise_z_dot": _RATE * _Z_PER_PHI,
}
_COUNT = 2.0 * math.pi / 4096.0  # of an encoder of 4096 counts a turn

IMPERFECTIONS: tuple[Imperfection, ...] = (
    Imperfection(name="control-period", title="control period", unit="ms", scale=1e3,
         fields={"control_period": 1.0}, reference=2e-3, benign=FINE_STEP, harsh=50e-3,
         quantum=FINE_STEP),
    Imperfection(name="delay", title="transport delay", unit="ms", scale=1e3,
         fields={"delay": 1.0}, reference=2e-3, benign=2e-4, harsh=0.2),
    Imperfection(name="actuator-lag", title="actuator lag", unit="ms", scale=1e3,
         fields={"actuator_lag": 1.0}, reference=2e-3, benign=2e-4, harsh=0.5),
    Imperfection(name="force-limit", title="force limit", unit="N",
         fields={"force_limit": 1.0}, reference=50.0, benign=1000.0, harsh=1.0),
    Imperfection(name="slew-rate", title="force slew rate", unit="N/s",
         fields={"slew_rate": 1.0}, reference=5e3, benign=1e6, harsh=10.0),
    Imperfection(name="encoder", title="encoder step", unit="mrad", scale=1e3,
         fields=_SENSORS, reference=_COUNT, benign=1e-4, harsh=0.5),
    Imperfection(name="differentiated", title="encoder, rates differenced", unit="mrad", scale=1e3,
         fields=_SENSORS, switches=("differentiated",), reference=_COUNT, benign=1e-5, harsh=0.5),
    Imperfection(name="noise", title="sensor noise", unit="mrad", scale=1e3,
         fields=_NOISE, reference=5e-4, benign=1e-5, harsh=0.5, seeded=True),
    Imperfection(name="rail-damping", title="rail damping", unit="N s/m",
         fields={"rail_damping": 1.0}, reference=5.0, benign=0.05, harsh=500.0),
    Imperfection(name="hinge-damping", title="hinge damping", unit="mN m s", scale=1e3,
         fields={"hinge_damping": 1.0}, reference=2e-3, benign=2e-5, harsh=2.0),
    Imperfection(name="rail-friction", title="dry friction", unit="N",
         fields={"rail_friction": 1.0}, reference=1.0, benign=0.01, harsh=100.0),
    Imperfection(name="rail-armature", title="inertia of the drive", unit="kg",
         fields={"rail_armature": 1.0}, reference=0.3, benign=3e-3, harsh=30.0),
    Imperfection(name="hinge-armature", title="inertia at the hinge", unit="g m²", scale=1e3,
         fields={"hinge_armature": 1.0}, reference=1e-4, benign=1e-6, harsh=1.0),
    Imperfection(name="tip-mass", title="share of m at the tip", unit="%", scale=1e2,
         fields={"tip_mass_share": 1.0}, reference=0.1, benign=1e-3, harsh=0.95),
    Imperfection(name="pole-radius", title="radius of the rod", unit="mm", scale=1e3,
         fields={"pole_radius": 1.0}, reference=5e-3, benign=5e-4, harsh=1.0),
    Imperfection(name="parameter-delay", title="M, l known late", unit="ms", scale=1e3,
         fields={"parameter_delay": 1.0}, reference=50e-3, benign=1e-3, harsh=10.0),
    Imperfection(name="mass-over", title="M assumed too large", unit="%", scale=1e2,
         fields={"mass_error": 1.0}, reference=0.1, benign=0.01, harsh=30.0),
    Imperfection(name="mass-under", title="M assumed too small", unit="%", scale=1e2,
         fields={"mass_error": -1.0}, reference=0.1, benign=0.01, harsh=0.95),
    Imperfection(name="length-over", title="l assumed too large", unit="%", scale=1e2,
         fields={"length_error": 1.0}, reference=0.05, benign=0.01, harsh=30.0),
    Imperfection(name="length-under", title="l assumed too small", unit="%", scale=1e2,
         fields={"length_error": -1.0}, reference=0.05, benign=0.01, harsh=0.95),
    Imperfection(name="rail", title="rail to either side", unit="m",
         fields={"rail_half_length": 1.0}, reference=1.0, benign=100.0, harsh=0.1),
)  # fmt: skip
"""Every imperfection, in the order in which they are combined; the rail comes last."""

BY_NAME: Mapping[str, Imperfection] = MappingProxyType({one.name: one for one in IMPERFECTIONS})
"""The imperfections by name."""

APART = ("encoder", "mass-under", "length-under", "rail")
"""What the combination leaves out: what another imperfection implies or contradicts, and the rail,
which alone decides for a controller that does not know of it."""


COMBINED = Imperfection(
    name="combined", title="all combined but the rail", unit="×", fields={},
    reference=1.0, benign=0.05, harsh=20.0, seeded=True,
)  # fmt: skip
"""All at once: each as many times worse than the reference hardware as the level says."""


def find_imperfection(name: str) -> Imperfection:
    """Return an imperfection by its name."""
    known = {**BY_NAME, COMBINED.name: COMBINED}
    if name not in known:
        raise UnknownNameError.among("imperfection", name, known)
    return known[name]


def imperfections_at(imperfection: Imperfection, level: float, seed: int = 0) -> Imperfections:
    """Return the ideal loop with one imperfection, or all combined, at a level."""
    if imperfection.name == COMBINED.name:
        return combined(level, [one for one in IMPERFECTIONS if one.name not in APART], seed)
    return Imperfections(**imperfection.options(level), seed=seed)


def combined(scale: float, imperfections: Sequence[Imperfection], seed: int = 0) -> Imperfections:
    """Return several imperfections at once, each as many times worse than the reference."""
    options: dict[str, Any] = {}
    for imperfection in imperfections:
        if imperfection.less_is_worse:
            level = max(imperfection.reference / scale, imperfection.harsh)
        else:
            level = min(imperfection.reference * scale, imperfection.harsh)
        options |= imperfection.options(level)
    if "control_period" in options:
        options["control_period"] = max(1, round(options["control_period"] / TIMESTEP)) * TIMESTEP
    return Imperfections(**options, seed=seed)
