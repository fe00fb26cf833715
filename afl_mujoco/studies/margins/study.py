"""The configuration of the study of margins, and its run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from afl_mujoco.control.names import INFORMED
from afl_mujoco.studies.contract import Progress, ScenarioIfAny, Study, counted, silent

if TYPE_CHECKING:
    from afl_mujoco.studies.margins.result import Result


@dataclass(frozen=True, kw_only=True)
class MarginsConfiguration:
    """Compute gain, phase, disk and delay margins of controllers at upright over a grid of plants.

    Example: afl-mujoco margins my-rig.toml --controllers adaptive lqr

    The loop is linearised by finite differences in MuJoCo. On some of the plants the study also
    measures the delay at which a small motion in MuJoCo grows; of controllers with a memory or an
    estimator, or without slopes, the gains too. Writes margins.json and figures.
    """

    scenario: ScenarioIfAny = None
    """Scenario by name, or TOML file, that gives the plants, the control period and the linear
    imperfections; by default the paper's grid of plants, without imperfections."""
    controllers: tuple[str, ...] = INFORMED
    """Controllers by name, or module:attribute of your own."""
    cart_masses: tuple[float, ...] | None = None
    """Cart masses M of the grid [kg]; the paper's 20, or 5 over the scenario's, by default."""
    half_lengths: tuple[float, ...] | None = None
    """Half-lengths l of the grid [m]; the paper's 20, or 5 over the scenario's, by default."""
    pole_mass: float | None = None
    """m of every plant [kg]; the scenario's, or 0.05, by default."""
    gravity: float | None = None
    """g of every plant [m/s^2]; the scenario's, or 9.81, by default."""
    control_period: float | None = None
    """How long the sampled loop holds the force [s]; the scenario's, or 0.001, by default."""
    timestep: float | None = None
    """Physics step of MuJoCo where motions are measured [s]; by default the longest up to 0.001
    that divides the control period."""
    quick: bool = False
    """Every fourth M and l of the paper, unless given otherwise, and two plants measured."""
    measure: bool = True
    """Do not measure the delay that the loop in MuJoCo tolerates on some plants of the grid."""


def check(configuration: MarginsConfiguration) -> None:
    """Raise if the configuration breaks a rule."""
    from afl_mujoco.studies.margins.survey import request_of

    request_of(configuration)


def run(
    configuration: MarginsConfiguration, *, progress: Progress = silent, workers: int = 1
) -> Result:
    """Survey the margins and measure delays; the result does not depend on the workers."""
    from dataclasses import replace

    from afl_mujoco.errors import AflMujocoError
    from afl_mujoco.studies.margins.measured_delay import (
        Deployment,
        compare_delays,
        measured_plants,
    )
    from afl_mujoco.studies.margins.small_motions import measure_small_motions
    from afl_mujoco.studies.margins.survey import described, request_of, survey_margins

    request, about = request_of(configuration), described(configuration)
    found = replace(survey_margins(*request, workers=workers, progress=progress), **about)
    if not configuration.measure:
        return found
    pairs = measured_plants(found.cart_masses, found.half_lengths, few=configuration.quick)
    plants = [request.plant(*pair) for pair in pairs]
    deployed = Deployment(
        request.control_period, request.imperfections, request.belief, configuration.timestep
    )
    units = [(one, plant, deployed) for one in request.controllers for plant in plants]
    linear = [unit for unit in units if unit[0].name in found.margins]
    units = [unit for unit in units if unit[0].name not in found.margins]
    total = len(linear) + len(units)
    advance = counted(progress, "measuring", total)
    progress("measuring", 0, total)
    measured = compare_delays(linear, workers=workers, progress=advance)
    motions = measure_small_motions(units, workers=workers, progress=advance)
    reasons = dict(found.not_linear)
    for (controller, *_), motion in zip(units, motions, strict=True):
        if isinstance(motion, AflMujocoError):
            reasons[controller.name] = str(motion)
    return replace(
        found,
        measured=tuple(measured),
        not_linear=reasons,
        small_motions=tuple(x for x in motions if not isinstance(x, AflMujocoError)),
    )


STUDY = Study(
    name="margins",
    title="Stability margins",
    order=40,
    schema=4,
    configuration=MarginsConfiguration,
    check=check,
    run=run,
)
