"""Whether a run meets its requirements, and by what margin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.baselines.linear_model import upright_model
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import UnknownNameError
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.requirements import UNITS, calm, recoveries
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    DIVERGED,
    FALL_ANGLE,
    STATE_LIMIT,
    Trajectory,
)

LONGEST = 50.0
"""Half-length that nobody means [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """One requirement, and how a run meets it.

    Attributes
    ----------
    requirement
        A key of `UNITS`.
    limit
        What is required, in the requirement's unit.
    value
        What was reached; None if the run ended too early to decide, or never settled.
    left
        Robustness as in signal temporal logic: by how much the limit exceeds the value, negative
        if the requirement is not met, in the requirement's unit. A run that never settles counts
        as settling at the last instant that it could. None if the run ended too early to decide.
    """

    requirement: str
    limit: float
    value: float | None
    left: float | None

    def __post_init__(self) -> None:
        """Raise unless there is such a requirement."""
        if self.requirement not in UNITS:
            raise UnknownNameError.among("requirement", self.requirement, UNITS)

    @property
    def met(self) -> bool:
        """Whether the run shows that the requirement is met."""
        return self.left is not None and self.left >= 0.0

    @property
    def relative(self) -> float | None:
        """Robustness as a share of the limit."""
        return None if self.left is None else self.left / self.limit

    @property
    def unit(self) -> str:
        """Unit of limit, value and robustness."""
        return UNITS[self.requirement]


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedRun:
    """How a controller meets the requirements of a scenario.

    Attributes
    ----------
    scenario, controller
        Their names.
    outcome
        How the run ended, in words.
    requirements
        How it meets each requirement.
    """

    scenario: str
    controller: str
    outcome: str
    requirements: tuple[Judgement, ...]

    @property
    def missed(self) -> list[Judgement]:
        """The requirements that are not met."""
        return [one for one in self.requirements if not one.met]


def judged(scenario: Scenario, controller: str, run: Trajectory) -> JudgedRun:
    """Return how a controller's run meets the requirements of the scenario."""
    return JudgedRun(
        scenario=scenario.name,
        controller=controller,
        outcome=str(run.outcome),
        requirements=judge(scenario, run),
    )


def judge(scenario: Scenario, run: Trajectory) -> tuple[Judgement, ...]:
    """Judge a run by the requirements of its scenario, in the order of `UNITS`."""
    return tuple(_judgements(scenario, run))


def judge_failure(scenario: Scenario) -> tuple[Judgement, ...]:
    """Judge a run without a result, because its controller failed: no requirement is met.

    Completing the run counts as one of them even if the scenario does not require it.
    """
    limits = {name: getattr(scenario.requirements, name) for name in UNITS}
    limits["completes"] = scenario.duration
    return tuple(
        Judgement(requirement=name, limit=limit, value=None, left=None)
        for name, limit in limits.items()
        if limit is not None
    )


def _judgements(scenario: Scenario, run: Trajectory) -> Iterator[Judgement]:
    """Yield one judgement for each requirement."""
    asked, completed = scenario.requirements, run.outcome.kind == COMPLETED
    if asked.completes:
        reached = scenario.duration if completed else run.outcome.time
        left = reached - scenario.duration
        yield Judgement(
            requirement="completes",
            limit=scenario.duration,
            value=reached,
            left=left if completed or left < 0.0 else None,  # it may fall at the very end
        )
    peaks = {
        "max_position": run.state[:, 0],
        "max_angle": run.state[:, 1],
        "max_force": run.force,
    }
    for name, signal in peaks.items():
        if (limit := getattr(asked, name)) is not None:
            yield _peak(name, limit, signal, completed)
    z, phi = np.abs(run.state[:, :2]).T
    outside = (z > asked.position_band) | (phi > asked.angle_band)
    if asked.settling_time is not None:
        first = [(0.0, calm(scenario.duration, scenario.disturbances))]
        yield _rest("settling_time", asked.settling_time, run, outside, first)
    if asked.recover_within is not None:
        after = recoveries(scenario.duration, scenario.disturbances)
        yield _rest("recover_within", asked.recover_within, run, outside, after)


def _peak(name: str, limit: float, signal: NDArray[np.float64], completed: bool) -> Judgement:
    """Judge the largest absolute value of a signal; a run cut short can only break the limit."""
    known = np.abs(signal[np.isfinite(signal)])
    value = float(known.max()) if len(known) else None
    if value is None or (not completed and value <= limit):
        return Judgement(requirement=name, limit=limit, value=value, left=None)
    return Judgement(requirement=name, limit=limit, value=value, left=limit - value)


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
        left=limit - slowest,
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
        *_clipped(scenario, run),
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
        f"{name} has no effect, because velocities are differentiated"
        for name in own.without_effect
        if getattr(own, name)
    ]


