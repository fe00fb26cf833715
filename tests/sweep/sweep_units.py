"""Functions that the workers of the tests compute, and programs that run them."""

from __future__ import annotations

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

VICTIM = 4
NAP = 60.0  # [s] no test lasts so long
PATIENCE = 20.0  # [s] for what should take one or two, on a busy machine

PROGRAM = """
import sys
from pathlib import Path
from afl_mujoco.errors import AflMujocoError
from afl_mujoco.sweep.executors import open_executor
from afl_mujoco.sweep.sweep import run_sweep
from sweep_units import slow

if __name__ == "__main__":
    workers, cluster, folder = sys.argv[1:]
    try:
        executor = open_executor(int(workers), cluster or None)
        run_sweep(slow, range(200), executor=executor, store=Path(folder), fingerprint={})
    except KeyboardInterrupt:
        sys.exit(130)
    except AflMujocoError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
"""


def hashed(unit: int) -> dict[str, object]:
    """Floats of all sizes that depend on every bit of the unit."""
    mantissas = struct.unpack("<4q", hashlib.sha256(str(unit).encode()).digest())
    floats = [math.ldexp(m, e) for m, e in zip(mantissas, (-1130, -63, 0, 900), strict=True)]
    return {"unit": unit, "floats": floats, "edges": (-0.0, math.inf, None, "φ"), "ok": True}


def slow(unit: int) -> dict[str, object]:
    time.sleep(0.1)
    return hashed(unit)


def noted(unit: tuple[Path, int]) -> dict[str, object]:
    """Leave a file that tells who computed which unit."""
    folder, index = unit
    (folder / f"{index}-{os.getpid()}-{time.monotonic_ns()}").touch()
    return hashed(index)


def doomed_once(unit: tuple[Path, int]) -> dict[str, object]:
    """Wait to be killed at the first try of one unit."""
    result = noted(unit)
    folder, index = unit
    if index == VICTIM and tries(folder)[VICTIM] == 1:
        time.sleep(NAP)
    return result


def doomed_always(unit: int) -> int:
    """Kill the worker of one unit, and let another be under way meanwhile."""
    time.sleep(0.5 if unit == VICTIM - 1 else 0.02)
    if unit == VICTIM:
        os.kill(os.getpid(), signal.SIGKILL)
    return unit


def refused(unit: tuple[Path, int]) -> dict[str, object]:
    """Fail at one unit when those before it are stored, and be long at those after it."""
    folder, index = unit
    if index == VICTIM:
        awaited(lambda: len(list(folder.parent.glob("store/unit-*.json"))) == VICTIM)
        raise InvalidValueError("unit", "must not be the victim", index)
    if index > VICTIM:
        time.sleep(NAP)
    return noted(unit)


def tries(folder: Path) -> Counter[int]:
    """How many times each unit was begun, from the files of `noted`."""
    return Counter(int(path.name.split("-")[0]) for path in folder.iterdir())


def killer(folder: Path) -> Callable[[int], None]:
    """A `progress` that kills the worker of the victim of `doomed_once`."""

    def kill(finished: int) -> None:
        if finished == VICTIM + 1:  # one after it is finished, so that it has begun
            path = awaited(lambda: next(folder.glob(f"{VICTIM}-*"), None))
            os.kill(int(path.name.split("-")[1]), signal.SIGKILL)

    return kill


def awaited(found: Callable[[], Any]) -> Any:
    """Wait until something is there, and return it."""
    deadline = time.monotonic() + PATIENCE
    while not (value := found()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return value


@contextmanager
def program(folder: Path, workers: int, cluster: str) -> Iterator[subprocess.Popen[str]]:
    """`PROGRAM` in a process group of its own, of which nothing may remain."""
    source = folder / "program.py"
    source.write_text(PROGRAM)
    path = (str(Path(__file__).parent), os.environ.get("PYTHONPATH", ""))
    process = subprocess.Popen(
        [sys.executable, source, str(workers), cluster, folder / "store"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if group_lives(process):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


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
