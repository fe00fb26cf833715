"""The configuration of the study of thresholds, and its run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from afl_mujoco.control.names import AFL, BASELINES, ESTIMATED, SUBJECT
from afl_mujoco.studies.contract import ControllerNames, Progress, ScenarioNames, Study, silent
from afl_mujoco.studies.thresholds.imperfections import KNOWN

if TYPE_CHECKING:
    from afl_mujoco.studies.thresholds.result import Result

CONTROLLERS = (
    *(name for name in AFL if name != "fixed-nominal"),
    f"{SUBJECT}{ESTIMATED}",
    *BASELINES,
)
"""Controllers that are studied by default."""

DEFAULT, QUICK = (4, 13, 0.02), (2, 7, 0.2)
"""Seeds, levels of the scan and tolerance, unless given otherwise."""


ImperfectionNames = Annotated[
    tuple[str, ...],
    tyro.conf.arg(help=f"Imperfections by name: {', '.join(KNOWN)}; all of these by default."),
]


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Find how much delay, noise, friction and so on each controller survives in MuJoCo.

    Example: afl-mujoco thresholds step-step --controllers adaptive lqr --imperfections delay noise

    Each imperfection is one departure from the ideal loop. For each of them the study runs the
    level of the reference hardware (good but ordinary laboratory equipment), and finds by
    bisection the level from which the pole falls, the run diverges or the cart reaches an end
    stop or, where a scenario has requirements, one of these is missed. It then does the same with
    all imperfections combined. Writes thresholds.json and figures. A full run takes about ten
    minutes on two cores.
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name, or TOML files: each level must be survived in all of them; step-step by
    default."""
    controllers: ControllerNames = CONTROLLERS
    imperfections: ImperfectionNames = ()
    seeds: int | None = None
    """Number of noise seeds, all of which must be survived; 4 by default."""
    scan: int | None = None
    """Number of levels in the scan before bisection; 13 by default."""
    tolerance: float | None = None
    """Relative width to which bisection narrows a threshold; 0.02 by default."""
    quick: bool = False
    """2 seeds, 7 levels and a tolerance of 0.2, unless given otherwise."""
    timestep: float | None = None
    """Physics step of MuJoCo [s]; by default the longest up to 0.001 that divides the control
    period."""
    integrator: str = "RK4"
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast."""


def check(configuration: Thresholds) -> None:
    """Raise if the configuration breaks a rule."""
    from afl_mujoco.studies.thresholds.sweep import request_of

    request_of(configuration)


def run(
    configuration: Thresholds,
    *,
    progress: Progress = silent,
    workers: int = 1,
    cluster: str | None = None,
) -> Result:
    """Find the thresholds; workers and cluster do not change a bit of them."""
    from afl_mujoco.studies.thresholds.sweep import find_thresholds, request_of

    request = request_of(configuration)
    return find_thresholds(*request, workers=workers, cluster=cluster, progress=progress)


STUDY = Study(
    name="thresholds",
    title="Imperfection thresholds",
    order=10,
    schema=5,
    configuration=Thresholds,
    check=check,
    run=run,
)
