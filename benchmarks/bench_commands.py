"""How long does a user wait for the commands of the README?

Times whole commands, in wall time and in CPU seconds of all their processes, medians of several
runs. The first run after set-up is the one that compiles: it starts with an empty code cache.

    python benchmarks/bench_commands.py [--repeats 3] [--only validate simulate] [--root CLONE]

`--root` times another clone of the repository whose environment is set up, to compare two versions
in one session.
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

PROGRAM = ".venv/bin/afl-mujoco"
COMMANDS = {
    "help": [PROGRAM, "--help"],
    "refused": [PROGRAM, "simulate", "nominal", "--controller", "adptive"],
    "simulate": [PROGRAM, "simulate", "nominal"],
    "validate": [PROGRAM, "validate"],
    "validate-first": [PROGRAM, "validate"],
    "test": ["make", "--no-print-directory", "test"],
}
FRESH = ("validate-first",)
ONCE = ("validate-first", "test")
EXIT_CODES = {"refused": 2}


def seconds(command: list[str], root: Path, expected: int, fresh: bool) -> tuple[float, float]:
    """Return the wall time and the CPU time of a command [s]."""
    with tempfile.TemporaryDirectory() as folder:
        environment = dict(os.environ)
        if fresh:
            environment["NUMBA_CACHE_DIR"] = folder
        arguments = list(command)
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
    print(f"{'command':<16} {'clock s':>8} {'CPU s':>8}  (medians; runs)")
    for name in options.only:
        expected, fresh = EXIT_CODES.get(name, 0), name in FRESH
        if not fresh and name != "test":  # what is measured is a warm run
            seconds(COMMANDS[name], options.root, expected, fresh)
        runs = 1 if name in ONCE else options.repeats
        taken = [seconds(COMMANDS[name], options.root, expected, fresh) for _ in range(runs)]
        clock, cpu = (statistics.median(column) for column in zip(*taken, strict=True))
        print(f"{name:<16} {clock:8.2f} {cpu:8.2f}  ({runs})", flush=True)


if __name__ == "__main__":
    main()
