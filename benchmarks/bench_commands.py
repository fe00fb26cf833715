"""How long does a user wait for the commands of the README?

Times whole commands, in wall time and in CPU seconds of all their processes, medians of several
runs. The first run after set-up is the one that compiles: it starts with an empty code cache.

Run: python benchmarks/bench_commands.py [--repeats 3] [--only validate simulate] [--root CLONE]

`--root` times another clone of the repository whose environment is set up, to compare two versions
in one session. From nothing: set-up on a clone of what is committed, and the command.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from ratios import say

PROGRAM = ".venv/bin/afl-mujoco"
EXAMPLES = "examples"
THREE = ["--controllers", "lqr", "adaptive", "fixed", "--draws", "1"]
COMMANDS = {
    "help": [PROGRAM, "--help"],
    "refused": [PROGRAM, "simulate", "nominal", "--controller", "adptive"],
    "simulate": [PROGRAM, "simulate", "nominal"],
    "compare": [PROGRAM, "compare", f"{EXAMPLES}/rig.toml", *THREE],
    "check": [PROGRAM, "check", f"{EXAMPLES}/quadrotor_load.py:plant"],
    "check-first": [PROGRAM, "check", f"{EXAMPLES}/quadrotor_load.py:plant"],
    "validate": [PROGRAM, "validate"],
    "validate-first": [PROGRAM, "validate"],
    "validate-from-nothing": ["make", "--no-print-directory", "validate"],
    "test": ["make", "--no-print-directory", "test"],
    "test-from-nothing": ["make", "--no-print-directory", "test"],
}
AIMS = {  # s
    "help": 0.25, "refused": 0.35, "simulate": 1.5, "compare": 2.0, "check": 2.0,
    "check-first": 8.0, "validate": 10.0, "validate-from-nothing": 45.0, "test": 90.0,
    "test-from-nothing": 110.0,
}  # fmt: skip
FRESH = ("validate-first", "check-first")
ONCE = ("validate-first", "validate-from-nothing", "test", "test-from-nothing")
EXIT_CODES = {"refused": 2, "compare": 1}  # adaptive does not recover in time on the rig


def seconds(
    command: list[str], root: Path, expected: int, *, fresh: bool, nothing: bool
) -> tuple[float, float]:
    """Return the wall time and the CPU time of a command [s]."""
    with tempfile.TemporaryDirectory() as folder:
        environment = dict(os.environ)
        if fresh:
            environment["NUMBA_CACHE_DIR"] = folder
        arguments = list(command)
        if nothing:
            subprocess.run(["git", "clone", "--quiet", root, f"{folder}/clone"], check=True)
            root = Path(folder) / "clone"
        if command[0] == PROGRAM and "--help" not in command:
            arguments += ["--out", f"{folder}/out"]
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(
            arguments, cwd=root, env=environment, capture_output=True, text=True, check=False
        )
        clock = time.perf_counter() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != expected:
        sys.exit(f"{' '.join(arguments)}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return clock, cpu


def main() -> None:
    """Time the commands and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", nargs="+", choices=list(COMMANDS), default=list(COMMANDS))
    parser.add_argument("--root", type=Path, default=Path(__file__).parent.parent)
    options = parser.parse_args()
    for name in options.only:
        how = {"fresh": name in FRESH, "nothing": name.endswith("from-nothing")}
        expected = EXIT_CODES.get(name, 0)
        if name not in FRESH + ONCE:  # what is measured is a warm run
            seconds(COMMANDS[name], options.root, expected, **how)
        runs = 1 if name in ONCE else options.repeats
        taken = [seconds(COMMANDS[name], options.root, expected, **how) for _ in range(runs)]
        clock, cpu = (statistics.median(column) for column in zip(*taken, strict=True))
        print(f"{name}: {clock:.2f} s, {cpu:.2f} s of CPU, median of {runs}", flush=True)
        if name in AIMS:
            say(f"{name} [s]", clock, most=AIMS[name])


if __name__ == "__main__":
    main()
