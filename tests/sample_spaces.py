from collections.abc import Mapping
from dataclasses import replace

from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.scenario.catalogue import LABORATORY
from afl_mujoco.scenario.ranges import Range, hardware_of
from afl_mujoco.scenario.sample_space import SampleSpace


def near_laboratory(
    *,
    imperfections: Mapping[str, Range] | None = None,
    duration: float = LABORATORY.duration,
    control_period: float | None = None,
    **changes: Range,
) -> SampleSpace:
    ranges = dict(LABORATORY.ranges)
    if imperfections is not None:
        hardware = hardware_of(CART_POLE)
        ranges = {n: r for n, r in ranges.items() if n not in hardware} | dict(imperfections)
    scenario = replace(
        LABORATORY,
        duration=duration,
        imperfections=replace(LABORATORY.imperfections, control_period=control_period),
        ranges={**ranges, **changes},
    )
    return SampleSpace(scenario)
