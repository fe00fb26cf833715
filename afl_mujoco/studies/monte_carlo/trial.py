"""One run of a controller on a hardware sample: how it ended, one that breaks down included."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.own.python_controller import ControllerError
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.judgement import Judgement
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
    requirements
        What the run made of the requirements of its scenario; nothing where it has none but to
        complete, or the controller failed.
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
    requirements: tuple[Judgement, ...] = ()

    @property
    def completed(self) -> bool:
        """Whether the pole survived to the end of the run."""
        return self.outcome == COMPLETED

    @property
    def missed(self) -> tuple[str, ...]:
        """The requirements that are not met."""
        return tuple(one.requirement for one in self.requirements if not one.met)

    @property
    def passed(self) -> bool:
        """Whether the run met its requirements; where it has none, whether it completed."""
        return not self.missed if self.requirements else self.completed

    @property
    def settled(self) -> bool:
        """Whether z and phi stayed within the bands of `loop` from some time on."""
        return not math.isnan(self.settling_time)

    def severity(self, duration: float) -> float:
        """Return how bad the run was: up to 1 if it passed, from 1 on if it did not.

        Without requirements one that completed counts the mean of its largest and its average
        abs(phi), as shares of the angle at which it would have fallen; with them, how much of the
        tightest limit is used up, and above that 1 + x / (1 + x) if it exceeds it by a share x. A
        run that ended early counts how much of it is missing, on top of 1; with requirements on
        top of 2, so that it is worse than any that completed. Nothing is worse than a controller
        that failed.

        Parameters
        ----------
        duration
            The horizon [s].
        """
        if self.outcome == CONTROLLER_FAILED:
            return 3.0
        if not (self.passed or self.completed):
            missing = 1.0 - self.end_time / duration
            return missing + (2.0 if self.requirements else 1.0)
        tightest = self.robustness
        if tightest is None:
            return 0.5 * (self.peak_phi + self.iae_phi / duration) / FALL_ANGLE
        return 1.0 - tightest if tightest >= 0.0 else 1.0 - tightest / (1.0 - tightest)

    @property
    def robustness(self) -> float | None:
        """Of a run that completed the least relative robustness of what else was required."""
        if not self.completed:
            return None
        found = [one.relative for one in self.requirements if one.requirement != "completes"]
        known = [one for one in found if one is not None]
        return min(known) if known else None


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
        asked = runs.requirements[i]
        trials.append(Trial(outcome=ended.kind, end_time=ended.time, requirements=asked, **figures))
    return trials
