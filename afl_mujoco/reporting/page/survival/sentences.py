"""What holds, what breaks first, at what, how sure that is, better than what, in sentences."""

from __future__ import annotations

from collections.abc import Mapping

from afl_mujoco.document.numbers import fixed, interval, percent, short
from afl_mujoco.reporting.page.inputs.studies import Row, Study
from afl_mujoco.reporting.page.summary import Sentence
from afl_mujoco.reporting.survival.ladder.words import (
    borne,
    level_text,
    rise_of,
    threshold_text,
)
from afl_mujoco.validation.ladder.climb import END_STOP, REFUSED
from afl_mujoco.validation.ladder.rungs import LADDER
from afl_mujoco.validation.ladder.thresholds import ABOVE, BELOW

OURS, REFERENCE = "adaptive", "lqr"
"""The controller that the sentences are about where it was studied, and the one beside it."""

APART = ("rail", "together")
"""Rungs that have a clause of their own."""

_ASKED = {
    "delay": "a delay",
    "control-period": "a control period",
    "force-limit": "a force limit",
    "noise": "sensor noise",
}

_HOW = {
    "fell": "the pole falls",
    "diverged": "the run diverges",
    END_STOP: "the cart reaches the end stop",
    REFUSED: "the law has no force to give",
}

_MARGIN = 1.05  # thresholds closer than that are as good as equal


def survival_sentences(studies: Mapping[str, Study]) -> tuple[Sentence, ...]:
    """Return the summary of the survival studies; none without any.

    Parameters
    ----------
    studies
        By name.
    """
    if not studies:
        return ()
    data = {name: study.data for name, study in studies.items()}
    ours = _subject(data)
    ladder = data.get("ladder")
    if ladder is None or ours not in ladder["controllers"]:
        ladder = None
    return (
        Sentence("What holds", _holds(ladder, ours), "ladder"),
        Sentence("What breaks first", _breaks(ladder, ours), "ladder"),
        Sentence("At what threshold", _thresholds(ladder, ours), "ladder"),
        Sentence("How sure that is", _confidence(ladder, data, ours), "montecarlo"),
        Sentence("Better than what", _compared(ladder, data, ours), "montecarlo"),
    )


def _subject(data: Mapping[str, Row]) -> str:
    """Return the controller that the sentences are about."""
    there: list[str] = [*data.get("ladder", {}).get("controllers", ())]
    there += [row["controller"] for row in data.get("montecarlo", {}).get("controllers", ())]
    return OURS if OURS in there or not there else there[0]


def _missing(study: str) -> str:
    """Say which command would answer."""
    return f"Not known here: afl-mujoco {study} finds out."


def _holds(ladder: Row | None, ours: str) -> str:
    """Say what one flaw of a typical rig at a time does."""
    if ladder is None:
        return _missing("ladder")
    single = [rung for rung in ladder["rungs"] if rung["name"] not in APART]
    if not single:
        return "The single flaws of a rig were not tried."
    rises = [rise_of(ladder, rung["name"], ours) for rung in single]
    survived = sum(rise["typical"]["survives"] for rise in rises)
    settled = sum(rise["typical"]["settles"] for rise in rises)
    roomy = sum(borne(*pair) >= 10.0 for pair in zip(single, rises, strict=True))
    whole = len(single) == len(LADDER) - 1
    kinds = " (delay, lag, limits, noise, friction, inertias, wrong M and l)" if whole else ""
    return (
        f"Of {len(single)} single flaws of a good laboratory rig{kinds}, each at its usual size "
        f"and the rail aside, the {ours} controller survives {survived}, comes to rest under "
        f"{settled}, and survives {roomy} even at ten times that size."
    )


