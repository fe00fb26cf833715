"""One run of a rig: prepared in Python, marched by the compiled loop or round a law in Python."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.estimation.estimated_law import EstimatedLaw
from afl_mujoco.control.estimation.estimator import blank_memory as blank_estimator
from afl_mujoco.control.law import Law
from afl_mujoco.control.user_law.python_law import PythonLaw
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.sampling import SNAP, impulses_by_step, whole_steps
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_model import CartPoleModel
from afl_mujoco.simulation.rig import loop
from afl_mujoco.simulation.rig.channels import (
    RUNNING,
    STATUS,
    STEP,
    Actuator,
    Sensors,
    actuator_of,
    blank_memory,
    sense,
    sensors_of,
)
from afl_mujoco.simulation.trajectory import OUTCOMES, Outcome, Trajectory, assemble


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A run that is ready to go.

    Attributes
    ----------
    plan, sensors, actuator
        Its numbers.
    course, initial_state
        What happens to the plant, as of `loop.start`.
    given
        What the law is told at each control tick, as of `loop.commanded`.
    """

    plan: loop.Plan
    sensors: Sensors
    actuator: Actuator
    course: NDArray[np.float64]
    initial_state: NDArray[np.float64]
    given: NDArray[np.float64]


def control_period_of(scenario: Scenario, given: float | None, timestep: float) -> float:
    """Return the control period [s]: the scenario's, else the one given, else the timestep.

    Parameters
    ----------
    scenario
        May have one.
    given, timestep
        The simulator's settings [s].

    Raises
    ------
    InvalidValueError
        If the scenario has one and another is given.
    """
    own = scenario.realism.control_period
    if own is None:
        return timestep if given is None else given
    if given is not None and given != own:
        raise InvalidValueError(
            "control_period", f"must be that of scenario {scenario.name!r}, {own:g} s", given
        )
    return own


