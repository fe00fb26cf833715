"""The Monte Carlo study in words, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import PurePath

import numpy as np

from afl_mujoco.control.names import REFERENCE, subject_of
from afl_mujoco.document.blocks import (
    Block,
    Cell,
    Column,
    Command,
    Figure,
    Finding,
    Section,
    Table,
    Text,
)
from afl_mujoco.document.numbers import MISSING, fixed, interval, listed, percent, short
from afl_mujoco.scenario.ranges import SCHEDULES, unit_of
from afl_mujoco.scenario.requirements import UNITS
from afl_mujoco.scenario.sample_space import acting
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED, unit_remarks
from afl_mujoco.simulation.sampled.runs import ticks_of
from afl_mujoco.simulation.trajectory import OUTCOMES
from afl_mujoco.studies.monte_carlo.figures import (
    BINS,
    draw_failures,
    draw_margins,
    draw_rates,
    separating_features,
)
from afl_mujoco.studies.monte_carlo.rates import Rate
from afl_mujoco.studies.monte_carlo.result import (
    QUANTILES,
    ControllerRates,
    Result,
    WorstCase,
)
from afl_mujoco.studies.monte_carlo.worst_case import HARDEST, NEAREST
from afl_mujoco.studies.requirements_table import IN_WORDS, SETTLES

QUESTIONS = {HARDEST: "hardest found", NEAREST: "nearest failure"}

SHOWN = 2
"""Number of coordinates of a worst case that are named."""

DEFAULT_INTEGRATOR = "RK4"
"""Default integrator of `afl-mujoco simulate`."""


def sections(result: Result) -> list[Section]:
    """Return what a report says about a campaign."""
    blocks: list[Block] = [*_findings(result), *_assumed(result), *_units(result)]
    blocks.append(Text(SETTLES))
    blocks += [_rates_figure(result), _rates(result), *_margins(result)]
    if result.comparisons:
        blocks.append(_comparisons(result))
    blocks += [Text(said) for said in _messages(result)]
    if any(rates.failures for rates in result.controllers):
        blocks += _failures_figure(result)
    if result.worst_cases:
        blocks.append(_worst_cases(result))
    blocks += [_space(result), *_replays(result)]
    return [Section("Monte Carlo and worst case", "montecarlo", blocks)]


def _findings(result: Result) -> Iterator[Finding]:
    """Return the sentences of the summary."""
    by_name = {rates.controller: rates for rates in result.controllers}
    ours = by_name[subject_of([*by_name])]
    level = percent(result.confidence, 3)
    rail = result.space.scenario.imperfections.rail_half_length
    endless = rail is None and "rail_half_length" not in result.space.varied
    said = "; ".join(
        f"{one.controller} {_passes(result)} {percent(one.rate, 3)} ({interval(one.interval)} %) "
        f"and settles on {percent(one.settled_rate, 3)}"
        for one in sorted(result.controllers, key=lambda one: one is not ours)
    )
    yield Finding(
        "On random hardware",
        f"On {ours.samples} random samples{' on a rail without end stops' if endless else ''}, "
        f"with exact {level} intervals: {said}.",
    )
    for pair in result.comparisons:
        if {pair.first, pair.second} == {ours.controller, REFERENCE}:
            mine, theirs = pair.only_first, pair.only_second
            if pair.first == REFERENCE:
                mine, theirs = theirs, mine
            yield Finding(
                "Compared with LQR on the same hardware",
                f"The {ours.controller} controller passes {mine} samples on which LQR fails, LQR "
                f"{theirs} on which {ours.controller} does (McNemar's exact test: p = "
                f"{short(pair.p_value, 2)}).",
            )


def _assumed(result: Result) -> Iterator[Text]:
    """Say what varies if the scenario itself does not say so."""
    if result.assumed:
        drawn = (
            f"`{name}` {short(low)} to {short(high)} {unit_of(name)}".rstrip()
            for name, (low, high) in result.space.varied.items()
        )
        yield Text(
            f"{result.space.scenario.name} does not say what varies. Imperfections that are ideal "
            "in it are those of random laboratory hardware; its start, M and l are the same in "
            "every sample. Add a table [ranges] to its file to change this. They are drawn from "
            f"these ranges: {'; '.join(drawn)}."
        )


def _units(result: Result) -> Iterator[Text]:
    """Say what in the harshest sample one may have meant in another unit."""
    corner = result.space.scenario_of(np.ones(result.space.dimension), 0, 0)
    for remark in unit_remarks(corner, ticks_of(corner, result.timestep).period):
        yield Text(f"Where everything that varies is at its largest, {remark}.")


def _passes(result: Result) -> str:
    """Say what it means for a run to pass."""
    return "meets all requirements on" if result.judged else "survives"


def _rates(result: Result) -> Table:
    """Return how often each controller passed and settled, and how the other runs failed."""
    level = Column(f"{100.0 * result.confidence:g} % interval", "%", number=True)
    found = {kind for one in result.controllers for kind in one.failures_by_kind}
    kinds = [kind for kind in (*OUTCOMES, CONTROLLER_FAILED, *UNITS) if kind in found]
    return Table(
        caption=(
            f"{result.samples} random samples of {result.space.scenario.name} (seed "
            f"{result.seed}), the same for every controller, with exact intervals; failures by how "
            "the run ended or, if it did not end early, by the requirement with the least margin"
        ),
        columns=(
            Column("Controller"),
            *(Column("Meets all" if result.judged else "Survives", number=True), level),
            *(Column("Settles", number=True), level),
            *(Column(_kind(result, kind), number=True) for kind in kinds),
            Column("Median peak |z| of passing runs", "m", number=True),
        ),
        rows=[
            (
                rates.controller,
                percent(rates.rate, 3),
                interval(rates.interval),
                percent(rates.settled_rate, 3),
                interval(rates.settled_interval),
                *(str(rates.failures_by_kind.get(kind, 0)) for kind in kinds),
                fixed(rates.median_displacement, 2),
            )
            for rates in result.controllers
        ],
    )


def _margins(result: Result) -> list[Block]:
    """Return by how much requirements are met, if they are measured."""
    if not any(one.margins for one in result.controllers):
        return []
    shares = ["Least", *(f"{100.0 * share:g} %" for share in QUANTILES[1:])]
    medians = "; ".join(
        f"{one.controller} {percent(one.margins[QUANTILES.index(0.5)])}"
        for one in result.controllers
        if one.margins
    )
    return [
        Figure(
            name="montecarlo-margins",
            title="By how much the requirements are met",
            caption=(
                "Quantiles of the least margin of each run, as a share of its limit: dot, median; "
                "thick, a quarter to three quarters; thin, 5 to 95 %. Left of 0 a requirement is "
                "missed. Runs that end early or never settle have no margin."
            ),
            alt=f"Median least margin: {medians}.",
            draw=partial(draw_margins, result),
        ),
        Table(
            caption="Quantiles of the least margin over the runs that have one",
            columns=(
                Column("Controller"),
                *(Column(share, number=True) for share in shares),
                Column("Runs without a margin", number=True),
            ),
            rows=[
                (
                    one.controller,
                    *(percent(x) for x in one.margins or (None,) * len(QUANTILES)),
                    str(one.unmargined),
                )
                for one in result.controllers
            ],
        ),
    ]


def _kind(result: Result, kind: str) -> str:
    """Return a way to fail in words."""
    return f"Misses “{_limit(result, kind)}”" if kind in IN_WORDS else kind.capitalize()


def _limit(result: Result, name: str) -> str:
    """Return a requirement in words."""
    if name == "completes" or "rail_half_length" in result.space.varied:
        return IN_WORDS[name]
    return f"{IN_WORDS[name]} {short(result.space.scenario.required[name])} {UNITS[name]}"


def _comparisons(result: Result) -> Table:
    """Return on how many samples both, one or neither of two controllers passed."""
    return Table(
        caption="Runs that pass on the same samples",
        columns=(
            Column("First"),
            Column("Second"),
            *(
                Column(title, number=True)
                for title in ("Both", "First only", "Second only", "Neither", "p (McNemar, exact)")
            ),
        ),
        rows=[
            (
                pair.first,
                pair.second,
                *(str(n) for n in (pair.both, pair.only_first, pair.only_second, pair.neither)),
                short(pair.p_value, 2),
            )
            for pair in result.comparisons
        ],
    )


def _messages(result: Result) -> Iterator[str]:
    """Say which controllers pass no sample, and the first error of each that raised one."""
    for rates in result.controllers:
        if not rates.passed:
            yield f"{rates.controller} passes no sample, so no harder one is searched for."
    for rates in result.controllers:
        for failure in islice((one for one in rates.failures if one.message), 1):
            said = f"{CONTROLLER_FAILED} on sample {failure.index}: {failure.message}"
            yield f"{rates.controller}: {said}"


def _worst_cases(result: Result) -> Table:
    """Return what the searches found."""
    axes = result.space.coordinates
    drawn = [x for name, x in zip(SCHEDULES, "Ml", strict=True) if f"{name} level 1" in axes]
    start = f" with the initial {listed(drawn, 'and')}" if drawn else ""
    changed = any(x.endswith(" level 2") for x in axes)
    later = "; “level 2” is the value after the first change" if changed else ""
    return Table(
        caption=(
            "What a search by CMA-ES found over the same ranges; distance 0 is the scenario "
            f"{result.space.scenario.name} itself{start}, 1 is the diagonal of all ranges. Last "
            f"but one: what was moved most, as a share of its range{later}"
        ),
        columns=(
            Column("Controller"),
            Column("Search"),
            Column("Outcome"),
            *([Column("Least margin", number=True)] if result.judged else []),
            Column("Distance", number=True),
            Column("Runs", number=True),
            Column("Moved most"),
            Column("File"),
        ),
        rows=[
            (
                one.controller,
                QUESTIONS[one.question],
                Cell(_how(result, one), "bad" if one.failed else "good"),
                *(
                    [MISSING if one.margin is None else percent(one.margin)]
                    if result.judged
                    else []
                ),
                fixed(one.distance, 2),
                str(one.runs),
                ", ".join(f"{n} {fixed(x, 2)}" for n, x in islice(_moved(one), SHOWN)),
                Cell(one.file, code=True),
            )
            for one in result.worst_cases
        ],
    )


def _moved(one: WorstCase) -> Iterator[tuple[str, float]]:
    """Return what differs from the scenario, which has no changes and so no instants of them."""
    moved = acting(one.changes).items()
    return ((n, x) for n, x in moved if " instant " not in n and " shape" not in n)


def _how(result: Result, one: WorstCase) -> str:
    """Say how the run of a worst case ended."""
    if not one.failed:
        return "passes"
    if one.failure in IN_WORDS:
        others = len(one.missed) - 1
        missed = f"misses “{_limit(result, one.failure)}”"
        return missed + (f" and {others} more" if others else "")
    return one.outcome + ("" if one.end_time is None else f" at {fixed(one.end_time, 2)} s")


def _space(result: Result) -> Table:
    """Return the ranges that samples are drawn from."""
    rows = []
    for name, unit, value in result.space.quantities():
        low, high = value if isinstance(value, tuple) else (value, value)
        rows.append((name, unit, short(low), short(high)))
    return Table(
        summary="Ranges of the random hardware",
        caption="What varies between samples, drawn uniformly",
        columns=(
            Column("Quantity"),
            Column("Unit"),
            Column("Least", number=True),
            Column("Largest", number=True),
        ),
        rows=rows,
    )


def _replays(result: Result) -> Iterator[Command]:
    """Return the command that replays the first failure of each controller."""
    integrator: list[str] = []
    if result.integrator != DEFAULT_INTEGRATOR:
        integrator = ["--integrator", result.integrator]
    for rates in result.controllers:
        for failure in islice((one for one in rates.failures if one.file), 1):
            file = PurePath(str(failure.file))
            command: list[str | PurePath] = ["afl-mujoco", "simulate", file]
            command += ["--controller", rates.asked, *integrator]
            title = f"Replay a failure of {rates.controller}, identical to the last bit"
            yield Command(title, command)


def _rates_figure(result: Result) -> Figure:
    """Return the figure of the rates."""
    said = "; ".join(
        f"{rates.controller} {_passes(result)} {_words(rates.success)} and settles on "
        f"{_words(rates.settling)}"
        for rates in result.controllers
    )
    filled = "all requirements are met" if result.judged else "the pole survives"
    return Figure(
        name="montecarlo-rates",
        title="How often each controller " + ("meets all" if result.judged else "survives"),
        caption=(
            f"{result.samples} samples drawn at random, the same for every controller. "
            f"Filled: {filled}; hollow: z and φ settle. Bars are exact (Clopper-Pearson) "
            f"{100.0 * result.confidence:g} % intervals."
        ),
        alt=f"Shares with intervals: {said}.",
        draw=partial(draw_rates, result),
    )


def _failures_figure(result: Result) -> Iterator[Figure]:
    """Return the figure of where the failures lie, if there is a feature to draw them over."""
    features, chosen = separating_features(result)
    if not chosen:
        return
    counts = ", ".join(f"{r.controller} {_failures(r)}" for r in result.controllers)
    yield Figure(
        name="montecarlo-failures",
        title="Where the failures lie",
        caption=(
            f"Share of the samples on which a controller does not pass, in {BINS} bins of equal "
            f"counts, with exact {100.0 * result.confidence:g} % intervals; each point is at its "
            f"bin's median. Of {len(features)} features, the {len(chosen)} whose distributions "
            "differ most between failures and the rest are shown. They were chosen on the same "
            "samples, and each interval covers its bin alone: read them as a hint where to look."
        ),
        alt=f"Failure rates over {', '.join(chosen)}. Failures: {counts}, of {result.samples}.",
        draw=partial(draw_failures, result),
    )


def _failures(rates: ControllerRates) -> int:
    """Return how many samples a controller did not pass."""
    return len(rates.failures)


def _words(rate: Rate) -> str:
    """Return a rate for use in a sentence."""
    low, high = (100.0 * x for x in rate.interval)
    return f"{100.0 * rate.share:.1f} % ({low:.1f} to {high:.1f})"
