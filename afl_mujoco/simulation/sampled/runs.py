"""One sampled run: prepared in Python, run by the compiled loop or around a Python controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller, Estimator
from afl_mujoco.control.estimator import EstimatedController, new_filter
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.belief import TRUTH
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import (
    DEFAULT,
    SNAP,
    Deployed,
    Ticks,
    held_disturbances,
    instants,
    last_step,
    step_times,
    ticks_of,
)
from afl_mujoco.simulation.judgement import require_start
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.sampled import loop
from afl_mujoco.simulation.sampled.hardware import (
    RUNNING,
    RunState,
    Sensors,
    actuators_of,
    new_run,
    no_commands,
    sense,
    sensors_of,
)
from afl_mujoco.simulation.trajectory import (
    OUTCOMES,
    Outcome,
    Trajectory,
    assemble,
    criterion_of,
    effort_names,
)

LONG_AGO = 1e9  # before that nothing was known of the plant [s]; a longer delay is the same

MOST_FINER = 1000
"""Largest factor by which a run makes its step finer for dampers and springs."""


class PreparedRun(NamedTuple):
    """A run that is ready to go."""

    plan: loop.Plan  # its numbers
    sensors: Sensors
    actuators: NDArray[Any]
    profile: loop.Profile  # what happens to the plant
    initial_state: Floats
    # inputs of the controller at each control tick, as in `loop.run_to_end`
    inputs: Floats
    estimator: Estimator | None  # the estimator of M, l and the state, None if there is none


class Timing(NamedTuple):
    """The instants of a run."""

    timestep: float  # physics step [s]
    hold: int  # physics steps of a control period
    period: float  # control period [s]
    # ends of the steps [s], shape (N + 1,); the last step may be shorter
    times: Floats
    asked: float  # physics step before it was made finer [s]


def timing_of(scenario: Scenario, model: SimulatedModel, deployed: Deployed = DEFAULT) -> Timing:
    """Return the instants of a run, its step fine enough for the model's dampers and springs."""
    asked = ticks_of(scenario, deployed.timestep, deployed.control_period)
    step, hold = fine_enough(asked, model.fastest_rate(scenario, scenario.spans))
    return Timing(step, hold, asked.period, step_times(scenario.duration, step), asked.timestep)


def fine_enough(ticks: Ticks, rate: float) -> Ticks:
    """Return ticks whose steps are no longer than the reciprocal of a rate [1/s], or raise."""
    finer = max(math.ceil(ticks.timestep * rate - SNAP), 1)
    step = ticks.timestep / finer
    if finer > MOST_FINER:
        where = "with these dampers and springs (or another integrator)"
        raise InvalidValueError("timestep", f"must be at most {step:.2g} s {where}", ticks.timestep)
    return Ticks(step, finer * ticks.hold) if finer > 1 else ticks


