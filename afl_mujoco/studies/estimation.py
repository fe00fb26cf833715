"""Find how well M and l are estimated online, at what cost."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.names import ESTIMATED as SUFFIX
from afl_mujoco.control.names import SUBJECT
from afl_mujoco.errors import InvalidValueError, UnknownNameError, require_count
from afl_mujoco.report.blocks import Cell, Figure, Matrix, Report, fixed, short
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import Deployed, ticks_of
from afl_mujoco.simulation.trajectory import COMPLETED
from afl_mujoco.studies.shared.arrays import Array
from afl_mujoco.studies.shared.contract import Progress, ScenarioNames, Study, compute, silent
from afl_mujoco.studies.shared.run import Rows, numbered, run_all, run_kept, run_of
from afl_mujoco.values import require_distinct

if TYPE_CHECKING:
    from afl_mujoco.simulation.sampled.runs import EstimatedRun

CASES = ("step-step", "step-trapezoid", "trapezoid-step", "trapezoid-trapezoid")
"""The paper's four schedules."""

NOISE = Imperfections(noise={"z": 1e-4, "phi": 5e-4})
"""The usual noise: 0.1 mm and 0.5 mrad, as from encoders of 0.35 mm and 3600 counts per turn."""

SEEDS, QUICK_SEEDS, MOST_SEEDS = 8, 2, 1000

TRUE, NOMINAL, ESTIMATED = "true", "nominal", "estimated"
"""Kinds of M and l that a controller assumes."""

OFF = 0.2  # by which share an estimate is wrong when it counts as off

UNTIL, EVERY = 12.0, 4
"""End of the curves that are kept [s], after which nothing happens; every so many instants."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Find how well M and l are estimated online, and what this costs the closed loop.

    Example: afl-mujoco estimation step-step --seeds 2

    The controller takes M, l and the state from an extended Kalman filter, which uses the measured
    z and phi and the commanded force. Writes estimation.json, an npz of curves and figures.
    """

    scenarios: ScenarioNames = ()
    """Scenarios of the paper by name; its four schedules by default."""
    controller: str = SUBJECT
    """Controller by name, without -estimated."""
    seeds: int | None = None
    """Number of runs with noise, each with its own seed; 8 by default."""
    timestep: float | None = None
    """Physics step of MuJoCo, and control period [s]; 0.001 by default."""
    quick: bool = False
    """2 seeds, unless a number is given."""


class Request(NamedTuple):
    """What is run."""

    scenarios: Sequence[Scenario]
    controller: Controller  # the estimator is put before it
    seeds: int = SEEDS
    timestep: float | None = None  # [s]


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    from afl_mujoco.control.catalogue import find_controller

    o = options
    seeds = (QUICK_SEEDS if o.quick else SEEDS) if o.seeds is None else o.seeds
    require_count("seeds", seeds, 1, MOST_SEEDS)
    controller = find_controller(o.controller)
    if controller.estimates or controller.interpreted or controller.belief is not None:
        rule = "must be a compiled controller that takes M and l: the study estimates them"
        raise InvalidValueError(f"controller {o.controller!r}", rule)
    names = o.scenarios or CASES
    for name in names:
        if name not in SCENARIOS:
            raise UnknownNameError.among("the cart-pole's scenario", name, SCENARIOS)
    require_distinct("scenario", names)
    scenarios = [SCENARIOS[name] for name in names]
    for scenario in scenarios:
        ticks_of(scenario, o.timestep)
    return Request(scenarios, controller, seeds, o.timestep)


# --- what is found ------------------------------------------------------------------------------

