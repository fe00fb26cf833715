"""C12: does the multiple-crossover genetic algorithm find the optimum? From shipped results."""

from __future__ import annotations

from typing import Any

from afl_mujoco.control.gain_function import shipped_data
from afl_mujoco.studies.verification.claims.claim import Claim, verdict

TARGET = 1e-3
"""Relative excess over the optimum up to which a cost counts as having found it."""


def search_claim() -> Claim:
    """Judge C12 by the benchmark of optimisers that comes with the package."""
    contest = shipped_data("optimisers.json")
    target = contest["targets"].index(TARGET)
    paper, *others = contest["optimisers"]
    found = _successes(contest, paper, target)
    runs = contest["runs"] * len(contest["problems"])
    times = {name: _time(contest, name, target) for name in (paper, *others)}
    quickest = min(times, key=lambda name: times[name])
    return Claim(
        id="C12",
        claim="the multiple-crossover genetic algorithm finds the optimum",
        figure=f"runs that come within {100 * TARGET:g} % of the optimal objective [%]",
        paper=100.0,
        here=100.0 * found / runs,
        verdict=verdict(found / runs, enough=0.99),
        why=f"{found} of {runs} runs with a population of 1000, {len(contest['problems'])} plants, "
        f"at most {contest['budget']} evaluations each; its expected running time is "
        f"{times[paper]:.3g} evaluations, the quickest is {quickest} with {times[quickest]:.3g}; "
        "the optima lie on the box's bounds of K and Phi (D8), where clipping helps it",
    )


def _successes(contest: dict[str, Any], name: str, target: int) -> int:
    """Return how many runs of an optimiser reach a target, over all problems."""
    return sum(
        scores["successes"][target]
        for scores in contest["summary"][name].values()
        if "successes" in scores
    )


def _time(contest: dict[str, Any], name: str, target: int) -> float:
    """Return the mean over the problems of the expected running time to a target."""
    times = [
        scores["expected_running_time"][target]
        for scores in contest["summary"][name].values()
        if "successes" in scores
    ]
    return float("inf") if None in times else sum(times) / len(times)
