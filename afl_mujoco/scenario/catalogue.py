"""The paper's scenarios, and random laboratory hardware."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from afl_mujoco.scenario.imperfections import DRAWS, IDEAL
from afl_mujoco.scenario.ranges import Range
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import ForcePulse, staircase, trapezoid

# Decision D3: Fig. 6 is not in the paper's text, so values and times are ours.
_CART_MASS = {
    "step": staircase((1.0, 3.0), (0.5, 1.0, 2.0)),
    "trapezoid": trapezoid((0.0, 2.0, 6.0, 8.0), low=0.5, high=2.0),
}
_HALF_LENGTH = {
    "step": staircase((1.0, 3.0), (0.2, 0.5, 1.0)),
    "trapezoid": trapezoid((0.0, 2.0, 6.0, 8.0), low=0.2, high=1.0),
}
_PULSE = ForcePulse(force=-10.0, start=10.0, duration=0.1)  # decision D6


def _build() -> dict[str, Scenario]:
    """Return the catalogue: mass shape first, then length shape, as the paper orders them."""
    cases = {
        f"{mass}-{length}": Scenario(
            name=f"{mass}-{length}",
            schedule={"cart_mass": _CART_MASS[mass], "half_length": _HALF_LENGTH[length]},
        )
        for mass in _CART_MASS
        for length in _HALF_LENGTH
    }
    disturbed = {
        f"{name}-impulse": replace(case, name=f"{name}-impulse", disturbances=(_PULSE,))
        for name, case in cases.items()
    }
    return {"nominal": Scenario(name="nominal"), **cases, **disturbed}


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(_build())
"""Every scenario of the paper by name."""


def is_published(scenario: Scenario) -> bool:
    """Return whether a scenario equals the paper's scenario of the same name."""
    return SCENARIOS.get(scenario.name) == scenario


CART_MASS_RANGE, HALF_LENGTH_RANGE = (0.1, 2.0), (0.05, 1.0)  # the paper's box of M [kg] and l [m]


class Start(NamedTuple):
    """The range of an initial value of random hardware, and the reason for it."""

    range: Range
    why: str


START: Mapping[str, Start] = MappingProxyType(
    {
        "z": Start((-0.5, 0.5), "the cart is put down by hand"),
        "phi": Start(
            (-math.radians(75.0), math.radians(75.0)),
            "75 degrees to either side; the paper starts at 60",
        ),
        "z_dot": Start((-0.5, 0.5), "the cart is pushed as it is let go"),
        "phi_dot": Start((-1.0, 1.0), "and so is the pole"),
    }
)
"""The initial state of random hardware."""

HARDWARE_RANGES = MappingProxyType({n: draw.range for n, draw in DRAWS.items()})  # imperfections

LABORATORY = Scenario(
    name="laboratory",
    ranges={
        **{name: start.range for name, start in START.items()},
        "cart_mass": CART_MASS_RANGE,
        "half_length": HALF_LENGTH_RANGE,
        **HARDWARE_RANGES,
    },
)
"""The paper's plant and horizon on random hardware; M and l change in the first half."""


def with_ranges(scenario: Scenario, *, start: bool = False) -> Scenario:
    """Return a scenario with ranges: its own, else those of laboratory hardware.

    Imperfections that are not ideal in the scenario stay as they are.
    """
    if scenario.ranges or not scenario.is_cart_pole:
        return scenario
    own = scenario.imperfections
    free = {
        name: bounds
        for name, bounds in HARDWARE_RANGES.items()
        if own.at(name) == IDEAL.at(name) and not own.without_effect(name)
    }
    begin = {name: one.range for name, one in START.items()} if start else {}
    return replace(scenario, ranges={**begin, **free})
