"""The study of readings in words, tables and a figure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import PurePath

from afl_mujoco.report.numbers import fixed, percent, scientific, short
from afl_mujoco.report.old import (
    Cell,
    Column,
    Command,
    Figure,
    Finding,
    Section,
    Table,
    Text,
)
from afl_mujoco.studies.paper_readings import (
    CASES,
    HORIZON,
    LABELS,
    NEAR,
    PUBLISHED,
    PUBLISHED_IMPROVEMENTS,
    SCALE_PHI,
    SCALE_Z,
    SCHEDULES,
    SIGNED,
)
from afl_mujoco.studies.paper_tables import OPTIMAL, PUBLISHED_RMSE, published_rows
from afl_mujoco.studies.readings.figures import draw_sensitivity
from afl_mujoco.studies.readings.optima import Optima
from afl_mujoco.studies.readings.result import FittedReading, Result
from afl_mujoco.studies.readings.search import GOALS, round_count

IMPROVEMENTS = ("improvements-d4", "improvements")
"""Goals whose error is that of the improvements."""

MAIN = 3
"""Unknowns that a sentence names."""


def sections(result: Result) -> list[Section]:
    """Return what a report says about readings."""
    text = Text(
        "The paper prints neither the values and times of its schedules nor the horizon and the "
        "scales of its objective, and contradicts itself on two columns (D2 to D5). A reading is a "
        "choice of all these; everything else is as the paper says. Everything here is of the "
        "ideal equations."
    )
    file = PurePath(f"{result.readings[0].scenarios[0].name}.toml")
    blocks = (
        Finding("Table 3", _table_3(result)),
        text,
        Section(
            "Random readings",
            "random-readings",
            (
                _random(result),
                Finding("The first levels decide", _drivers(result)),
                _figure(result),
            ),
        ),
        Section(
            "Fitted readings",
            "fitted-readings",
            (
                _nearest(result),
                _values(result),
                _schedules(result),
                Text(
                    "A case in MuJoCo (a minute; a pole of 5 cm is stiff, so that fixed steps need "
                    "to be shorter than 1 ms):"
                ),
                Command(
                    "Validate a case",
                    ["afl-mujoco", "validate", file, "--timestep", "0.00025"],
                ),
            ),
        ),
        Section("Table 1 under every scale", "readings-optima", _optima(result)),
        Section("Table 2 under both labels", "readings-fits", (_fits(result),)),
    )
    return [Section("Readings of the paper", "readings", blocks)]


def _table_3(result: Result) -> str:
    """Say how rare a reading near Table 3 is, and that one can be fitted."""
    found = result.sensitivity
    improved, valued = (
        min((one for one in result.readings if one.goal in goals), key=lambda one: one.error)
        for goals in (IMPROVEMENTS, ("values",))
    )
    in_round = min(one.error for one in result.readings if one.round and one.goal in IMPROVEMENTS)
    return (
        f"Of {short(found.samples)} readings drawn at random {found.all_near or 'none'} "
        f"{'has' if found.all_near == 1 else 'have'} all four improvements within {NEAR:g} points "
        f"of the paper's, {short(found.all_half)} at least half of every one. A reading can be "
        f"fitted to Table 3, which is no evidence for it: {improved.name} comes within "
        f"{short(improved.error, 2)} percentage points (rms), one in round numbers within "
        f"{short(in_round, 2)}, and the eight values of the objective are met to "
        f"{short(valued.error, 2)} % (rms) under {valued.name}."
    )


def _reading_columns() -> tuple[Column, ...]:
    """Return the columns of the cases."""
    return tuple(Column(case, number=True) for case in CASES)


def _nearest(result: Result) -> Table:
    """Return the fitted readings with their improvements."""
    rows: list[tuple[Cell | str, ...]] = [
        ("Table 3", "", "", "", *(fixed(x, 2) for x in PUBLISHED_IMPROVEMENTS))
    ]
    rows += [
        (
            Cell(one.name, code=True),
            GOALS[one.goal].meaning,
            short(one.error, 3),
            short(one.tried),
            *(fixed(x, 1) for x in one.improvements),
        )
        for one in result.readings
    ]
    return Table(
        caption=(
            "Readings fitted to Table 3 (the error is what the search made least), and the "
            "improvement of the objective in % under each. Round: times in half seconds, levels "
            "from the paper's grids, one of "
            f"{scientific(float(round_count()), 1)} readings without their scales; descents from "
            f"the best of {result.draws} drawn and from the nearest found freely, so a nearer one "
            "may exist. Each case of each reading is a scenario file beside this result"
        ),
        columns=(
            Column("Reading"),
            Column("Error"),
            Column("Value", number=True),
            Column("Tried", number=True),
            *_reading_columns(),
        ),
        rows=rows,
    )


def _values(result: Result) -> Table:
    """Return the objectives under the fitted readings."""

    def pairs(values: Iterable[Iterable[float]]) -> list[str]:
        return [", ".join(fixed(x, 3) for x in pair) for pair in values]

    rows: list[tuple[Cell | str, ...]] = [("Table 3", *pairs(PUBLISHED.tolist()))]
    rows += [(Cell(one.name, code=True), *pairs(one.objectives)) for one in result.readings]
    return Table(
        summary="Objectives under the fitted readings",
        caption=(
            "Objective with fixed and with adaptive gains, at the common scale that brings the "
            "eight values nearest to Table 3"
        ),
        columns=(Column("Reading"), *_reading_columns()),
        rows=rows,
    )


def _schedules(result: Result) -> Table:
    """Return what the fitted readings are."""
    return Table(
        summary="What the fitted readings are",
        caption=(
            "Levels and times of the schedules, horizon, scales relative to D4's, labels of K and "
            "Φ (D2) and largest force (D5)"
        ),
        columns=(
            Column("Reading"),
            *(Column(f"{shape} {symbol}") for symbol, shape in SCHEDULES),
            Column("Horizon", "s", number=True),
            Column("Scales of ∫|z| dt, ∫|φ| dt"),
            Column("Labels"),
            Column("Force"),
        ),
        rows=[
            (
                Cell(one.name, code=True),
                *(_schedule(one, symbol, shape) for symbol, shape in SCHEDULES),
                short(float(one.vector[HORIZON])),
                f"{short(10.0 ** float(one.vector[SCALE_Z]), 3)}, "
                f"{short(10.0 ** float(one.vector[SCALE_PHI]), 3)}",
                "Table 1" if one.vector[LABELS] else "Table 2",
                "max F" if one.vector[SIGNED] else "max |F|",
            )
            for one in result.readings
        ],
    )


def _schedule(one: FittedReading, symbol: str, shape: str) -> str:
    """Return a schedule of a reading in few words."""
    times, levels = (one.vector[columns].tolist() for columns in SCHEDULES[symbol, shape])
    if len(times) > len(levels):
        levels = [levels[0], levels[1], levels[0]]
    return f"{'–'.join(short(x, 3) for x in levels)} at {', '.join(short(t, 4) for t in times)} s"


def _drivers(result: Result) -> str:
    """Say what of a reading drives the improvement."""
    found = [dict((name, total) for name, total, *_ in c.drivers) for c in result.sensitivity.cases]
    length, mass = (
        [
            case.get(f"{name.split('-')[which]} {symbol}, level 1", 0.0)
            for case, name in zip(found, CASES, strict=True)
        ]
        for symbol, which in (("l", 1), ("M", 0))
    )
    return (
        "The first length of the pole has a part in "
        f"{_span(length)} of the variance of the improvement, the first cart mass in "
        f"{_span(mass)}, each alone or with others (estimates of total-order Sobol' indices)."
    )


def _span(shares: Sequence[float]) -> str:
    """Return the range of shares in percent."""
    return f"{100.0 * min(shares):.0f} to {100.0 * min(max(shares), 1.0):.0f} %"


def _random(result: Result) -> Table:
    """Return how often each improvement holds over random readings."""
    found = result.sensitivity
    return Table(
        caption=(
            f"{found.samples} random readings, uniform over M 0.1 to 2 kg, l 0.05 to 1 m, times "
            "over the horizon, horizons of 10 to 30 s, scales of the integrals a tenth to ten "
            "times D4's, both labels, max F or max |F|; a run falls under "
            f"{found.lost or 'none'} of them"
        ),
        columns=(
            Column("Case"),
            Column("Paper", "%", number=True),
            Column(f"Within {NEAR:g} points", "%", number=True),
            Column("At least half", "%", number=True),
            Column("Above zero", "%", number=True),
            *(Column(q, "%", number=True) for q in ("5 % quantile", "Median", "95 % quantile")),
        ),
        rows=[
            (
                case.case,
                fixed(case.paper, 2),
                fixed(100.0 * case.near, 1),
                fixed(100.0 * case.half, 1),
                fixed(100.0 * case.positive, 1),
                *(fixed(case.quantiles[k], 1) for k in (0, 2, 4)),
            )
            for case in found.cases
        ],
    )


def _figure(result: Result) -> Figure:
    """Return the figure of random readings."""
    said = []
    for case in result.sensitivity.cases:
        main = ", ".join(f"{name} ({fixed(total, 2)})" for name, total, *_ in case.drivers[:MAIN])
        said.append(f"{case.case}: {main}")
    return Figure(
        name="readings",
        title="What a reading decides",
        caption=(
            "Above: the improvement of the objective over random readings (what is below -100 % "
            "is in the first bar); red: the paper's. Below: total-order Sobol' indices, with "
            "the least and largest of five estimates: the share of the variance of the improvement "
            "in which the unknown has a part. Largest: " + "; ".join(said) + "."
        ),
        alt="Largest total-order indices: " + "; ".join(said) + ".",
        draw=partial(draw_sensitivity, result.sensitivity),
    )


def _optima(result: Result) -> tuple[Finding, Table]:
    """Return how many rows of Table 1 are optima."""
    rows = len(published_rows())
    most = max(result.optima, key=lambda one: (one.best, -one.median_excess))
    column = min(one.column_error for one in result.optima)
    finding = Finding(
        "Table 1",
        f"Under none of the scales tried are all {rows} rows within {percent(OPTIMAL)} of the "
        f"optimum: at most {most.best} are ({_label(most)}, {most.horizon:g} s), under D4's "
        f"{max(one.as_decided for one in result.optima)}. The column OF fits no non-negative "
        f"weights of the three terms: the best leave {percent(column)} rms."
        if most.best < rows
        else f"Under some scales all {rows} rows are within {percent(OPTIMAL)} of the optimum "
        f"({_label(most)}, {most.horizon:g} s); the column OF is met to {percent(column)} rms.",
    )
    table = Table(
        caption=(
            f"Rows of Table 1, of {rows}, whose gains come within {percent(OPTIMAL)} of the "
            "optimum over the box of D8, under the scales that make most rows "
            "optimal; and the best fit of the column OF by non-negative weights of the terms"
        ),
        columns=(
            Column("K and Φ by"),
            Column("Horizon", "s", number=True),
            Column("Optimal at best", number=True),
            Column("Scales of ∫|z| dt, ∫|φ| dt, relative to D4's"),
            Column("Median excess there", "%", number=True),
            Column("Optimal under D4", number=True),
            Column("Column OF, rms", "%", number=True),
        ),
        rows=[
            (
                _label(one),
                short(one.horizon),
                str(one.best),
                ", ".join(short(10.0**x, 2) for x in one.scales) if one.best else "–",
                fixed(100.0 * one.median_excess, 1),
                str(one.as_decided),
                fixed(100.0 * one.column_error, 1),
            )
            for one in result.optima
        ],
    )
    return finding, table


def _label(one: Optima) -> str:
    """Return the reading of the columns in words."""
    return "Table 1's header" if one.labels == "table1" else "Table 2 and the text"


def _fits(result: Result) -> Table:
    """Return the RMSE of the fits over the printed rows, and what they rule out."""
    symbols = dict(zip(PUBLISHED_RMSE, ("K", "λ", "Φ"), strict=True))
    return Table(
        caption=(
            "RMSE of the published functions over the 40 printed rows, and the least that they can "
            "have over all 400, where the other 360 may be met exactly, beside Table 2's"
        ),
        columns=(
            Column("K and Φ by"),
            Column("Gain"),
            Column("Printed rows", number=True),
            Column("Least over all", number=True),
            Column("Table 2", number=True),
            Column("Table 2 can be right"),
        ),
        rows=[
            (
                "Table 1's header" if one.labels == "table1" else "Table 2 and the text",
                symbols[one.gain],
                short(one.rmse),
                short(one.least),
                short(one.published),
                Cell("not ruled out" if one.possible else "no", "" if one.possible else "bad"),
            )
            for one in result.fits
        ],
    )
