"""The study of thresholds in words, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from afl_mujoco.control.names import REFERENCE, subject_of
from afl_mujoco.document.blocks import (
    Block,
    Cell,
    Column,
    Figure,
    Finding,
    Section,
    Status,
    Table,
    Text,
)
from afl_mujoco.document.numbers import MISSING, ceil_to, fixed, listed, percent, sentence, short
from afl_mujoco.scenario.imperfections import IDEAL, Imperfection
from afl_mujoco.scenario.requirements import UNITS
from afl_mujoco.scenario.words import departures_text
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED
from afl_mujoco.studies.bisection import LOWER, UPPER, Threshold
from afl_mujoco.studies.requirements_table import IN_WORDS, SETTLES, in_words
from afl_mujoco.studies.thresholds.classes import (
    CLASSES,
    FAILS,
    IDLE,
    LITTLE,
    class_of,
    level_text,
    reached,
    threshold_text,
    times_reference,
    tolerated,
    unit_text,
    unsettled,
)
from afl_mujoco.studies.thresholds.figures import added_titles, draw_combined, draw_thresholds
from afl_mujoco.studies.thresholds.imperfections import COMBINED, RAIL
from afl_mujoco.studies.thresholds.result import Result, Sweep, Verdict

DELAY = "delay"

_ASKED = {
    DELAY: "a delay",
    "control-period": "a control period",
    "force-limit": "a force limit",
    "noise": "sensor noise",
}

_HOW = {
    "fell": "the pole falls",
    "diverged": "the run diverges",
    "end_stops": "the cart reaches the end stop",
    CONTROLLER_FAILED: "the controller computes no force",
}

AMPLE = 10.0
"""How many times the reference level is ample."""

_EQUAL = 1.05  # thresholds closer than this factor count as equal


def sections(result: Result) -> list[Section]:
    """Return what a report says about the thresholds."""
    blocks: list[Block] = [*findings(result), Text(_meaning(result))]
    if result.controllers:
        blocks += [_thresholds_figure(result), _overview(result), _details(result)]
    if result.combined:
        blocks.append(_combined_figure(result))
    if result.bare:
        blocks.append(_drive(result))
    if result.delay_margins:
        blocks.append(_delays(result))
    return [Section("Imperfection thresholds", "thresholds", blocks)]


def _meaning(result: Result) -> str:
    """Say what a run has to achieve, and what the imperfections are added to."""
    text = ""
    if result.settling:
        text = "To *survive*: no pole falls, no run diverges, no cart reaches an end stop. "
        text += f"{SETTLES} "
    for scenario in result.scenarios:
        if asked := in_words(scenario):
            to_the_end = [IN_WORDS["completes"]] if scenario.requirements.completes else []
            words = listed([*to_the_end, *asked], "and")
            text += f"On {scenario.name} the requirements are: {words}. "
        if scenario.imperfections != IDEAL:
            text += (
                f"{scenario.name} itself has {departures_text(scenario.imperfections)}. A level is "
                "the total and not what is added; where the scenario's own is harsher than the "
                "reference hardware, it is the reference. Errors of the belief are added to its "
                "own. "
            )
    damped = {"rail-damping", "hinge-damping"} & {one.name for one in result.imperfections}
    if damped and result.settings.integrator == "RK4":
        text += "Where a damping is too fast for RK4 at the timestep, the run takes a finer one. "
    several = [one for one in result.imperfections if len(one.fields) > 1]
    return (text + " ".join(_keys(one) for one in several)).rstrip()


def _keys(one: Imperfection) -> str:
    """Say which keys of a scenario file an imperfection sets beside the first."""
    (first, factor), *others = one.fields.items()
    words = [f"{name} {short(other / factor)}" for name, other in others]
    return f"{sentence(one.title)}: `{first}`, with {listed(words, 'and')} times as much (in SI)."


def _failing(result: Result) -> str:
    """Say what it means not to survive."""
    if result.required:
        return "a requirement of the scenario is not met"
    return "the pole falls, the run diverges or the cart reaches an end stop"


def _passes(result: Result, under: bool = False) -> str:
    """Say what it means to survive, where needed with a word for the imperfections behind it."""
    if result.required:
        return "meets its requirements" + " under" * under
    return "survives"


def findings(result: Result) -> Iterator[Finding]:
    """Return the sentences of the summary."""
    for name, verdict in result.failing.items():
        yield Finding(f"No threshold for {name}", _fails_already(result, name, verdict))
    if not result.controllers:
        return
    ours = subject_of(result.controllers)
    yield Finding("What holds", _holds(result, ours))
    yield Finding("What breaks first", _breaks(result, ours))
    yield Finding("At what threshold", _thresholds(result, ours))
    if REFERENCE in result.controllers and ours != REFERENCE:
        yield Finding("Compared with LQR", _compared(result, ours))


def _fails_already(result: Result, name: str, verdict: Verdict) -> str:
    """Say how a controller fails before anything is added."""
    on = verdict.scenario or listed(result.settings.scenarios, "and")
    why = f" ({verdict.message})" if verdict.message else ""
    return (
        f"The {name} controller fails on {on} even without any added imperfection: "
        f"{_how(result, verdict)}{why}."
    )


def _holds(result: Result, ours: str) -> str:
    """Say what one imperfection at a time does at its reference level, and at ten times that.

    An endless rail is no imperfection, so that its end is left out there.
    """
    left_out = (COMBINED.name, RAIL) if result.endless else (COMBINED.name,)
    single = [
        one
        for one in result.imperfections
        if one.name not in left_out and result.sweep(one.name, ours).applies
    ]
    if not single:
        return f"No single imperfection was tried that acts on the {ours} controller."
    sweeps = [result.sweep(one.name, ours) for one in single]
    without = _endless(result, " and on a rail without end stops")
    at = f"at the level of the reference hardware{without}"
    if len(single) == 1:
        reference = sweeps[0].reference
        passes = _passes(result) if reference.survives else "fails"
        but = " but does not settle" if result.settling and unsettled(sweeps[0]) else ""
        return f"{sentence(single[0].title)} {at}: the {ours} controller {passes}{but}."
    survived = sum(sweep.reference.survives for sweep in sweeps)
    settled = sum(sweep.reference.settles for sweep in sweeps)
    settles = f" and settles under {settled}" if result.settling else ""
    text = (
        f"Of {len(single)} single imperfections, each {at}, the {ours} controller "
        f"{_passes(result, under=True)} {survived}{settles}."
    )
    pairs = zip(single, sweeps, strict=True)
    far = [pair for pair in pairs if times_reference(pair[0], pair[0].harsh) >= AMPLE]
    if far:
        ample = sum(tolerated(*pair) >= AMPLE for pair in far)
        again = "meets them under" if result.required else "survives"
        text += (
            f" Of the {len(far)} searched to ten times that level, it {again} {ample} even there."
        )
    return text


def _breaks(result: Result, ours: str) -> str:
    """Say which imperfection has the least to spare, or is already too much."""
    sweeps = {
        one.name: (one, result.sweep(one.name, ours))
        for one in result.imperfections
        if one.name != COMBINED.name and result.sweep(one.name, ours).applies
    }
    failing = {name: pair for name, pair in sweeps.items() if pair[1].survives.bound != LOWER}
    if not failing:
        return "Nothing, within the ranges that were tried."
    if all(sweep.survives.bound == UPPER for _, sweep in sweeps.values()):
        return "Everything that was tried, even at its mildest level."
    text = ""
    if RAIL in failing and not failing[RAIL][1].reference.survives:
        text = _rail(*failing.pop(RAIL))
        if not failing:
            return f"{text}."
    clause = _clause(result, *min(failing.values(), key=lambda pair: tolerated(*pair)))
    rail = "on a rail without end stops" if result.endless else "of the others"
    return f"{text}; {rail}, {clause}." if text else f"{sentence(clause)}."


def _endless(result: Result, words: str) -> str:
    """Return words that are true only of an endless rail."""
    return words if result.endless else ""


def _rail(rail: Imperfection, sweep: Sweep) -> str:
    """Say that the reference rail is too short, and which rail is not, rounded up."""
    level = level_text(rail, rail.reference)
    text = f"The rail: the reference of {level} m to either side is too short"
    enough = sweep.survives.holds_at
    if sweep.survives.bound == UPPER or enough is None:
        return text
    return f"{text}; {level_text(rail, ceil_to(enough))} m is enough"


def _clause(result: Result, one: Imperfection, sweep: Sweep) -> str:
    """Say from which level on a controller fails, and how."""
    failure = "" if sweep.failure is None else sweep.failure.failure
    how = _HOW.get(failure, f"the run {_in_words(result, sweep.failure)}")
    level = reached(sweep.survives)
    at = f"{level_text(one, level)} {one.unit}"
    if sweep.survives.bound == UPPER:
        return f"{one.title}: already at {at}, the mildest tried, {how}"
    times = short(times_reference(one, level), 2)
    return f"{one.title}: at {at}, {times} times the reference, {how}"


def _thresholds(result: Result, ours: str) -> str:
    """Say the thresholds that users ask for, and that of everything combined."""
    fatal: list[str] = []
    harmless: list[str] = []
    short_list = len(result.imperfections) <= len(_ASKED)  # then each was asked for by name
    for tried in result.imperfections:
        asked = tried.name in _ASKED or (short_list and tried.name != COMBINED.name)
        if asked and result.sweep(tried.name, ours).applies:
            threshold = result.sweep(tried.name, ours).survives
            words = _ASKED.get(tried.name, tried.title)
            text = f"{words} of {level_text(tried, reached(threshold))} {tried.unit}"
            (harmless if threshold.bound == LOWER else fatal).append(text)
    parts = []
    if fatal:
        parts.append(f"the {ours} controller fails at {listed(fatal, 'or')}")
    if harmless:
        subject = "" if fatal else f"the {ours} controller "
        tolerated_levels = f"{listed(harmless, 'and')}, the harshest tried"
        parts.append(f"{subject}{_passes(result, under=True)} {tolerated_levels}")
    if (one := result.imperfection(COMBINED.name)) is not None:
        but = _endless(result, ", except the end of the rail,")
        parts.append(_all_combined(result, one, result.sweep(one.name, ours), but))
    if not parts:
        return "Delay, control period, force limit and noise were not tried."
    settings = result.settings
    seeds = f"{settings.seeds} seed{'s' * (settings.seeds != 1)}"
    return (
        f"{sentence('; '.join(parts))}. Thresholds are bisected to "
        f"{percent(settings.tolerance, 3)} on {listed(settings.scenarios, 'and')}, with {seeds} "
        "of noise."
    )


def _all_combined(result: Result, one: Imperfection, sweep: Sweep, but: str) -> str:
    """Say at what multiple of the reference all imperfections combined are too much.

    Parameters
    ----------
    but
        What is not among them.
    """
    bound = _bound(one, sweep.survives)
    if sweep.survives.bound == LOWER:
        passes = _passes(result)
        return f"with all imperfections combined it {passes} up to {bound} times the reference"
    text = f"with all imperfections combined{but} it fails at {bound} times the reference levels"
    if result.settling:
        text += f" and no longer settles at {_bound(one, sweep.settles)} times"
    return text


def _bound(one: Imperfection, threshold: Threshold) -> str:
    """Return a threshold for use in a sentence: 5, more than 5, less than 5."""
    return threshold_text(one, threshold).replace("> ", "more than ").replace("< ", "less than ")


def _compared(result: Result, ours: str) -> str:
    """Say under how many imperfections it tolerates more than LQR."""
    ratios, neither = [], 0
    for one in result.imperfections:
        sweeps = [result.sweep(one.name, name) for name in (ours, REFERENCE)]
        if not all(sweep.applies for sweep in sweeps):
            continue
        if all(sweep.survives.bound == LOWER for sweep in sweeps):
            neither += 1
            continue
        mine, theirs = (tolerated(one, sweep) for sweep in sweeps)
        ratios.append(1.0 if mine == theirs else mine / theirs if theirs > 0.0 else 2.0 * _EQUAL)
    better = sum(ratio > _EQUAL for ratio in ratios)
    worse = sum(ratio < 1.0 / _EQUAL for ratio in ratios)
    text = (
        f"The {ours} controller tolerates more than LQR under {better} of "
        f"{len(ratios) + neither} imperfections that act on both, as much under "
        f"{len(ratios) - better - worse} and less under {worse}"
    )
    if neither:
        text += f"; neither fails under {neither}"
    if (everything := result.imperfection(COMBINED.name)) is not None:
        mine_text, theirs_text = (
            _bound(everything, result.sweep(everything.name, name).survives)
            for name in (ours, REFERENCE)
        )
        text += f"; combined, it fails at {mine_text} times the reference, LQR at {theirs_text}"
    return f"{text}."


def _thresholds_figure(result: Result) -> Figure:
    """Return the figure of the thresholds."""
    kinds = [
        class_of(one, result.sweep(one.name, controller))
        for one in result.imperfections
        for controller in result.controllers
    ]
    return Figure(
        name="thresholds",
        title=f"Level at which each controller no longer {_passes(result)}",
        caption=(
            f"Scenario {listed(result.settings.scenarios, 'and')}. Each cell gives the level, "
            f"in the unit of its row, from which {_failing(result)}, bisected to "
            f"{100.0 * result.settings.tolerance:g} %. The colour compares it with the reference "
            "hardware, whose level is given beside each imperfection."
            + (
                " ~ : on the reference hardware the controller survives but does not settle."
                if any(unsettled(sweep) for sweep in result.sweeps)
                else ""
            )
        ),
        alt=(
            f"A table of {len(result.imperfections)} imperfections by {len(result.controllers)} "
            f"controllers; {kinds.count(FAILS)} of {len(kinds)} fail at the reference level."
        ),
        draw=partial(draw_thresholds, result),
    )


def _combined_figure(result: Result) -> Figure:
    """Return the figure of the imperfections that are added one after another."""
    titles = added_titles(result)
    said = (
        f"{name}: {_story(result, verdicts, titles)}" for name, verdicts in result.combined.items()
    )
    return Figure(
        name="thresholds-combined",
        title="Reference imperfections, added one after another",
        caption=(
            f"Scenario {listed(result.settings.scenarios, 'and')}. Each column adds one "
            "imperfection, at the level of the reference hardware, to those before it."
        ),
        alt=f"{'; '.join(said)}.",
        draw=partial(draw_combined, result),
    )


def _story(result: Result, verdicts: tuple[Verdict, ...], titles: list[str]) -> str:
    """Say from which imperfection on a controller does not settle, and does not survive."""
    lost = {"fails": [not verdict.survives for verdict in verdicts]}
    if result.settling:
        lost = {"does not settle": [not verdict.settles for verdict in verdicts], **lost}
    said = [f"{w} from {titles[x.index(True)]} on" for w, x in lost.items() if True in x]
    holds = "settles" if result.settling else _passes(result)
    return " and ".join(said) or f"{holds} throughout"


def _overview(result: Result) -> Table:
    """Return the thresholds of survival: a row for each imperfection."""
    cells = [
        [_cell(one, result.sweep(one.name, name)) for name in result.controllers]
        for one in result.imperfections
    ]
    marks: dict[Status, str] = {
        "bad": "✗: it fails on the reference hardware",
        "neutral": f"◐: it {_passes(result)} at the reference level with less than 3 times to spare"
        + (", or does not settle" if result.settling else ""),
    }
    present = {cell.status for row in cells for cell in row}
    legend = "; ".join(text for status, text in marks.items() if status in present)
    if not all(sweep.applies for sweep in result.sweeps):
        legend += f"; {MISSING}: {CLASSES[IDLE]}" if legend else f"{MISSING}: {CLASSES[IDLE]}"
    on = listed(result.settings.scenarios, "and")
    return Table(
        caption=f"Level at which each controller no longer {_passes(result)} on {on}, found to "
        f"{percent(result.settings.tolerance, 3)}: what holds is up to that much milder"
        + (f". {legend}" if legend else ""),
        columns=(
            Column("Imperfection"),
            Column("Unit"),
            Column("Reference", number=True),
            *(Column(name, number=True) for name in result.controllers),
        ),
        rows=[
            (
                one.title,
                unit_text(result, one),
                level_text(one, one.reference),
                *row,
            )
            for one, row in zip(result.imperfections, cells, strict=True)
        ],
    )


def _cell(one: Imperfection, sweep: Sweep) -> Cell:
    """Return a threshold, marked by what happens on the reference hardware."""
    kind = class_of(one, sweep)
    if kind == IDLE:
        return Cell(MISSING)
    status: Status = "bad" if kind == FAILS else "neutral"
    plain = kind not in (FAILS, LITTLE) and not unsettled(sweep)
    return Cell(threshold_text(one, sweep.survives), "" if plain else status)


def _drive(result: Result) -> Table:
    """Return what drive each controller needs: what it asks for, and the limit that is enough."""
    limit = result.imperfection("force-limit")
    return Table(
        caption="What drive it needs: with nothing added, and the force limit at which it fails",
        columns=(
            Column("Controller"),
            Column("Largest command", "N", number=True),
            Column("Largest |F| exerted", "N", number=True),
            *([Column("Fails at a limit of", "N", number=True)] if limit else []),
        ),
        rows=[
            (
                name,
                fixed(verdict.metrics["max_command"], 0),
                fixed(verdict.metrics["max_force"], 0),
                *(
                    [threshold_text(limit, result.sweep(limit.name, name).survives)]
                    if limit
                    else []
                ),
            )
            for name, verdict in zip(result.controllers, result.bare, strict=True)
        ],
    )


def _details(result: Result) -> Table:
    """Return one row for each imperfection and controller."""
    return Table(
        summary="Every imperfection and controller: thresholds, and the reference hardware",
        caption=(
            f"Level at which each controller no longer {_passes(result)}, and how it fails there; "
            + ("level at which it no longer settles; " if result.settling else "")
            + "and its result on the reference hardware"
        ),
        columns=(
            Column("Imperfection"),
            Column("Reference", number=True),
            Column("Controller"),
            Column("Fails at", number=True),
            Column("How"),
            *([Column("Unsettled at", number=True)] if result.settling else []),
            Column("On the reference hardware"),
            Column("|z|", "m", number=True),
            Column("Force", "N", number=True),
        ),
        rows=[
            _detail(result, one, result.sweep(one.name, controller))
            for one in result.imperfections
            for controller in result.controllers
            if result.sweep(one.name, controller).applies
        ],
    )


def _detail(result: Result, one: Imperfection, sweep: Sweep) -> tuple[Cell | str, ...]:
    """Return one controller under one imperfection."""
    kinds: tuple[Status, ...] = ("bad", "neutral", "good", "good")
    reference, metrics = sweep.reference, sweep.reference.metrics
    status: Status = "good" if reference.settles else "neutral" if reference.survives else "bad"
    settled = metrics["settling_time"]
    settles = f"settles in {fixed(settled, 1)} s"
    if not result.settling or settled is None:
        settles = "as required"
    return (
        one.title,
        f"{level_text(one, one.reference)} {one.unit}",
        sweep.controller,
        Cell(threshold_text(one, sweep.survives), kinds[class_of(one, sweep)]),
        _how(result, sweep.failure),
        *([threshold_text(one, sweep.settles)] if result.settling else []),
        Cell(_in_words(result, reference) or settles, status),
        fixed(metrics["peak_z"], 2),
        fixed(metrics["max_force"], 0),
    )


def _how(result: Result, failure: Verdict | None) -> str:
    """Say what happened first where a controller does not survive."""
    if failure is None:
        return "none"
    at = "" if failure.time is None else f" at {fixed(failure.time, 2)} s"
    return _in_words(result, failure) + at


def _in_words(result: Result, verdict: Verdict | None) -> str:
    """Return how a controller failed, a requirement in words and with its limit."""
    if verdict is None:
        return ""
    missed = verdict.failure
    if missed == "end_stops":
        return "reached the end stop"
    if missed not in IN_WORDS:
        return missed or "does not settle" * (not verdict.settles)
    asked = [s.required for s in result.scenarios if verdict.scenario in (None, s.name)]
    limits = {one.get(missed) for one in asked}
    known = len(limits) == 1 and missed != "completes"  # which has no limit of its own
    limit = f" {short(limits.pop())} {UNITS[missed]}" if known else ""
    return f"misses “{IN_WORDS[missed]}{limit}”"


def _delays(result: Result) -> Section:
    """Return the delay margins beside the thresholds of the delay."""
    return Section(
        "Delay: linear margin and threshold",
        "thresholds-delay",
        (
            Text(
                "The delay margin applies to small motions on a plant that does not change; it is "
                "the least over the plants that the scenario goes through. The run starts far "
                "from upright and passes its worst plant within seconds: a loop that is unstable "
                "there may survive, and one that is stable may fail from the start. Where the "
                "ratio is far from 1 the linearisation is not valid for such a run."
            ),
            Table(
                caption="Least delay margin, and the delay at which the controller fails",
                columns=(
                    Column("Controller"),
                    Column("Margin", "ms", number=True),
                    Column("At M, l"),
                    Column("Threshold", "ms", number=True),
                    Column("Ratio", number=True),
                ),
                rows=list(_delay_rows(result)),
            ),
        ),
    )


def _delay_rows(result: Result) -> Iterator[tuple[str, ...]]:
    """Return one row for each controller that has a margin."""
    delay = result.imperfection(DELAY)
    if delay is None:
        return
    for margin in result.delay_margins:
        threshold = result.sweep(DELAY, margin.controller).survives
        sign = {LOWER: "> ", UPPER: "< "}.get(threshold.bound, "")
        ratio = reached(threshold) / margin.margin if margin.margin else None
        yield (
            margin.controller,
            fixed(1e3 * margin.margin, 1),
            f"{short(margin.cart_mass)} kg, {short(margin.half_length)} m",
            threshold_text(delay, threshold),
            fixed(None, 2) if ratio is None else f"{sign}{fixed(ratio, 2)}",
        )
