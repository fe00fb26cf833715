"""How long does a map of attraction take? 201 x 201 by the equations, 101 x 101 in MuJoCo.

Run: python benchmarks/bench_attraction.py [--threads 2] [--controllers fixed adaptive lqr]

Both by the clock, after a first map that compiles; beside it processor time, and the load of the
machine at the start, which says whether something else ran. Targets on two cores: 30 s by the
equations, 2 minutes in MuJoCo at 2 ms. At the end, what the early end saves on a coarser map.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import afl_mujoco as afl
from afl_mujoco.simulation.attraction.cells import (
    LENGTHS,
    MASSES,
    MAX_ANGLE,
    MAX_RATE,
    AttractionMap,
    Cells,
    Settling,
    axis,
    plant_cells,
    state_cells,
)
from afl_mujoco.simulation.attraction.mujoco_map import map_in_mujoco
from afl_mujoco.simulation.attraction.ode_map import map_by_ode

March = Callable[..., AttractionMap]

SIDES = {"equations": (map_by_ode, 201, 30.0), "MuJoCo": (map_in_mujoco, 101, 120.0)}
"""The march, cells along an axis, and the target [s]."""


def cells_of(plane: str, count: int) -> Cells:
    if plane == "states":
        angles, rates = (
            axis("a", -MAX_ANGLE, MAX_ANGLE, count),
            axis("r", -MAX_RATE, MAX_RATE, count),
        )
        return state_cells(angles, rates)
    return plant_cells(axis("M", *MASSES, count), axis("l", *LENGTHS, count))


def timed(march: March, cells: Cells, name: str, **options: Any) -> tuple[float, float]:
    """The seconds that a map takes, by the clock and of the processor."""
    wall, processor = time.perf_counter(), time.process_time()
    march(cells, afl.CONTROLLERS[name], **options)
    return time.perf_counter() - wall, time.process_time() - processor


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--controllers", nargs="+", default=["fixed", "adaptive", "lqr"])
    options = parser.parse_args()
    threads = options.threads
    for march, _, _ in SIDES.values():
        march(cells_of("states", 2), afl.CONTROLLERS["lqr"])  # compiles
    print(f"{threads} threads on {os.cpu_count()} processors")
    print("side       map     controller        cells   time [s]  target  cpu [s]  ms/cell  load")
    for side, (march, count, target) in SIDES.items():
        for plane in ("states", "plants"):
            cells = cells_of(plane, count)
            for name in options.controllers:
                load = os.getloadavg()[0]
                wall, cpu = timed(march, cells, name, threads=threads)
                each = 1e3 * cpu / len(cells.starts)
                print(
                    f"{side:10} {plane:7} {name:17} {len(cells.starts):6} {wall:9.1f} {target:7.0f}"
                    f" {cpu:8.1f} {each:8.2f} {load:5.1f}",
                    flush=True,
                )
    print("early end against the whole horizon, 21 x 21 states, processor time:")
    never = Settling(dwell=Settling().horizon)
    for side, (march, _, _) in SIDES.items():
        for name in options.controllers:
            cells = cells_of("states", 21)
            early = timed(march, cells, name, threads=threads)[1]
            whole = timed(march, cells, name, threads=threads, settling=never)[1]
            print(f"{side:10} {name:17} {whole / early:5.2f} times less")


if __name__ == "__main__":
    main()
