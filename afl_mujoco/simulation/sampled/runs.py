"""One sampled run: prepared in Python, run by the compiled loop or around a Python controller."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller, Estimator
from afl_mujoco.control.estimator import EstimatedController, new_filter
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.belief import TRUTH
from afl_mujoco.scenario.sampling import (
    SNAP,
    TYPED,
    Ticks,
    cut_period,
    held_disturbances,
    instants,
    step_times,
)
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_model import CartPoleModel
from afl_mujoco.simulation.sampled import loop
from afl_mujoco.simulation.sampled.hardware import (
    RECORD,
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

LONG_AGO = 1e9
"""Before that nothing was known of the plant [s]; a longer delay is the same."""

MOST_FINER = 1000
"""Largest factor by which a run makes its step finer for the damping of the joints."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedRun:
    """A run that is ready to go."""

    plan: loop.Plan  # its numbers
    sensors: Sensors
    actuator: Actuator
    profile: NDArray[Any]  # what happens to the plant, as in `loop.start`
    initial_state: NDArray[np.float64]
    # inputs of the controller at each control tick, as in `loop.run_to_end`
    inputs: NDArray[np.float64]
    estimator: Estimator | None  # the estimator of M, l and the state, None if there is none


class Timing(NamedTuple):
    """The instants of a run."""

    timestep: float  # physics step [s]
    hold: int  # physics steps of a control period
    period: float  # control period [s]
    # ends of the steps [s], shape (N + 1,); the last step may be shorter
    times: NDArray[np.float64]
    asked: float  # physics step before it was made finer [s]

    @property
    def last(self) -> float:
        """Length of the last step [s]; the timestep itself unless it is shorter."""
        length = float(self.times[-1]) - (len(self.times) - 2) * self.timestep
        return length if length < (1.0 - SNAP) * self.timestep else self.timestep


def ticks_of(
    scenario: Scenario, timestep: float | None = None, control_period: float | None = None
) -> Ticks:
    """Return how the control period of a scenario is cut into physics steps, or raise.

    timestep: Physics step [s]; None for the longest up to 1 ms that divides the control period.
    control_period: Control period for a scenario that does not set it [s]; None for one step.
    """
    own = scenario.imperfections.control_period
    period = control_period if own is None else own
    if period is not None and period > scenario.duration:
        rule = f"must be within the duration {scenario.duration:g} s (in seconds, not Hz)"
        raise InvalidValueError("control_period", rule, period)
    if control_period is not None and own is not None:
        if abs(control_period - own) > TYPED * own:
            rule = f"must be that of scenario {scenario.name!r}, {own:g} s"
            raise InvalidValueError("control_period", rule, control_period)
    if timestep is not None and timestep > scenario.duration:
        rule = f"must be within the duration {scenario.duration:g} s"
        raise InvalidValueError("timestep", rule, timestep)
    ticks = cut_period(period, timestep)
    step_times(scenario.duration, ticks.timestep)  # raises if there are too many
    return ticks


def timing_of(
    scenario: Scenario,
    model: CartPoleModel,
    *,
    timestep: float | None = None,
    control_period: float | None = None,
) -> Timing:
    """Return the instants of a run, its step fine enough for the damping in the model."""
    asked = ticks_of(scenario, timestep, control_period)
    ticks = fine_enough(asked, model.decay_rate(scenario.plants))
    return Timing(
        timestep=ticks.timestep,
        hold=ticks.hold,
        period=asked.period,
        times=step_times(scenario.duration, ticks.timestep),
        asked=asked.timestep,
    )


def fine_enough(ticks: Ticks, rate: float) -> Ticks:
    """Return ticks whose physics steps are no longer than the fastest decay, or raise.

    rate: `CartPoleModel.decay_rate` [1/s].
    """
    finer = max(math.ceil(ticks.timestep * rate - SNAP), 1)
    step = ticks.timestep / finer
    if finer > MOST_FINER:
        rule = f"must be at most {step:.2g} s with this damping under RK4 (or another integrator)"
        raise InvalidValueError("timestep", rule, ticks.timestep)
    return Ticks(step, finer * ticks.hold) if finer > 1 else ticks


