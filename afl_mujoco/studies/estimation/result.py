"""What the study of estimation finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.studies.arrays import Array
from afl_mujoco.studies.estimation.loops import Loop, Runs, Unit, run_case
from afl_mujoco.studies.estimation.tracking import FOUND, WINDOWS, Tracking

UNTIL, EVERY = 12.0, 4
"""End of the curves that are kept [s], after which nothing happens; every so many instants."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """The curves that are drawn for one schedule, up to `UNTIL`.

    Attributes
    ----------
    time
        Instants of the estimates [s].
    cart_mass, half_length, true_cart_mass, true_half_length
        Estimated and true M [kg] and l [m] at these instants.
    estimated_time, estimated_angle
        Instants [s] and pole angle [rad] of the loop with the estimator and noise.
    true_time, true_angle
        Instants [s] and pole angle [rad] of the loop with the true parameters, without noise.
    """

    time: Array
    cart_mass: Array
    half_length: Array
    true_cart_mass: Array
    true_half_length: Array
    estimated_time: Array
    estimated_angle: Array
    true_time: Array
    true_angle: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """What was found on one schedule.

    Attributes
    ----------
    scenario
        Its name.
    cart_mass, half_length
        How M and l were tracked under noise, one for each seed.
    loops
        The cost of each loop.
    curves
        The curves that are drawn.
    """

    scenario: str
    cart_mass: tuple[Tracking, ...]
    half_length: tuple[Tracking, ...]
    loops: tuple[Loop, ...]
    curves: Curves


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """How well M and l are tracked, and what estimation costs the closed loop.

    Attributes
    ----------
    controller
        Name that the controller has with the true parameters.
    windows
        Names of the time windows over which errors are judged.
    found_within
        Relative error within which a step counts as found [1].
    noise_z, noise_phi
        Noise of the sensors in the noisy runs [m, rad].
    cases
        The schedules.
    """

    controller: str
    windows: tuple[str, ...]
    found_within: float
    noise_z: float
    noise_phi: float
    cases: tuple[Case, ...]


def result_of(controller: str, noise: Imperfections, cases: Sequence[Case]) -> Result:
    """Return the cases of one controller under one noise as a result."""
    return Result(
        controller=controller,
        windows=tuple(WINDOWS),
        found_within=FOUND,
        noise_z=noise.noise_z,
        noise_phi=noise.noise_phi,
        cases=tuple(cases),
    )


def study_case(unit: Unit) -> Case:
    """Run one schedule; this is the work of one worker."""
    return case_of(run_case(unit))


def case_of(runs: Runs) -> Case:
    """Return the runs on one schedule as plain data and curves."""
    found, oracle, scenario = runs.estimated, runs.oracle, runs.scenario
    part, *angles = (
        (time <= UNTIL).nonzero()[0][::EVERY] for time in (found.time, found.run.time, oracle.time)
    )
    time = found.time[part]
    return Case(
        scenario=scenario.name,
        cart_mass=runs.cart_mass,
        half_length=runs.half_length,
        loops=runs.loops,
        curves=Curves(
            time=time,
            cart_mass=found.cart_mass[part],
            half_length=found.half_length[part],
            true_cart_mass=scenario.cart_mass(time),
            true_half_length=scenario.half_length(time),
            estimated_time=found.run.time[angles[0]],
            estimated_angle=found.run.state[angles[0], 1],
            true_time=oracle.time[angles[1]],
            true_angle=oracle.state[angles[1], 1],
        ),
    )
