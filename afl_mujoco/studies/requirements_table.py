"""Requirements in words: who meets them, what the others miss, and how much is left."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import median

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


def by_case(runs: Sequence[JudgedRun]) -> list[list[JudgedRun]]:
    """Return the draws of each controller on each scenario, in their order."""
    found: dict[tuple[str, str], list[JudgedRun]] = {}
    for run in runs:
        found.setdefault((run.scenario, run.controller), []).append(run)
    return list(found.values())


def tally(runs: Sequence[JudgedRun]) -> str:
    """Say how many requirements are met, or runs complete, and which runs miss one."""
    cases = by_case(runs)
    if any(len(draws) > 1 for draws in cases):
        return "; ".join(f"{d[0].controller} on {d[0].scenario} {_passes(d)}" for d in cases)
    total = sum(len(run.requirements) for run in runs)
    missing = [run for run in runs if run.failure]
    if not total and not missing:
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
    named = [f"{run.controller} on {run.scenario}{_ending(run)}" for run in missing[:MOST]]
    named += [f"{len(missing) - MOST} more"] if len(missing) > MOST else []
    which = f"{missed} of {total} {noun}s" if total > 1 else f"the one {noun}"
    return f"{which} {unmet[missed > 1]}: {listed(named, 'and')}"


def _passes(draws: Sequence[JudgedRun]) -> str:
    """Say how many draws pass, and how the others fail."""
    failures = [run.failure for run in draws if run.failure]
    text = f"passes {len(draws) - len(failures)} of {len(draws)} draws"
    how = [
        (f"misses “{IN_WORDS[word]}”" if word in IN_WORDS else word)
        + (f" ({failures.count(word)})" if len(set(failures)) > 1 else "")
        for word in dict.fromkeys(failures)
    ]
    return text + (f", else {listed(how, 'and')}" if how else "")


def _ending(run: JudgedRun) -> str:
    """Say how a run ended if it did not complete."""
    return "" if run.outcome == COMPLETED else f" ({run.outcome.partition(':')[0]})"


def finding(runs: Sequence[JudgedRun]) -> str:
    """Say who meets the requirements of a scenario, and what the others miss."""
    cases = by_case(runs)
    if any(len(draws) > 1 for draws in cases):
        return "; ".join(f"`{draws[0].controller}` {_passes(draws)}" for draws in cases) + "."
    good = [f"`{run.controller}`" for run in runs if not run.failure]
    parts = [f"{listed(good, 'and')} meet{'s' if len(good) == 1 else ''} every requirement"]
    parts = parts if good else []
    for run in runs:
        if run.failure and run.outcome != COMPLETED:
            parts.append(f"`{run.controller}` {run.outcome}")
        elif run.failure:
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
    """Return every requirement of every case with its margin; add a column of scenarios if asked.

    Of several draws it has the medians, with the range in brackets.
    """
    first = (Column("Scenario"),) if scenarios else ()
    cases = by_case(runs)
    several = "; of several draws the medians, with the range in brackets"
    return Table(
        caption="Requirements and margins; a negative margin means that one is not met"
        + several * any(len(draws) > 1 for draws in cases),
        columns=(
            *first,
            Column("Controller"),
            Column("Requirement"),
            Column("Value", number=True),
            Column("Margin", number=True),
        ),
        rows=[
            (draws[0].scenario, *row) if scenarios else row
            for draws in cases
            for row in _rows_of(draws)
        ],
        stacked=True,
    )


def _rows_of(draws: Sequence[JudgedRun]) -> Iterator[tuple[Cell | str, ...]]:
    """Yield a row for each requirement of some draws."""
    ended = [run.outcome for run in draws if run.outcome != COMPLETED]
    for judgements in zip(*(run.requirements for run in draws), strict=True):
        one = judgements[0]
        completes = one.requirement == "completes"
        met = all(each.met for each in judgements)
        value = spread([each.value for each in judgements], one.unit)
        if never := sum(each.graded is not None for each in judgements):
            value = NEVER if len(draws) == 1 else f"{value}; {NEVER} in {never} of {len(draws)}"
        if limited := max(each.limited for each in judgements):  # so the margin is the drive's
            value += f" (drive at its limit {percent(limited, 2)} of the time)"
        if completes and ended:
            first = ended[0].replace(" at t = ", " at ")
            value = first if len(draws) == 1 else f"{len(ended)} of {len(draws)} end early: {first}"
        yield (
            draws[0].controller,
            _asked(one),
            value,
            Cell(MISSING if completes and met else _margin(judgements), good_or_bad(met)),
        )


def _margin(judgements: Sequence[Judgement]) -> str:
    """Return a margin, absolute and relative; of several draws the median, and the range."""
    left = [one.left for one in judgements if one.left is not None]
    shares = [one.relative for one in judgements if one.relative is not None]
    if not left:
        return MISSING
    share = percent(median(shares))
    if len(judgements) > 1:
        share += f"; {percent(min(shares))} to {percent(max(shares))}"
    return f"{short(median(left), 3)} {judgements[0].unit} ({share})"


def spread(values: Sequence[float | None], unit: str = "") -> str:
    """Return a number, of several draws the median, with the range in brackets; with its unit."""
    known = [value for value in values if value is not None]
    if not known:
        return MISSING
    text = f"{short(median(known), 3)} {unit}".rstrip()
    if len(values) > 1 and min(known) < max(known):
        text += f" ({short(min(known), 3)} to {short(max(known), 3)})"
    return text


def _asked(one: Judgement) -> str:
    """Say what was asked for."""
    return f"{IN_WORDS[one.requirement]} {short(one.limit)} {one.unit}"


def _with_unit(value: float | None, unit: str) -> str:
    """Return a number with its unit, or the sign for a missing one."""
    return MISSING if value is None else f"{short(value, 3)} {unit}"
