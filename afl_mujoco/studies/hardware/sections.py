"""A validation against recordings in words: verdicts, errors, terms, what controllers would do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

from afl_mujoco.identification.export import TILT, certain
from afl_mujoco.identification.prediction import AWAY, Errors
from afl_mujoco.report.numbers import MISSING, listed, percent, short
from afl_mujoco.report.old import (
    Block,
    Cell,
    Column,
    Figure,
    Finding,
    Section,
    Table,
    Text,
    Verdict,
    good_or_bad,
)
from afl_mujoco.studies.hardware.figures import (
    NAMES,
    draw_horizons,
    draw_recording,
    draw_residuals,
)
from afl_mujoco.studies.hardware.outlook import AS_IT_IS
from afl_mujoco.studies.hardware.protocol import load_protocol
from afl_mujoco.studies.hardware.result import Judged, Result
from afl_mujoco.studies.identified_parts import (
    indistinct,
    linearity_text,
    nominal_table,
)


def verdict(result: Result) -> Verdict:
    """Return whether every statement of the protocol holds that could be decided."""
    missed = [one.id for one in result.statements if one.fails]
    undecided = [one.id for one in result.statements if one.value is None]
    total = len(result.statements)
    of = f"of {total} statements of the protocol"
    parts = []
    if missed:
        does = "does" if len(missed) == 1 else "do"
        parts.append(f"{len(missed)} {of} {does} not hold: {listed(missed, 'and')}")
    elif not undecided:
        parts.append(f"all {total} statements of the protocol hold")
    elif len(undecided) < total:
        held = total - len(undecided)
        parts.append(f"{held} {of} hold{'s' if held == 1 else ''}")
    if undecided:
        are = "is" if len(undecided) == 1 else "are"
        parts.append(f"{len(undecided)} of {total} {are} not decided: {listed(undecided, 'and')}")
    text = "; ".join(parts)
    return Verdict(
        result.passed,
        f"{text}, on {_recordings(len(result.logs))}",
        f"What holds is validated against measurements of {result.identified.description.name}, in "
        "the range of states and commands of the recordings; not beyond it, and not for another "
        "cart-pole.",
    )


def _recordings(count: int) -> str:
    """Return how many recordings there are."""
    return f"{count} recording{'s' if count > 1 else ''}"


def sections(result: Result) -> list[Section]:
    """Return what a report says about a validation."""
    blocks: list[Block] = [
        Finding("Measured hardware", _finding(result)),
        Text(_range(result)),
        *_warnings(result),
        _statements(result),
        _errors("Whole cart-pole in MuJoCo, from the command alone", result.held_out),
        *_whole(result),
        _pole(result),
        _baselines(result),
        _terms(result),
        Figure(
            name="hardware-recording",
            title=f"{result.recorded.name}, measured and predicted",
            caption="Dots: measured (none in the dead zone of the angle). Lines: MuJoCo under the "
            "recorded command, for half a second from each fitted state. Bands: twice the rms "
            "error of all recordings after that time.",
            alt=f"{len(result.recorded.starts)} predictions of half a second over the readings",
            draw=partial(draw_recording, result),
        ),
        Figure(
            name="hardware-residuals",
            title="Errors of these predictions",
            caption="Predicted minus measured; dots: where a prediction starts.",
            alt="Errors of the predictions of the recording above over time",
            draw=partial(draw_residuals, result),
        ),
        Figure(
            name="hardware-horizons",
            title="Error against horizon",
            caption="All recordings. Near upright an angle error grows by a factor of e every "
            f"{short(1.0 / math.sqrt(result.terms['gravity'].value), 2)} s.",
            alt=_finding(result),
            draw=partial(draw_horizons, result),
        ),
        _parameters(result),
    ]
    if result.survival:
        blocks.append(_outlook(result))
    elif not certain(result.identified):
        blocks.append(
            Text(
                "The estimates are too uncertain to say what controllers would do: identify from "
                "more logs, or from logs with more motion."
            )
        )
    return [Section("Measured hardware", "hardware", blocks)]


def _finding(result: Result) -> str:
    """Say the main finding in a sentence."""
    at = next(one for one in result.held_out if one.horizon == 0.5)
    return (
        f"From the command alone MuJoCo predicts {short(at.horizon)} s of "
        f"{_recordings(len(result.logs))} of {result.identified.description.name} to "
        f"{short(1e3 * (at.rms_z or 0.0), 2)} mm and {short(1e3 * at.rms_phi, 2)} mrad rms, "
        f"or {percent(at.explained_z, 3)} and {percent(at.explained_phi, 3)} of the variance."
    )


def _range(result: Result) -> str:
    """Say what the recordings cover, and how they were predicted."""
    p = load_protocol().prediction
    v, w = result.speeds
    return (
        f"Recordings of {result.source}: |z| up to {short(result.reach, 2)} m, speeds up to "
        f"{short(v, 2)} m/s and {short(w, 2)} rad/s, angles over a range of up to "
        f"{short(math.degrees(result.turned), 3)}°. States are fitted to "
        f"the {short(p.past)} s before each start, one every {short(p.every)} s. The protocol "
        "(statements and limits) was fixed before any prediction of the recordings that come with "
        "the package and were not fitted."
    )


def _warnings(result: Result) -> list[Block]:
    """Warn where the recordings were fitted."""
    if not result.fitted:
        return []
    has = "have names" if len(result.fitted) > 1 else "has the name"
    return [
        Text(
            f"{_recordings(len(result.fitted))} of these {has} of recordings that the estimates "
            "were fitted to. If they are the same recordings, what follows is no proof."
        )
    ]


def _shown(judged: Judged, value: float | None) -> str:
    """Return a value or a limit of a statement."""
    if "share" in judged.measure or "relative" in judged.measure:
        return percent(value, 3)
    return short(value, 3)


def _statements(result: Result) -> Table:
    """Return the statements with their verdicts."""
    return Table(
        caption="Statements of the protocol",
        columns=(
            Column("Statement"),
            Column("Measure"),
            Column("Measured", number=True),
            Column("Limit", number=True),
            Column("Verdict"),
        ),
        rows=[
            (
                Cell(one.statement, note=f"{one.suspected or f'limit: {one.reason}'}"),
                one.measure,
                _shown(one, one.value),
                f"{'≥' if one.at_least else '≤'} {_shown(one, one.limit)}",
                _verdict(one),
            )
            for one in result.statements
        ],
        stacked=True,
    )


def _verdict(judged: Judged) -> Cell:
    """Return the verdict on a statement."""
    if judged.value is None:
        return Cell("not decided", "open")
    return Cell("validated" if judged.holds else "not validated", good_or_bad(judged.holds))


def _whole(result: Result) -> list[Block]:
    """Return the errors without the starts around which a row is missing, if there are any."""
    if [one.starts for one in result.whole] == [one.starts for one in result.held_out]:
        return []
    caption = "The same without the starts around which a row, and so its command, is missing"
    return [_errors(caption, result.whole)]


def _errors(caption: str, errors: Sequence[Errors]) -> Table:
    """Return errors by horizon."""
    return Table(
        caption=caption,
        columns=(
            Column("Horizon", "s", number=True),
            Column("φ", "mrad", number=True),
            Column("φ", "counts", number=True),
            Column("explained", "%", number=True),
            Column("z", "mm", number=True),
            Column("z", "counts", number=True),
            Column("explained", "%", number=True),
            Column("Starts", number=True),
        ),
        rows=[
            (
                short(one.horizon),
                short(1e3 * one.rms_phi, 3),
                short(one.counts_phi, 3),
                _share(one.explained_phi),
                short(None if one.rms_z is None else 1e3 * one.rms_z, 3),
                short(one.counts_z, 3),
                _share(one.explained_z),
                str(one.starts),
            )
            for one in errors
        ],
    )


def _share(value: float | None) -> str:
    """Return a share of variance in percent; one below zero explains nothing."""
    return MISSING if value is None else "< 0" if value < 0.0 else short(100.0 * value, 4)


def _pole(result: Result) -> Table:
    """Return the errors of the pole alone."""
    return Table(
        caption="The pole alone, given the motion of the cart",
        columns=(
            Column("Horizon", "s", number=True),
            Column("φ", "mrad", number=True),
            Column("φ", "counts", number=True),
            Column(f"φ beyond {short(AWAY)} rad from upright", "counts", number=True),
            Column("explained", "%", number=True),
            Column("Starts", number=True),
        ),
        rows=[
            (
                short(one.horizon),
                short(1e3 * one.rms_phi, 3),
                short(one.counts_phi, 3),
                short(one.away_phi, 3),
                _share(one.explained_phi),
                str(one.starts),
            )
            for one in result.pole
        ],
    )


def _baselines(result: Result) -> Table:
    """Return the errors of the baselines beside those of the model."""
    names = {"": "identified, in MuJoCo", **NAMES}
    found = {"": result.held_out, **result.baselines}
    horizons = [one.horizon for one in result.held_out]
    return Table(
        caption="rms error of φ [mrad] and z [mm], from the command alone",
        columns=(Column("Model"), *(Column(f"{short(h)} s", number=True) for h in horizons)),
        rows=[
            (
                names[key],
                *(
                    f"{short(1e3 * one.rms_phi, 3)}, {short(1e3 * (one.rms_z or 0.0), 3)}"
                    for one in errors
                ),
            )
            for key, errors in found.items()
        ],
    )


def _terms(result: Result) -> Table:
    """Return the terms of the pole's equation."""
    return Table(
        caption="Term by term, estimated again from these recordings alone",
        columns=(
            Column("Term"),
            Column("Unit"),
            Column("Estimate", number=True),
            Column("95 % interval", number=True),
            Column("Expected", number=True),
            Column("Deviation", "%", number=True),
        ),
        rows=[
            (
                one.title,
                one.unit,
                short(one.value),
                f"{short(one.low)} to {short(one.high)}",
                short(one.expected),
                short(None if one.expected is None else 100.0 * (one.value / one.expected - 1), 2),
            )
            for one in result.terms.values()
        ],
    )


