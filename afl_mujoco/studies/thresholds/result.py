"""What the study of thresholds finds."""

from __future__ import annotations

from dataclasses import dataclass, field

from afl_mujoco.scenario.imperfections import Imperfection
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.bisection import Threshold
from afl_mujoco.studies.delay_margin import LeastMargin


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The outcome of one controller at one level, over all scenarios and seeds.

    Attributes
    ----------
    level
        The level.
    survives
        Whether every run met the requirements of its scenario.
    settles
        Whether every run survived and, where the scenario has no requirements, settled.
    failure
        How the first failed run failed, from `failure_of`; empty if none failed.
    scenario, time
        Scenario of that run, or else of the first that did not settle, and when it fell, diverged
        or reached the end stop [s]; None if there is none.
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
        Verdict at the level of the reference hardware.
    survives, settles
        Thresholds up to which the controller survives, and settles.
    failure
        Verdict at the mildest level found at which it does not survive; None if it always does.
    applies
        Whether it acts on the controller at all: what is wrong about a belief does not where the
        force does not depend on it.
    """

    imperfection: str
    controller: str
    reference: Verdict
    survives: Threshold
    settles: Threshold
    failure: Verdict | None
    applies: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How thresholds are searched.

    Attributes
    ----------
    scenarios
        Names of the scenarios; each level must be survived in all of them.
    seeds
        How many seeds of noise must be survived where there is noise.
    scan
        Number of levels in the scan of each imperfection; also the number of levels beside the
        threshold of survival, half the tolerance apart, that must be survived.
    tolerance
        Relative width to which bisection narrows a threshold [1].
    integrator, timestep
        MuJoCo's integrator, and its step [s], None for the default of each control period.
    """

    scenarios: tuple[str, ...] = ()
    seeds: int = 4
    scan: int = 13
    tolerance: float = 0.02
    integrator: str = "RK4"
    timestep: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Thresholds of every controller under every imperfection.

    Attributes
    ----------
    settings
        How they were searched.
    controllers, imperfections
        In their order; only controllers that survive without any added imperfection.
    bare
        Verdicts on them with nothing added, in their order.
    failing
        Verdicts on the other controllers, by name.
    sweeps
        Each controller under each imperfection, by imperfection and then by controller.
    added
        Names of the imperfections that were added one after another, at their reference level.
    combined
        By controller, the verdicts with the first imperfection of `added`, with the first two,
        and so on; empty if the combination of all was not asked for.
    scenarios
        The scenarios; each level must be survived in all of them.
    delay_margins
        Least delay margin of the linearised loop of each controller over the plants of the
        scenarios; only if the delay was among the imperfections and the scenarios have no
        imperfections of their own. Controllers with the estimator, and Python controllers, which
        may be stateful, have none.
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
    bare: tuple[Verdict, ...] = ()

    @property
    def endless(self) -> bool:
        """Whether the rail of every scenario is endless."""
        return all(one.imperfections.rail_half_length is None for one in self.scenarios)

    @property
    def required(self) -> bool:
        """Whether a scenario has requirements, by which its runs are judged."""
        return any(scenario.requirements != NONE for scenario in self.scenarios)

    @property
    def settling(self) -> bool:
        """Whether a scenario has none, so that to survive is less than to settle."""
        return not self.scenarios or any(one.requirements == NONE for one in self.scenarios)

    def imperfection(self, name: str) -> Imperfection | None:
        """Return an imperfection by its name, None if it was not studied."""
        return next((one for one in self.imperfections if one.name == name), None)

    def sweep(self, imperfection: str, controller: str) -> Sweep:
        """Return one controller under one imperfection, by their names."""
        names = [one.name for one in self.imperfections]
        row, column = names.index(imperfection), self.controllers.index(controller)
        return self.sweeps[row * len(self.controllers) + column]
