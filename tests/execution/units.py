"""Functions that the workers of the tests compute, and a program that runs them."""

import hashlib
import math
import os
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from afl_mujoco.errors import InvalidValueError

ROOT = Path(__file__).parents[2]
COUNT = 12
VICTIM = 4
PATIENCE = 30.0  # [s] for what should take one or two, on a busy machine

PROGRAM = """
import sys
from pathlib import Path
from afl_mujoco.errors import AflMujocoError
from afl_mujoco.pool import compute_all, open_executor
from tests.execution.units import slow

if __name__ == "__main__":
    workers, cluster, file = sys.argv[1:]
    try:
        with open_executor(int(workers), cluster or None) as executor:
            with open(file, "w", buffering=1) as done:
                compute_all(slow, range(200), executor, lambda i: print(i, file=done))
    except KeyboardInterrupt:
        sys.exit(130)
    except AflMujocoError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
"""


def hashed(unit: int) -> list[object]:
    """Floats of all sizes that depend on every bit of the unit."""
    mantissas = struct.unpack("<4q", hashlib.sha256(str(unit).encode()).digest())
    floats = [math.ldexp(m, e) for m, e in zip(mantissas, (-1130, -63, 0, 900), strict=True)]
    return [unit, *floats, -0.0, None, "φ"]


SERIAL = [hashed(index) for index in range(COUNT)]


def slow(unit: int) -> list[object]:
    time.sleep(0.1)
    return hashed(unit)


def noted(unit: tuple[Path, int]) -> list[object]:
    """Leave a file that says which process computed which unit."""
    folder, index = unit
    (folder / f"{index}-{os.getpid()}-{time.monotonic_ns()}").touch()
    return hashed(index)


def doomed_always(unit: int, dies: bool = True) -> int:
    if unit == VICTIM and dies:
        os.kill(os.getpid(), signal.SIGKILL)
    return unit


def doomed_once(unit: tuple[Path, int]) -> list[object]:
    """Kill the worker at the first try of one unit."""
    result, (folder, index) = noted(unit), unit
    doomed_always(index, tries(folder)[VICTIM] == 1)
    return result


def refused(unit: tuple[Path, int]) -> list[object]:
    """Fail at one unit, and be long at those after it."""
    folder, index = unit
    if index == VICTIM:
        awaited(lambda: len(tries(folder)) >= VICTIM)
        raise InvalidValueError("unit", "must not be the victim", index)
    if index > VICTIM:
        time.sleep(60.0)  # no test lasts so long
    return noted(unit)


def tries(folder: Path) -> Counter[int]:
    return Counter(int(path.name.split("-")[0]) for path in folder.iterdir())


def kept(file: Path) -> set[int]:
    """Indices of the units that `PROGRAM` has told to be done."""
    return {int(line) for line in file.read_text().splitlines()} if file.exists() else set()


def awaited(found: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + PATIENCE
    while not (value := found()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return value


@contextmanager
def program(folder: Path, workers: int, cluster: str = "") -> Iterator[subprocess.Popen[str]]:
    """`PROGRAM` in a process group of its own, of which nothing may remain."""
    source = folder / "program.py"
    source.write_text(PROGRAM)
    process = subprocess.Popen(
        [sys.executable, source, str(workers), cluster, folder / "done"],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        if group_lives(process):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def interrupt(process: subprocess.Popen[str]) -> None:
    """Press Ctrl-C: the group must end, and say nothing."""
    os.killpg(process.pid, signal.SIGINT)
    said, _ = process.communicate(timeout=PATIENCE)
    assert (process.returncode, said) == (130, "")
    awaited(lambda: not group_lives(process))


def group_lives(process: subprocess.Popen[str]) -> bool:
    """Whether a process of the group is left that has not ended."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, group = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(group) == process.pid and state not in "ZX":
            return True
    return False
