"""One sampled run: prepared in Python, run by the compiled loop or around a Python controller."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller, Estimator
from afl_mujoco.control.estimation.estimator import new_filter
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.sampling import SNAP, impulses_by_step, whole_steps
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_model import CartPoleModel
from afl_mujoco.simulation.sampled import loop
from afl_mujoco.simulation.sampled.hardware import (
    RUNNING,
    Actuator,
    Sensors,
    actuator_of,
    new_run,
    no_commands,
    sense,
    sensors_of,
)
from afl_mujoco.simulation.trajectory import OUTCOMES, Outcome, Trajectory, assemble


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedRun:
    """A run that is ready to go.

    Attributes
    ----------
    plan, sensors, actuator
        Its numbers.
    profile, initial_state
        What happens to the plant, as in `loop.start`.
    inputs
        Inputs of the controller at each control tick, as in `loop.run_to_end`.
    estimator
        The estimator of M, l and the state, None if there is none.
    """

    plan: loop.Plan
    sensors: Sensors
    actuator: Actuator
    profile: NDArray[Any]
    initial_state: NDArray[np.float64]
    inputs: NDArray[np.float64]
    estimator: Estimator | None


def control_period_of(scenario: Scenario, given: float | None, timestep: float) -> float:
    """Return the control period [s]: the scenario's, else the one given, else the timestep.

    Parameters
    ----------
    given, timestep
        The simulator's settings [s].
    """
    own = scenario.imperfections.control_period
    period = given if own is None else own
    if period is not None and period > scenario.duration:
        rule = f"must be within the duration {scenario.duration:g} s (in seconds, not Hz)"
        raise InvalidValueError("control_period", rule, period)
    if own is None:
        return timestep if given is None else given
    if given is not None and given != own:
        raise InvalidValueError(
            "control_period", f"must be that of scenario {scenario.name!r}, {own:g} s", given
        )
    return own


def prepare(
    scenario: Scenario,
    controller: Controller,
    *,
    timestep: float,
    control_period: float | None = None,
) -> PreparedRun:
    """Sample all inputs of a scenario on the steps and ticks of a run.

    Parameters
    ----------
    timestep
        Physics step [s].
    control_period
        Control period for a scenario that does not set it [s] (default: one step).
    """
    s, r = scenario, scenario.imperfections
    period = control_period_of(s, control_period, timestep)
    hold = whole_steps("control_period", period, "timestep", timestep)
    count = whole_steps("duration", s.duration, "timestep", timestep)
    last = min(last_change(s), s.duration)
    changing = min(math.ceil(last / timestep) + 1, count)
    known_until = min(last + r.parameter_delay, s.duration)
    ticks = _grid(min(math.ceil(known_until / period) + 2, -(-count // hold)))
    masses, lengths = told_parameters(s, ticks * hold * timestep, timestep, controller.estimates)
    return PreparedRun(
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
        profile=input_profile(s, timestep, changing, count),
        initial_state=np.array(s.initial_state),
        estimator=controller.estimator_for(s.parameters_at(0.0)),
        inputs=controller.inputs_along_run(
            masses,
            lengths,
            s.pole_mass,
            s.gravity,
        ),
    )


def last_change(scenario: Scenario) -> float:
    """Return when anything prescribed changes for the last time [s]; 0 if nothing does."""
    sources = (scenario.cart_mass, scenario.half_length, *scenario.disturbances)
    return max((t for source in sources for t in source.breakpoints), default=0.0)


def told_parameters(
    scenario: Scenario, times: NDArray[np.float64], timestep: float, estimates: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return M [kg] and l [m] as a controller assumes them at some times, late and with an error.

    Parameters
    ----------
    times
        Times of its control ticks [s].
    timestep
        Physics step [s].
    estimates
        Whether it uses estimates instead, to which the errors do not apply.
    """
    s, r = scenario, scenario.imperfections
    known_at = times - (r.parameter_delay - SNAP * timestep if r.parameter_delay else 0.0)
    mass_error, length_error = (0.0, 0.0) if estimates else (r.mass_error, r.length_error)
    masses, lengths = s.cart_mass(known_at), s.half_length(known_at)
    return masses * (1.0 + mass_error), lengths * (1.0 + length_error)


