"""The study of estimation in words, tables and figures."""

from __future__ import annotations

from functools import partial

from afl_mujoco.report.numbers import fixed, short
from afl_mujoco.report.old import Cell, Column, Figure, Finding, Section, Table
from afl_mujoco.report.style import in_words
from afl_mujoco.studies.estimation.figures import draw_estimation, shown_cases
from afl_mujoco.studies.estimation.loops import ESTIMATED, TRUE, Loop
from afl_mujoco.studies.estimation.result import Case, Result
from afl_mujoco.studies.estimation.tracking import Tracking


def sections(result: Result) -> list[Section]:
    """Return what a report says about estimation."""
    blocks = (
        Finding("Cost of estimation", _finding(result)),
        _figure(result),
        _loops(result),
        _tracking(result),
    )
    return [Section("M and l estimated online", "estimation", blocks)]


def _finding(result: Result) -> str:
    """Say how many runs with the estimator completed, and their largest cost."""
    noisy = [_loop(case, ESTIMATED, noise=True) for case in result.cases]
    completed, runs = sum(loop.completed for loop in noisy), sum(loop.runs for loop in noisy)
    text = (
        f"With M and l estimated from noisy sensors, the {result.controller} controller completes "
        f"{completed} of {runs} runs"
    )
    ratios = []
    for case, loop in zip(result.cases, noisy, strict=True):
        mine, true = (x.metrics["iae_phi"] for x in (loop, _loop(case, TRUE, noise=False)))
        if mine is not None and true:
            ratios.append(mine / true)
    if not ratios:
        return f"{text}."
    return (
        f"{text}; its ∫|φ| dt is at most {short(max(ratios), 3)} times that with the true M and l "
        "and without noise."
    )


def _loop(case: Case, parameters: str, *, noise: bool) -> Loop:
    """Return one of the loops of a schedule."""
    wanted = parameters, noise
    return next(loop for loop in case.loops if (loop.parameters, loop.noise) == wanted)


def _loops(result: Result) -> Table:
    """Return the cost of each loop."""
    return Table(
        caption=(
            "Cost of the closed loop by the M and l that the controller assumes; metrics are "
            "medians over the runs, the largest force is that of all runs"
        ),
        columns=(
            Column("Scenario"),
            Column("M and l"),
            Column("Completed", number=True),
            Column("∫|z| dt", "m s", number=True),
            Column("∫|φ| dt", "rad s", number=True),
            Column("Force", "N", number=True),
            Column("Largest force", "N", number=True),
        ),
        rows=[
            (
                case.scenario,
                loop.parameters + (", with noise" if loop.noise else ""),
                Cell(
                    f"{loop.completed} of {loop.runs}",
                    "bad" if loop.completed < loop.runs else "",
                ),
                fixed(loop.metrics["iae_z"], 2),
                fixed(loop.metrics["iae_phi"], 3),
                fixed(loop.metrics["max_force"], 1),
                fixed(loop.largest_force, 1),
            )
            for case in result.cases
            for loop in case.loops
        ],
    )


def _tracking(result: Result) -> Table:
    """Return the errors of the estimates over the windows of time."""
    return Table(
        summary="Errors of the estimates",
        caption=(
            "Root mean square of ln(estimate / truth), the largest over the seeds, by time window"
        ),
        columns=(
            Column("Scenario"),
            Column("Parameter"),
            *(Column(window, number=True) for window in result.windows),
        ),
        rows=[
            (case.scenario, symbol, *(_largest(found, window) for window in result.windows))
            for case in result.cases
            for symbol, found in (("M", case.cart_mass), ("l", case.half_length))
        ],
    )


def _largest(found: tuple[Tracking, ...], window: str) -> str:
    """Return the largest error in a window over the seeds."""
    errors = [x for one in found if (x := one.rms[window]) is not None]
    return fixed(max(errors), 4) if errors else fixed(None, 4)


def _figure(result: Result) -> Figure:
    """Return the figure of what was estimated."""
    return Figure(
        name="estimation",
        title="M and l estimated online",
        caption=(
            f"The {result.controller} controller with M, l and the state from the estimator, as "
            f"deployed at 1 kHz, with {1e3 * result.noise_z:g} mm and "
            f"{1e3 * result.noise_phi:g} mrad of noise on the measured z and φ. Black: the true "
            "values, and the same controller with the true parameters and without noise. An "
            "estimate is frozen while the motion carries no information about it: a change of the "
            "plant at rest is found when it next moves."
        ),
        alt=" ".join(_said(case, result.found_within) for case in shown_cases(result)),
        draw=partial(draw_estimation, result),
    )


def _said(case: Case, within: float) -> str:
    """Say with numbers how the estimates follow one schedule."""
    loops = _loop(case, TRUE, noise=False), _loop(case, ESTIMATED, noise=True)
    forces = [loop.metrics["max_force"] for loop in loops]
    text = ["none" if x is None else f"{in_words(x)} N" for x in forces]
    return (
        f"{case.scenario}: M {_followed(case.cart_mass[0], within)}, l "
        f"{_followed(case.half_length[0], within)}; the largest force is {text[0]} with the true "
        f"parameters, {text[1]} with the estimated ones."
    )


def _followed(one: Tracking, within: float) -> str:
    """Say how soon an estimate finds steps, and how far it lags on ramps."""
    said = []
    for step in one.steps:
        after = step.reached_after
        late = "never" if after is None else f"{in_words(after)} s later"
        said.append(f"stepped at {step.at:g} s is first within {100.0 * within:g} % {late}")
    for ramp in one.ramps:
        if ramp.lag is not None:
            said.append(f"lags {in_words(ramp.lag)} s on the ramp from {ramp.start:g} s")
    return " and ".join(said) or "does not change"
