"""What does a closed-loop Monte Carlo cost, against MuJoCo's own open-loop rollout?

Run: python benchmarks/bench_montecarlo.py [--steps 20000] [--repeats 9] [--rollouts 10000]

Everything runs on two threads. The ways are timed in turn in each repeat, so that a slow moment of
the machine slows them all; a ratio is the median over the repeats of the ratio within one repeat.
Both clocks are given, since on a machine that others use as well wall time says little: CPU time
counts what the two threads themselves spent.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import mujoco
import mujoco.rollout
import numpy as np
from ratios import median_ratio, say

import afl_mujoco as afl
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.mujoco_model import CartPoleModel
from afl_mujoco.studies.shared.run import Run, run_all

TIMESTEP, THREADS = 1e-3, 2
CONTROLLER = afl.CONTROLLERS["adaptive"]
NOISE = Imperfections(
    noise={"z": 1e-3, "phi": 1e-3, "z_dot": 1e-2, "phi_dot": 1e-2},
)
"""Noise on every channel of the measurement at every step, and no other imperfection."""

WAYS = (
    "mujoco.rollout, open loop",
    "closed loop with noise, parameters constant",
    "closed loop with noise, parameters change every step",
)
AIMS = {  # (way, integrator): least ratio to the open loop
    (1, "Euler"): 0.8,
    (1, "RK4"): 0.95,
    (2, "RK4"): 0.6,
}


def scenarios(steps: int, batch: int) -> tuple[list[Scenario], list[Scenario]]:
    """Return seeds of a constant scenario, and of one whose M and l change at every step."""
    duration = steps * TIMESTEP
    ramp = afl.piecewise_linear((0.0, duration), (0.5, 1.0))
    constant = Scenario(name="constant", duration=duration)
    changing = replace(constant, name="ramp", schedule={"cart_mass": ramp, "half_length": ramp})
    return tuple(
        [replace(scenario, imperfections=replace(NOISE, seed=seed)) for seed in range(batch)]
        for scenario in (constant, changing)
    )


def open_loop(scenario: Scenario, integrator: str, steps: int, batch: int) -> Callable[[], object]:
    """Return a call of MuJoCo's batched rollout, its threads running and its outputs allocated."""
    model = CartPoleModel(
        scenario.parameters_at(0.0), timestep=TIMESTEP, integrator=integrator
    ).mj_model
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    start = np.zeros((batch, size))
    start[:, 2] = 0.1
    states, sensors = np.empty((batch, steps, size)), np.empty((batch, steps, model.nsensordata))
    data = [mujoco.MjData(model) for _ in range(THREADS)]
    pool = mujoco.rollout.Rollout(nthread=THREADS)
    return lambda: pool.rollout(
        [model] * batch, data, start, nstep=steps, state=states, sensordata=sensors
    )


def closed_loop(batch: list[Scenario], integrator: str) -> Callable[[], list[Run]]:
    """Return a call of the whole Monte Carlo, preparation included."""
    return lambda: run_all(CONTROLLER, batch, Deployed(integrator, TIMESTEP), threads=THREADS)


def compare(integrator: str, options: argparse.Namespace) -> None:
    """Time the three ways and print steps per second and ratios."""
    constant, changing = scenarios(options.steps, options.batch)
    calls = (
        open_loop(constant[0], integrator, options.steps, options.batch),
        closed_loop(constant, integrator),
        closed_loop(changing, integrator),
    )
    for call in calls[1:]:  # every step was simulated
        assert all(run.outcome == "completed" for run in call())
    calls[0]()
    rates: list[list[tuple[float, float]]] = [[] for _ in calls]
    for _ in range(options.repeats):
        for call, rate in zip(calls, rates, strict=True):
            wall, cpu = time.perf_counter(), time.process_time()
            call()
            spent = (time.perf_counter() - wall, time.process_time() - cpu)
            rate.append(tuple(options.batch * options.steps / seconds for seconds in spent))
    print(f"\n{integrator}, {options.batch} runs of {options.steps} steps, {THREADS} threads")
    print(f"  {'':<54} {'steps/s':>10} {'per CPU s':>10}")
    for way, rate in zip(WAYS, rates, strict=True):
        wall, cpu = (statistics.median(r[clock] for r in rate) for clock in (0, 1))
        print(f"  {way:<54} {wall:>10,.0f} {cpu:>10,.0f}")
    for way in (1, 2):
        closed, bare = zip(*rates[way], strict=True), zip(*rates[0], strict=True)
        wall, cpu = map(median_ratio, closed, bare)
        print(f"  ratio, {WAYS[way]}: {wall:.2f}, by CPU time {cpu:.2f}")
        if aim := AIMS.get((way, integrator)):
            say(f"{integrator}: {WAYS[way]}, by CPU time", cpu, least=aim)


def many(count: int, steps: int) -> None:
    """Time a Monte Carlo of many runs by Euler."""
    batch, _ = scenarios(steps, count)
    wall, cpu = time.perf_counter(), time.process_time()
    rollouts = closed_loop(batch, "Euler")()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    completed = int((rollouts.status == 0).sum())
    print(
        f"\n{count} rollouts of {steps * TIMESTEP:g} s, Euler at 1 ms: {wall:.1f} s on {THREADS} "
        f"threads ({cpu:.1f} s of CPU time), {count * steps / wall:,.0f} steps/s, "
        f"{completed} completed"
    )


def main() -> None:
    """Print what the closed loop costs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000, help="steps of a run")
    parser.add_argument("--batch", type=int, default=8, help="runs of a timing")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--rollouts", type=int, default=10_000, help="runs of the Monte Carlo")
    options = parser.parse_args()
    for integrator in ("Euler", "RK4"):
        compare(integrator, options)
    if options.rollouts:
        many(options.rollouts, options.steps)


if __name__ == "__main__":
    main()