def prepare(scenario: Scenario, controller: Controller, timing: Timing) -> PreparedRun:
    """Sample all inputs of a scenario on the steps and ticks of a run."""
    s, r = scenario, scenario.imperfections
    times, hold, period = timing.times, timing.hold, timing.period
    count = len(times) - 1
    last = min(last_change(s), s.duration)
    changing = min(math.ceil(last / timing.timestep) + 1, count)
    known_until = min(last + r.parameter_delay, s.duration)
    ticks = _grid(min(math.ceil(known_until / period) + 2, -(-count // hold)))
    pole_mass, gravity = s.told_constants
    known = replace(s, belief=TRUTH) if controller.estimates else s  # it is told neither M nor l
    told = told_parameters(known, ticks * hold * timing.timestep)
    return PreparedRun(
        plan=loop.Plan(
            steps=count,
            hold=hold,
            timestep=timing.timestep,
            last=timing.last,
            pole_mass=s.pole_mass,
            gravity=s.gravity,
            rail=math.inf if s.rail is None else s.rail,
            criterion=loop.Criterion(z=s.requirements.band("z"), phi=s.requirements.band("phi")),
        ),
        sensors=sensors_of(r, period),
        actuator=actuator_of(r, timing.timestep, count),
        profile=input_profile(s, times[: min(changing + 1, count) + 1]),
        initial_state=np.array(s.initial_state),
        estimator=controller.estimator_for(
            replace(s.parameters_at(0.0), pole_mass=pole_mass, gravity=gravity)
        ),
        inputs=controller.inputs_along_run(*told, pole_mass, gravity),
    )


def last_change(scenario: Scenario) -> float:
    """Return when anything prescribed changes for the last time [s]; 0 if nothing does."""
    sources = (scenario.cart_mass, scenario.half_length, *scenario.disturbances)
    return max((t for source in sources for t in source.breakpoints), default=0.0)


def told_parameters(
    scenario: Scenario, times: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return M [kg] and l [m] as a controller is told them at some times, late and with an error.

    times: Times of its control ticks [s].
    """
    late = scenario.imperfections.parameter_delay
    known_at = instants(np.maximum(times - late, -LONG_AGO))
    masses = scenario.told("cart_mass", scenario.cart_mass(known_at))
    return masses, scenario.told("half_length", scenario.half_length(known_at))


def input_profile(scenario: Scenario, times: NDArray[np.float64]) -> NDArray[Any]:
    """Return what happens to the plant in each step of a grid.

    times: Ends of the steps [s], shape (N + 1,); after the last of them nothing changes.
    """
    middles = 0.5 * (times[:-1] + times[1:])
    profile = np.empty(len(middles), loop.PROFILE)
    profile["cart_mass"] = scenario.cart_mass(middles)
    profile["half_length"] = scenario.half_length(middles)
    for name, values in held_disturbances(scenario, times)._asdict().items():
        profile[name] = values
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

    estimates: Takes the estimates of M [kg] and l [m] at each control tick, shape (T, 2).
    Returns record: Columns of `RECORD`, shape (N + 1, 6), or (0, 6) if they are not kept; a run
        that ends early fills only the first rows.
    """
    at, plan, actuator = model.addresses, prepared.plan, prepared.actuator
    run, pending = new_run(), no_commands(actuator)
    rows = np.empty((plan.steps + 1 if record else 0, len(RECORD)))
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
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    model: CartPoleModel | None = None,
    estimates: NDArray[np.float64] | None = None,
) -> Trajectory:
    """Simulate a scenario with all its imperfections, as `simulate_mujoco` does in sampled mode."""
    if model is None:
        model = CartPoleModel(
            scenario.parameters_at(0.0),
            integrator=integrator,
            imperfections=scenario.imperfections,
        )
        model.compute_only(scenario.imperfections)
    timing = timing_of(scenario, model, timestep=timestep, control_period=control_period)
    prepared = prepare(scenario, controller, timing)
    run, rows = perform(model, prepared, controller, record=True, estimates=estimates)
    return recorded(scenario, controller, timing, run, rows, integrator)


def recorded(
    scenario: Scenario,
    controller: Controller,
    timing: Timing,
    run: Any,
    rows: NDArray[np.float64],
    integrator: str,
) -> Trajectory:
    """Return the trajectory of a recorded run from what `perform` returned."""
    count = int(run["step"])
    settings = {
        "timestep": timing.timestep,
        "control_period": timing.period,
        "integrator": integrator,
    }
    if timing.asked != timing.timestep:
        settings["asked_timestep"] = timing.asked
    return assemble(
        scenario,
        controller,
        "mujoco sampled",
        settings,
        timing.times,
        rows[: count + 1, :4],
        Outcome(OUTCOMES[int(run["status"])], float(timing.times[count])),
        rows[: count + 1, 4],
        command=rows[: count + 1, 5],
        effort=effort_of(run, timing),
    )


def effort_of(run: Any, timing: Timing) -> dict[str, float]:
    """Return the figures of command and exerted force, exact for their course within the steps."""
    ended = float(timing.times[int(run["step"])])
    return {
        "max_command": float(run["max_command"]),
        "max_force": float(run["max_force"]),
        "force_squared": float(run["force_squared"]) * timing.timestep,
        "force_variation": float(run["force_variation"]),
        "limited_share": float(run["limited"]) * timing.timestep / ended if ended else 0.0,
    }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatedRun:
    """A run and its estimates."""

    run: Trajectory  # the run
    time: NDArray[np.float64]  # control ticks that the run reached [s], shape (T,)
    # M [kg] and l [m] that the command of each tick assumed, shape (T,)
    cart_mass: NDArray[np.float64]
    half_length: NDArray[np.float64]


def simulate_estimated(
    scenario: Scenario,
    controller: EstimatedController,
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
) -> EstimatedRun:
    """Simulate a scenario as `simulate_mujoco` does in sampled mode, and keep the estimates."""
    period = ticks_of(scenario, timestep, control_period).period
    estimates = np.full((int(scenario.duration / period) + 2, 2), np.nan)
    run = simulate_sampled(
        scenario,
        controller,
        timestep=timestep,
        control_period=control_period,
        integrator=integrator,
        estimates=estimates,
    )
    assumed = estimates[~np.isnan(estimates[:, 0])]
    time = np.asarray(np.arange(len(assumed)) * period, dtype=np.float64)
    return EstimatedRun(run=run, time=time, cart_mass=assumed[:, 0], half_length=assumed[:, 1])
