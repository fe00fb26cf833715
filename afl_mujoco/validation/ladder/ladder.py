"""The realism ladder: every law on every rung, one at a time and together."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from afl_mujoco.control.estimation.estimated_law import EstimatedLaw
from afl_mujoco.control.law import Law
from afl_mujoco.control.user_law.python_law import PythonLaw
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.execution.executors import compute_all, open_executor
from afl_mujoco.scenario.parameters import require_distinct
from afl_mujoco.scenario.realism import IDEAL
from afl_mujoco.scenario.sampling import whole_steps
from afl_mujoco.simulation.mujoco_model import INTEGRATORS
from afl_mujoco.validation.ladder.climb import (
    Rise,
    Settings,
    Verdict,
    climb,
    climb_together,
    climbed,
    rung_names,
)
from afl_mujoco.validation.ladder.rungs import TIMESTEP, find_rung
from afl_mujoco.validation.margins.delay import LeastMargin, least_margin

_DELAY = "delay"
_PLAIN = ("name", "title", "unit", "scale", "typical", "benign", "harsh", "seeded", "quantum")


@dataclass(frozen=True, slots=True, kw_only=True)
class Ladder:
    """What was found.

    Attributes
    ----------
    controllers, rungs
        Names, in their order.
    settings
        How it was climbed.
    rises
        Each law on each rung, by rung and then by controller.
    together
        By controller, the verdicts as the typical rungs of `climbed` are switched on in turn.
    margins
        Least delay margin of the linearised loop of each law over the plants of the scenarios, if
        the rung of the delay was climbed; not of a law that an estimator tells, nor of one in
        Python, which may remember.
    """

    controllers: tuple[str, ...]
    rungs: tuple[str, ...]
    settings: Settings
    rises: tuple[Rise, ...]
    together: tuple[tuple[Verdict, ...], ...]
    margins: tuple[LeastMargin, ...]

    def rise(self, rung: str, controller: str) -> Rise:
        """Return one law on one rung.

        Parameters
        ----------
        rung, controller
            Their names.
        """
        place = self.rungs.index(rung) * len(self.controllers) + self.controllers.index(controller)
        return self.rises[place]

    def to_dict(self) -> dict[str, Any]:
        """Return the ladder as plain data."""
        s = self.settings
        return {
            "settings": {
                "scenarios": [scenario.name for scenario in s.scenarios],
                "seeds": s.seeds,
                "scan": s.scan,
                "tolerance": s.tolerance,
                "integrator": s.integrator,
                "timestep": TIMESTEP,
            },
            "controllers": list(self.controllers),
            "rungs": [_rung_as_data(name) for name in self.rungs],
            "rises": [rise.to_dict() for rise in self.rises],
            "together": {
                "rungs": [rung.name for rung in climbed()],
                "verdicts": {
                    name: [asdict(verdict) for verdict in verdicts]
                    for name, verdicts in zip(self.controllers, self.together, strict=True)
                },
            },
            "delay_margins": [asdict(margin) for margin in self.margins],
        }


def _rung_as_data(name: str) -> dict[str, Any]:
    """Return a rung as plain data."""
    rung = find_rung(name)
    plain = {key: getattr(rung, key) for key in _PLAIN}
    return {**plain, "less_is_worse": rung.less_is_worse, "sets": [*rung.fields, *rung.switches]}


def unit_count(controllers: Sequence[Law], rungs: Sequence[str]) -> int:
    """Return how often `run_ladder` reports progress.

    Parameters
    ----------
    controllers, rungs
        As of `run_ladder`.
    """
    return len(controllers) * (len(rung_names(rungs)) + 1)


def run_ladder(
    controllers: Sequence[Law],
    settings: Settings,
    rungs: Sequence[str] = (),
    *,
    workers: int = 1,
    cluster: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Ladder:
    """Climb the ladder with some laws.

    Parameters
    ----------
    controllers
        The laws.
    settings
        How.
    rungs
        Names; none for all and the whole rig.
    workers, cluster
        Who computes, as of `open_executor`; the result does not depend on it.
    progress
        Called with how many units are done, of `unit_count`.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule, or a law cannot be run.
    """
    names = require_climbable(controllers, settings, rungs)
    units = [(name, law, settings) for name in names for law in controllers]
    done = itertools.count(1)
    with open_executor(workers, cluster) as executor:
        rises = compute_all(climb, units, executor, lambda i: progress(next(done)))
        pairs = [(law, settings) for law in controllers]
        together = compute_all(climb_together, pairs, executor, lambda i: progress(next(done)))
        linear = [law for law in controllers if not isinstance(law, EstimatedLaw | PythonLaw)]
        plants = [(law, settings.scenarios) for law in linear if _DELAY in names]
        margins = compute_all(least_margin, plants, executor)
    return Ladder(
        controllers=tuple(law.name for law in controllers),
        rungs=names,
        settings=settings,
        rises=tuple(rises),
        together=tuple(tuple(verdicts) for verdicts in together),
        margins=tuple(margin for margin in margins if margin is not None),
    )


def require_climbable(
    controllers: Sequence[Law], settings: Settings, rungs: Sequence[str], workers: int = 1
) -> tuple[str, ...]:
    """Return the names of the rungs, or raise at what breaks a rule, before anything is run.

    Parameters
    ----------
    controllers, settings, rungs, workers
        As of `run_ladder`.

    Raises
    ------
    AflMujocoError
        See above.
    """
    names = rung_names(rungs)
    require_distinct("controller", [law.name for law in controllers])
    require_distinct("scenario", [scenario.name for scenario in settings.scenarios])
    require_distinct("rung", names)
    counts = (("seeds", settings.seeds, 1), ("scan", settings.scan, 2), ("workers", workers, 1))
    for name, count, least in counts:
        if count < least:
            raise InvalidValueError(name, f"must be at least {least}", count)
    if not 1e-4 <= settings.tolerance <= 1.0:
        raise InvalidValueError("tolerance", "must lie in 1e-4 to 1", settings.tolerance)
    if settings.integrator not in INTEGRATORS:
        raise UnknownNameError.among("integrator", settings.integrator, INTEGRATORS)
    for scenario in settings.scenarios:
        if scenario.realism != IDEAL:
            rule = "must be ideal: what departs from it is for the rungs to say"
            raise InvalidValueError(f"scenario {scenario.name!r}", rule)
        whole_steps("duration", scenario.duration, "timestep", TIMESTEP)
    return names
