"""Whether a run meets its requirements, and by what margin."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.scenario.requirements import asked_of, calm, recoveries
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.metrics import effort_names
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory

DWELL = 1.0  # how long a run must stay settled, up to its end, to count as settled [s]


@dataclass(frozen=True, slots=True)
class Judgement:
    """One requirement, and how a run meets it."""

    requirement: str  # one of `asked_of` of the plant
    limit: float
    value: float | None  # None if the run ended too early to decide, or never settles
    margin: float | None  # robustness as in signal temporal logic, as a share of the limit
    graded: float | None = None  # for a search: the margin had it settled at the last instant
    limited: float = 0.0  # of the exerted force: share of the time with the drive at its limit

    @property
    def met(self) -> bool:
        """Whether the run shows that the requirement is met."""
        return self.margin is not None and self.margin >= 0.0


CONTROLLER_FAILED = "controller failed"
"""Ending of a run whose controller raises, takes too long or does not return a force."""


def failure_of(ending: str, requirements: Sequence[Judgement]) -> str:
    """Return how a run failed, the one definition of it; empty if it meets every requirement.

    A run that ended early is named by how it ended, any other by the requirement with the least
    margin, of which it has none where it never settles.
    """
    missed = [one for one in requirements if not one.met]
    if ending == CONTROLLER_FAILED or (missed and ending != COMPLETED):
        return ending
    if not missed:
        return ""
    return min(missed, key=_margin).requirement


def least_margin(requirements: Iterable[Judgement]) -> float | None:
    """Return the least margin of a run over what is measured; None where one has none."""
    margins = [one.margin for one in requirements if one.requirement != "completes"]
    return min((x for x in margins if x is not None), default=None) if None not in margins else None


def _margin(one: Judgement) -> float:
    return -math.inf if one.margin is None else one.margin


def judge(scenario: Scenario, run: Trajectory) -> tuple[Judgement, ...]:
    """Judge a run by the requirements of its scenario, in the order of `asked_of`."""
    required, completed = scenario.required, run.outcome.kind == COMPLETED
    found = []
    if "completes" in required:
        duration = scenario.duration
        reached = duration if completed else run.outcome.time
        left = (reached - duration) / duration
        margin = left if completed or left < 0.0 else None  # it may fall at the very end
        found.append(Judgement("completes", duration, reached, margin))
    if "end_stops" in required:
        peaks = np.abs(run.state).max(axis=0).tolist()
        of, stops = (
            dict(zip(run.layout.states, peaks, strict=True)),
            scenario.imperfections.end_stops,
        )
        judged = [_peak("end_stops", stop, of[name], completed) for name, stop in stops.items()]
        found.append(min(judged, key=_margin))
    return (*found, *_judgements(scenario, run))


def judge_failure(scenario: Scenario) -> tuple[Judgement, ...]:
    """Judge a run whose controller failed: it misses every requirement, and completing."""
    limits = {"completes": scenario.duration, **scenario.required}
    return tuple(Judgement(name, limit, None, None) for name, limit in limits.items())


def _judgements(scenario: Scenario, run: Trajectory) -> Iterator[Judgement]:
    asked, completed = scenario.requirements, run.outcome.kind == COMPLETED
    metrics = run.metrics if asked.max else {}
    known = asked_of(scenario.plant) if asked.max else {}
    inputs = scenario.plant.inputs
    for name, limit in asked.max.items():
        share = metrics[effort_names(inputs, name)[-1]] if name in inputs else 0.0
        peak = metrics[known[f"max.{name}"].metric]
        yield replace(_peak(f"max.{name}", limit, peak, completed), limited=share or 0.0)
    states = dict(zip(scenario.plant.states, run.state.T, strict=True))
    for name, limit in asked.min.items():
        least = float((run.signals[name] if name in run.signals else states[name]).min())
        yield _least(f"min.{name}", limit, least, completed)
    outside = _outside(scenario, run)
    if asked.settling_time is not None:
        first = [(0.0, calm(scenario.duration, scenario.disturbances))]
        yield _rest("settling_time", asked.settling_time, run, outside, first)
    if asked.recover_within is not None:
        after = recoveries(scenario.duration, scenario.disturbances)
        yield _rest("recover_within", asked.recover_within, run, outside, after)


def _outside(scenario: Scenario, run: Trajectory) -> NDArray[np.bool_]:
    names = scenario.plant.coordinates
    bands = np.array([scenario.band(name) for name in names])
    return np.asarray((np.abs(run.away[:, : len(names)]) > bands).any(axis=1))


def settling_time(scenario: Scenario, run: Trajectory) -> float | None:
    """Return from when a run stayed within the bands of rest, `DWELL` before its end or earlier."""
    outside = np.flatnonzero(_outside(scenario, run))
    settled = int(outside[-1]) + 1 if len(outside) else 0
    if run.outcome.kind != COMPLETED or settled == len(run.time):
        return None
    dwelled = run.time[-1] - run.time[settled] >= DWELL - 1e-9
    return float(run.time[settled]) if dwelled else None


def _peak(name: str, limit: float, value: float | None, completed: bool) -> Judgement:
    """Judge the largest absolute value of a signal; a run cut short can only break the limit."""
    if value is None or (not completed and value <= limit):
        return Judgement(name, limit, value, None)
    return Judgement(name, limit, value, (limit - value) / limit)


def _least(name: str, limit: float, value: float, completed: bool) -> Judgement:
    """Judge the least value of a signal; a run cut short can only break the limit."""
    unknown = not completed and value >= limit
    return Judgement(name, limit, value, None if unknown else (value - limit) / (abs(limit) or 1.0))


def _rest(name: str, limit: float, run: Trajectory, outside: Any, windows: Any) -> Judgement:
    """Judge the longest time, over some windows, until the state stays within its bands."""
    time, slowest, ever = run.time, 0.0, True
    for begin, end in windows:
        last = np.flatnonzero(outside & (time >= begin) & (time <= end))
        rest = end
        if run.outcome.kind == COMPLETED or run.outcome.time > end:
            rest = begin
            if len(last):
                rest = time[last[-1] + 1] if last[-1] + 1 < len(time) else end
        lasted = round(float(min(rest, end)) - begin, 9)  # a nanosecond is less than any step
        slowest, ever = max(slowest, lasted), ever and bool(rest < end)
    margin = (limit - slowest) / limit
    if ever:
        return Judgement(name, limit, slowest, margin)
    return Judgement(name, limit, None, None, graded=margin)
