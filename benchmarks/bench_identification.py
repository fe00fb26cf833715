"""Does `identify` find the true values? Coverage of its intervals on simulated cart-poles.

    .venv/bin/python -m benchmarks.bench_identification --rigs 20 --logs 10

Logs come from MuJoCo stepped at 1 ms by itself, with encoders of 4096 counts and 0.1 mm, noise,
delay, skew and scattering time stamps. Printed: how many of the intervals of 95 % hold the truth.
"""

from __future__ import annotations

import argparse
import os
import time

from afl_mujoco.identification.identify import identify
from afl_mujoco.identification.log import log_of
from tests.synthetic_logs import random_truth, swing


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=20)
    parser.add_argument("--logs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=4.0)
    given = parser.parse_args()
    held: dict[str, list[bool]] = {}
    off: dict[str, list[float]] = {}
    started = time.perf_counter()
    for seed in range(given.rigs):
        truth = random_truth(seed)
        logs = [
            log_of(f"log-{i}", swing(truth, 1000 * seed + i, given.seconds), truth.description)
            for i in range(given.logs)
        ]
        found = identify(logs, truth.description, workers=os.cpu_count() or 1)
        for name, true in truth.expected.items():
            one = found.find(name)
            held.setdefault(name, []).append(one.low <= true <= one.high)
            off.setdefault(name, []).append(abs(one.value - true) / max(abs(true), 1e-9))
    taken = time.perf_counter() - started
    print(f"{given.rigs} cart-poles, {given.logs} logs of {given.seconds:g} s each, {taken:.0f} s")
    print(f"{'parameter':14} {'covered':>9} {'median error':>13}")
    for name, flags in held.items():
        median = sorted(off[name])[len(flags) // 2]
        print(f"{name:14} {sum(flags):4d} of {len(flags):2d} {100.0 * median:11.2f} %")
    total = [flag for flags in held.values() for flag in flags]
    print(f"{'all':14} {sum(total):4d} of {len(total)}, {100.0 * sum(total) / len(total):.1f} %")


if __name__ == "__main__":
    main()
