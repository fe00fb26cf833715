"""The Monte Carlo study in words, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import PurePath

from afl_mujoco.control.names import REFERENCE, SUBJECT
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
from afl_mujoco.document.numbers import fixed, interval, percent, short
from afl_mujoco.studies.monte_carlo.figures import (
    BINS,
    draw_failures,
    draw_rates,
    separating_features,
)
from afl_mujoco.studies.monte_carlo.rates import Rate
from afl_mujoco.studies.monte_carlo.result import ControllerRates, Result
from afl_mujoco.studies.monte_carlo.trial import CONTROLLER_FAILED, ENDINGS
from afl_mujoco.studies.monte_carlo.worst_case import HARDEST, NEAREST

QUESTIONS = {HARDEST: "hardest found", NEAREST: "nearest failure"}

SHOWN = 4
"""Coordinates of a worst case that are named."""

DEFAULT_INTEGRATOR = "RK4"
"""Of `afl-mujoco simulate`."""


def sections(result: Result) -> list[Section]:
    """Return what a report says of a campaign."""
    blocks: list[Block] = [*_findings(result), _rates_figure(result), _rates(result)]
    if result.comparisons:
        blocks.append(_comparisons(result))
    blocks += [Text(said) for said in _messages(result)]
    if any(rates.failures for rates in result.controllers):
        blocks.append(_failures_figure(result))
    if result.worst_cases:
        blocks.append(_worst_cases(result))
    blocks += [_space(result), *_replays(result)]
    return [Section("Monte Carlo and worst case", "montecarlo", blocks)]


def _findings(result: Result) -> Iterator[Finding]:
    """Return the sentences of the summary."""
    by_name = {rates.controller: rates for rates in result.controllers}
    ours = by_name.get(SUBJECT, result.controllers[0])
    hardest = [
        one.failed
        for one in result.worst_cases
        if (one.controller, one.question) == (ours.controller, HARDEST)
    ]
    search = ""
    if hardest:
        which = "one" if hardest[0] else "none"
        search = f"; a search for the worst sample found {which} that fails"
    level = percent(result.confidence, 3)
    yield Finding(
        "On random hardware",
        f"On {ours.samples} random samples with an endless rail the {ours.controller} controller "
        f"survives {percent(ours.rate, 3)} (exact {level} interval {interval(ours.interval)} %) "
        f"and settles on {percent(ours.settled_rate, 3)} "
        f"({interval(ours.settled_interval)} %){search}.",
    )
    for pair in result.comparisons:
        if {pair.first, pair.second} == {ours.controller, REFERENCE}:
            mine, theirs = pair.only_first, pair.only_second
            if pair.first == REFERENCE:
                mine, theirs = theirs, mine
            yield Finding(
                "Compared with LQR on the same hardware",
                f"Only the {ours.controller} controller survives {mine} samples, only LQR "
                f"{theirs} (McNemar's exact test: p = {short(pair.p_value, 2)}).",
            )


def _rates(result: Result) -> Table:
    """Return how often each controller survived and settled."""
    level = f"{100.0 * result.confidence:g} % interval"
    return Table(
        caption=(
            f"{result.samples} random samples (seed {result.seed}), the same for every "
            "controller, with exact intervals"
        ),
        columns=(
            Column("Controller"),
            Column("Survives", number=True),
            Column(level, "%", number=True),
            Column("Settles", number=True),
            Column(level, "%", number=True),
            *(Column(ending.capitalize(), number=True) for ending in ENDINGS[1:]),
            Column("Median peak |z|", "m", number=True),
        ),
        rows=[
            (
                rates.controller,
                percent(rates.rate, 3),
                interval(rates.interval),
                percent(rates.settled_rate, 3),
                interval(rates.settled_interval),
                *(str(rates.failures_by_outcome[ending]) for ending in ENDINGS[1:]),
                fixed(rates.median_displacement, 2),
            )
            for rates in result.controllers
        ],
    )


def _comparisons(result: Result) -> Table:
    """Return on how many samples only one of two controllers survived."""
    return Table(
        caption="Survival on the same samples",
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
    """Say what the first failure of each controller that failed itself was."""
    for rates in result.controllers:
        for failure in islice((one for one in rates.failures if one.message), 1):
            said = f"{CONTROLLER_FAILED} on sample {failure.index}: {failure.message}"
            yield f"{rates.controller}: {said}"


def _worst_cases(result: Result) -> Table:
    """Return what the searches found."""
    return Table(
        caption=(
            "What a search by CMA-ES found over the same hardware; distance 0 is the paper's "
            "nominal run, 1 the diagonal of all ranges"
        ),
        columns=(
            Column("Controller"),
            Column("Search"),
            Column("Outcome"),
            Column("Distance", number=True),
            Column("Runs", number=True),
            Column("Farthest from nominal"),
            Column("File"),
        ),
        rows=[
            (
                one.controller,
                QUESTIONS[one.question],
                Cell(one.outcome + _at(one.end_time), "bad")
                if one.failed
                else Cell("survives", "good"),
                fixed(one.distance, 2),
                str(one.runs),
                ", ".join(f"{n} {fixed(x, 2)}" for n, x in islice(one.changes.items(), SHOWN)),
                Cell(one.file, code=True),
            )
            for one in result.worst_cases
        ],
    )


def _at(time: float | None) -> str:
    """Say when [s], if that is known."""
    return "" if time is None else f" at {fixed(time, 2)} s"


def _space(result: Result) -> Table:
    """Return the ranges that samples are drawn from."""
    rows = []
    for name, unit, value, _ in result.space.quantities():
        low, high = value if isinstance(value, tuple) else (value, value)
        rows.append((name, unit, short(low), short(high)))
    return Table(
        summary="Ranges of the random hardware",
        caption="What varies from sample to sample, drawn uniformly",
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
            yield Command("Replay a failure to the last bit", command)


def _rates_figure(result: Result) -> Figure:
    """Return the figure of the rates."""
    said = "; ".join(
        f"{rates.controller} survives {_words(rates.survival)} and settles on "
        f"{_words(rates.settling)}"
        for rates in result.controllers
    )
    return Figure(
        name="montecarlo-rates",
        title="How often each controller survives laboratory hardware",
        caption=(
            f"{result.samples} samples drawn at random, the same for every controller. Filled: "
            f"the pole survives {result.space.duration:g} s; hollow: z and φ also settle. "
            f"Bars are exact (Clopper-Pearson) {100.0 * result.confidence:g} % intervals."
        ),
        alt=f"Shares with intervals: {said}.",
        draw=partial(draw_rates, result),
    )


def _failures_figure(result: Result) -> Figure:
    """Return the figure of where the failures lie."""
    features, chosen = separating_features(result)
    counts = ", ".join(f"{r.controller} {_failures(r)}" for r in result.controllers)
    return Figure(
        name="montecarlo-failures",
        title="Where the failures lie",
        caption=(
            f"Share of the samples on which the pole does not survive, in {BINS} bins of equal "
            f"counts, with exact {100.0 * result.confidence:g} % intervals; each point is at its "
            f"bin's median. Of {len(features)} features, the {len(chosen)} whose distributions "
            "differ most between failures and survivors. They were chosen on the same samples, "
            "and each interval is of its bin alone: read them as a hint where to look."
        ),
        alt=f"Failure rates over {', '.join(chosen)}. Failures: {counts}, of {result.samples}.",
        draw=partial(draw_failures, result),
    )


def _failures(rates: ControllerRates) -> int:
    """Return how many samples a controller did not survive."""
    return len(rates.failures)


def _words(rate: Rate) -> str:
    """Return a rate as a sentence has it."""
    low, high = (100.0 * x for x in rate.interval)
    return f"{100.0 * rate.share:.1f} % ({low:.1f} to {high:.1f})"
