"""The configuration of the Monte Carlo study, and its run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from afl_mujoco.control.names import REFERENCE, SUBJECT
from afl_mujoco.studies.contract import (
    ControllerNames,
    Progress,
    ScenarioName,
    Study,
    silent,
)

if TYPE_CHECKING:
    from afl_mujoco.control.controller import Controller
    from afl_mujoco.scenario.sample_space import SampleSpace
    from afl_mujoco.studies.cube_search import Budget
    from afl_mujoco.studies.monte_carlo.result import Result
    from afl_mujoco.studies.monte_carlo.trial import Settings

LABORATORY = "laboratory"
SAMPLES, QUICK_SAMPLES = 1000, 100
GENERATIONS, QUICK_GENERATIONS = 30, 5


@dataclass(frozen=True, kw_only=True)
class MonteCarlo:
    """Run controllers on the same random hardware samples, then search for the worst case.

    Example: afl-mujoco montecarlo my-rig.toml --controllers adaptive lqr --quick

    The table [ranges] of the scenario file says what varies: start, schedules of M and l within
    bounds and rates, imperfections. A scenario without it gets random laboratory hardware for all
    imperfections that are ideal in it. A run passes if it meets the scenario's requirements or,
    if there are none, survives to the end. The search looks for the sample that fails worst, or
    has the least robustness left. Writes montecarlo.json, figures, and a scenario file for every
    failure, which `afl-mujoco simulate` replays to the same bits. A full run takes about ten
    minutes on two cores.
    """

    scenario: ScenarioName = LABORATORY
    """Scenario by name, or TOML file; laboratory: the paper's plant on random laboratory hardware,
    its M and l changing at random."""
    controllers: ControllerNames = (SUBJECT, REFERENCE)
    samples: int | None = None
    """Number of hardware samples; 1000 by default. Sample i does not depend on the number."""
    seed: int = 1
    """Seed of the samples, their noise and the search."""
    worst_case: bool = True
    """Do not search for the hardest sample and the nearest failure (by CMA-ES)."""
    generations: int | None = None
    """Number of generations of each search, 16 runs each; 30 by default."""
    quick: bool = False
    """100 samples and 5 generations, unless other numbers are given."""
    timestep: float | None = None
    """Physics step of MuJoCo [s]; by default the longest up to 0.001 that divides the control
    period."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, the default of `simulate`, Euler, implicit, implicitfast."""
    keep: int | None = None
    """Number of failures of each controller to keep as scenario files; all by default."""
    film: bool = False
    """Film the hardest sample found for each controller."""


class Request(NamedTuple):
    """What is studied, as `request_of` makes it: space, whether its ranges are assumed, and how."""

    space: SampleSpace
    assumed: bool
    controllers: list[Controller]
    samples: int
    settings: Settings
    budget: Budget


def request_of(configuration: MonteCarlo) -> Request:
    """Return the request of a configuration, or raise."""
    from afl_mujoco.errors import InvalidValueError, require_count
    from afl_mujoco.scenario.files import find_scenario
    from afl_mujoco.scenario.laboratory import with_ranges
    from afl_mujoco.scenario.ranges import FIXED
    from afl_mujoco.scenario.sample_space import SampleSpace

    c = configuration
    asked = find_scenario(c.scenario)
    space = SampleSpace(with_ranges(asked))
    if c.film:
        from afl_mujoco.graphics import require_backend

        if not c.worst_case:
            raise InvalidValueError(
                "film", "shows what the search found: do not give --no-worst-case"
            )
        require_backend()  # before MuJoCo

    from afl_mujoco.control.catalogue import find_controller
    from afl_mujoco.studies.cube_search import Budget
    from afl_mujoco.studies.monte_carlo.campaign import MOST_SAMPLES, require_campaign
    from afl_mujoco.studies.monte_carlo.trial import Settings

    samples = QUICK_SAMPLES if c.quick else SAMPLES
    generations = QUICK_GENERATIONS if c.quick else GENERATIONS
    request = Request(
        space=space,
        assumed=asked.ranges == FIXED,
        controllers=[find_controller(name) for name in c.controllers],
        samples=samples if c.samples is None else c.samples,
        settings=Settings(integrator=c.integrator, timestep=c.timestep),
        budget=Budget(generations=generations if c.generations is None else c.generations),
    )
    require_campaign(
        request.controllers,
        space,
        samples=request.samples,
        seed=c.seed,
        settings=request.settings,
    )
    if c.keep is not None:
        require_count("keep", c.keep, 0, MOST_SAMPLES)
    if c.film:
        from afl_mujoco.films.video import side_by_side

        side_by_side(space.scenario, request.controllers[:1])  # raises if it is too short
    return request


def check(configuration: MonteCarlo) -> None:
    """Raise if the configuration breaks a rule."""
    request_of(configuration)


def run(
    configuration: MonteCarlo,
    *,
    progress: Progress = silent,
    workers: int = 1,
    cluster: str | None = None,
) -> Result:
    """Run the campaign and the searches; the result does not depend on the workers."""
    from afl_mujoco.execution.executors import open_executor
    from afl_mujoco.studies.monte_carlo.campaign import run_campaign
    from afl_mujoco.studies.monte_carlo.result import result_of
    from afl_mujoco.studies.monte_carlo.worst_case import Found, most_runs, search_worst

    space, assumed, controllers, samples, settings, budget = request_of(configuration)
    total = samples * len(controllers)
    found: list[Found] = []
    with open_executor(workers, cluster) as executor:
        progress("sampling", 0, total)
        campaign = run_campaign(
            controllers,
            space,
            samples=samples,
            seed=configuration.seed,
            settings=settings,
            executor=executor,
            progress=lambda done, name: progress(f"sampling: {name}", done, total),
        )
        for controller in controllers if configuration.worst_case else []:
            found += search_worst(
                controller,
                campaign,
                budget=budget,
                executor=executor,
                progress=partial(_search_progress, progress, controller.name, most_runs(budget)),
            )
    asked = dict(
        zip((controller.name for controller in controllers), configuration.controllers, strict=True)
    )
    c = configuration
    kept = {"keep": c.keep, "asked": asked, "film": c.film, "assumed": assumed}
    return result_of(campaign, found, **kept)  # type: ignore[arg-type]


def _search_progress(progress: Progress, controller: str, total: int, done: int) -> None:
    """Report the progress of a search."""
    progress(f"searching the worst case for {controller}", done, total)


STUDY = Study(
    name="montecarlo",
    title="Monte Carlo",
    order=20,
    schema=5,
    configuration=MonteCarlo,
    check=check,
    run=run,
)