def _stopped(scenario: Scenario, run: Trajectory) -> list[str]:
    """Remark on a cart that hits an end stop."""
    end, most = scenario.imperfections.rail_half_length, scenario.requirements.max_position
    if end is None or not (hits := np.flatnonzero(np.abs(run.state[:, 0]) >= end)).size:
        return []
    short = f", short of max_position, {most:g} m" if most is not None and most > end else ""
    first = run.time[hits[0]]
    return [f"the cart hits the end stop, {end:g} m from the middle, first at {first:.3g} s{short}"]


def _clipped(scenario: Scenario, run: Trajectory) -> list[str]:
    """Remark on a force that is clipped, so that it cannot exceed what is required of it."""
    limit, most = scenario.imperfections.force_limit, scenario.requirements.max_force
    if limit is None or most is None or limit > most:
        return []
    if np.abs(run.force[np.isfinite(run.force)]).max(initial=0.0) < limit:
        return []
    return [
        f"the force is clipped at force_limit, {limit:g} N: it cannot exceed max_force, "
        f"{most:g} N, however much the controller asks for"
    ]


def _idle(run: Trajectory) -> list[str]:
    """Remark on a controller that does nothing, which can meet requirements all the same."""
    if len(run.time) == 1 or run.force.any():
        return []
    if run.state[:, 1].any():
        return ["the force is 0 N throughout"]
    return ["the force is 0 N throughout and the pole never leans: the run tests no controller"]


def _ended(run: Trajectory) -> list[str]:
    """Remark on an end that the outcome alone does not explain."""
    phi, force = np.degrees(run.state[0, 1]), run.force[-1]
    if abs(run.state[0, 1]) >= FALL_ANGLE:
        return [f"the pole lies at the start, φ = {phi:.4g}°; every run ends as fallen at 90°"]
    if run.outcome.kind == DIVERGED and not abs(force) < STATE_LIMIT:
        rule = f"a run ends where it is not below {STATE_LIMIT:g} N or not a number"
        return [f"the force was {force:g} at {run.outcome.time:.3g} s; {rule}"]
    return []


def unit_remarks(scenario: Scenario, period: float | None) -> list[str]:
    """Return remarks on values that one may have meant in another unit.

    Parameters
    ----------
    period
        Control period [s].
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
    for name, symbol, band, unit, others in (
        ("encoder_step_z", "z", asked.position_band, "m", "mm or counts"),
        ("encoder_step_phi", "φ", asked.angle_band, "rad", "degrees or counts"),
        ("noise_z", "z", asked.position_band, "m", "mm"),
        ("noise_phi", "φ", asked.angle_band, "rad", "degrees or mrad"),
    ):
        if (value := getattr(own, name)) >= band:
            yield (
                f"{name}, {value:g} {unit}, is no less than the {band:g} {unit} to either side "
                f"within which {symbol} is at rest; it is given in {unit}, not in {others}"
            )


def _long(scenario: Scenario) -> Iterator[str]:
    """Remark on a pole that is no pole."""
    _, (_, length), _, _ = scenario.plants
    if length > LONGEST:
        yield f"l reaches {length:g} m, half the length of the pole; it is given in m, not in mm"
