"""How long does a map of attraction take, 201 x 201 by the equations and 101 x 101 in MuJoCo?

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
from afl_mujoco.simulation.attraction.grid import (
    LENGTHS,
    MASSES,
    MAX_ANGLE,
    MAX_RATE,
    AttractionMap,
    Grid,
    Settling,
    axis,
    plant_grid,
    state_grid,
)
from afl_mujoco.simulation.attraction.mujoco_map import map_in_mujoco
from afl_mujoco.simulation.attraction.ode_map import map_by_ode

Simulate = Callable[..., AttractionMap]

SIDES = {"equations": (map_by_ode, 201, 30.0), "MuJoCo": (map_in_mujoco, 101, 120.0)}
"""For each simulator, grid points along an axis and the target [s]."""


def grid_of(plane: str, count: int) -> Grid:
    if plane == "states":
        angles, rates = (
            axis("a", -MAX_ANGLE, MAX_ANGLE, count),
            axis("r", -MAX_RATE, MAX_RATE, count),
        )
        return state_grid(angles, rates)
    return plant_grid(axis("M", *MASSES, count), axis("l", *LENGTHS, count))


def timed(simulate: Simulate, grid: Grid, name: str, **options: Any) -> tuple[float, float]:
    """Return the wall time and the processor time of a map [s]."""
    wall, processor = time.perf_counter(), time.process_time()
    simulate(grid, afl.CONTROLLERS[name], **options)
    return time.perf_counter() - wall, time.process_time() - processor


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--controllers", nargs="+", default=["fixed", "adaptive", "lqr"])
    options = parser.parse_args()
    threads = options.threads
    for simulate, _, _ in SIDES.values():
        simulate(grid_of("states", 2), afl.CONTROLLERS["lqr"])  # compiles
    print(f"{threads} threads on {os.cpu_count()} processors")
    print("side       map     controller       points   time [s]  target  cpu [s]  ms/point  load")
    for side, (simulate, count, target) in SIDES.items():
        for plane in ("states", "plants"):
            grid = grid_of(plane, count)
            for name in options.controllers:
                load = os.getloadavg()[0]
                wall, cpu = timed(simulate, grid, name, threads=threads)
                each = 1e3 * cpu / len(grid.starts)
                print(
                    f"{side:10} {plane:7} {name:17} {len(grid.starts):6} {wall:9.1f} {target:7.0f}"
                    f" {cpu:8.1f} {each:8.2f} {load:5.1f}",
                    flush=True,
                )
    print("early end against the whole horizon, 21 x 21 states, processor time:")
    never = Settling(dwell=Settling().horizon)
    for side, (simulate, _, _) in SIDES.items():
        for name in options.controllers:
            grid = grid_of("states", 21)
            early = timed(simulate, grid, name, threads=threads)[1]
            whole = timed(simulate, grid, name, threads=threads, settling=never)[1]
            print(f"{side:10} {name:17} {whole / early:5.2f} times less")


if __name__ == "__main__":
    main()