Curves = dict[str, dict[str, tuple[Array, Array]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """Runs of one loop, one for each seed of the noise."""

    parameters: str  # that the controller assumes: `TRUE`, `NOMINAL` or `ESTIMATED`
    noise: bool  # of the sensors
    runs: Rows
    # share of each run for which M and l are off by more than `OFF`; of estimates with noise alone
    off: tuple[tuple[float, float], ...] = ()

    @property
    def median_off(self) -> list[float | None]:
        """The medians of these shares, of M and of l."""
        return [statistics.median(x) for x in zip(*self.off, strict=True)] or [None, None]

    @property
    def completed(self) -> int:
        """How many of the runs completed."""
        return sum(run.outcome == COMPLETED for run in self.runs)

    def median(self, metric: str) -> float | None:
        """Return the median of a metric; None if a run did not complete."""
        known = [x for run in self.runs if (x := run.metrics[metric]) is not None]
        return statistics.median(known) if len(known) == self.completed == len(self.runs) else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """What was found on one schedule."""

    scenario: str
    loops: tuple[Loop, ...]
    # by quantity, what is true and what is estimated up to `UNTIL`: instants [s] and values. Those
    # estimated are of the first seed, the true angle is of the loop without noise
    curves: Curves

    @property
    def costs(self) -> list[float | None]:
        """∫|φ| dt of each noisy run over that with the true M and l; None if one ends early."""
        found = {(one.parameters, one.noise): one for one in self.loops}
        (true,) = (run.metrics["iae_phi"] for run in found[TRUE, False].runs)
        noisy = (run.metrics["iae_phi"] for run in found[ESTIMATED, True].runs)
        return [x / true if x is not None and true else None for x in noisy]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """How M and l are followed, and what estimation costs the closed loop."""

    controller: str  # name that it has with the true parameters
    cases: tuple[Case, ...]  # the schedules


# --- the runs -----------------------------------------------------------------------------------


def run(request: Request, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Run every schedule; the result does not depend on the workers."""
    units = [request._replace(scenarios=[scenario]) for scenario in request.scenarios]
    cases = compute(run_case, units, "estimating", progress, workers)
    return Result(controller=request.controller.name, cases=tuple(cases))


def run_case(unit: Request) -> Case:
    """Run the only schedule of a request, the force held over each physics step."""
    from afl_mujoco.control.catalogue import CONTROLLERS
    from afl_mujoco.control.estimator import EstimatedController
    from afl_mujoco.simulation.sampled.runs import simulate_estimated

    (scenario,), controller, seeds, step = unit
    estimating = EstimatedController(name=f"{controller.name}{SUFFIX}", controller=controller)
    noisy = [
        replace(scenario, imperfections=replace(NOISE, seed=NOISE.seed + seed))
        for seed in range(seeds)
    ]
    deployed = Deployed(timestep=step)
    ((true, oracle),) = run_kept(controller, [scenario], deployed)
    followed = [simulate_estimated(one, estimating, deployed) for one in noisy]
    observed = [run_of(one, estimating, x.run) for one, x in zip(noisy, followed, strict=True)]
    runs = {
        (TRUE, False): [true],
        (TRUE, True): run_all(controller, noisy, deployed),
        (ESTIMATED, False): run_all(estimating, [scenario], deployed),
        (ESTIMATED, True): observed,
    }
    if (nominal := CONTROLLERS.get(f"{controller.name}-nominal")) is not None:
        runs[NOMINAL, False] = run_all(nominal, [scenario], deployed)
    off = tuple(_off(scenario, one) for one in followed)
    loops = [
        Loop(
            parameters=parameters, noise=noise, runs=tuple(numbered(some)),
            off=off if (parameters, noise) == (ESTIMATED, True) else (),
        )
        for (parameters, noise), some in runs.items()
    ]  # fmt: skip
    found, first = followed[0], followed[0].run
    oracle = oracle or first
    part, mine, its = (
        (time <= UNTIL).nonzero()[0][::EVERY] for time in (found.time, first.time, oracle.time)
    )
    time = found.time[part]
    pairs = {
        "cart mass M [kg]": ((time, scenario.cart_mass(time)), (time, found.cart_mass[part])),
        "half-length l [m]": ((time, scenario.half_length(time)), (time, found.half_length[part])),
        "pole angle φ [rad]": (
            (oracle.time[its], oracle.state[its, 1]), (first.time[mine], first.state[mine, 1])
        ),
    }  # fmt: skip
    curves = {label: {TRUE: a, ESTIMATED: b} for label, (a, b) in pairs.items()}
    return Case(scenario=scenario.name, loops=tuple(loops), curves=curves)


def _off(scenario: Scenario, one: EstimatedRun) -> tuple[float, float]:
    """Return for which share of a run M and l are off by more than `OFF`."""
    pairs = (one.cart_mass, scenario.cart_mass), (one.half_length, scenario.half_length)
    mass, length = (np.mean(np.abs(x / of(one.time) - 1.0) > OFF) for x, of in pairs)
    return float(mass), float(length)


# --- what is shown ------------------------------------------------------------------------------


def report(result: Result) -> Report:
    """Return what is shown of estimation."""
    cases = result.cases
    loops = [{(loop.parameters, loop.noise): loop for loop in case.loops} for case in cases]
    noisy = [one[ESTIMATED, True] for one in loops]
    costs = [cost for case in cases for cost in case.costs]
    headline = (
        f"{result.controller} with estimated M and l completes "
        f"{sum(loop.completed for loop in noisy)} of "
        f"{sum(len(loop.runs) for loop in noisy)} noisy runs"
    )
    if known := [cost for cost in costs if cost is not None]:
        most = f"at most {short(max(known), 3)} times that with the true M and l"
        headline += f" · ∫|φ| dt {most}" + ", where it completes" * (len(known) < len(costs))
    shares = [x for loop in noisy for pair in loop.off for x in pair]
    headline += f" · M or l over {100 * OFF:.0f} % off for up to {100 * max(shares):.0f} % of a run"
    case = cases[0]
    figure = Figure(
        name="estimation",
        title=f"M and l estimated on {case.scenario}",
        caption=f"{result.controller} with {1e3 * NOISE.at('noise.z'):g} mm and "
        f"{1e3 * NOISE.at('noise.phi'):g} mrad of noise on z and φ; beside it, the same "
        "controller with the true M and l and without noise.",
        draw=partial(_draw, case.curves),
    )
    return Report(headline=headline, blocks=[figure, _loops(result)])


def _loops(result: Result) -> Matrix:
    return Matrix(
        caption="Cost of the loop by the M and l that are assumed: medians; off is a share of the "
        f"run, by more than {100 * OFF:.0f} %",
        columns=[
            "Scenario", "M and l", "Completed", "∫|z| dt [m s]", "∫|φ| dt [rad s]", "Force [N]",
            "M off [%]", "l off [%]",
        ],
        rows=[
            [
                case.scenario, loop.parameters + ", noise" * loop.noise,
                Cell(f"{loop.completed} of {len(loop.runs)}",
                     "bad" if loop.completed < len(loop.runs) else ""),
                fixed(loop.median("iae_z"), 2), fixed(loop.median("iae_phi"), 3),
                fixed(loop.median("max_force"), 1),
                *(fixed(None if x is None else 100.0 * x, 0) for x in loop.median_off),
            ]
            for case in result.cases
            for loop in case.loops
        ],
    )  # fmt: skip


def _draw(made: Curves) -> Any:
    from afl_mujoco.report.figures import Panel, curves

    ends = [float(time[-1]) for pair in made.values() for time, _ in pair.values()]
    panels = [Panel(label=label, curves=pair) for label, pair in made.items()]
    return curves(panels, 0.999 * max(ends))  # a cross is only where a run ended early


STUDY = Study(
    module=__name__, name="estimation", title="M and l estimated online", order=50, schema=7
)
