"""Many sampled runs on several threads: how each ended and a few figures, not the whole run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import AflMujocoError
from afl_mujoco.pool import Task, require_threads, share
from afl_mujoco.scenario.files import as_scenarios
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.sampling import SNAP
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.judgement import DWELL, Judgement, failure_of, judge, judge_ending
from afl_mujoco.simulation.mujoco_model import CartPoleModel
from afl_mujoco.simulation.sampled.runs import Timing, perform, prepare, recorded, timing_of
from afl_mujoco.simulation.trajectory import COMPLETED, OUTCOMES, Outcome, Trajectory

_SUMMED = ("peak_z", "peak_phi", "max_command", "max_force", "iae_z", "iae_phi")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rollouts:
    """Outcomes of many runs; every array has one entry per run, in the order of the scenarios.

    Attributes
    ----------
    status
        How each ended: 0 completed, 1 fell, 2 diverged.
    end_time
        When it ended [s].
    peak_z, peak_phi
        Largest abs(z) [m] and abs(phi) [rad] up to then.
    max_command, max_force
        Largest abs(force) that the controller asked for, and that the drive exerted [N].
    iae_z, iae_phi
        Integrals of abs(z) [m s] and abs(phi) [rad s] up to then.
    settling_time
        Time from which abs(z) and abs(phi) stayed within the bands of the requirements [s]; NaN if
        it is less than a second before the end, or the run did not complete.
    stop_time
        When the cart first reached an end stop [s]; NaN if it never did.
    requirements
        How each run meets the requirements of its scenario.
    """

    status: NDArray[np.int64]
    end_time: NDArray[np.float64]
    peak_z: NDArray[np.float64]
    peak_phi: NDArray[np.float64]
    max_command: NDArray[np.float64]
    max_force: NDArray[np.float64]
    iae_z: NDArray[np.float64]
    iae_phi: NDArray[np.float64]
    settling_time: NDArray[np.float64]
    stop_time: NDArray[np.float64]
    requirements: tuple[tuple[Judgement, ...], ...]

    def __len__(self) -> int:
        """Return how many runs there were."""
        return len(self.status)

    def outcome(self, index: int) -> Outcome:
        """Return how one run ended.

        Parameters
        ----------
        index
            Its index.
        """
        return Outcome(OUTCOMES[int(self.status[index])], float(self.end_time[index]))

    def failure(self, index: int) -> str:
        """Return how one run failed, from `failure_of`; empty if it met every requirement.

        Parameters
        ----------
        index
            Its index.
        """
        return failure_of(OUTCOMES[int(self.status[index])], self.requirements[index])

    def settled(self, index: int) -> bool:
        """Return whether one run settled, required or not.

        Parameters
        ----------
        index
            Its index.
        """
        return bool(np.isfinite(self.settling_time[index]))


class Rollout(NamedTuple):
    """One run: how it ended, its figures by name, how it meets its requirements."""

    outcome: Outcome
    figures: dict[str, float]  # fields of `Rollouts`, NaN for a missing one
    requirements: tuple[Judgement, ...]
    trajectory: Trajectory | None  # where it is kept

    @property
    def failure(self) -> str:
        """How it failed, from `failure_of`; empty if it met every requirement."""
        return failure_of(self.outcome.kind, self.requirements)


def run_rollouts(
    scenarios: Scenario | str | Path | Sequence[Scenario | str | Path],
    controller: Any,
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    threads: int = 1,
) -> Rollouts:
    """Run one controller on many scenarios, each as `simulate_mujoco` does in sampled mode.

    A run depends on its scenario alone, which includes its seed: it is the same to the last bit
    with any other runs, on any number of threads, and in `simulate_mujoco` with the same settings.

    Parameters
    ----------
    scenarios
        One or several, with their imperfections.
    controller
        The controller; both as `simulate_mujoco` takes them.
    timestep, control_period, integrator
        As in `simulate_mujoco`.
    threads
        Number of threads, each with its own model. A single thread is that of the caller; so is
        that of a Python controller, which can be stopped there if it hangs.

    Returns
    -------
    Rollouts
        Their outcomes.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    controller, asked = as_controller(controller), as_scenarios(scenarios)
    found = roll_out(
        asked, controller, timestep=timestep, control_period=control_period,
        integrator=integrator, threads=threads,
    )  # fmt: skip
    runs = [one for one in found if isinstance(one, Rollout)]
    names = Rollouts.__slots__[1:-1]
    return Rollouts(
        status=np.array([OUTCOMES.index(run.outcome.kind) for run in runs], dtype=np.int64),
        requirements=tuple(run.requirements for run in runs),
        **{name: np.array([run.figures[name] for run in runs]) for name in names},
    )


def roll_out(
    scenarios: Sequence[Scenario],
    controller: Controller,
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    threads: int = 1,
    keep: bool = False,
    caught: tuple[type[AflMujocoError], ...] = (),
) -> list[Rollout | AflMujocoError]:
    """Return the runs of one controller, or the error of one of the types that are caught.

    With `keep` the runs have their trajectories.
    """
    require_threads(threads)
    found: list[Any] = [None] * len(scenarios)
    settings: Any = {"timestep": timestep, "control_period": control_period}

    def run(model: CartPoleModel, scenario: Scenario) -> Rollout:
        model.set_imperfections(scenario.imperfections, scenario.parameters_at(0.0))
        model.compute_only(scenario.imperfections)
        timing = timing_of(scenario, model, **settings)
        prepared = prepare(scenario, controller, timing)
        asked = scenario.requirements != NONE
        done, rows = perform(model, prepared, controller, record=keep or asked)
        ended = Outcome(OUTCOMES[int(done["status"])], float(timing.times[int(done["step"])]))
        whole = None
        if keep or asked:
            whole = recorded(scenario, controller, timing, done, rows, integrator)
        if asked and whole is not None:
            judged = judge(scenario, whole)
        else:  # which needs no record
            judged = judge_ending(scenario, ended, float(done["peak_z"]))
        return Rollout(ended, _figures(done, timing), judged, whole if keep else None)

    def task_on(model: CartPoleModel) -> Task:
        def run_part(part: slice) -> None:
            for i in range(part.start, part.stop):
                try:
                    found[i] = run(model, scenarios[i])
                except caught as error:
                    found[i] = error

        return run_part

    alone = controller.interpreted  # threads do not speed it up; here it can be stopped
    models = [
        CartPoleModel(NOMINAL, integrator=integrator)
        for _ in range(1 if alone else min(threads, max(len(scenarios), 1)))
    ]
    share(len(scenarios), [task_on(model) for model in models], part=1)
    return found


def _figures(run: Any, timing: Timing) -> dict[str, float]:
    """Return the figures of a run."""
    times, steps, settled = timing.times, int(run["step"]), int(run["unsettled"])
    dwelled = settled <= steps and times[steps] - times[settled] >= DWELL - SNAP * timing.timestep
    completed = OUTCOMES[int(run["status"])] == COMPLETED
    return {
        "end_time": float(times[steps]),
        **{name: float(run[name]) for name in _SUMMED},
        "settling_time": float(times[settled]) if completed and dwelled else math.nan,
        "stop_time": float(times[run["at_stop"]]) if run["at_stop"] >= 0 else math.nan,
    }
