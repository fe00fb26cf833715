"""The study of attraction in words, tables and figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

from afl_mujoco.document.blocks import (
    Block,
    Cell,
    Column,
    Figure,
    Finding,
    Section,
    Table,
    Text,
    good_or_bad,
)
from afl_mujoco.document.numbers import fixed, percent, short
from afl_mujoco.simulation.attraction.grid import OUTCOMES, PLANTS, SETTLED, STATES
from afl_mujoco.studies.attraction.deployed import WORDS as ENDINGS
from afl_mujoco.studies.attraction.deployed import StartMap
from afl_mujoco.studies.attraction.figures import draw_attraction, draw_starts
from afl_mujoco.studies.attraction.result import Map, MapPair, Result
from afl_mujoco.studies.requirements_table import SETTLES

FEW = 0.1
"""Share of starts below which a map shows little."""

WORDS = {
    STATES: ("states", "From which starts each controller settles", "over starts (φ₀, φ₀′)"),
    PLANTS: (
        "plants",
        "On which plants each controller settles from {start:.0f}°",
        "over plants (M, l)",
    ),
}
"""For each plane: the name of its figure, its title, and what it is drawn over."""


def sections(result: Result) -> list[Section]:
    """Return what a report says about the maps."""
    if result.starts:
        return [Section("Regions of attraction", "attraction", _of_a_scenario(result.starts))]
    planes = dict.fromkeys(pair.plane for pair in result.maps)
    figures = [_figure([pair for pair in result.maps if pair.plane == p]) for p in planes]
    finding = Finding("Where it settles", _finding(result))
    blocks: list[Block] = [finding, Text(_settled(result)), *figures, _table(result)]
    return [Section("Regions of attraction", "attraction", blocks)]


def _of_a_scenario(maps: Sequence[StartMap]) -> list[Block]:
    """Return what a report says about a scenario's maps."""
    first = maps[0]
    good, *others = ENDINGS[first.judged]
    angle, rate = short(float(first.angles[-1])), short(float(first.rates[-1]))
    reach = f"starts up to {angle} rad and {rate} rad/s"
    total = first.outcome.size
    said = "; ".join(f"{one.controller} {round(total * one.shares[good])}" for one in maps)
    words = {"meets all": "meets all requirements"}.get(good, good)
    text = f"On {first.scenario}, of {total} {reach} to either side (--max-angle, --max-rate), "
    text += f"those from which each controller {words}: {said}."
    if max(one.shares[good] for one in maps) < FEW:
        text += f" Fewer than {percent(FEW)}: smaller limits show more."
    return [
        Finding("Starting region", text),
        *([] if first.judged else [Text(SETTLES)]),
        Figure(
            name="attraction-starts",
            title=f"From which starts each controller {words} on {first.scenario}",
            caption=(
                f"One run in MuJoCo ({first.integrator}) for each point, as deployed, with "
                "schedules, disturbances and imperfections. The cross marks the start of the "
                "scenario itself, in the colour of how its run ends; it need not be one of the "
                "points."
            ),
            alt=text,
            draw=partial(draw_starts, maps),
        ),
        Table(
            caption=f"How runs on {first.scenario} end, in % of {first.outcome.size} starts",
            columns=(
                Column("Controller"),
                *(Column(word.capitalize(), "%", number=True) for word in (good, *others)),
                Column("From its own start"),
            ),
            rows=[
                (
                    one.controller,
                    *(fixed(100.0 * x, 1) for x in one.shares.values()),
                    Cell((good, *others)[one.own_outcome], good_or_bad(one.own_outcome == SETTLED)),
                )
                for one in maps
            ],
        ),
    ]


def _finding(result: Result) -> str:
    """Say what share of each map settles, and how many grid points differ away from a border."""
    said = (
        f"{pair.controller} {percent(pair.mujoco.shares['settled'], 3)} "
        f"{WORDS[pair.plane][2].replace('over', 'of the')}"
        for pair in result.maps
    )
    text = f"Share that settles in MuJoCo: {'; '.join(said)}."
    differ = sum(pair.disagreement.differ for pair in result.maps)
    inside = sum(pair.disagreement.inside for pair in result.maps)
    points = sum(pair.points for pair in result.maps)
    if not differ:
        return f"{text} MuJoCo and the equations agree on all {points} grid points."
    where = f"{inside} of them away from any border" if inside else "each on a border of outcomes"
    return f"{text} MuJoCo and the equations disagree on {differ} of {points} grid points, {where}."


def _settled(result: Result) -> str:
    """Say when a rollout counts as settled, the same in every map."""
    settings: Any = result.maps[0].mujoco.settings
    z, phi, z_dot, phi_dot = settings["bands"]
    return (
        f"Settled: for {settings['dwell']:g} s within {z:g} m, {phi:g} rad, {z_dot:g} m/s and "
        f"{phi_dot:g} rad/s of rest, at any time up to {settings['horizon']:g} s."
    )


def _table(result: Result) -> Table:
    """Return two rows for each pair of maps: by the equations, in MuJoCo."""
    counts = ("Differ", "On a border", "Inside", "Of points")
    return Table(
        caption=(
            "How rollouts end, in % of the grid points; number of points that end differently in "
            "MuJoCo, on a border between outcomes and inside"
        ),
        columns=(
            Column("Map over"),
            Column("Controller"),
            Column("By"),
            *(Column(outcome.capitalize(), "%", number=True) for outcome in OUTCOMES),
            *(Column(title, number=True) for title in counts),
        ),
        rows=[
            row
            for pair in result.maps
            for row in (
                (*_shares(pair, pair.ode, "equations"), "", "", "", ""),
                (*_shares(pair, pair.mujoco, "MuJoCo"), *_counts(pair)),
            )
        ],
    )


def _shares(pair: MapPair, found: Map, by: str) -> tuple[str, ...]:
    """Return the beginning of a row."""
    shares = (fixed(100.0 * found.shares[outcome], 2) for outcome in OUTCOMES)
    return (pair.plane, pair.controller, by, *shares)


def _counts(pair: MapPair) -> tuple[Cell | str, ...]:
    """Return how many grid points disagree."""
    d = pair.disagreement
    inside = Cell(str(d.inside), "neutral" if d.inside else "")
    return (str(d.differ), str(d.on_border), inside, str(pair.points))


def _figure(pairs: list[MapPair]) -> Figure:
    """Return the figure of one plane."""
    name, title, over = WORDS[pairs[0].plane]
    settings: Any = pairs[0].mujoco.settings
    step = 1e3 * float(settings["timestep"])
    said = (
        f"{pair.controller}: {100.0 * pair.ode.shares['settled']:.1f} % settle by the equations, "
        f"{100.0 * pair.mujoco.shares['settled']:.1f} % in MuJoCo, {pair.disagreement.differ} "
        f"grid points differ, {pair.disagreement.inside} of them not on a border"
        for pair in pairs
    )
    return Figure(
        name=f"attraction-{name}",
        title=title.format(start=math.degrees(pairs[0].starts[0, 1])),
        caption=(
            f"Outcome {over}: by the ideal equations, in MuJoCo at {step:g} ms with a held force, "
            "and where the two differ. A grid point on a border has a neighbour with a different "
            "outcome, so a finer grid would move it."
        ),
        alt="; ".join(said) + ".",
        draw=partial(draw_attraction, [pair.comparison for pair in pairs]),
    )