def prepare(
    scenario: Scenario,
    law: Law,
    *,
    timestep: float,
    control_period: float | None = None,
) -> Run:
    """Sample everything prescribed on the steps and ticks of a run.

    Parameters
    ----------
    scenario
        What happens, and what departs from the ideal.
    law
        Gives belief and gains.
    timestep
        Physics step [s].
    control_period
        For a scenario that leaves it open [s] (default: one step).

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule, or a gain of the law does.
    """
    s, r = scenario, scenario.realism
    period = control_period_of(s, control_period, timestep)
    hold = whole_steps("control_period", period, "timestep", timestep)
    count = whole_steps("duration", s.duration, "timestep", timestep)
    sources = (s.cart_mass, s.half_length, *s.disturbances)
    last = min(max((t for source in sources for t in source.breakpoints), default=0.0), s.duration)
    changing = min(math.ceil(last / timestep) + 1, count)
    told_until = min(last + r.belief_delay, s.duration)
    ticks = _grid(min(math.ceil(told_until / period) + 2, -(-count // hold)))
    told_at = ticks * hold * timestep - (r.belief_delay - SNAP * timestep if r.belief_delay else 0)
    mass_error, length_error = r.mass_error, r.length_error
    if isinstance(law, EstimatedLaw):  # nobody tells it anything
        mass_error = length_error = 0.0
    return Run(
        plan=loop.Plan(
            steps=count,
            hold=hold,
            timestep=timestep,
            pole_mass=s.pole_mass,
            gravity=s.gravity,
            rail=math.inf if r.rail_half_length is None else r.rail_half_length,
        ),
        sensors=sensors_of(r, period),
        actuator=actuator_of(r, timestep, count),
        course=_course(s, timestep, changing, count),
        initial_state=np.array(s.initial_state),
        given=law.law_inputs(
            s.cart_mass(told_at) * (1.0 + mass_error),
            s.half_length(told_at) * (1.0 + length_error),
            s.pole_mass,
            s.gravity,
        ),
    )


def _course(scenario: Scenario, timestep: float, changing: int, count: int) -> NDArray[np.float64]:
    """Return what happens to the plant in each step until nothing changes any more."""
    starts = _grid(min(changing + 1, count) + 1) * timestep
    middles = (_grid(len(starts) - 1) + 0.5) * timestep
    course = np.empty((len(middles), 4))
    course[:, loop.COURSE_MASS] = scenario.cart_mass(middles)
    course[:, loop.COURSE_LENGTH] = scenario.half_length(middles)
    course[:, loop.COURSE_PUSH] = scenario.pushes(middles)
    course[:, loop.COURSE_IMPULSE] = impulses_by_step(scenario, starts)
    return course


def _grid(count: int) -> NDArray[np.float64]:
    """Return 0, 1, ..., as floats."""
    return np.arange(count, dtype=np.float64)


def perform(
    model: CartPoleModel,
    run: Run,
    law: Law,
    *,
    record: bool,
    beliefs: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """March a run from start to end.

    Parameters
    ----------
    model
        With the realism of the scenario; its state is of no consequence.
    run
        From `prepare`.
    law
        The law that it was prepared for.
    record
        Whether to keep every state and force.
    beliefs
        Takes what an `EstimatedLaw` believes of M [kg] and l [m] at each control tick, shape
        (T, 2).

    Returns
    -------
    memory
        How the run ended and its figures, places as of `channels`.
    record
        States and forces, shape (N + 1, 5), of which a run that ends early fills the first; (0, 5)
        if they are not to be kept.
    """
    at, plan, memory = model.addresses, run.plan, blank_memory(run.actuator)
    rows = np.empty((plan.steps + 1 if record else 0, 5))
    march = (at, plan, run.course, memory, rows, run.initial_state)
    if isinstance(law, EstimatedLaw):
        kept = np.empty((0, 2)) if beliefs is None else beliefs
        told = (law.law.compiled, blank_estimator(), law.settings.array, kept)
        loop.march_estimating(*march, run.sensors, run.actuator, *told)
        return memory, rows
    if not isinstance(law, PythonLaw):
        loop.march(*march, run.sensors, run.actuator, law.compiled.kind, run.given)
        return memory, rows
    loop.start(*march)
    tick = 0
    while memory[STATUS] == RUNNING:
        measured = sense(at, run.sensors, memory, tick)
        time = tick * plan.hold * plan.timestep
        command = law.command(time, measured, run.given[min(tick, len(run.given) - 1)])
        loop.advance(at, plan, run.actuator, run.course, memory, rows, command)
        tick += 1
    return memory, rows


def simulate_rig(
    scenario: Scenario,
    law: Law,
    *,
    timestep: float = 1e-3,
    control_period: float | None = None,
    integrator: str = "RK4",
    model: CartPoleModel | None = None,
    beliefs: NDArray[np.float64] | None = None,
) -> Trajectory:
    """Simulate a scenario with all its realism, as `simulate_mujoco` does in sampled mode.

    Parameters
    ----------
    scenario
        What happens, and what departs from the ideal.
    law
        What is commanded; a `PythonLaw` runs in Python, an `EstimatedLaw` with its estimator.
    timestep, control_period, integrator
        As of `simulate_mujoco`.
    model
        The model to use instead of a fresh one, its timestep and integrator as given here.
    beliefs
        As of `perform`.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    run = prepare(scenario, law, timestep=timestep, control_period=control_period)
    if model is None:
        model = CartPoleModel(
            scenario.parameters_at(0.0),
            timestep=timestep,
            integrator=integrator,
            realism=scenario.realism,
        )
    memory, rows = perform(model, run, law, record=True, beliefs=beliefs)
    count = int(memory[STEP])
    times = _grid(run.plan.steps + 1) * timestep
    settings = {
        "timestep": timestep,
        "control_period": run.sensors.period,
        "integrator": integrator,
    }
    return assemble(
        scenario,
        law,
        "mujoco sampled",
        settings,
        times,
        rows[: count + 1, :4],
        Outcome(OUTCOMES[int(memory[STATUS])], float(times[count])),
        rows[: count + 1, 4],
    )
