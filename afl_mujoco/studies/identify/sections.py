"""An identification in words: estimates, also in kilograms and newtons, and what is unknown."""

from __future__ import annotations

from functools import partial
from pathlib import PurePath

from afl_mujoco.identification.identify import WINDOW
from afl_mujoco.identification.least_squares import FEW_CLUSTERS
from afl_mujoco.report.numbers import percent, short
from afl_mujoco.report.old import Block, Command, Figure, Finding, Section, Text
from afl_mujoco.studies.identified_parts import (
    draw_log,
    estimates_table,
    indistinct,
    linearity_text,
    nominal_table,
)
from afl_mujoco.studies.identify.files import ESTIMATES, SCENARIO
from afl_mujoco.studies.identify.result import Result, Shown


def sections(result: Result) -> list[Section]:
    """Return what a report says about an identification."""
    one = result.identified
    blocks: list[Block] = [
        Finding(one.description.name, _finding(result)),
        Text(_what(result)),
        estimates_table("The pole and the sensors", one.pole.estimates),
    ]
    if text := linearity_text(one):
        blocks.append(Text(text))
    if one.drive is not None:
        blocks += [
            estimates_table("Cart and drive", one.drive.estimates),
            nominal_table(one),
        ]
    blocks += [Text(sentence) for sentence in indistinct(one)]
    if result.shown is not None:
        blocks.append(_figure(result.shown))
    if one.drive is not None:
        blocks.append(
            Command(
                "Controllers on this cart-pole",
                ("afl-mujoco", "compare", PurePath(SCENARIO), "--controllers", "lqr", "adaptive"),
            )
        )
        blocks.append(Text(f"`afl-mujoco hardware --estimates` reads `{ESTIMATES}`."))
    return [Section("A cart-pole identified", "identify", blocks)]


def _finding(result: Result) -> str:
    """Say the main finding in a sentence."""
    one = result.identified
    w2, k = one.find("gravity_term"), one.find("coupling")
    off = 100.0 * (w2.value / one.description.nominal.gravity_term - 1.0)
    return (
        f"Gravity acts on the pole as on its rod to within {short(abs(off), 2)} % "
        f"(w2 = {short(w2.value)} 1/s²), and the cart acts on it as on any rigid body to within "
        f"{short(100.0 * abs(k.value - 1.0), 2)} % (k = {short(k.value)})."
    )


def _what(result: Result) -> str:
    """Say what was fitted to what, and how well."""
    one = result.identified
    d = one.description
    left = f"{short(1e3 * one.pole.scatter_phi, 3)} mrad"
    left += f" ({short(one.pole.scatter_phi / d.angle_count, 2)} counts)" if d.angle_count else ""
    text = (
        f"{len(one.logs)} log{'s' * (len(one.logs) > 1)}, {short(one.seconds, 3)} s in all, one "
        f"row every {short(1e3 * one.period)} ms. The model is fitted to {one.pole.windows} "
        f"windows of at most {short(WINDOW)} s, each with its own initial state, which hold "
        f"{percent(one.share, 3)} of that; {one.dropped or 'no'} "
        f"{'stretches are' if one.dropped != 1 else 'stretch is'} left out, too short between lost "
        f"rows or without a known angle at the start. Residuals: {left} for the pole "
        "alone, driven by the recorded motion of the cart"
    )
    if one.drive is not None:
        z = one.drive.scatter_z
        text += (
            f"; {short(1e3 * one.drive.scatter_phi, 3)} mrad and {short(1e3 * (z or 0.0), 2)} mm "
            "for the whole cart-pole in MuJoCo, driven by the command"
        )
    few = len(one.logs) < FEW_CLUSTERS
    independent = (
        f"windows as independent, since there are fewer than {FEW_CLUSTERS} logs, and so are "
        "too narrow"
        if few
        else "logs, not readings, as independent"
    )
    return f"{text}. Intervals take {independent}."


def _figure(shown: Shown) -> Figure:
    """Return a log beside the model."""
    starts = list(zip(shown.simulated_time, shown.simulated_z, shown.simulated_phi, strict=True))
    return Figure(
        name="identify-log",
        title=f"{shown.name}, measured and simulated",
        caption="Dots: measured. Lines: MuJoCo under the recorded command, each from a state that "
        "was fitted to the half second before it.",
        alt=f"{len(starts)} simulations of half a second over the readings of {shown.name}",
        draw=partial(draw_log, shown.time, shown.z, shown.phi, shown.command, starts),
    )
