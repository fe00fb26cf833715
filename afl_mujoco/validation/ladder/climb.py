"""Climbing the ladder: what each controller does on each rung, and where it stops holding up."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from afl_mujoco.control.controllers import GainError
from afl_mujoco.control.law import Law
from afl_mujoco.control.user_law.python_law import LawError
from afl_mujoco.scenario.realism import Realism
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.sampled.rollouts import Rollouts, run_rollouts
from afl_mujoco.simulation.trajectory import COMPLETED
from afl_mujoco.validation.ladder.rungs import (
    LADDER,
    TIMESTEP,
    TOGETHER,
    Rung,
    find_rung,
    realism_at,
    rig,
)
from afl_mujoco.validation.ladder.thresholds import Threshold, find_threshold, scan_levels

END_STOP, UNSETTLED, REFUSED = "reached the end stop", "does not settle", "the law failed"
"""Ways to fail besides the outcomes of a run."""

METRICS = ("settling_time", "peak_z", "peak_phi", "max_force", "iae_z", "iae_phi")
"""Figures of a run on the ladder, in SI units, as of `Rollouts`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How the ladder is climbed.

    Attributes
    ----------
    scenarios
        Each level must be survived in all of them.
    seeds
        How many seeds of noise must be survived where there is noise.
    scan
        Levels of the scan of each rung; and how many levels beside the threshold of survival, half
        the tolerance apart, must be survived.
    tolerance
        Relative width to which bisection narrows a threshold [1].
    integrator
        MuJoCo's.
    """

    scenarios: tuple[Scenario, ...]
    seeds: int = 4
    scan: int = 13
    tolerance: float = 0.02
    integrator: str = "RK4"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What became of one law at one level, over all scenarios and seeds.

    Attributes
    ----------
    level
        The level.
    survives
        Whether no pole fell, no run diverged and no cart reached an end stop.
    settles
        Whether every run survived and ended within the bands of `rig.loop`.
    failure
        How the first run failed, survival before settling; empty if none did.
    scenario, time
        Which that was, and when it ended or reached the stop [s]; None if none failed.
    metrics
        The largest of each of `METRICS` over the runs; None where a run has none.
    message
        What a law said that has no force for what it is told; empty for all others.
    """

    level: float
    survives: bool
    settles: bool
    failure: str
    scenario: str | None
    time: float | None
    metrics: dict[str, float | None]
    message: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rise:
    """One law on one rung.

    Attributes
    ----------
    rung, controller
        Their names.
    typical
        At the level of a good laboratory rig.
    survives, settles
        Up to where the law survives, and settles.
    failure
        What happens at the least level found at which it does not survive; None if it always does.
    """

    rung: str
    controller: str
    typical: Verdict
    survives: Threshold
    settles: Threshold
    failure: Verdict | None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


Unit = tuple[str, Law, Settings]


def climb(unit: Unit) -> Rise:
    """Return one law's threshold on one rung.

    Parameters
    ----------
    unit
        Name of the rung, the law, the settings.
    """
    name, law, settings = unit
    rung = find_rung(name)

    @functools.cache
    def at(level: float) -> Verdict:
        real = [realism_at(rung, level, seed) for seed in seeds(rung.seeded, settings)]
        return judge(level, real, rung.timestep, law, settings)

    def threshold(holds: Callable[[float], bool], closer: int = 0) -> Threshold:
        scan = scan_levels(rung.benign, rung.harsh, settings.scan)
        return find_threshold(holds, scan, settings.tolerance, rung.snapped, closer=closer)

    survives = threshold(lambda level: at(level).survives, settings.scan)
    return Rise(
        rung=rung.name,
        controller=law.name,
        typical=at(rung.typical),
        survives=survives,
        settles=threshold(lambda level: at(level).settles),
        failure=None if survives.fails_at is None else at(survives.fails_at),
    )


def climb_together(unit: tuple[Law, Settings]) -> list[Verdict]:
    """Return what happens to one law as the typical rungs are switched on one after another.

    Parameters
    ----------
    unit
        The law and the settings.

    Returns
    -------
    list of Verdict
        The n-th has the first n rungs of `climbed`; its level is n.
    """
    law, settings = unit
    found = []
    for count in range(1, len(climbed()) + 1):
        below = climbed()[:count]
        chance = seeds(any(rung.seeded for rung in below), settings)
        real = [rig(1.0, below, seed) for seed in chance]
        found.append(judge(float(count), real, TIMESTEP, law, settings))
    return found


def climbed() -> tuple[Rung, ...]:
    """Return the rungs that are switched on one after another, the rail last."""
    return tuple(rung for rung in LADDER if not rung.name.endswith("-under"))


def seeds(seeded: bool, settings: Settings) -> range:
    """Return the seeds that must be survived.

    Parameters
    ----------
    seeded
        Whether chance plays a part.
    settings
        Say how many.
    """
    return range(settings.seeds if seeded else 1)


def judge(
    level: float, real: Sequence[Realism], timestep: float, law: Law, settings: Settings
) -> Verdict:
    """Run a law in every scenario with everything that may depart from the ideal.

    Parameters
    ----------
    level
        For the verdict.
    real
        Departures from the ideal; all must be survived.
    timestep
        MuJoCo's [s].
    law, settings
        As of `climb`.
    """
    scenarios = [replace(s, realism=r) for s in settings.scenarios for r in real]
    try:
        runs = run_rollouts(scenarios, law, timestep=timestep, integrator=settings.integrator)
    except (LawError, GainError) as error:
        return _refused(level, str(error))
    failures = [_failure(runs, i) for i in range(len(runs))]
    fatal = [failure not in ("", UNSETTLED) for failure in failures]
    worst = min(range(len(runs)), key=lambda i: (not fatal[i], not failures[i]))
    stopped = failures[worst] == END_STOP
    ended = float((runs.stop_time if stopped else runs.end_time)[worst])
    return Verdict(
        level=level,
        survives=not any(fatal),
        settles=not any(failures),
        failure=failures[worst],
        scenario=scenarios[worst].name if failures[worst] else None,
        time=ended if failures[worst] else None,
        metrics={name: _largest(getattr(runs, name).tolist()) for name in METRICS},
    )


def _refused(level: float, message: str) -> Verdict:
    """Return the verdict on a law that has no force for what it is told."""
    nothing: dict[str, float | None] = dict.fromkeys(METRICS)
    return Verdict(
        level=level, survives=False, settles=False, failure=REFUSED, scenario=None, time=None,
        metrics=nothing, message=message,
    )  # fmt: skip


def _failure(runs: Rollouts, index: int) -> str:
    """Return how a run failed; empty if it did not."""
    outcome = runs.outcome(index)
    if math.isfinite(runs.stop_time[index]):
        return END_STOP
    if outcome.kind != COMPLETED:
        return outcome.kind
    return "" if math.isfinite(runs.settling_time[index]) else UNSETTLED


def _largest(values: Sequence[float]) -> float | None:
    """Return the largest of some numbers, None if one is not finite."""
    return max(values) if all(math.isfinite(value) for value in values) else None


def rung_names(chosen: Sequence[str]) -> tuple[str, ...]:
    """Return the rungs to climb, all and the whole rig by default.

    Parameters
    ----------
    chosen
        Names; none for all.

    Raises
    ------
    UnknownNameError
        If one is not known.
    """
    if not chosen:
        return (*(rung.name for rung in LADDER), TOGETHER.name)
    return tuple(find_rung(name).name for name in chosen)
