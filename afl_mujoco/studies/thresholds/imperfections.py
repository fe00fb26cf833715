"""The imperfections at a level: one at a time, and all of them combined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from afl_mujoco.errors import UnknownNameError
from afl_mujoco.scenario.imperfections import IMPERFECTIONS, Imperfection

TIMESTEP = 1e-3
"""MuJoCo's step [s], and the control period where the imperfection does not set it."""

BY_NAME: Mapping[str, Imperfection] = MappingProxyType({one.name: one for one in IMPERFECTIONS})
"""The imperfections by name."""

RAIL = "rail"
"""Not combined with the rest: the rail alone decides for a controller that does not know it."""

COMBINED = Imperfection(
    name="combined", title="all combined but the rail", unit="×", fields={},
    reference=1.0, benign=0.05, harsh=20.0, seeded=True,
)  # fmt: skip
"""All at once: each as many times worse than the reference hardware as the level says."""


KNOWN: Mapping[str, Imperfection] = MappingProxyType({**BY_NAME, COMBINED.name: COMBINED})
"""All that can be studied, by name."""


def find_imperfection(name: str) -> Imperfection:
    """Return an imperfection by its name."""
    if name not in KNOWN:
        raise UnknownNameError.among("imperfection", name, KNOWN)
    return KNOWN[name]


def added() -> tuple[Imperfection, ...]:
    """Return the imperfections that can be present at once, in their order.

    One that sets only what an earlier one has set is left out: it would contradict the earlier one.
    """
    found, set_before = [], set[str]()
    for one in IMPERFECTIONS:
        sets = {*one.fields, *one.switches}
        if not sets <= set_before:
            found.append(one)
        set_before |= sets
    return tuple(found)


Hardware = dict[str, Any]
"""Imperfections and errors of the belief by name, as `Scenario.changed` takes them."""


def hardware_at(imperfection: Imperfection, level: float, seed: int = 0) -> Hardware:
    """Return one imperfection, or all combined, at a level."""
    if imperfection.name == COMBINED.name:
        return combined(level, [one for one in added() if one.name != RAIL], seed)
    return {**imperfection.options(level), "seed": seed}


def combined(scale: float, imperfections: Sequence[Imperfection], seed: int = 0) -> Hardware:
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
    return {**options, "seed": seed}
