"""A run in MuJoCo and the ideal one, at the instants of a film's frames."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import labelled, symbol
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import Impulse, channel_of
from afl_mujoco.scenario.time_steps import LONGEST_STEP, Deployed
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.drawing import PUSHED, between, changing, said_during
from afl_mujoco.simulation.judgement import judge
from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
from afl_mujoco.simulation.ode_fixed_step import simulate_ode_held
from afl_mujoco.simulation.simulate import simulate_ode
from afl_mujoco.simulation.trajectory import Trajectory

IDEAL = "ideal ODE"  # what the ghost is

MOST_PLACES = 5  # of a number in a picture

AFTERWARDS = 1.0
"""How long a film goes on when every run has ended, and shows a verdict at its end [s]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """What a film shows, frame by frame; a run that has ended keeps its last state, without forces.

    Arrays have a row for each frame. `endings` are texts about runs that did not complete, each
    with the time [s] from which it is true.
    """

    plan: Scenario
    controller: str
    run: Trajectory  # in MuJoCo, at every step: between two frames a force may peak
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
    def changing(self) -> list[tuple[str, str, NDArray[np.float64]]]:
        """Name, unit and course of each parameter that changes."""
        return changing(self.plan.plant, self.values)

    def readouts(self, index: int) -> list[tuple[str, str]]:
        """Return the numbers of a frame with their labels, what matters most first.

        Δ is how far MuJoCo is from the ghost.
        """
        plant, state = self.plan.plant, self.state[index]
        found = [("t [s]", f"{self.time[index]:.2f}")]
        found += [(labelled(name, unit), f"{x[index]:.3g}") for name, unit, x in self.changing]
        shown = (*zip(plant.inputs, self.inputs.T, strict=True),
                 *zip(plant.coordinates, self.state.T, strict=False))  # fmt: skip
        found += [
            (labelled(name, plant.units[name]), f"{x[index]:+z.{_places(x)}f}") for name, x in shown
        ]
        if self.ideal is None:
            return found
        apart = zip(plant.coordinates, np.abs(state - self.ideal[index]), strict=False)
        return found + [
            (labelled(f"|Δ{symbol(name)}|", plant.units[name]), f"{x:.0e}" if x else "0")
            for name, x in apart
        ]

    def limits(self, name: str) -> list[float]:
        """Return the limits that are required of a coordinate or an input, and its end stops."""
        stop = self.plan.imperfections.end_stops.get(name)
        return self.plan.required_of(name) + ([] if stop is None else [-stop, stop])

    def ended(self, index: int) -> str:
        """Say which runs have ended before a frame, and how; empty if none has."""
        return "; ".join(text for time, text in self.endings if self.time[index] >= time)


def _places(values: NDArray[np.float64]) -> int:
    """Return to how many places numbers are written, so that the largest has two digits if it can.

    What is only the rounding of 0 has as few as what is 0.
    """
    most = float(np.abs(values).max(initial=0.0, where=np.isfinite(values)))
    places = 1 - math.floor(math.log10(most)) if most else 0
    return max(2 - (most >= 100.0), places) if places <= MOST_PLACES else 2


def frame_times(duration: float, fps: int) -> NDArray[np.float64]:
    """Return the instants of the frames [s], ``round(duration * fps)`` of them."""
    return np.arange(round(duration * fps), dtype=np.float64) / fps


def record(scenario: Scenario, controller: Controller, deployment: Deployed, fps: int) -> Replay:
    """Run the controller as deployed in MuJoCo, and the ideal loop, for a film."""
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
    times = frame_times(scenario.duration, fps)
    held = np.searchsorted(run.time, times + 1e-9, side="right") - 1
    runs_on = (times <= run.outcome.time)[:, None]
    return Replay(
        plan=scenario,
        controller=controller.name,
        run=run,
        time=times,
        state=between(run.time, run.state, times),
        ideal=None if ideal is None else between(ideal.time, ideal.state, times),
        inputs=np.where(runs_on, run.inputs[held], 0.0),
        channels=np.where(runs_on, _seen_pushes(scenario, times), 0.0),
        values=scenario.values(np.minimum(times, run.outcome.time)),
        endings=tuple(
            (end.outcome.time, f"{name} {end.outcome}")
            for name, end in (("MuJoCo", run), (IDEAL, ideal))
            if end is not None and end.outcome.time < scenario.duration
        ),
        end=run.outcome.time,
        verdict=f"meets {sum(one.met for one in asked)} of {len(asked)} requirements" * bool(asked),
    )


def _ideal(scenario: Scenario, controller: Controller, deployment: Deployed) -> Trajectory | None:
    """Return the run of the ghost, without imperfections and told the truth.

    It obeys the plant's equations; there is none where they cannot say what happens. The commands
    of a Python controller are held: it may switch at every call, or count on its period.
    """
    period, plan = deployment.control_period, scenario.ideal
    informed = bound(controller.without_estimator(), plan)
    h = deployment.timestep or LONGEST_STEP
    with suppress(InvalidValueError):  # there are no equations, or they leave something out
        if informed.interpreted:
            return simulate_ode_held(plan, informed, timestep=h, control_period=period)
        return simulate_ode(plan, informed, sample_period=h)
    return None


def _seen_pushes(scenario: Scenario, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what disturbs, shape (N, channels), each for `PUSHED` at least.

    Many pulses lie between two frames; an impulse is a force over that time.
    """
    plant = scenario.plant
    found = np.zeros((len(times), len(plant.inputs) + len(plant.coordinates)))
    for one in scenario.disturbances:
        start, end = said_during(one)
        force = one.momentum / PUSHED if isinstance(one, Impulse) else one.force
        found[(start <= times) & (times < end), channel_of(one, plant)] += force
    return found