def prepare(
    model: SimulatedModel, scenario: Scenario, controller: Controller, timing: Timing
) -> PreparedRun:
    """Sample all inputs of a scenario on the steps and ticks of a run."""
    s, (step, hold, period, times, _), count = scenario, timing, len(timing.times) - 1
    last = min(last_change(s), s.duration)
    changing = min(math.ceil(last / step) + 1, count)
    known_until = min(last + s.imperfections.parameter_delay, s.duration)
    number = min(math.ceil(known_until / period) + 2, -(-count // hold))
    ticks: Floats = np.arange(number, dtype=np.float64) * hold * step
    told = given = told_parameters(s, ticks)
    estimator = None
    if controller.estimates:  # it is told neither M nor l
        given = told_parameters(replace(s, belief=TRUTH), ticks)
        given[:, 1], given[:, 3] = told[:, 1], told[:, 3]
        at_start = replace(s.parameters_at(0.0), pole_mass=told[0, 1], gravity=told[0, 3])
        estimator = controller.estimator_for(at_start)
    return PreparedRun(
        plan=loop.Plan(count, hold, step, last_step(times, step), criterion_of(s)),
        sensors=sensors_of(s, period),
        actuators=actuators_of(s, step, count),
        profile=input_profile(model, s, times[: min(changing + 1, count) + 1]),
        initial_state=np.array(s.initial_state),
        inputs=controller.inputs_for(given),
        estimator=estimator,
    )


def last_change(scenario: Scenario) -> float:
    """Return when anything prescribed changes for the last time [s]; 0 if nothing does."""
    sources = (*scenario.schedule.values(), *scenario.disturbances)
    return max(0.0, max((t for source in sources for t in source.breakpoints), default=0.0))


def told_parameters(scenario: Scenario, times: Floats) -> Floats:
    """Return parameters as a controller is told them at times [s], late and wrong."""
    late = scenario.imperfections.parameter_delay
    return scenario.told_values(instants(np.maximum(times - late, -LONG_AGO)))


def input_profile(model: SimulatedModel, scenario: Scenario, times: Floats) -> loop.Profile:
    """Return what happens to the plant in each step of a grid, and after the last."""
    middles = 0.5 * (times[:-1] + times[1:])
    values, rates = scenario.values(middles), scenario.acting_rates(middles)
    rows, which = model.course(np.hstack([values, rates]) if rates.any() else values)
    known = {time: one for time, one in scenario.events.items() if time <= middles[-1]}
    steps, found = np.searchsorted(middles, [*known]), [*known.values()]  # at whose start they act
    first = np.searchsorted(steps, np.arange(len(middles)))
    events = len(rows) + 2 * np.column_stack([first, np.append(first[1:], len(found))])
    writing = np.flatnonzero(np.diff(which, prepend=-1))  # steps that write a row
    held, struck = held_disturbances(scenario, times), which.copy()
    hits = np.flatnonzero(held.split >= 0.0)
    there = scenario.values(instants(times[hits] + held.split[hits] * np.diff(times)[hits]))
    moved = (there != values[hits]).any(axis=1)
    hits, there = hits[moved], there[moved]
    struck[hits] = len(rows) + 2 * len(found) + np.arange(len(hits))
    ends = (x for one in found for x in (one.before, one.after))
    values = np.vstack([values[writing], *ends, there])
    rates = np.vstack([rates[writing], *(x for one in found for x in one.rates), 0.0 * there])
    if len(values) > len(rows):
        rows = np.vstack([rows, model.rows(values[len(rows) :])])
    drift = np.empty((0, 15 * len(model.addresses.parents)))
    if rates.any():
        drift = model.writer.drift(values, rates).reshape(len(rows), -1)
    push, beside = model.generalised(held.push)
    impulse = model.along("impulse on an input", held.impulse)
    return loop.Profile(
        rows=rows, which=which, push=push, beside=beside, impulse=impulse, split=held.split,
        struck=struck, events=events, drift=drift,
    )  # fmt: skip


def perform(
    model: SimulatedModel,
    prepared: PreparedRun,
    controller: Controller,
    *,
    estimates: Floats | None = None,
) -> tuple[RunState, Floats]:
    """Run the loop; return state, inputs and commands of each instant too."""
    at, plan, actuators = model.addresses, prepared.plan, prepared.actuators
    run, pending = new_run(at.n, at.k), no_commands(actuators)
    rows = np.empty((plan.steps + 1, 2 * at.n + 2 * at.k))
    plant = (at, plan, prepared.profile, run)
    devices = (prepared.initial_state, prepared.sensors, actuators)
    if (estimator := prepared.estimator) is not None:
        kept = np.empty((0, 2)) if estimates is None else estimates
        filter_ = (estimator.compiled, new_filter(), estimator.settings, kept)
        loop.run_estimating(*plant, pending, rows, *devices, filter_)
    elif not controller.interpreted:
        loop.run_to_end(*plant, pending, rows, *devices, controller.kind, prepared.inputs)
    else:
        own, tick = controller.start(), 0
        loop.start(*plant, rows, prepared.initial_state)
        while run.marks["status"] == RUNNING:
            sense(at, prepared.sensors, run, tick)
            time = tick * plan.hold * plan.timestep
            given = prepared.inputs[min(tick, len(prepared.inputs) - 1)]
            run.command[:] = own.command(time, run.measured.copy(), given)
            loop.advance(at, plan, actuators, *plant[2:], pending, rows)
            tick += 1
    return run, rows


def simulate_sampled(
    scenario: Scenario,
    controller: Controller,
    deployed: Deployed = DEFAULT,
    *,
    model: SimulatedModel | None = None,
    estimates: Floats | None = None,
) -> Trajectory:
    """Simulate a scenario with all its imperfections, as `simulate_mujoco` does in sampled mode."""
    if model is None:
        r, integrator = scenario.imperfections, deployed.integrator
        model = SimulatedModel(scenario.plant, integrator=integrator, imperfections=r)
        model.compute_only()
    require_start(scenario)
    timing = timing_of(scenario, model, deployed)
    prepared = prepare(model, scenario, controller, timing)
    run, rows = perform(model, prepared, controller, estimates=estimates)
    return recorded(scenario, controller, timing, run, rows, deployed.integrator)


def recorded(
    scenario: Scenario,
    controller: Controller,
    timing: Timing,
    run: RunState,
    rows: Floats,
    integrator: str,
) -> Trajectory:
    """Return the trajectory of a recorded run from what `perform` returned."""
    count, k = int(run.marks["step"]), len(scenario.plant.inputs)
    settings: dict[str, Any] = {"timestep": timing.timestep, "control_period": timing.period}
    settings["integrator"] = integrator
    if timing.asked != timing.timestep:
        settings["asked_timestep"] = timing.asked
    kept = rows[: count + 1]
    states, inputs, commands = np.split(kept, [kept.shape[1] - 2 * k, kept.shape[1] - k], axis=1)
    if k == 1:
        inputs, commands = inputs[:, 0], commands[:, 0]
    outcome = Outcome(OUTCOMES[int(run.marks["status"])], float(timing.times[count]))
    result = ("mujoco sampled", settings, timing.times, states, outcome, inputs)
    effort = effort_of(scenario.plant.inputs, run, timing)
    return assemble(scenario, controller, *result, command=commands, effort=effort)


def effort_of(inputs: Sequence[str], run: RunState, timing: Timing) -> dict[str, float]:
    """Return the figures of commands and inputs, exact for their course within the steps."""
    ended = float(timing.times[int(run.marks["step"])])
    found: dict[str, float] = {}
    for name, drive in zip(inputs, run.drive, strict=True):
        share = float(drive["limited"]) * timing.timestep / ended if ended else 0.0
        squared = float(drive["force_squared"]) * timing.timestep
        largest = (float(drive["max_command"]), float(drive["max_force"]))
        figures = (*largest, squared, float(drive["force_variation"]), share)
        found |= dict(zip(effort_names(inputs, name), figures, strict=True))
    return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatedRun:
    """A run and its estimates."""

    run: Trajectory  # the run
    time: Floats  # control ticks that the run reached [s], shape (T,)
    # M [kg] and l [m] that the command of each tick assumed, shape (T,)
    cart_mass: Floats
    half_length: Floats


def simulate_estimated(
    scenario: Scenario, controller: EstimatedController, deployed: Deployed = DEFAULT
) -> EstimatedRun:
    """Simulate a scenario as `simulate_mujoco` does in sampled mode, and keep the estimates."""
    period = ticks_of(scenario, deployed.timestep, deployed.control_period).period
    estimates = np.full((int(scenario.duration / period) + 2, 2), np.nan)
    run = simulate_sampled(scenario, controller, deployed, estimates=estimates)
    assumed = estimates[~np.isnan(estimates[:, 0])]
    time = np.asarray(np.arange(len(assumed)) * period, dtype=np.float64)
    return EstimatedRun(run=run, time=time, cart_mass=assumed[:, 0], half_length=assumed[:, 1])