def _breaks(ladder: Row | None, ours: str) -> str:
    """Say which flaw comes nearest to what a typical rig has, or is already too much."""
    if ladder is None:
        return _missing("ladder")
    rungs = {rung["name"]: rung for rung in ladder["rungs"] if rung["name"] != "together"}
    rises = {name: rise_of(ladder, name, ours) for name in rungs}
    failing = [name for name in rungs if rises[name]["survives"]["place"] != ABOVE]
    if not failing:
        return "Nothing, within the ranges that were tried."
    if all(rises[name]["survives"]["place"] == BELOW for name in rungs):
        return "Everything that was tried, at its mildest: it may fail on the ideal loop already."
    text = ""
    if "rail" in failing and not rises["rail"]["typical"]["survives"]:
        rail, needs = rungs["rail"], rises["rail"]["survives"]
        typical = level_text(rail, rail["typical"])
        text = f"The rail: {typical} m to either side, as on a rig, is too short"
        if needs["place"] != BELOW:
            text += f" and {threshold_text(rail, needs)} m the least"
        failing.remove("rail")
        if not failing:
            return f"{text}."
    first = min(failing, key=lambda name: borne(rungs[name], rises[name]))
    clause = _clause(rungs[first], rises[first])
    return f"{text}; on an endless one, {clause}." if text else f"{_start(clause)}."


def _clause(rung: Row, rise: Row) -> str:
    """Say from which level of a rung a controller fails, and how."""
    how = _HOW.get(rise["failure"]["failure"], rise["failure"]["failure"])
    at = level_text(rung, rise["survives"]["fails_at"])
    if rise["survives"]["place"] == BELOW:
        return f"{rung['title']}: already at {at} {rung['unit']}, the mildest tried, {how}"
    times = rise["survives"]["fails_at"] / rung["typical"]
    times = short(1.0 / times if rung["less_is_worse"] else times, 2)
    return f"{rung['title']}: at {at} {rung['unit']}, {times} times that of a typical rig, {how}"


def _thresholds(ladder: Row | None, ours: str) -> str:
    """Say the thresholds that users ask for, and that of everything at once."""
    if ladder is None:
        return _missing("ladder")
    rungs = {rung["name"]: rung for rung in ladder["rungs"]}
    fatal: list[str] = []
    harmless: list[str] = []
    for name, words in _ASKED.items():
        if name in rungs:
            threshold = rise_of(ladder, name, ours)["survives"]
            held = threshold["place"] == ABOVE
            level = threshold["holds_at" if held else "fails_at"]
            text = f"{words} of {level_text(rungs[name], level)} {rungs[name]['unit']}"
            (harmless if held else fatal).append(text)
    parts = [f"{_or(fatal)} brings it down"] if fatal else []
    parts += [f"{_or(harmless)} does not{'' if fatal else ' bring it down'}"] if harmless else []
    if "together" in rungs:
        parts.append(_all_at_once(rungs["together"], rise_of(ladder, "together", ours)))
    if not parts:
        return "Delay, control period, force limit and noise were not tried."
    return f"{_start('; '.join(parts))}."


def _all_at_once(rung: Row, rise: Row) -> str:
    """Say how bad a rig must be to bring the controller down, and to keep it from resting."""
    bound = in_words(rung, rise["survives"])
    if rise["survives"]["place"] == ABOVE:
        return f"all flaws at once, the rail aside, bring it down only at {bound} times their size"
    return (
        f"all flaws at once, the rail aside, bring it down at {bound} times their usual size and "
        f"keep it from coming to rest at {in_words(rung, rise['settles'])} times"
    )


def in_words(rung: Row, threshold: Row) -> str:
    """Return a threshold as a sentence has it: 5, more than 5, less than 5.

    Parameters
    ----------
    rung, threshold
        As of `threshold_text`.
    """
    return threshold_text(rung, threshold).replace("> ", "more than ").replace("< ", "less than ")


def _confidence(ladder: Row | None, data: Mapping[str, Row], ours: str) -> str:
    """Say how often it stays up on random rigs, and how well thresholds are known."""
    tail = ""
    if ladder is not None:
        settings = ladder["settings"]
        seeds = f"{settings['seeds']} seed{'s' * (settings['seeds'] != 1)}"
        tail = (
            f" Thresholds are bisected to {percent(settings['tolerance'], 3)} on "
            f"{' and '.join(settings['scenarios'])}, with {seeds} of noise."
        )
    study = data.get("montecarlo", {})
    rows = {row["controller"]: row for row in study.get("controllers", ())}
    if ours not in rows:
        return f"{_missing('montecarlo')}{tail}"
    row = rows[ours]
    found = [
        case["failed"]
        for case in study["worst_cases"]
        if (case["controller"], case["question"]) == (ours, "hardest")
    ]
    search = ""
    if found:
        search = f"; a search for the worst rig found {'one' if found[0] else 'none'} that fails"
    return (
        f"On {row['samples']} random rigs with an endless rail it stays up on "
        f"{percent(row['rate'], 3)} (exact 95 % interval {interval(row['interval'])} %) and comes "
        f"to rest on {percent(row['settled_rate'], 3)} ({interval(row['settled_interval'])} %)"
        f"{search}.{tail}"
    )