def input_profile(scenario: Scenario, timestep: float, changing: int, count: int) -> NDArray[Any]:
    """Return what happens to the plant in each step until nothing changes any more.

    Parameters
    ----------
    timestep
        Physics step [s].
    """
    starts = _grid(min(changing + 1, count) + 1) * timestep
    middles = (_grid(len(starts) - 1) + 0.5) * timestep
    profile = np.empty(len(middles), loop.PROFILE)
    profile["cart_mass"] = scenario.cart_mass(middles)
    profile["half_length"] = scenario.half_length(middles)
    profile["push"] = scenario.pushes(middles)
    profile["impulse"] = impulses_by_step(scenario, starts)
    return profile


def _grid(count: int) -> NDArray[np.float64]:
    """Return 0, 1, ..., as floats."""
    return np.arange(count, dtype=np.float64)


def perform(
    model: CartPoleModel,
    prepared: PreparedRun,
    controller: Controller,
    *,
    record: bool,
    estimates: NDArray[np.float64] | None = None,
) -> tuple[Any, NDArray[np.float64]]:
    """Run the loop from start to end.

    Parameters
    ----------
    model
        The model, with the passive physics of the scenario; its state does not matter.
    estimates
        Takes the estimates of M [kg] and l [m] at each control tick, shape (T, 2).

    Returns
    -------
    run
        How the run ended and its figures, a record with the fields of `hardware.RUN`.
    record
        States and forces, shape (N + 1, 5), or (0, 5) if they are not kept; a run that ends early
        fills only the first rows.
    """
    at, plan, actuator = model.addresses, prepared.plan, prepared.actuator
    run, pending = new_run(), no_commands(actuator)
    rows = np.empty((plan.steps + 1 if record else 0, 5))
    plant = (at, plan, prepared.profile, run)
    devices = (prepared.initial_state, prepared.sensors, actuator)
    if (estimator := prepared.estimator) is not None:
        kept = np.empty((0, 2)) if estimates is None else estimates
        filter_ = (estimator.compiled, new_filter(), estimator.settings, kept)
        loop.run_estimating(*plant, pending, rows, *devices, *filter_)
    elif not controller.interpreted:
        loop.run_to_end(*plant, pending, rows, *devices, controller.kind, prepared.inputs)
    else:
        own, tick = controller.start(), 0
        loop.start(*plant, rows, prepared.initial_state)
        while run["status"] == RUNNING:
            measured = sense(at, prepared.sensors, run, tick)
            time = tick * plan.hold * plan.timestep
            given = prepared.inputs[min(tick, len(prepared.inputs) - 1)]
            command = own.command(time, measured, given)
            loop.advance(at, plan, actuator, *plant[2:], pending, rows, command)
            tick += 1
    return run, rows


def simulate_sampled(
    scenario: Scenario,
    controller: Controller,
    *,
    timestep: float = 1e-3,
    control_period: float | None = None,
    integrator: str = "RK4",
    model: CartPoleModel | None = None,
    estimates: NDArray[np.float64] | None = None,
) -> Trajectory:
    """Simulate a scenario with all its imperfections, as `simulate_mujoco` does in sampled mode.

    Parameters
    ----------
    model
        The model to use instead of a fresh one, with the same timestep and integrator.
    """
    prepared = prepare(scenario, controller, timestep=timestep, control_period=control_period)
    if model is None:
        model = CartPoleModel(
            scenario.parameters_at(0.0),
            timestep=timestep,
            integrator=integrator,
            imperfections=scenario.imperfections,
        )
        model.compute_only(scenario.imperfections)
    run, rows = perform(model, prepared, controller, record=True, estimates=estimates)
    return recorded(scenario, controller, prepared, run, rows, integrator)


def recorded(
    scenario: Scenario,
    controller: Controller,
    prepared: PreparedRun,
    run: Any,
    rows: NDArray[np.float64],
    integrator: str,
) -> Trajectory:
    """Return the trajectory of a recorded run from what `perform` returned."""
    count, timestep = int(run["step"]), prepared.plan.timestep
    times = _grid(prepared.plan.steps + 1) * timestep
    settings = {
        "timestep": timestep,
        "control_period": prepared.sensors.period,
        "integrator": integrator,
    }
    return assemble(
        scenario,
        controller,
        "mujoco sampled",
        settings,
        times,
        rows[: count + 1, :4],
        Outcome(OUTCOMES[int(run["status"])], float(times[count])),
        rows[: count + 1, 4],
    )