def _parameters(result: Result) -> Section:
    """Return the cart-pole in kilograms and newtons."""
    one = result.identified
    texts = [*indistinct(one), *filter(None, [linearity_text(one)])]
    return Section(
        "The cart-pole in MuJoCo",
        "hardware-parameters",
        [nominal_table(one), *(Text(text) for text in texts)],
    )


def _outlook(result: Result) -> Section:
    """Return what controllers would do on that cart-pole."""
    found = result.survival
    table = Table(
        caption="Largest starting angle from which a controller, as deployed on this cart-pole, "
        "ends upright and never reaches the end of its rail [deg]",
        columns=(Column("Change"), *(Column(s.controller, number=True) for s in found)),
        rows=[
            (what, *(f"{math.degrees(s.angles[what]):.0f}" for s in found))
            for what in found[0].angles
        ],
    )
    said = [f"`{s.controller}` survives {s.survived} of {s.runs}" for s in found]
    text = (
        f"On cart-poles drawn from the distribution of the estimates, the pole starting within "
        f"{math.degrees(TILT):.1f}° of upright: {listed(said, 'and')}."
    )
    return Section(
        "What controllers would do on it",
        "hardware-outlook",
        [Finding("On this cart-pole", _outlook_finding(result)), Text(text), table],
    )


def _outlook_finding(result: Result) -> str:
    """Say which controllers balance it, from which angles, and which change helps most."""
    parts = []
    for s in result.survival:
        now = math.degrees(s.angles[AS_IT_IS])
        best = max(s.angles, key=lambda what: s.angles[what])
        then = math.degrees(s.angles[best])
        name = f"`{s.controller}`"
        said = f"{name} balances from up to {now:.0f}°" if now else f"{name} fails even from 1°"
        if then > now:
            said += f" ({then:.0f}° with the change “{best}”)"
        parts.append(said)
    return f"As deployed, {listed(parts, 'and')}."
