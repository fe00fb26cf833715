"""Whether a run meets its requirements, and by what margin."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.feedback import upright_model
from afl_mujoco.errors import UnknownNameError
from afl_mujoco.scenario.parameters import INPUTS, CartPoleParameters
from afl_mujoco.scenario.requirements import REQUIREMENTS, calm, recoveries
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    DIVERGED,
    FALL_ANGLE,
    STATE_LIMIT,
    Outcome,
    Trajectory,
)

DWELL = 1.0
"""How long a run must stay settled, up to its end, to count as settled [s]."""

LONGEST = 50.0
"""Half-length that nobody means [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """One requirement, and how a run meets it."""

    requirement: str  # a key of REQUIREMENTS
    limit: float
    value: float | None  # None if the run ended too early to decide, or never settles
    margin: float | None  # robustness as in signal temporal logic, as a share of the limit
    graded: float | None = None  # for a search: the margin had it settled at the last instant
    limited: float = 0.0  # of the exerted force: share of the time with the drive at its limit

    def __post_init__(self) -> None:
        """Raise unless there is such a requirement."""
        if self.requirement not in REQUIREMENTS:
            raise UnknownNameError.among("requirement", self.requirement, REQUIREMENTS)

    @property
    def met(self) -> bool:
        """Whether the run shows that the requirement is met."""
        return self.margin is not None and self.margin >= 0.0

    @property
    def unit(self) -> str:
        """Unit of limit and value."""
        return REQUIREMENTS[self.requirement].unit


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
    """Return a margin to compare with others."""
    return -math.inf if one.margin is None else one.margin


def judge(scenario: Scenario, run: Trajectory) -> tuple[Judgement, ...]:
    """Judge a run by the requirements of its scenario, in the order of `REQUIREMENTS`."""
    peak = float(np.abs(run.state[:, 0]).max())
    return (*judge_ending(scenario, run.outcome, peak), *_judgements(scenario, run))


def judge_ending(scenario: Scenario, outcome: Outcome, peak: float) -> tuple[Judgement, ...]:
    """Judge a run by what needs no record of it: whether it completes and spares the end stops.

    peak: Its largest abs(z) [m].
    """
    required, completed = scenario.required, outcome.kind == COMPLETED
    found = []
    if "completes" in required:
        reached = scenario.duration if completed else outcome.time
        left = (reached - scenario.duration) / scenario.duration
        found.append(
            Judgement(
                requirement="completes",
                limit=scenario.duration,
                value=reached,
                margin=left if completed or left < 0.0 else None,  # it may fall at the very end
            )
        )
    if "end_stops" in required:
        found.append(_peak("end_stops", required["end_stops"], peak, completed))
    return tuple(found)


def judge_failure(scenario: Scenario) -> tuple[Judgement, ...]:
    """Judge a run without a result, because its controller failed: no requirement is met.

    Completing the run counts as one of them even if the scenario does not require it.
    """
    limits = {"completes": scenario.duration, **scenario.required}
    return tuple(
        Judgement(requirement=name, limit=limit, value=None, margin=None)
        for name, limit in limits.items()
    )


def _judgements(scenario: Scenario, run: Trajectory) -> Iterator[Judgement]:
    """Yield one judgement for each requirement that needs the whole run."""
    asked, completed = scenario.requirements, run.outcome.kind == COMPLETED
    metrics = run.metrics
    for name, limit in asked.max.items():
        share = (metrics["limited_share"] or 0.0) if name in INPUTS else 0.0
        peak = metrics[REQUIREMENTS[f"max.{name}"].metric]
        yield replace(_peak(f"max.{name}", limit, peak, completed), limited=share)
    outside = _outside(scenario, run)
    if asked.settling_time is not None:
        first = [(0.0, calm(scenario.duration, scenario.disturbances))]
        yield _rest("settling_time", asked.settling_time, run, outside, first)
    if asked.recover_within is not None:
        after = recoveries(scenario.duration, scenario.disturbances)
        yield _rest("recover_within", asked.recover_within, run, outside, after)


def _outside(scenario: Scenario, run: Trajectory) -> NDArray[np.bool_]:
    """Return where a run is outside the bands of rest."""
    z, phi = np.abs(run.state[:, :2]).T
    band = scenario.requirements.band
    outside: NDArray[np.bool_] = (z > band("z")) | (phi > band("phi"))
    return outside


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
        return Judgement(requirement=name, limit=limit, value=value, margin=None)
    return Judgement(requirement=name, limit=limit, value=value, margin=(limit - value) / limit)


def _rest(
    name: str,
    limit: float,
    run: Trajectory,
    outside: NDArray[np.bool_],
    windows: list[tuple[float, float]],
) -> Judgement:
    """Judge the longest time, over some windows, until the state stays within its bands."""
    time, slowest, ever = run.time, 0.0, True
    for begin, end in windows:
        last = np.flatnonzero(outside & (time >= begin) & (time <= end))
        rest = end
        if run.outcome.kind == COMPLETED or run.outcome.time > end:
            following = last[-1] + 1 if len(last) else int(np.searchsorted(time, begin))
            rest = time[following] if following < len(time) else end
        lasted = round(float(min(rest, end)) - begin, 9)  # a nanosecond is less than any step
        slowest, ever = max(slowest, lasted), ever and bool(rest < end)
    return Judgement(
        requirement=name,
        limit=limit,
        value=slowest if ever else None,
        margin=(limit - slowest) / limit if ever else None,
        graded=None if ever else (limit - slowest) / limit,
    )


def remarks_on(run: Trajectory, scenario: Scenario, controller: Controller) -> list[str]:
    """Return remarks on a run that no requirement makes, one sentence each."""
    return [
        *controller.remarks(scenario.assumed_plants),
        *controller.estimator_remarks(scenario.parameters_at(0.0), scenario.plants),
        *_unreached(scenario),
        *_without_effect(scenario),
        *unit_remarks(scenario, run.control_period),
        *_ended(run),
        *_stopped(scenario, run),
        *_limited(scenario, run),
        *_refined(run),
        *_nothing_required(scenario),
        *_idle(run),
    ]


def _unreached(scenario: Scenario) -> list[str]:
    """Remark on changes of M or l that come after the end."""
    end, found = scenario.duration, []
    for name, schedule in (("M", scenario.cart_mass), ("l", scenario.half_length)):
        knots = zip(schedule.times, schedule.values, strict=True)
        if late := [time for time, value in knots if time > end and value != schedule.at(end)]:
            found.append(f"{name} changes at {late[-1]:g} s, after the end at {end:g} s")
    return found


def _without_effect(scenario: Scenario) -> list[str]:
    """Remark on noise of what is not measured."""
    own = scenario.imperfections
    return [
        f"{path} has no effect, because velocities are differentiated"
        for path in own.without_effect
        if own.at(path)
    ]


def _stopped(scenario: Scenario, run: Trajectory) -> list[str]:
    """Remark on a cart that hits an end stop."""
    end, most = scenario.rail, scenario.requirements.max.get("z")
    if end is None or not (hits := np.flatnonzero(np.abs(run.state[:, 0]) >= end)).size:
        return []
    short = f", short of max.z, {most:g} m" if most is not None and most > end else ""
    first = run.time[hits[0]]
    return [f"the cart hits the end stop, {end:g} m from the middle, first at {first:.3g} s{short}"]


def _limited(scenario: Scenario, run: Trajectory) -> list[str]:
    """Remark on a drive that cuts the command off."""
    limit, figures = scenario.imperfections.input_limit, run.metrics
    share, most = figures["limited_share"], figures["max_command"]
    if limit is None or not share or most is None:
        return []
    asked = f"asks for up to {most:.3g} N" if most > limit else f"asks for all of {limit:g} N"
    return [
        f"the drive is at its limit for {100.0 * share:.2g} % of the run: the controller {asked}"
    ]


def _refined(run: Trajectory) -> list[str]:
    """Remark on a step that was made finer for the damping."""
    settings = run.provenance.get("settings", {})
    if (asked := settings.get("asked_timestep")) is None:
        return []
    return [
        f"the physics step is {1e3 * settings['timestep']:.3g} ms: at {1e3 * asked:.3g} ms RK4 is "
        "unstable or inaccurate with this damping"
    ]


def _nothing_required(scenario: Scenario) -> list[str]:
    """Remark on a scenario that no run can fail."""
    if not scenario.required:
        return ["completes = false and nothing else is required: no run of this scenario can fail"]
    return []


def _idle(run: Trajectory) -> list[str]:
    """Remark on a controller that does nothing, which can meet requirements all the same."""
    if len(run.time) == 1 or run.command.any():
        return []
    if run.state[:, 1].any():
        return ["the force is 0 N throughout"]
    return ["the force is 0 N throughout and the pole never leans: the run tests no controller"]


def _ended(run: Trajectory) -> list[str]:
    """Remark on an end that the outcome alone does not explain."""
    phi, force = np.degrees(run.state[0, 1]), run.command[-1]
    if abs(run.state[0, 1]) >= FALL_ANGLE:
        return [f"the pole lies at the start, φ = {phi:.4g}°; every run ends as fallen at 90°"]
    if run.outcome.kind == DIVERGED and not abs(force) < STATE_LIMIT:
        rule = f"a run ends where it is not below {STATE_LIMIT:g} N or not a number"
        return [f"the force was {force:g} at {run.outcome.time:.3g} s; {rule}"]
    return []


def unit_remarks(scenario: Scenario, period: float | None) -> list[str]:
    """Return remarks on values that one may have meant in another unit.

    period: Control period [s].
    """
    return [*_slow(scenario, period or 0.0), *_coarse(scenario), *_long(scenario)]


def _slow(scenario: Scenario, period: float) -> Iterator[str]:
    """Remark on waiting while the pole leans far."""
    (mass, _), (length, _), pole_mass, gravity = scenario.plants  # the fastest to fall
    plant = CartPoleParameters(
        cart_mass=mass, pole_mass=pole_mass, half_length=length, gravity=gravity
    )
    time = upright_model(plant).a[3, 1] ** -0.5
    for name, wait in (("delay", scenario.imperfections.delay), ("control period", period)):
        if wait >= time:
            yield (
                f"the {name}, {wait:g} s, is longer than a pole left alone takes to lean e times "
                f"as far, {time:.2g} s; it is given in seconds, not in ms or Hz"
            )


def _coarse(scenario: Scenario) -> Iterator[str]:
    """Remark on sensors that cannot tell whether the cart-pole is at rest."""
    own, asked = scenario.imperfections, scenario.requirements
    for field, name, unit, others in (
        ("encoder_step", "z", "m", "mm or counts"),
        ("encoder_step", "phi", "rad", "degrees or counts"),
        ("noise", "z", "m", "mm"),
        ("noise", "phi", "rad", "degrees or mrad"),
    ):
        value, band = own.at(f"{field}.{name}"), asked.band(name)
        if value >= band:
            yield (
                f"{field}.{name}, {value:g} {unit}, is no less than the {band:g} {unit} to either "
                f"side within which {name} is at rest; it is given in {unit}, not in {others}"
            )


def _long(scenario: Scenario) -> Iterator[str]:
    """Remark on a pole that is no pole."""
    _, (_, length), _, _ = scenario.plants
    if length > LONGEST:
        yield f"l reaches {length:g} m, half the length of the pole; it is given in m, not in mm"
