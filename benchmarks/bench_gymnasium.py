"""How many steps per second do the Gymnasium environments make? All timed in one run.

Run: python benchmarks/bench_gymnasium.py [--envs 32] [--seconds 5]

One environment, and many by `CartPoleVectorEnv` and by Gymnasium's `SyncVectorEnv`: step-step, and
everything drawn at random. Beside Gymnasium's own `InvertedPendulum-v5`, with its model and with
ours, and our environment with the same two steps of RK4 in a step of it. Actions are the same
random ones, under which the pole soon falls: resets count. The parts are measured in turn, three
times; ratios are medians of those within one time.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import SyncVectorEnv
from ratios import median_ratio, say

from afl_mujoco.simulation.gym_env.environment import CartPoleEnv
from afl_mujoco.simulation.gym_env.vector import CartPoleVectorEnv

KINDS: dict[str, dict[str, Any]] = {
    f"{name} {integrator}": {**settings, "integrator": integrator}
    for name, settings in {
        "step-step": {"scenario": "step-step"},
        "random": {"scenario": "laboratory", "randomize": True},
    }.items()
    for integrator in ("RK4", "Euler")
}
REPETITIONS = 3
PEER, MODEL = "InvertedPendulum-v5", Path(__file__).parents[1] / "models" / "cartpole.xml"


def our_model() -> str:
    """Return the cart-pole's MJCF with the steps and the range of actions of `PEER`."""
    spec = mujoco.MjSpec.from_file(str(MODEL))
    spec.option.timestep, spec.option.integrator = 0.02, mujoco.mjtIntegrator.mjINT_RK4
    for motor in spec.actuators:
        motor.ctrllimited, motor.ctrlrange = True, (-3.0, 3.0)
    spec.compile()
    return str(spec.to_xml())


def rate_of_one(environment: gymnasium.Env, seconds: float) -> float:
    """Return the steps per second of one environment, resets included."""
    rng = np.random.default_rng(1)
    shape, high = environment.action_space.shape, float(environment.action_space.high[0])
    environment.reset(seed=1)
    count, begun = 0, time.perf_counter()
    while time.perf_counter() - begun < seconds:
        _, _, terminated, truncated, _ = environment.step(rng.uniform(-high, high, shape))
        count += 1
        if terminated or truncated:
            environment.reset()
    return count / (time.perf_counter() - begun)


def rate_of_many(environments: gymnasium.vector.VectorEnv, seconds: float) -> float:
    """Return the steps per second of all environments combined, resets included."""
    rng = np.random.default_rng(1)
    environments.reset(seed=1)
    count, begun = 0, time.perf_counter()
    while time.perf_counter() - begun < seconds:
        environments.step(rng.uniform(-0.1, 0.1, environments.action_space.shape))
        count += environments.num_envs
    return count / (time.perf_counter() - begun)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument("--seconds", type=float, default=5.0)
    arguments = parser.parse_args()
    rates: dict[str, Callable[[float], float]] = {}
    for kind, settings in KINDS.items():
        one = CartPoleEnv(**settings)
        many = CartPoleVectorEnv(arguments.envs, **settings)
        sync = SyncVectorEnv([lambda s=settings: CartPoleEnv(**s) for _ in range(arguments.envs)])
        for name, measure, what in (
            ("one", rate_of_one, one),
            ("CartPoleVectorEnv", rate_of_many, many),
            ("SyncVectorEnv", rate_of_many, sync),
        ):
            rates[f"{kind} {name}"] = partial(measure, what)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cartpole.xml"
        file.write_text(our_model())
        rates[f"{PEER}, our model"] = partial(rate_of_one, gymnasium.make(PEER, xml_file=str(file)))
    rates[PEER] = partial(rate_of_one, gymnasium.make(PEER))
    rates["ours, its steps"] = partial(
        rate_of_one, CartPoleEnv("nominal", timestep=0.02, control_period=0.04)
    )
    found: dict[str, list[float]] = {name: [] for name in rates}
    for _ in range(REPETITIONS):
        for name, measure in rates.items():
            found[name].append(measure(arguments.seconds))
    for name, values in found.items():
        spread = f"{min(values):.0f} to {max(values):.0f}"
        print(f"{name:36s} {statistics.median(values):8.0f} steps/s ({spread})")
    for kind in KINDS:
        ratio = median_ratio(found[f"{kind} CartPoleVectorEnv"], found[f"{kind} SyncVectorEnv"])
        say(f"{kind}: CartPoleVectorEnv / SyncVectorEnv", ratio)
    say(f"our environment / {PEER}", median_ratio(found["ours, its steps"], found[PEER]))
    say(f"{PEER}: our model / its own", median_ratio(found[f"{PEER}, our model"], found[PEER]))


if __name__ == "__main__":
    main()
