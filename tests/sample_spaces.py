from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.scenario.catalogue import LABORATORY
from afl_mujoco.scenario.ranges import Range, Ranges, hardware_of, settings_of
from afl_mujoco.scenario.sample_space import SampleSpace


def near_laboratory(
    *,
    imperfections: Mapping[str, Range] | None = None,
    duration: float = LABORATORY.duration,
    control_period: float | None = None,
    **changes: Any,
) -> SampleSpace:
    varied = dict(LABORATORY.ranges.varied)
    if imperfections is not None:
        hardware = hardware_of(CART_POLE)
        varied = {n: r for n, r in varied.items() if n not in hardware} | dict(imperfections)
    table = {**LABORATORY.ranges.table, **changes}
    known = settings_of(CART_POLE)
    settings = {n: table[n] for n in known if n in table}
    varied |= {n: r for n, r in changes.items() if n not in known}
    scenario = replace(
        LABORATORY,
        duration=duration,
        imperfections=replace(LABORATORY.imperfections, control_period=control_period),
        ranges=Ranges.of({**varied, **settings}),
    )
    return SampleSpace(scenario)