def _compared(ladder: Row | None, data: Mapping[str, Row], ours: str) -> str:
    """Say how it compares with LQR."""
    told = []
    if ladder is not None and REFERENCE in ladder["controllers"] and ours != REFERENCE:
        better, worse, equal, neither = _score(ladder, ours)
        beyond = f", neither fails on {neither}" if neither else ""
        told.append(
            f"of the ladder's rungs it bears more than LQR on {better}, as much on {equal} and "
            f"less on {worse}{beyond}{_both_together(ladder, ours)}"
        )
    for pair in data.get("montecarlo", {}).get("comparisons", ()):
        if {pair["first"], pair["second"]} == {ours, REFERENCE}:
            mine, theirs = pair["only_first"], pair["only_second"]
            if pair["first"] == REFERENCE:
                mine, theirs = theirs, mine
            told.append(
                f"on the same random rigs it alone stays up on {mine}, LQR alone on {theirs} "
                f"(p = {short(pair['p_value'], 2)})"
            )
    disks = _disks(data.get("margins"), ours)
    if disks:
        told.append(disks)
    if not told:
        return "Not known here: afl-mujoco ladder and montecarlo compare it with lqr."
    return f"{_start('; '.join(told))}."


def _both_together(ladder: Row, ours: str) -> str:
    """Say how bad a whole rig must be to bring down ours, and the reference."""
    rung = next((rung for rung in ladder["rungs"] if rung["name"] == "together"), None)
    if rung is None:
        return ""
    mine, theirs = (
        in_words(rung, rise_of(ladder, "together", name)["survives"]) for name in (ours, REFERENCE)
    )
    return f", and fails on a rig {mine} times as bad as a typical one, LQR on one {theirs} times"


def _score(ladder: Row, ours: str) -> tuple[int, int, int, int]:
    """Return on how many rungs ours bears more, less and as much as the reference; neither fails.

    The last is how many rungs both bear as far as they were tried.
    """
    ratios, neither = [], 0
    for rung in ladder["rungs"]:
        rises = [rise_of(ladder, rung["name"], name) for name in (ours, REFERENCE)]
        if all(rise["survives"]["fails_at"] is None for rise in rises):
            neither += 1
            continue
        mine, theirs = (borne(rung, rise) for rise in rises)
        ratios.append(1.0 if mine == theirs else mine / theirs if theirs > 0.0 else 2.0 * _MARGIN)
    better = sum(ratio > _MARGIN for ratio in ratios)
    worse = sum(ratio < 1.0 / _MARGIN for ratio in ratios)
    return better, worse, len(ratios) - better - worse, neither


def _disks(margins: Row | None, ours: str) -> str:
    """Say the least disk margins of ours and the reference, or on how many plants there is none."""
    if margins is None or not {ours, REFERENCE} <= margins["margins"].keys() or ours == REFERENCE:
        return ""
    found = [margins["margins"][name]["sampled"] for name in (ours, REFERENCE)]
    lost = [sum(not flag for row in table["stable"] for flag in row) for table in found]
    if any(lost):
        count = sum(len(row) for row in found[0]["stable"])
        return f"linearised, it is unstable on {lost[0]} of {count} plants, LQR on {lost[1]}"
    mine, theirs = (min(x for row in table["disk"] for x in row) for table in found)
    return f"its least disk margin is {fixed(mine, 2)}, that of LQR {fixed(theirs, 2)}"


def _start(text: str) -> str:
    """Return a sentence with a capital."""
    return text[:1].upper() + text[1:]


def _or(parts: list[str]) -> str:
    """Join parts as a sentence does."""
    return " or ".join(filter(None, (", ".join(parts[:-1]), *parts[-1:])))
