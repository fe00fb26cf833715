"""Does the paper's genetic algorithm find the optimal gains, and which search is the fastest?

Run: python benchmarks/bench_optimisers.py [--runs 51] [--budget 100000] [--seed 0] [--workers 2]
     [--out DIR]

Every optimiser searches the same box on the same plants, from a seed of its own in each run, until
it comes within the last target of the optimal cost or has spent its budget of evaluations. With
--out, DIR receives the result, optimisers.json, and the figure optimisers.png. The default settings
take some minutes on two cores; the result does not depend on the number of workers.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

from optimisers.figure import draw_benchmark
from optimisers.result import Benchmark, Result, save_result
from optimisers.runs import run_benchmark

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.files import output_folder
from afl_mujoco.report.style import save_figure

WIDTH = 34


def count(evaluations: float) -> str:
    """Return evaluations with at least three digits, or a dash for infinitely many."""
    return f"{evaluations:,.0f}" if math.isfinite(evaluations) else "-"


def print_problems(result: Result) -> None:
    """Print the optimum of each problem, and the evaluations of each optimiser."""
    benchmark = result.benchmark
    for p, (problem, optimum) in enumerate(zip(benchmark.problems, result.optima, strict=True)):
        gains = ", ".join(f"{gain:.4f}" for gain in optimum.gains)
        moved = abs(optimum.cost / optimum.tight_cost - 1.0)
        print(f"\n{problem.label}: optimal cost {optimum.cost:.7f} at (K, λ, Φ) = ({gains});")
        print(f"a tighter tolerance moves it by {moved:.1e}, relatively")
        print("   expected evaluations to the target [runs that reached it]")
        print(f"  {'':<{WIDTH}}" + "".join(f"{f'1 + {t:g}':>15}" for t in benchmark.targets))
        for a, name in enumerate(benchmark.optimisers):
            cells = zip(result.expected_running_times[a, p], result.successes[a, p], strict=True)
            row = "".join(f"{f'{count(ert)} [{reached}]':>15}" for ert, reached in cells)
            print(f"  {name:<{WIDTH}}{row}")


def print_effects(result: Result) -> None:
    """Print the probability that a run of each optimiser is faster than one of the first."""
    benchmark = result.benchmark
    first, *others = benchmark.optimisers
    if not others:
        return
    print(f"\nA12: probability that a run is faster than one of {first}")
    print("   mean over the plants [95 % interval]")
    print(f"  {'':<{WIDTH}}" + "".join(f"{f'1 + {t:g}':>19}" for t in benchmark.targets))
    for name in others:
        effects = [result.effect(name, target) for target in benchmark.targets]
        row = "".join(f"{f'{e.a12:.2f} [{e.low:.2f}, {e.high:.2f}]':>19}" for e in effects)
        print(f"  {name:<{WIDTH}}{row}")
    last = benchmark.targets[-1]
    print(f"   to 1 + {last:g} on each plant [95 % interval], p of Mann and Whitney's test")
    for name in others:
        print(f"  {name}")
        for problem in benchmark.problems:
            e = result.effect(name, last, problem)
            row = f"{e.a12:.2f} [{e.low:.2f}, {e.high:.2f}]   p = {e.p_value:.1e}"
            print(f"    {problem.label:<{WIDTH - 2}}{row}")


def show_progress(finished: int, of: int) -> None:
    """Rewrite one line of a terminal."""
    if sys.stderr.isatty():
        print(f"\r{finished} of {of} runs", end="\n" if finished == of else "", file=sys.stderr)


def main() -> None:
    """Run the benchmark, print its tables and write its files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=Benchmark().runs)
    parser.add_argument("--budget", type=int, default=Benchmark().budget)
    parser.add_argument("--seed", type=int, default=Benchmark().seed)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    try:
        benchmark = Benchmark(runs=options.runs, budget=options.budget, seed=options.seed)
        folder = options.out and output_folder(options.out)
        result = run_benchmark(benchmark, workers=options.workers, progress=show_progress)
        print_problems(result)
        print_effects(result)
        if folder:
            write(result, folder)
    except AflMujocoError as error:
        parser.exit(2, f"error: {error}\n")


def write(result: Result, folder: Path) -> None:
    """Write the result and its figure into a folder."""
    save_result(result, folder / "optimisers.json")
    save_figure(draw_benchmark(result), folder / "optimisers.png")
    print(f"\nwrote optimisers.json and optimisers.png to {folder}")


if __name__ == "__main__":
    main()
