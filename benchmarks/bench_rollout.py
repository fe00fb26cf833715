"""How fast is the closed loop? Steps per second of five ways to step a plant.

Run: python benchmarks/bench_rollout.py [--steps 20000] [--repeats 15]

All ways are timed in turn in each repeat, so that a slow moment of the machine slows them all; a
ratio is the median over the repeats of the ratio within one repeat.
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from ratios import median_ratio, say

import afl_mujoco as afl
from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.imperfections import IDEAL
from afl_mujoco.scenario.requirements import Requirements
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.sampled.runs import perform, prepare, timing_of
from afl_mujoco.simulation.task import controller_policy

TIMESTEP = 1e-3
CONTROLLER = afl.CONTROLLERS["adaptive"]
EXAMPLES = Path(__file__).parents[1] / "examples"
WAYS = (
    "bare mj_step(m, d, nstep)",
    "compiled loop, parameters constant",
    "compiled loop, mutated every step",
    "Python mj_step loop, no controller",
    "Environment.step with controller",
)
AIMS = {  # (numerator, denominator, integrator): least ratio
    (1, 0, "Euler"): 0.95,
    (1, 0, "RK4"): 0.99,
    (2, 0, "RK4"): 0.85,
    (2, 4, "RK4"): 2.5,
}
OTHERS = ("quadrotor_load", "double_pendulum", "cart_double_pendulum")
AIM_OF_OTHERS = 0.85  # in RK4, parameters constant


def scenarios(steps: int) -> tuple[Scenario, Scenario]:
    """Return a constant scenario and one whose M and l change at every step."""
    duration = steps * TIMESTEP
    ramp = afl.piecewise_linear((0.0, duration), (0.5, 1.0))
    constant = afl.Scenario(name="constant", duration=duration)
    return constant, dataclasses.replace(
        constant, name="ramp", schedule={"cart_mass": ramp, "half_length": ramp}
    )


def loop(scenario: Scenario, integrator: str, controller: Controller) -> Callable[[], object]:
    """Return a call of the compiled loop alone, everything it needs prepared."""
    controller = bound(controller, scenario)
    model = SimulatedModel(scenario.plant, timestep=TIMESTEP, integrator=integrator)
    timing = timing_of(scenario, model, Deployed(timestep=TIMESTEP))
    prepared = prepare(model, scenario, controller, timing)
    return lambda: perform(model, prepared, controller)


def bare(scenario: Scenario, integrator: str, steps: int, *, in_loop: bool) -> Callable[[], object]:
    """Return MuJoCo's own stepping, in C or in a Python loop."""
    model = SimulatedModel(scenario.plant, timestep=TIMESTEP, integrator=integrator)
    m, d = model.mj_model, model.mj_data

    def in_python() -> None:
        for _ in range(steps):
            mujoco.mj_step(m, d)

    def reset_and(step: Callable[[], object]) -> Callable[[], object]:
        def call() -> None:
            mujoco.mj_resetData(m, d)
            d.qpos[:] += 0.1
            step()

        return call

    return reset_and(in_python if in_loop else lambda: mujoco.mj_step(m, d, steps))


def rates_of(calls: Sequence[tuple[Callable[[], object], int]], repeats: int) -> list[list[float]]:
    """Return the steps per second of each way, all timed in turn in each repeat."""
    rates: list[list[float]] = [[] for _ in calls]
    for _ in range(repeats):
        for (call, count), rate in zip(calls, rates, strict=True):
            start = time.perf_counter()
            call()
            rate.append(count / (time.perf_counter() - start))
    return rates


def environment(scenario: Scenario, integrator: str, steps: int) -> Callable[[], object]:
    """Return the dm_control loop of agent and environment, one substep a control step."""
    env = afl.load(scenario, timestep=TIMESTEP, integrator=integrator)
    policy = controller_policy(CONTROLLER, scenario)
    spec = env.action_spec()

    def call() -> None:
        step = env.reset()
        for _ in range(steps):
            step = env.step(np.clip(policy(step), spec.minimum, spec.maximum))

    return call


def main() -> None:
    """Time every way and print steps per second and the ratios that have a target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    constant, ramp = scenarios(options.steps)
    short = options.steps // 10
    for integrator in ("Euler", "RK4"):
        calls = (
            (bare(constant, integrator, options.steps, in_loop=False), options.steps),
            (loop(constant, integrator, CONTROLLER), options.steps),
            (loop(ramp, integrator, CONTROLLER), options.steps),
            (bare(constant, integrator, options.steps, in_loop=True), options.steps),
            (environment(ramp, integrator, short), short),
        )
        rates = rates_of(calls, options.repeats)
        print(f"\n{integrator}, {options.steps} steps, median of {options.repeats}")
        for way, rate in zip(WAYS, rates, strict=True):
            print(f"  {way:<38} {statistics.median(rate):>10,.0f} steps/s")
        for (top, bottom, which), aim in AIMS.items():
            if which == integrator:
                ratio = median_ratio(rates[top], rates[bottom])
                say(f"{which}: {WAYS[top]} / {WAYS[bottom]}", ratio, least=aim)
    print(f"\nother plants, RK4, {options.steps} steps, median of {options.repeats}")
    for name in OTHERS:
        scenario = dataclasses.replace(
            afl.load_scenario(EXAMPLES / f"{name}.toml"),
            schedule={}, disturbances=(), imperfections=IDEAL,
            duration=options.steps * TIMESTEP, requirements=Requirements(),
        )  # fmt: skip
        calls = (
            (bare(scenario, "RK4", options.steps, in_loop=False), options.steps),
            (loop(scenario, "RK4", afl.CONTROLLERS["lqr"]), options.steps),
        )
        rates = rates_of(calls, options.repeats)
        say(
            f"{name}: compiled loop / {WAYS[0]}",
            median_ratio(rates[1], rates[0]),
            least=AIM_OF_OTHERS,
        )


if __name__ == "__main__":
    main()
