"""A run in MuJoCo and the ideal one, at the instants of a film's frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.sampling import LONGEST_STEP
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.ode import simulate_ode
from afl_mujoco.simulation.ode_fixed_step import simulate_ode_held
from afl_mujoco.simulation.sampled.runs import ticks_of
from afl_mujoco.simulation.trajectory import Trajectory

IDEAL_ODE = "ideal ODE"


@dataclass(frozen=True, slots=True, kw_only=True)
class Deployment:
    """How the controller is deployed in the run that is filmed.

    Attributes
    ----------
    timestep, control_period
        Physics step, and how long the force is held [s], as in `simulate_mujoco`.
    integrator
        MuJoCo's integrator.
    """

    timestep: float | None = None
    control_period: float | None = None
    integrator: str = "RK4"

    def on(self, scenario: Scenario) -> Deployment:
        """Return the same with the control period that applies to a scenario."""
        ticks = ticks_of(scenario, self.timestep, self.control_period)
        return replace(self, timestep=ticks.timestep, control_period=ticks.period)

    def describe(self) -> str:
        """Describe the deployment in one line."""
        step = LONGEST_STEP if self.timestep is None else self.timestep
        period = step if self.control_period is None else self.control_period
        return (
            f"as deployed: {self.integrator} at {1e3 * step:.3g} ms, "
            f"force held for {1e3 * period:.3g} ms"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """What a film shows, frame by frame; a run that has ended keeps its last state, without forces.

    Attributes
    ----------
    scenario, controller
        Their names.
    time
        Instants of the frames [s], shape (N,).
    state, ideal
        States of the run in MuJoCo and of the ideal ODE, shape (N, 4).
    force, push
        Force of the controller and disturbing force [N], shape (N,).
    cart_mass, half_length
        M [kg] and l [m], shape (N,).
    pole_mass, gravity
        m [kg] and g [m/s^2].
    endings
        Texts about runs that did not complete, each with the time [s] from which it is true.
    ghost
        What `ideal` shows: the ideal ODE, or a measurement.
    looks
        Mass that gives the drawn size of the cart [kg], if much of its mass belongs to its drive;
        its own by default.
    rail_half_length
        Where the end stops stop the middle of the cart [m]; without them by default.
    """

    scenario: str
    controller: str
    time: NDArray[np.float64]
    state: NDArray[np.float64]
    ideal: NDArray[np.float64]
    force: NDArray[np.float64]
    push: NDArray[np.float64]
    cart_mass: NDArray[np.float64]
    half_length: NDArray[np.float64]
    pole_mass: float
    gravity: float
    endings: tuple[tuple[float, str], ...] = ()
    ghost: str = IDEAL_ODE
    looks: float | None = None
    rail_half_length: float | None = None

    def drawn_mass(self, index: int) -> float:
        """Return the mass that gives the drawn size of the cart in a frame [kg]."""
        return float(self.cart_mass[index]) if self.looks is None else self.looks

    @property
    def difference(self) -> NDArray[np.float64]:
        """|MuJoCo - ODE| of every state, shape (N, 4)."""
        return np.abs(self.state - self.ideal)


def frame_times(duration: float, fps: int) -> NDArray[np.float64]:
    """Return the instants of the frames [s], ``round(duration * fps)`` of them.

    Parameters
    ----------
    duration
        How long the film is [s].
    """
    return np.arange(round(duration * fps), dtype=np.float64) / fps


def record(scenario: Scenario, controller: Controller, deployment: Deployment, fps: int) -> Replay:
    """Run the controller as deployed in MuJoCo, and the ideal ODE, for a film.

    The ideal ODE has none of the scenario's imperfections. A controller with the estimator gets the
    true parameters, and the force of a Python controller is held: it may be stateful, or switch at
    every call.
    """
    nominal = scenario.ideal
    run = simulate_mujoco(
        scenario,
        controller,
        "sampled",
        timestep=deployment.timestep,
        control_period=deployment.control_period,
        integrator=deployment.integrator,
    )
    h, period = deployment.timestep or LONGEST_STEP, deployment.control_period
    informed = controller.without_estimator()
    if informed.interpreted:
        ideal = simulate_ode_held(nominal, informed, timestep=h, control_period=period)
    else:
        ideal = simulate_ode(nominal, informed, sample_period=h)
    times = frame_times(scenario.duration, fps)
    held = np.searchsorted(run.time, times + 1e-9, side="right") - 1
    runs_on = times <= run.outcome.time
    there = np.minimum(times, run.outcome.time)
    return Replay(
        scenario=scenario.name,
        controller=controller.name,
        time=times,
        state=_at(run, times),
        ideal=_at(ideal, times),
        force=np.where(runs_on, run.force[held], 0.0),
        push=np.where(runs_on, scenario.pushes(times), 0.0),
        cart_mass=scenario.cart_mass(there),
        half_length=scenario.half_length(there),
        pole_mass=scenario.pole_mass,
        gravity=scenario.gravity,
        rail_half_length=scenario.imperfections.rail_half_length,
        endings=tuple(
            (end.outcome.time, f"{name} {end.outcome}")
            for name, end in (("MuJoCo", run), ("ideal ODE", ideal))
            if end.outcome.time < scenario.duration
        ),
    )


def _at(run: Trajectory, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the states at some times, interpolated linearly, the last one held; shape (N, 4)."""
    return np.column_stack([np.interp(times, run.time, column) for column in run.state.T])
