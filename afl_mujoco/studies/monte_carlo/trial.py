"""One run of a controller on a hardware sample: how it ended, one that breaks down included."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.own.python_controller import ControllerError
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.sampled.rollouts import Rollouts, run_rollouts
from afl_mujoco.simulation.trajectory import COMPLETED, FALL_ANGLE, OUTCOMES

CONTROLLER_FAILED = "controller failed"
"""How a run ends whose controller raises, takes too long or returns what is no force."""

ENDINGS = (*OUTCOMES, CONTROLLER_FAILED)
"""The ways a trial can end; all but the first are failures."""

FIGURES = ("peak_z", "peak_phi", "max_force", "iae_z", "iae_phi", "settling_time")


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """How one run ended, and figures of it up to then; NaN where there is none.

    Attributes
    ----------
    outcome
        One of `ENDINGS`.
    end_time
        When it ended [s]; NaN if the controller failed.
    peak_z, peak_phi, max_force, iae_z, iae_phi, settling_time
        As of `Rollouts`.
    message
        What the controller did, if it failed.
    """

    outcome: str
    end_time: float = math.nan
    peak_z: float = math.nan
    peak_phi: float = math.nan
    max_force: float = math.nan
    iae_z: float = math.nan
    iae_phi: float = math.nan
    settling_time: float = math.nan
    message: str | None = None

    @property
    def survived(self) -> bool:
        """Whether the pole survived to the end of the run."""
        return self.outcome == COMPLETED

    @property
    def settled(self) -> bool:
        """Whether z and phi stayed within the bands of `loop` from some time on."""
        return not math.isnan(self.settling_time)

    def severity(self, duration: float) -> float:
        """Return how bad the run was: below 1 if it survived, 1 to 2 if it did not.

        A survivor counts the mean of its largest and its average abs(phi), as shares of the angle
        at which it would have fallen; a failure counts how much of the run it missed.

        Parameters
        ----------
        duration
            The horizon [s].
        """
        if self.survived:
            return 0.5 * (self.peak_phi + self.iae_phi / duration) / FALL_ANGLE
        lasted = 0.0 if math.isnan(self.end_time) else self.end_time
        return 2.0 - lasted / duration


class Settings(NamedTuple):
    """How MuJoCo runs a trial.

    Attributes
    ----------
    integrator
        MuJoCo's integrator, as of `simulate_mujoco`.
    timestep
        Physics step [s].
    """

    integrator: str = "RK4"
    timestep: float = 1e-3


def run_trials(
    scenarios: Sequence[Scenario], controller: Controller, settings: Settings
) -> list[Trial]:
    """Run a controller on scenarios; an error of a Python controller fails that run and no other.

    Each run is, to the last bit, that of `simulate_mujoco` in sampled mode.
    """
    options = settings._asdict()
    if not controller.interpreted:
        return trials_of(run_rollouts(scenarios, controller, **options))
    trials = []
    for scenario in scenarios:
        try:
            trials += trials_of(run_rollouts([scenario], controller, **options))
        except ControllerError as error:
            trials.append(Trial(outcome=CONTROLLER_FAILED, message=str(error)))
    return trials


def trials_of(runs: Rollouts) -> list[Trial]:
    """Return rollouts one by one."""
    trials = []
    for i in range(len(runs)):
        figures: dict[str, Any] = {name: float(getattr(runs, name)[i]) for name in FIGURES}
        ended = runs.outcome(i)
        trials.append(Trial(outcome=ended.kind, end_time=ended.time, **figures))
    return trials
