"""Is it fast enough? Every benchmark of speed, one after the other, and a table of what holds.

Run: python -m benchmarks [rollout montecarlo gymnasium render batch optimisers commands]

Each is a file that asks one question and can be run by itself; they are ratios measured in one run,
but for the commands, which are seconds.
"""

from __future__ import annotations

import subprocess
import sys

from benchmarks.ratios import LINE

QUESTIONS = {
    "rollout": ["benchmarks/bench_rollout.py"],
    "montecarlo": ["benchmarks/bench_montecarlo.py"],
    "gymnasium": ["benchmarks/bench_gymnasium.py"],
    "render": ["benchmarks/bench_render.py"],
    "batch": ["benchmarks/bench_batch.py"],
    "optimisers": ["-m", "research.optimisers", "--out", "renders/bench"],
    "commands": ["benchmarks/bench_commands.py"],
}


def main(asked: list[str]) -> int:
    """Run the benchmarks, print what they print, and then the table."""
    if unknown := [name for name in asked if name not in QUESTIONS]:
        print(f"benchmark: must be one of {', '.join(QUESTIONS)}, got {unknown[0]!r}")
        return 2
    rows, failed = [], []
    for name in asked or QUESTIONS:
        print(f"\n== {name}", flush=True)
        run = subprocess.Popen(
            [sys.executable, *QUESTIONS[name]], stdout=subprocess.PIPE, text=True
        )
        assert run.stdout is not None
        for line in run.stdout:
            print(line, end="", flush=True)
            if found := LINE.match(line):
                rows.append((name, found.groups()))
        if run.wait():
            failed.append(name)
    print(f"\n{'benchmark':<12} {'measured':<74} {'value':>7}  {'aim':<16} holds")
    for name, (what, value, aim, holds) in rows:
        print(f"{name:<12} {what:<74} {value:>7}  {aim:<16} {holds}")
    for name in failed:
        print(f"{name:<12} did not run to its end")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
