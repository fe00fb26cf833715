"""A run in MuJoCo and the ideal one, at the instants of a film's frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.parameters import labelled
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import LONGEST_STEP, Deployed
from afl_mujoco.simulation.judgement import judge
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.ode import simulate_ode
from afl_mujoco.simulation.ode_fixed_step import simulate_ode_held
from afl_mujoco.simulation.trajectory import Trajectory

AFTERWARDS = 1.0
"""How long a film goes on when every run has ended, and shows a verdict at its end [s]."""

GHOSTS = {True: "ideal ODE", False: "ideal loop"}
"""What the ghost of a cart-pole is, and that of another plant."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """What a film shows, frame by frame; a run that has ended keeps its last state, without forces.

    Arrays have a row for each frame. `endings` are texts about runs that did not complete, each
    with the time [s] from which it is true.
    """

    plan: Scenario
    controller: str
    time: NDArray[np.float64]
    state: NDArray[np.float64]  # shape (N, 2 n)
    ideal: NDArray[np.float64] | None  # the same of the ghost, if there is one
    inputs: NDArray[np.float64]  # shape (N, k)
    channels: NDArray[np.float64]  # what disturbs, shape (N, channels)
    values: NDArray[np.float64]  # parameters, shape (N, parameters)
    endings: tuple[tuple[float, str], ...] = ()
    end: float = math.inf  # when MuJoCo's run ended [s]
    verdict: str = ""  # how it met what is required

    @property
    def scenario(self) -> str:
        """The name of the scenario."""
        return self.plan.name

    @property
    def changing(self) -> list[tuple[str, str, NDArray[np.float64]]]:
        """Name, unit and course of each parameter that changes."""
        plant = self.plan.plant
        columns = zip(plant.parameters, self.values.T, strict=True)
        return [(name, plant.units[name], x) for name, x in columns if np.ptp(x) > 0.0]

    @property
    def force(self) -> NDArray[np.float64]:
        """The force on the cart of a cart-pole [N], shape (N,)."""
        return self.inputs[:, 0]

    @property
    def push(self) -> NDArray[np.float64]:
        """What disturbs the cart of a cart-pole [N], shape (N,)."""
        return self.channels[:, 0] + self.channels[:, 1]

    @property
    def cart_mass(self) -> NDArray[np.float64]:
        """M of a cart-pole [kg], shape (N,)."""
        return self.values[:, 0]

    @property
    def half_length(self) -> NDArray[np.float64]:
        """The l of a cart-pole [m], shape (N,)."""
        return self.values[:, 2]

    def readouts(self, index: int) -> list[tuple[str, str]]:
        """Return the numbers of a frame with their labels.

        Of the cart-pole Δ is MuJoCo against the ideal ODE; of another plant they are the parameters
        that change, the inputs and the coordinates.
        """
        if not self.plan.is_cart_pole:
            return self._numbers(index)
        assert self.ideal is not None  # a cart-pole has equations
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

    def _numbers(self, index: int) -> list[tuple[str, str]]:
        plant = self.plan.plant
        found = [("t [s]", f"{self.time[index]:.2f}")]
        found += [(labelled(name, unit), f"{x[index]:.3g}") for name, unit, x in self.changing]
        shown = (*zip(plant.inputs, self.inputs[index], strict=True),
                 *zip(plant.coordinates, self.state[index], strict=False))  # fmt: skip
        return found + [(labelled(name, plant.units[name]), f"{x:+.2f}") for name, x in shown]

    def limits(self, name: str) -> list[float]:
        """Return the limits of a coordinate or an input on both sides, and its end stops."""
        asked, stop = self.plan.requirements, self.plan.imperfections.end_stops.get(name)
        targets = dict(zip(self.plan.plant.coordinates, self.plan.target, strict=True))
        most, about = asked.max.get(name), targets.get(name, 0.0)
        found = [] if most is None else [about - most, about + most]
        return found + ([] if stop is None else [-stop, stop])

    def ended(self, index: int) -> str:
        """Say which runs have ended before a frame, and how; empty if none has."""
        return "; ".join(text for time, text in self.endings if self.time[index] >= time)


def last_frame(replays: Sequence[Replay], fps: int) -> int:
    """Return the last frame of a film: `AFTERWARDS` after the last run ended, if all did."""
    end = max(replay.end for replay in replays) + AFTERWARDS
    return min(len(replays[0].time) - 1, math.ceil(min(end, replays[0].plan.duration) * fps))


def frame_times(duration: float, fps: int) -> NDArray[np.float64]:
    """Return the instants of the frames [s], ``round(duration * fps)`` of them."""
    return np.arange(round(duration * fps), dtype=np.float64) / fps


def record(scenario: Scenario, controller: Controller, deployment: Deployed, fps: int) -> Replay:
    """Run the controller as deployed in MuJoCo, and the ideal ODE, for a film.

    The ideal ODE has none of the scenario's imperfections. A controller with the estimator gets the
    true parameters, and the force of a Python controller is held: it may be stateful, or switch at
    every call. For another plant it is the same loop in MuJoCo without the imperfections.
    """
    run = simulate_mujoco(
        scenario,
        controller,
        "sampled",
        timestep=deployment.timestep,
        control_period=deployment.control_period,
        integrator=deployment.integrator,
    )
    ideal = _ideal(scenario, controller, deployment)
    asked = judge(scenario, run)
    met = sum(one.met for one in asked)
    times = frame_times(scenario.duration, fps)
    held = np.searchsorted(run.time, times + 1e-9, side="right") - 1
    runs_on = (times <= run.outcome.time)[:, None]
    there = np.minimum(times, run.outcome.time)
    return Replay(
        plan=scenario,
        controller=controller.name,
        time=times,
        state=_at(run, times),
        ideal=None if ideal is None else _at(ideal, times),
        inputs=np.where(runs_on, run.inputs[held], 0.0),
        channels=np.where(runs_on, scenario.pushes(times), 0.0),
        values=scenario.values(there),
        endings=tuple(
            (end.outcome.time, f"{name} {end.outcome}")
            for name, end in (("MuJoCo", run), (GHOSTS[scenario.is_cart_pole], ideal))
            if end is not None and end.outcome.time < scenario.duration
        ),
        end=run.outcome.time,
        verdict=f"meets {met} of {len(asked)} requirements",
    )


def _ideal(scenario: Scenario, controller: Controller, deployment: Deployed) -> Trajectory | None:
    """Return the run of the ghost; None if that of MuJoCo has no imperfections."""
    h, period = deployment.timestep or LONGEST_STEP, deployment.control_period
    informed = controller.without_estimator()
    if not scenario.is_cart_pole:
        if scenario.ideal == scenario:
            return None
        # a controller in Python may count on its period; no other loop needs one to be ideal
        kept = period if informed.interpreted else None
        settings: Any = {"timestep": deployment.timestep, "control_period": kept}
        return simulate_mujoco(
            scenario.ideal, informed, "sampled", integrator=deployment.integrator, **settings
        )
    if informed.interpreted:
        return simulate_ode_held(scenario.ideal, informed, timestep=h, control_period=period)
    return simulate_ode(scenario.ideal, informed, sample_period=h)


def _at(run: Trajectory, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the states at some times, interpolated linearly, the last one held; shape (N, 2 n)."""
    return np.column_stack([np.interp(times, run.time, column) for column in run.state.T])
