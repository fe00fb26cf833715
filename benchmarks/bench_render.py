"""How fast are films made? Seconds of film per second of work, of one run and side by side.

Run: python benchmarks/bench_render.py [--size 640x480] [--workers 2]

The runs that are filmed are simulated again each time, as `afl-mujoco render` does.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from afl_mujoco.graphics import require_backend

BACKEND = require_backend()  # before anything imports mujoco

from ratios import say  # noqa: E402

import afl_mujoco as afl  # noqa: E402
from afl_mujoco.films.video import make_films, plan  # noqa: E402

AIMS = {"one run": 2.5, "side by side": 1.0, "four films": 2.5}
CONTROLLERS = [afl.CONTROLLERS[name] for name in ("fixed", "adaptive")]


def main() -> None:
    """Make a film of one run and one side by side in this process, then four on processes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    cases = ("step-step", "step-trapezoid", "trapezoid-step", "trapezoid-trapezoid")
    scenarios = [afl.SCENARIOS[name] for name in cases]
    films = plan(scenarios, CONTROLLERS, size=(width, height), fps=30)
    print(f"{BACKEND}, {width}x{height}, 30 frames per second")
    report("one run", films[:1], 1)
    report("side by side", films[2:3], 1)
    singles = [film for film in films if len(film.controllers) == 1]
    report("four films", singles[:4], options.workers)


def report(what: str, films: list, workers: int) -> None:
    """Make films and print how fast."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        make_films(films, Path(folder), workers=workers)
        wall = time.perf_counter() - start
    duration = sum(film.length / film.fps for film in films)
    processes = f"{workers} process{'es' * (workers > 1)}"
    print(f"  {what:<16} {processes}: {duration:5.1f} s of film in {wall:5.1f} s")
    say(f"{what}: seconds of film per second", duration / wall, least=AIMS[what])


if __name__ == "__main__":
    main()
