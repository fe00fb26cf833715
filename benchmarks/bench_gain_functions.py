"""Which structure of gain scheduling beats the retuned fixed gains, on how many random schedules?

Run: python benchmarks/bench_gain_functions.py [--schedules 1000] [--seed 0] [--workers 2]

K and Phi are those of `fixed-retuned` throughout; only lambda is scheduled. Each line is the share
of schedules on which the objective (O1) is lower than with fixed gains, its exact 95 % interval,
and the mean improvement. The ideal ODE by RK4 at 2 ms; seed 1 was used to choose, seed 0 is for
judging.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

import afl_mujoco as afl
from afl_mujoco.control.catalogue import AFLController
from afl_mujoco.control.gain_function import scheduled_gain, shipped_data
from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.execution.executors import compute_all, open_executor
from afl_mujoco.scenario.randomised import random_scenario
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.simulation.scoring import with_objective
from afl_mujoco.studies.gain_tuning.gain_cost import paper_scales
from afl_mujoco.studies.verification.claims.schedules import compare

TIMESTEP = 2e-3
FIXED = afl.CONTROLLERS["fixed-retuned"]
NOMINAL_SLOPE = FIXED.gain_function.slope[0]

Array = NDArray[np.float64]
Slope = Callable[[Array, Array], Array]


@dataclass(frozen=True, kw_only=True)
class Tried(AFLController):
    """Fixed gains, except lambda, which a function computes from M and l along the whole run."""

    slope: Slope

    def inputs_along_run(
        self, cart_mass: Any, half_length: Any, pole_mass: float, gravity: float
    ) -> Array:
        law = AFLController.inputs_along_run(self, cart_mass, half_length, pole_mass, gravity)
        law[..., 5] = self.slope(np.asarray(cart_mass), np.asarray(half_length))
        return law


def damped(slope: Array, exponent: float) -> Array:
    return NOMINAL_SLOPE * (slope / NOMINAL_SLOPE) ** exponent


@functools.cache
def table() -> Slope:
    """The table, interpolated linearly."""
    rows = GainTable.shipped()
    masses, lengths = (np.unique(rows.column(x)) for x in ("cart_mass", "half_length"))
    order = np.lexsort((rows.column("half_length"), rows.column("cart_mass")))
    slopes = rows.column("slope")[order].reshape(len(masses), len(lengths))
    interpolate = RegularGridInterpolator((masses, lengths), slopes)
    return lambda m, x: interpolate(np.stack([m, x], axis=-1))


def held(slope: Slope) -> Slope:
    """Return the slope at the start for the whole run."""

    def first(mass: Array, length: Array) -> Array:
        start = slope(mass.ravel()[:1], length.ravel()[:1])[0]
        return np.full(mass.shape, start)

    return first


def rising(slope: Slope) -> Slope:
    """Return the largest slope so far."""
    return lambda m, x: np.maximum.accumulate(slope(m.ravel(), x.ravel())).reshape(m.shape)


def fitted(method: str) -> Slope:
    fits = shipped_data("gain_functions.json")["fits"]
    (w,) = [f["coefficients"] for f in fits if (f["gain"], f["method"]) == ("slope", method)]
    return lambda m, x: scheduled_gain(m, x, tuple(w))


@functools.cache
def candidates() -> dict[str, Slope]:
    exact = table()

    def softened(exponent: float) -> Slope:
        return lambda m, x: damped(exact(m, x), exponent)

    return {
        "(G1), least squares on the table": fitted("least squares"),
        "(G1), damped by 0.4: adaptive-retuned": fitted("damped least squares"),
        "the table": exact,
        "the table, damped by 0.4": softened(0.4),
        "the table, damped by 0.2": softened(0.2),
        "the table, damped by 0.4, may only increase": rising(softened(0.4)),
        "the table, held at its start": held(exact),
        "the table, held at its start, damped by 0.4": held(softened(0.4)),
        "the table, held at its start, damped by 0.2": held(softened(0.2)),
        "constant lambda = 3.2": lambda m, x: np.full(m.shape, 3.2),
    }


def objectives(unit: tuple[int, int]) -> list[float]:
    """The objective under fixed gains and under each candidate; infinite where the pole fell."""
    scenario = random_scenario(*unit)
    tried = [
        Tried(name="tried", gain_function=FIXED.gain_function, slope=slope)
        for slope in candidates().values()
    ]
    found = []
    for controller in (FIXED, *tried):
        run = afl.simulate_ode_rk4(scenario, controller, timestep=TIMESTEP)
        score = with_objective(metrics(scenario, controller, run), paper_scales())["objective"]
        found.append(np.inf if score is None else score)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare structures of gain scheduling.")
    parser.add_argument("--schedules", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    units = [(options.seed, index) for index in range(options.schedules)]
    with open_executor(options.workers) as executor:
        scores = np.array(compute_all(objectives, units, executor))
    print(f"{options.schedules} schedules of seed {options.seed}: share won, mean improvement")
    for column, name in enumerate(candidates(), start=1):
        found = compare(scores[:, 0], scores[:, column])
        low, high = (100.0 * x for x in found.interval)
        mean = 100.0 * float(np.mean(1.0 - scores[:, column] / scores[:, 0]))
        share = 100.0 * found.share
        print(f"  {name:<46} {share:5.1f} % [{low:4.1f}, {high:4.1f}]  {mean:+.2f} %")


if __name__ == "__main__":
    main()
