"""A run in MuJoCo and the ideal one, at the instants of a film's frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.sampling import LONGEST_STEP
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.ode import simulate_ode
from afl_mujoco.simulation.ode_fixed_step import simulate_ode_held
from afl_mujoco.simulation.sampled.runs import ticks_of
from afl_mujoco.simulation.trajectory import Trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class Deployment:
    """Physics step and control period [s] and integrator of what is filmed."""

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

    Arrays have a row for each frame. `endings` are texts about runs that did not complete, each
    with the time [s] from which it is true.
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
    rail_half_length: float | None = None

    def plant(self, index: int) -> CartPoleParameters:
        """Return the plant of a frame."""
        return CartPoleParameters(
            cart_mass=float(self.cart_mass[index]),
            pole_mass=self.pole_mass,
            half_length=float(self.half_length[index]),
            gravity=self.gravity,
        )

    def readouts(self, index: int) -> list[tuple[str, str]]:
        """Return the numbers of a frame with their labels; Δ is MuJoCo against the ideal ODE."""
        apart = np.abs(self.state[index] - self.ideal[index])
        return [
            ("t [s]", f"{self.time[index]:.2f}"),
            ("M [kg]", f"{self.cart_mass[index]:.2f}"),
            ("l [m]", f"{self.half_length[index]:.2f}"),
            ("F [N]", f"{self.force[index]:+.2f}"),
            ("D [N]", f"{self.push[index]:+.0f}" if self.push[index] else "0"),
            ("|Δz| [m]", f"{apart[0]:.0e}" if apart[0] else "0"),
            ("|Δφ| [rad]", f"{apart[1]:.0e}" if apart[1] else "0"),
        ]

    def ended(self, index: int) -> str:
        """Say which runs have ended before a frame, and how; empty if none has."""
        return "; ".join(text for time, text in self.endings if self.time[index] >= time)


def frame_times(duration: float, fps: int) -> NDArray[np.float64]:
    """Return the instants of the frames [s], ``round(duration * fps)`` of them."""
    return np.arange(round(duration * fps), dtype=np.float64) / fps


def record(scenario: Scenario, controller: Controller, deployment: Deployment, fps: int) -> Replay:
    """Run the controller as deployed in MuJoCo, and the ideal ODE, for a film.

    The ideal ODE has none of the scenario's imperfections. A controller with the estimator gets the
    true parameters, and the force of a Python controller is held: it may be stateful, or switch at
    every call.
    """
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
        ideal = simulate_ode_held(scenario.ideal, informed, timestep=h, control_period=period)
    else:
        ideal = simulate_ode(scenario.ideal, informed, sample_period=h)
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
        rail_half_length=scenario.rail,
        endings=tuple(
            (end.outcome.time, f"{name} {end.outcome}")
            for name, end in (("MuJoCo", run), ("ideal ODE", ideal))
            if end.outcome.time < scenario.duration
        ),
    )


def _at(run: Trajectory, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the states at some times, interpolated linearly, the last one held; shape (N, 4)."""
    return np.column_stack([np.interp(times, run.time, column) for column in run.state.T])
