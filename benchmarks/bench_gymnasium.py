"""How many steps per second do the Gymnasium environments make? All timed in one run.

``python benchmarks/bench_gymnasium.py [--envs 32] [--seconds 5]``: one environment, Gymnasium's own
``InvertedPendulum-v5`` where it can be made (it needs imageio), and many environments by
`CartPoleVectorEnv` and by Gymnasium's `SyncVectorEnv`: step-step, and everything drawn at random.
Actions are the same random ones, under which the pole soon falls: resets count. The parts are
measured in turn, three times; the ratio of the medians is printed.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import SyncVectorEnv

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
    rates: dict[str, Callable[[], float]] = {}
    for kind, settings in KINDS.items():
        one = CartPoleEnv(**settings)
        many = CartPoleVectorEnv(arguments.envs, **settings)
        sync = SyncVectorEnv([lambda s=settings: CartPoleEnv(**s) for _ in range(arguments.envs)])
        for name, measure, what in (
            ("one", rate_of_one, one),
            ("CartPoleVectorEnv", rate_of_many, many),
            ("SyncVectorEnv", rate_of_many, sync),
        ):
            rates[f"{kind} {name}"] = lambda m=measure, w=what: m(w, arguments.seconds)
    try:
        theirs = gymnasium.make("InvertedPendulum-v5")
        rates["InvertedPendulum-v5"] = lambda: rate_of_one(theirs, arguments.seconds)
    except ImportError as error:
        print(f"InvertedPendulum-v5 cannot be made: {error}")
    found: dict[str, list[float]] = {name: [] for name in rates}
    for _ in range(REPETITIONS):
        for name, measure in rates.items():
            found[name].append(measure())
    medians = {name: statistics.median(values) for name, values in found.items()}
    for name, median in medians.items():
        spread = f"{min(found[name]):.0f} to {max(found[name]):.0f}"
        print(f"{name:32s} {median:8.0f} steps/s ({spread})")
    for kind in KINDS:
        ratio = medians[f"{kind} CartPoleVectorEnv"] / medians[f"{kind} SyncVectorEnv"]
        print(f"{kind}: CartPoleVectorEnv is {ratio:.2f} times SyncVectorEnv")


if __name__ == "__main__":
    main()
