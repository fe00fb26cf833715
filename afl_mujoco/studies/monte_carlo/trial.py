"""One run of a controller on a hardware sample, also one whose controller fails: how it ended."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.own.python_controller import ControllerError
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.judgement import (
    CONTROLLER_FAILED,
    Judgement,
    failure_of,
    least_margin,
)
from afl_mujoco.simulation.sampled.rollouts import Rollouts, run_rollouts
from afl_mujoco.simulation.trajectory import COMPLETED, FALL_ANGLE

FIGURES = (
    "peak_z", "peak_phi", "max_command", "max_force", "iae_z", "iae_phi", "settling_time",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """How one run ended, and its metrics up to then; NaN for a missing one.

    Attributes
    ----------
    outcome
        How it ended: one of `OUTCOMES`, or `CONTROLLER_FAILED`.
    end_time
        When it ended [s]; NaN if the controller failed.
    peak_z, peak_phi, max_command, max_force, iae_z, iae_phi, settling_time
        As in `Rollouts`.
    message
        How the controller failed, if it did.
    requirements
        Judgements of the run by the requirements of its scenario; empty if the controller failed.
    """

    outcome: str
    end_time: float = math.nan
    peak_z: float = math.nan
    peak_phi: float = math.nan
    max_command: float = math.nan
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
    def failure(self) -> str:
        """How the run failed, from `failure_of`; empty if it met every requirement."""
        return failure_of(self.outcome, self.requirements)

    @property
    def passed(self) -> bool:
        """Whether the run met every requirement of its scenario."""
        return not self.failure

    @property
    def margin(self) -> float | None:
        """The least margin of a run that completed; None if it has none."""
        return least_margin(self.requirements) if self.completed else None

    @property
    def settled(self) -> bool:
        """Whether z and phi stayed within the bands of `loop` from some time on."""
        return not math.isnan(self.settling_time)

    def severity(self, duration: float) -> float:
        """Return how bad the run was: up to 1 if it passed, from 1 on if it did not.

        The severity of a run that completed where only that is required is the mean of its largest
        and its average abs(phi), as shares of the angle at which it would have fallen. With
        requirements it is the share of the tightest limit that is used up, or 1 + x / (1 + x) if
        the run exceeds that limit by a share x. The severity of a run that failed by ending early
        is 2 plus the share of it that is missing, so that it is worse than any run that completed.
        A controller that failed is the worst.

        Parameters
        ----------
        duration
            Duration of a whole run [s].
        """
        if self.outcome == CONTROLLER_FAILED:
            return 3.0
        if not (self.passed or self.completed):
            return 3.0 - self.end_time / duration
        tightest = self.robustness
        if tightest is None:
            return 0.5 * (self.peak_phi + self.iae_phi / duration) / FALL_ANGLE
        return 1.0 - tightest if tightest >= 0.0 else 1.0 - tightest / (1.0 - tightest)

    @property
    def robustness(self) -> float | None:
        """The same for a search: a requirement that is never met has a graded one there."""
        if not self.completed:
            return None
        found = [
            one.graded if one.relative is None else one.relative
            for one in self.requirements
            if one.requirement != "completes"
        ]
        return min((x for x in found if x is not None), default=None)


class Settings(NamedTuple):
    """How MuJoCo runs a trial.

    Attributes
    ----------
    integrator
        MuJoCo's integrator, as in `simulate_mujoco`.
    timestep
        Physics step [s], None for the default of `simulate_mujoco`.
    """

    integrator: str = "RK4"
    timestep: float | None = None


def run_trials(
    scenarios: Sequence[Scenario], controller: Controller, settings: Settings
) -> list[Trial]:
    """Run a controller on scenarios; an error in a Python controller fails only that run.

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
