"""What the study of thresholds finds."""

from __future__ import annotations

from dataclasses import dataclass, field

from afl_mujoco.scenario.imperfections import Imperfection
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.bisection import Threshold
from afl_mujoco.studies.delay_margin import LeastMargin
from afl_mujoco.studies.thresholds.imperfections import TIMESTEP

END_STOP, UNSETTLED, REFUSED = "reached the end stop", "does not settle", "no force"
"""Ways to fail besides the outcomes of a run."""

MISSES = "misses "
"""Before the requirement that a run misses."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The outcome of one controller at one level, over all scenarios and seeds.

    Attributes
    ----------
    level
        The level.
    survives
        Whether no pole fell, no run diverged and no cart reached an end stop; where the scenario
        has requirements, whether they were met.
    settles
        Whether every run survived and ended within the bands of `sampled.loop`; where the scenario
        has requirements, the same as survival.
    failure
        How the first run failed, survival before settling; empty if none did.
    scenario, time
        Which that was, and when it ended or reached the stop [s]; None if none failed, or what it
        missed is a requirement on the whole run.
    metrics
        The largest of each of `sweep.METRICS` over the runs; None where a run has none.
    message
        Why a controller computed no force; empty for all others.
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
class Sweep:
    """One controller under one imperfection.

    Attributes
    ----------
    imperfection, controller
        Their names.
    reference
        At the level of the reference hardware.
    survives, settles
        Up to where the controller survives, and settles.
    failure
        At the least level found at which it does not survive; None if it always does.
    """

    imperfection: str
    controller: str
    reference: Verdict
    survives: Threshold
    settles: Threshold
    failure: Verdict | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How thresholds are searched.

    Attributes
    ----------
    scenarios
        Names of the scenarios, in all of which each level must be survived.
    seeds
        How many seeds of noise must be survived where there is noise.
    scan
        Levels of the scan of each imperfection; and how many levels beside the threshold of
        survival, half the tolerance apart, must be survived.
    tolerance
        Relative width to which bisection narrows a threshold [1].
    integrator, timestep
        MuJoCo's, the step [s] where the imperfection does not set it.
    """

    scenarios: tuple[str, ...] = ()
    seeds: int = 4
    scan: int = 13
    tolerance: float = 0.02
    integrator: str = "RK4"
    timestep: float = TIMESTEP


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Thresholds of every controller under every imperfection.

    Attributes
    ----------
    settings
        How they were searched.
    controllers, imperfections
        In their order; of the controllers those that survive without any imperfection added.
    failing
        The others, with what becomes of them.
    sweeps
        Each controller under each imperfection, by imperfection and then by controller.
    added
        Names of the imperfections that were added one after another, at their reference level.
    combined
        By controller, the verdict with the first, the first two ... of `added`; empty if all
        combined was not asked for.
    scenarios
        In all of which each level must be survived.
    delay_margins
        Least delay margin of the linearised loop of each controller over the plants of the
        scenarios, if the delay was among the imperfections and they have none of their own; not of
        a controller with the
        estimator, nor of a Python controller, which may be stateful.
    """

    settings: Settings
    controllers: tuple[str, ...]
    imperfections: tuple[Imperfection, ...]
    sweeps: tuple[Sweep, ...]
    added: tuple[str, ...]
    combined: dict[str, tuple[Verdict, ...]]
    delay_margins: tuple[LeastMargin, ...]
    scenarios: tuple[Scenario, ...] = ()
    failing: dict[str, Verdict] = field(default_factory=dict)

    @property
    def endless(self) -> bool:
        """Whether no scenario has an end to its rail."""
        return all(one.imperfections.rail_half_length is None for one in self.scenarios)

    @property
    def required(self) -> bool:
        """Whether a scenario has requirements, by which its runs are judged."""
        return any(scenario.requirements != NONE for scenario in self.scenarios)

    def imperfection(self, name: str) -> Imperfection | None:
        """Return an imperfection by its name, None if it was not studied."""
        return next((one for one in self.imperfections if one.name == name), None)

    def sweep(self, imperfection: str, controller: str) -> Sweep:
        """Return one controller under one imperfection, by their names."""
        names = [one.name for one in self.imperfections]
        row, column = names.index(imperfection), self.controllers.index(controller)
        return self.sweeps[row * len(self.controllers) + column]
