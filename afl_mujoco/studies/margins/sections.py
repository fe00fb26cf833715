"""The study of margins in words, tables and figures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import islice

import numpy as np

from afl_mujoco.report.numbers import MISSING, fixed, listed, percent, short
from afl_mujoco.report.old import Block, Cell, Column, Figure, Finding, Section, Table, Text
from afl_mujoco.report.style import in_words
from afl_mujoco.studies.margins.figures import delay_margins, draw_delay_margins, draw_measured
from afl_mujoco.studies.margins.measured_delay import REACH, START, TOLERANCE, DelayComparison
from afl_mujoco.studies.margins.result import Result
from afl_mujoco.studies.margins.small_motions import DELAYS, GAINS, SmallMotions

MOST = 4
"""Largest number of controllers that the finding names; the table has all."""

_COLUMNS = (
    (Column("Gain down to", number=True), "gain_decrease", 2, 1.0),
    (Column("Gain up to", number=True), "gain_increase", 1, 1.0),
    (Column("Phase", "°", number=True), "phase", 1, 1.0),
    (Column("Disk", number=True), "disk", 2, 1.0),
    (Column("Delay", "ms", number=True), "delay", 2, 1e3),
)
"""Column, margin, decimals and factor for each margin in the table."""


def sections(result: Result) -> list[Section]:
    """Return what a report says about the margins."""
    blocks: list[Block] = [_finding(result), *_about(result)]
    if result.margins and result.plants > 1:
        blocks.append(_delay_figure(result))
    if result.margins:
        blocks.append(_table(result))
    if result.not_linear:
        blocks.append(_motions_table(result))
    if both := _both(result):
        blocks += [Text(_measured_text(result, both)), _measured_figure(both, result)]
    return [Section("Stability margins", "margins", blocks)]


def _about(result: Result) -> Iterator[Text]:
    """Say which scenario gives the plants, and which of its imperfections count."""
    if result.scenario is None:
        return
    rest = f"; its {listed(result.left_out, 'and')} are not modelled" if result.left_out else ""
    counts = result.imperfections if result.imperfections != "none" else "none, as none is linear"
    yield Text(
        f"Of the imperfections of {result.scenario} these count: {counts}{rest}. The delay margin "
        "with a held force is the additional delay that the loop tolerates besides its own; with a "
        "continuous force it is without hold and delay."
    )


def _finding(result: Result) -> Finding:
    """Say how far each loop is from instability on its worst plant, in one sentence."""
    parts = []
    for name in islice(result.margins, MOST):
        unstable = result.grid(name, sampled=True).unstable
        if unstable:
            parts.append(f"{name} is unstable on {unstable} of {result.plants} plants")
            continue
        disk, delay = (result.worst(name, kind, sampled=True) for kind in ("disk", "delay"))
        if disk is not None and delay is not None:
            margin = f"{fixed(1e3 * delay.value, 1)} ms" if math.isfinite(delay.value) else "none"
            said = f"{fixed(disk.value, 2)} and a least delay margin of {margin}"
            parts.append(f"{name} has a least disk margin of {said}")
    sentences = [f"Linearised at upright, {'; '.join(parts)}."] if parts else []
    measured = [_motions_said(result, name) for name in islice(result.not_linear, MOST)]
    sentences += [f"Measured by small motions, {'; '.join(measured)}."] if measured else []
    return Finding("Margins" if measured else "Linear margins", " ".join(sentences))


def _motions_said(result: Result, name: str) -> str:
    """Say what small motions of a controller tolerate on its worst plant."""
    motions = [one for one in result.small_motions if one.controller == name]
    grow = sum(not one.decays for one in motions)
    if not motions:
        return f"none for {name}"
    if grow:
        return f"those of {name} do not decay on {grow} of {len(motions)} plants"
    return (
        f"{name} tolerates gains of {_down(motions)} to {_up(motions)} and a delay of "
        f"{_delay(motions)} ms"
    )


def _down(motions: list[SmallMotions]) -> str:
    """Return the largest of the least gains."""
    found = [one.gain_decrease for one in motions if one.decays and one.gain_decrease is not None]
    return fixed(max(found), 2) if found else f"< {1.0 / GAINS[-1]:.2g}"


def _up(motions: list[SmallMotions]) -> str:
    """Return the least of the largest gains."""
    found = [one.gain_increase for one in motions if one.decays and one.gain_increase is not None]
    return fixed(min(found), 1) if found else f"> {GAINS[-1]:g}"


def _delay(motions: list[SmallMotions]) -> str:
    """Return the least delay [ms]."""
    found = [one.delay for one in motions if one.decays and one.delay is not None]
    if not found:
        return f"> {1e3 * DELAYS[-1]:g}"
    return fixed(1e3 * min(found), 1) if min(found) > 0.0 else f"< {1e3 * DELAYS[0]:g}"


def _motions_table(result: Result) -> Table:
    """Return what small motions of each controller without linear margins tolerate."""
    rows: list[tuple[Cell | str, ...]] = []
    for name, reason in result.not_linear.items():
        motions = [one for one in result.small_motions if one.controller == name]
        grow = sum(not one.decays for one in motions)
        cells = [MISSING] * 3
        if grow < len(motions):
            cells = [_down(motions), _up(motions), _delay(motions)]
        count = f"{grow} of {len(motions)}" if motions else MISSING
        rows.append((name, Cell(count, "bad" if grow else ""), *cells, reason))
    return Table(
        caption=(
            f"Margins measured by motions of {short(1e3 * START)} mrad in MuJoCo, the force held "
            f"for {short(1e3 * result.control_period)} ms: the worst of the plants where they decay"
        ),
        columns=(
            Column("Controller"),
            Column("Plants where they grow", number=True),
            Column("Gain down to", number=True),
            Column("Gain up to", number=True),
            Column("Delay", "ms", number=True),
            Column("Why no linear margins"),
        ),
        rows=rows,
    )


def _table(result: Result) -> Table:
    """Return the worst margins of each controller, continuous and held."""
    period = f"held {short(1e3 * result.control_period)} ms"
    return Table(
        caption=f"Worst margins over {result.plants} plants, and where the delay margin is least",
        columns=(
            Column("Controller"),
            Column("Force"),
            Column("Unstable plants", number=True),
            *(column for column, *_ in _COLUMNS),
            Column("At M, l"),
        ),
        rows=[
            _row(result, name, sampled, period if sampled else "continuous")
            for name in result.margins
            for sampled in (False, True)
        ],
    )


def _row(result: Result, name: str, sampled: bool, force: str) -> tuple[Cell | str, ...]:
    """Return one loop."""
    unstable = result.grid(name, sampled=sampled).unstable
    least = result.worst(name, "delay", sampled=sampled)
    where = "" if least is None else f"{least.cart_mass:g} kg, {least.half_length:g} m"
    cells = []
    for _, metric, decimals, factor in _COLUMNS:
        worst = result.worst(name, metric, sampled=sampled)
        infinite = worst is not None and not math.isfinite(worst.value)
        value = None if worst is None else factor * worst.value
        cells.append("∞" if infinite else fixed(value, decimals))
    return (name, force, Cell(str(unstable), "bad" if unstable else ""), *cells, where)


def _both(result: Result) -> list[DelayComparison]:
    """Return the comparisons that have a margin and a measurement."""
    return [one for one in result.measured if one.difference is not None]


def _measured_text(result: Result, both: list[DelayComparison]) -> str:
    """Say how margins and measured delays of small motions agree."""
    worst = max(both, key=lambda one: abs(one.difference or 0.0))
    agree = sum(one.agrees for one in both)
    neither = sum(one.margin is None and one.measured is None for one in result.measured)
    unstable = ""
    if neither:
        unstable = f" On {neither}, both find the loop unstable even without added delay."
    return (
        f"The measured delay is that from which a motion of {short(1e3 * START)} mrad no longer "
        f"decays in MuJoCo, with the force held for {short(1e3 * result.control_period)} ms. "
        f"A margin and a measured delay exist for {len(both)} of {len(result.measured)} plants and "
        f"controllers; they differ by at most {percent(abs(worst.difference or 0.0), 2)} "
        f"({worst.controller}, "
        f"M = {short(worst.cart_mass)} kg, l = {short(worst.half_length)} m), and {agree} agree "
        f"within {percent(REACH, 2)}.{unstable}"
    )


def _delay_figure(result: Result) -> Figure:
    """Return the figure of the delay margins, a map or a line for each controller."""
    masses, lengths = len(result.cart_masses), len(result.half_lengths)
    over = f"{masses} × {lengths} plants. Red: unstable"
    if lengths == 1:
        over = f"{masses} M at l = {short(result.half_lengths[0])} m. Crosses at 0: unstable"
    elif masses == 1:
        over = f"{lengths} l at M = {short(result.cart_masses[0])} kg. Crosses at 0: unstable"
    return Figure(
        name="margins-delay",
        title="Delay margin of the linearised loop",
        caption=(
            "Delay margin at upright of the loop linearised from MuJoCo, with the force held for "
            f"{1e3 * result.control_period:g} ms, over {over} even without added delay."
        ),
        alt=f"Least delay margin: {'; '.join(_least(result)) or 'none'}.",
        draw=partial(draw_delay_margins, result),
    )


def _least(result: Result) -> Iterator[str]:
    """Yield the least delay margin of each controller that has one, in words."""
    for name, table in delay_margins(result).items():
        if np.isfinite(table).any():
            yield f"{name} {in_words(float(np.nanmin(table)))} ms"


def _measured_figure(both: list[DelayComparison], result: Result) -> Figure:
    """Return the figure of the measured delays."""
    plants = len({(one.cart_mass, one.half_length) for one in both})
    largest = max(abs(one.difference or 0.0) for one in both)
    return Figure(
        name="margins-measured",
        title="Margins and delays measured in MuJoCo",
        caption=(
            "Each mark is one controller on one plant: the delay from which a motion of "
            f"{short(1e3 * START)} mrad no longer decays in MuJoCo, found by bisection to "
            f"{percent(TOLERANCE, 2)}, against the margin."
        ),
        alt=(
            f"{len(both)} comparisons on {plants} plants; the largest difference is "
            f"{in_words(100.0 * largest)} %."
        ),
        draw=partial(draw_measured, result),
    )
