"""Does `identify` find the true values? Coverage of its intervals on simulated cart-poles.

    .venv/bin/python -m benchmarks.bench_identification --rigs 20 --dry 10 --logs 10

Logs come from MuJoCo stepped at 1 ms by itself, with encoders of 4096 counts and 0.1 mm, noise,
delay, skew and scattering time stamps; then from rigs with exact dry friction, integrated by SciPy
from event to event without MuJoCo or this package, and read by finer sensors. Printed: how many of
the intervals of 95 % hold the truth.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterable, Mapping

import numpy as np

from afl_mujoco.identification.identify import Identified, identify
from afl_mujoco.identification.log import log_of
from tests.coulomb_rig import CoulombRig, description_of
from tests.synthetic_logs import STEP, Truth, swing


def random_truth(seed: int) -> Truth:
    u = np.random.default_rng(seed).uniform
    return Truth(
        cart_mass=u(0.3, 1.5), half_length=u(0.12, 0.35), pole_mass=u(0.05, 0.2),
        force=u(6.0, 14.0), rail_damping=u(2.0, 8.0), hinge_damping=u(1e-4, 6e-4),
        delay=STEP * round(u(2.0, 15.0)), skew=u(-0.005, 0.005), offset=u(-0.02, 0.02),
    )  # fmt: skip


def random_rig(seed):
    u = np.random.default_rng(seed).uniform
    return CoulombRig(
        cart_mass=u(0.3, 1.5), half_length=u(0.12, 0.35), pole_mass=u(0.05, 0.2),
        force=u(8.0, 14.0), friction=u(0.2, 2.0), rail_damping=u(2.0, 8.0),
        hinge_damping=u(1e-4, 6e-4), delay=u(0.002, 0.015),
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=20)
    parser.add_argument("--dry", type=int, default=10)
    parser.add_argument("--logs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=4.0)
    given = parser.parse_args()
    workers = os.cpu_count() or 1

    def simulated() -> Iterable[tuple[Identified, Mapping[str, float]]]:
        for seed in range(given.rigs):
            truth = random_truth(seed)
            columns = [swing(truth, 1000 * seed + i, given.seconds) for i in range(given.logs)]
            logs = [log_of(f"log-{i}", one, truth.description) for i, one in enumerate(columns)]
            yield identify(logs, truth.description, workers=workers), truth.expected

    def dry() -> Iterable[tuple[Identified, Mapping[str, float]]]:
        for seed in range(given.dry):
            rig = random_rig(seed)
            columns = [rig.log(1000 * seed + i, given.seconds) for i in range(given.logs)]
            logs = [log_of(f"log-{i}", c, description_of(rig)) for i, c in enumerate(columns)]
            yield identify(logs, description_of(rig), workers=workers), rig.physical

    report(f"{given.rigs} cart-poles by MuJoCo", given, simulated())
    report(f"{given.dry} cart-poles with dry friction by SciPy", given, dry())


def report(
    title: str, given: argparse.Namespace, found: Iterable[tuple[Identified, Mapping[str, float]]]
) -> None:
    """Print how many intervals hold the truth."""
    held: dict[str, list[bool]] = {}
    off: dict[str, list[float]] = {}
    started = time.perf_counter()
    for identified, truth in found:
        for name, true in truth.items():
            one = identified.find(name)
            held.setdefault(name, []).append(one.low <= true <= one.high)
            off.setdefault(name, []).append(abs(one.value - true) / max(abs(true), 1e-9))
    taken = time.perf_counter() - started
    print(f"{title}, {given.logs} logs of {given.seconds:g} s each, {taken:.0f} s")
    print(f"{'parameter':14} {'covered':>9} {'median error':>13}")
    for name, flags in held.items():
        median = sorted(off[name])[len(flags) // 2]
        print(f"{name:14} {sum(flags):4d} of {len(flags):2d} {100.0 * median:11.2f} %")
    total = [flag for flags in held.values() for flag in flags]
    share = 100.0 * sum(total) / max(1, len(total))
    print(f"{'all':14} {sum(total):4d} of {len(total)}, {share:.1f} %")


if __name__ == "__main__":
    main()
