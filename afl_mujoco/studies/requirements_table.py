"""Requirements in words: who meets them, what the others miss, and how much is left."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from afl_mujoco.document.blocks import Cell, Column, Table, good_or_bad
from afl_mujoco.document.numbers import MISSING, listed, percent, short
from afl_mujoco.scenario.requirements import UNITS
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.judgement import DWELL, JudgedRun, Judgement
from afl_mujoco.simulation.sampled.loop import BAND_PHI, BAND_Z
from afl_mujoco.simulation.trajectory import COMPLETED

IN_WORDS = {
    "completes": "runs to the end",
    "end_stops": "keeps off the end stops at",
    "max_position": "|z| at most",
    "max_angle": "|φ| at most",
    "max_command": "command at most",
    "max_force": "|F| exerted at most",
    "settling_time": "settles within",
    "recover_within": "recovers within",
}
"""Each requirement in words."""

SETTLES = (
    f"To *settle*: |z| stays within {short(1e2 * BAND_Z)} cm and |φ| within "
    f"{short(BAND_PHI)} rad for the last {short(DWELL)} s at least."
)
"""What it means to settle where a scenario requires nothing."""

NEVER = "never"
"""Value of a requirement to settle that a run never meets."""

MOST = 3
"""Largest number of runs that a verdict names as missing a requirement."""


def in_words(scenario: Scenario) -> list[str]:
    """Return what a scenario requires besides completion, each in a few words."""
    return [
        f"{IN_WORDS[name]} {short(limit)} {UNITS[name]}"
        for name, limit in scenario.required.items()
        if name != "completes"
    ]


def tally(runs: Sequence[JudgedRun]) -> str:
    """Say how many requirements are met, or runs complete, and which runs miss one."""
    total = sum(len(run.requirements) for run in runs)
    missing = [run for run in runs if run.missed]
    if not total:
        return "no requirements are asked for"
    noun, met, unmet = "requirement", ("is met", "are met"), ("is not met", "are not met")
    if alone := all(one.requirement == "completes" for run in runs for one in run.requirements):
        noun, met, unmet = (
            "run",
            ("completes", "complete"),
            ("does not complete", "do not complete"),
        )
    if not missing:
        found = f"all {total} {noun}s {met[1]}" if total > 1 else f"the one {noun} {met[0]}"
        return f"{found}, and nothing else is required" if alone else found
    missed = sum(len(run.missed) for run in missing)
    cases = [f"{run.controller} on {run.scenario}{_ending(run)}" for run in missing[:MOST]]
    cases += [f"{len(missing) - MOST} more"] if len(missing) > MOST else []
    which = f"{missed} of {total} {noun}s" if total > 1 else f"the one {noun}"
    return f"{which} {unmet[missed > 1]}: {listed(cases, 'and')}"


def _ending(run: JudgedRun) -> str:
    """Say how a run ended if it did not complete."""
    return "" if run.outcome == COMPLETED else f" ({run.outcome.partition(':')[0]})"


def finding(runs: Sequence[JudgedRun]) -> str:
    """Say who meets the requirements of a scenario, and what the others miss."""
    good = [f"`{run.controller}`" for run in runs if not run.missed]
    parts = [f"{listed(good, 'and')} meet{'s' if len(good) == 1 else ''} every requirement"]
    parts = parts if good else []
    for run in runs:
        if run.missed and run.outcome != COMPLETED:
            parts.append(f"`{run.controller}` {run.outcome}")
        elif run.missed:
            parts.append(f"`{run.controller}` misses {listed(list(map(_miss, run.missed)), 'and')}")
    if len(good) == len(runs) > 1:
        every = "Both" if len(good) == 2 else f"All {len(good)}"
        return f"{every} controllers meet every requirement."
    who = f"Of {len(runs)} controllers " if len(runs) > 1 else "The controller "
    return who + "; ".join(parts) + "."


def _miss(one: Judgement) -> str:
    """Say how a run that completed misses a requirement."""
    if one.value is None and one.graded is not None:
        return f"“{_asked(one)}” (it never does)"
    return f"“{_asked(one)}” with {_with_unit(one.value, one.unit)}"


def requirements_table(runs: Sequence[JudgedRun], *, scenarios: bool = False) -> Table:
    """Return every requirement of every run with its margin; add a column of scenarios if asked."""
    first = (Column("Scenario"),) if scenarios else ()
    return Table(
        caption="Requirements and margins; a negative margin means that one is not met",
        columns=(
            *first,
            Column("Controller"),
            Column("Requirement"),
            Column("Value", number=True),
            Column("Margin", number=True),
        ),
        rows=[(run.scenario, *row) if scenarios else row for run in runs for row in _rows_of(run)],
        stacked=True,
    )


def _rows_of(run: JudgedRun) -> Iterator[tuple[Cell | str, ...]]:
    """Yield a row for each requirement of a run."""
    for one in run.requirements:
        completes = one.requirement == "completes"
        ended = completes and run.outcome != COMPLETED
        share = "" if one.relative is None else f" ({percent(one.relative)})"
        margin = f"{_with_unit(one.left, one.unit)}{share}"
        value = NEVER if one.graded is not None else _with_unit(one.value, one.unit)
        if one.limited:  # the margin is the drive's, not the controller's
            value += f" (drive at its limit {percent(one.limited, 2)} of the time)"
        yield (
            run.controller,
            _asked(one),
            run.outcome.replace(" at t = ", " at ") if ended else value,
            Cell(MISSING if completes and one.met else margin, good_or_bad(one.met)),
        )


def _asked(one: Judgement) -> str:
    """Say what was asked for."""
    return f"{IN_WORDS[one.requirement]} {short(one.limit)} {one.unit}"


def _with_unit(value: float | None, unit: str) -> str:
    """Return a number with its unit, or the sign for a missing one."""
    return MISSING if value is None else f"{short(value)} {unit}"
