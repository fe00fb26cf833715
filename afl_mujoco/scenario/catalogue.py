"""The scenarios of the paper: nominal, and four schedule cases with and without the disturbance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from afl_mujoco.scenario.disturbances import ForcePulse
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import staircase, trapezoid

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
            cart_mass=_CART_MASS[mass],
            half_length=_HALF_LENGTH[length],
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
