"""Random laboratory hardware: what Monte Carlo draws for a scenario without ranges of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from afl_mujoco.scenario.imperfections import DRAWS, IDEAL
from afl_mujoco.scenario.randomised import CART_MASS_RANGE, HALF_LENGTH_RANGE
from afl_mujoco.scenario.ranges import FIXED, Range, Ranges
from afl_mujoco.scenario.scenario import Scenario


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

HARDWARE_RANGES: Mapping[str, Range] = MappingProxyType(
    {name: draw.range for name, draw in DRAWS.items()}
)
"""The imperfections of random hardware."""

LABORATORY = Scenario(
    name="laboratory",
    ranges=Ranges(
        varied={
            **{name: start.range for name, start in START.items()},
            "cart_mass": CART_MASS_RANGE,
            "half_length": HALF_LENGTH_RANGE,
            **HARDWARE_RANGES,
        },
        last_change=10.0,
    ),
)
"""The paper's plant and horizon on random hardware; M and l change in the first half."""

REASONS: Mapping[str, str] = MappingProxyType(
    {
        **{name: start.why for name, start in START.items()},
        "cart_mass": "the paper's box",
        "half_length": "the paper's box",
        "last_change": "M and l change in the first half of the run, as in the paper",
        **{name: draw.why for name, draw in DRAWS.items()},
        "duration": "the paper's horizon",
    }
)
"""The reason for each number of `LABORATORY`."""


def with_ranges(scenario: Scenario, *, start: bool = False) -> Scenario:
    """Return a scenario with ranges: its own, else those of laboratory hardware.

    Imperfections that are not ideal in the scenario stay as they are.
    """
    if scenario.ranges != FIXED:
        return scenario
    own = scenario.imperfections
    free = {
        name: bounds
        for name, bounds in HARDWARE_RANGES.items()
        if getattr(own, name) == getattr(IDEAL, name) and name not in own.without_effect
    }
    begin = {name: one.range for name, one in START.items()} if start else {}
    return replace(scenario, ranges=Ranges(varied={**begin, **free}))
