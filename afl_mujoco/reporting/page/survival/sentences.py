"""What holds, what breaks first, at what, how sure that is, better than what, in sentences."""

from __future__ import annotations

from collections.abc import Mapping

from afl_mujoco.reporting.page.inputs.studies import Row, Study
from afl_mujoco.reporting.page.numbers import fixed, percent, short
from afl_mujoco.reporting.page.summary import Sentence
from afl_mujoco.reporting.survival.ladder.words import (
    level_text,
    rise_of,
    spare,
    threshold_text,
)
from afl_mujoco.validation.ladder.climb import END_STOP, REFUSED
from afl_mujoco.validation.ladder.thresholds import ABOVE

OURS, REFERENCE = "adaptive", "lqr"
"""The controller that the sentences are about, and the one that it is compared with."""

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
    ladder = data.get("ladder")
    if ladder is not None and OURS not in ladder["controllers"]:
        ladder = None
    return (
        Sentence("What holds", _holds(ladder), "ladder"),
        Sentence("What breaks first", _breaks(ladder), "ladder"),
        Sentence("At what threshold", _thresholds(ladder), "ladder"),
        Sentence("How sure that is", _confidence(data), "montecarlo"),
        Sentence("Better than what", _compared(ladder, data), "montecarlo"),
    )


def _missing(study: str) -> str:
    """Say which command would answer."""
    return f"Not known here: afl-mujoco {study} finds out."


def _holds(ladder: Row | None) -> str:
    """Say what one flaw of a typical rig at a time does."""
    if ladder is None:
        return _missing("ladder")
    rises = [rise_of(ladder, r["name"], OURS) for r in _single(ladder)]
    survived = sum(rise["typical"]["survives"] for rise in rises)
    settled = sum(rise["typical"]["settles"] for rise in rises)
    roomy = sum(_spare(ladder, rung) >= 10.0 for rung in _single(ladder))
    return (
        f"Under each single flaw of a good laboratory rig (delay, lag, limits, noise, friction, "
        f"wrong M and l), the rail aside, the {OURS} controller stays up on {survived} of "
        f"{len(rises)} rungs and also comes to rest on {settled}; on {roomy} it would bear ten "
        "times as much."
    )


def _breaks(ladder: Row | None) -> str:
    """Say which flaws come nearest to what a typical rig has, or are already too much."""
    if ladder is None:
        return _missing("ladder")
    rungs = {rung["name"]: rung for rung in ladder["rungs"]}
    first = min(_single(ladder), key=lambda rung: _spare(ladder, rung))
    rise = rise_of(ladder, first["name"], OURS)
    at = threshold_text(first, rise["survives"])
    times = short(spare(first, rise["survives"]), 2)
    how = _HOW[rise["failure"]["failure"]] if rise["failure"] else "nothing fails"
    text = ""
    if "rail" in rungs:
        needs = rise_of(ladder, "rail", OURS)["survives"]
        typical = level_text(rungs["rail"], rungs["rail"]["typical"])
        text = (
            f"The rail: it must reach {threshold_text(rungs['rail'], needs)} m to either side, "
            f"where a rig has {typical} m. On an endless rail "
        )
    verb = "it is" if text else "It is"
    return (
        f"{text}{verb} {first['title']}: at {at} {first['unit']}, {times} times that of a typical "
        f"rig, {how}."
    )


def _thresholds(ladder: Row | None) -> str:
    """Say the thresholds that users ask for, and that of everything at once."""
    if ladder is None:
        return _missing("ladder")
    rungs = {rung["name"]: rung for rung in ladder["rungs"]}
    told: list[str] = []
    borne: list[str] = []
    for name, words in _ASKED.items():
        if name in rungs:
            threshold = rise_of(ladder, name, OURS)["survives"]
            text = f"{words} of {threshold_text(rungs[name], threshold)} {rungs[name]['unit']}"
            (borne if threshold["place"] == ABOVE else told).append(text.replace("> ", ""))
    parts = [f"{_or(told)} brings it down"] if told else []
    parts += [f"{_or(borne)} does not"] if borne else []
    if "together" in rungs:
        rise = rise_of(ladder, "together", OURS)
        bound = threshold_text(rungs["together"], rise["survives"])
        settles = threshold_text(rungs["together"], rise["settles"])
        parts.append(
            f"all flaws at once do at {bound} times those of a typical rig, and keep it from "
            f"coming to rest at {settles} times"
        )
    return f"{_start('; '.join(parts))}." if parts else _missing("ladder")


def _confidence(data: Mapping[str, Row]) -> str:
    """Say how often it stays up on random rigs, and how well thresholds are known."""
    ladder = data.get("ladder")
    tail = ""
    if ladder is not None:
        settings = ladder["settings"]
        tail = (
            f" Thresholds are bisected to {percent(settings['tolerance'], 3)} on "
            f"{' and '.join(settings['scenarios'])}, with {settings['seeds']} seeds of noise."
        )
    rows = {row["controller"]: row for row in data.get("montecarlo", {}).get("controllers", ())}
    if OURS not in rows:
        return f"{_missing('montecarlo')}{tail}"
    row = rows[OURS]
    worst = [
        case for case in data["montecarlo"]["worst_cases"]
        if case["controller"] == OURS and case["question"] == "hardest"
    ]  # fmt: skip
    search = ""
    if worst:
        found = "found one that fails" if worst[0]["failed"] else "found none that fails"
        search = f"; a search for the worst rig {found}"
    return (
        f"On {row['samples']} random rigs it stays up on {percent(row['rate'], 3)} "
        f"(exact 95 % interval {_interval(row['interval'])}) and comes to rest on "
        f"{percent(row['settled_rate'], 3)} ({_interval(row['settled_interval'])}){search}.{tail}"
    )


def _compared(ladder: Row | None, data: Mapping[str, Row]) -> str:
    """Say how it compares with LQR."""
    told = []
    if ladder is not None and REFERENCE in ladder["controllers"]:
        better, worse, equal = _score(ladder)
        told.append(
            f"On the ladder it bears more than LQR on {len(better)} rungs, as much on {equal} and "
            f"less on {len(worse)}{_both_together(ladder)}"
        )
    for pair in data.get("montecarlo", {}).get("comparisons", ()):
        if {pair["first"], pair["second"]} == {OURS, REFERENCE}:
            ours, theirs = pair["only_first"], pair["only_second"]
            if pair["first"] == REFERENCE:
                ours, theirs = theirs, ours
            told.append(
                f"on the same random rigs it alone stays up on {ours}, LQR alone on {theirs} "
                f"(p = {short(pair['p_value'], 2)})"
            )
    disks = _disks(data.get("margins"))
    if disks:
        told.append(f"its least disk margin is {disks[0]}, LQR's {disks[1]}")
    if not told:
        return _missing("ladder")
    return f"{_start('; '.join(told))}."


def _both_together(ladder: Row) -> str:
    """Say how bad a whole rig must be to bring down ours, and the reference."""
    rung = next((rung for rung in ladder["rungs"] if rung["name"] == "together"), None)
    if rung is None:
        return ""
    ours, theirs = (
        threshold_text(rung, rise_of(ladder, "together", name)["survives"])
        for name in (OURS, REFERENCE)
    )
    return f", and fails on a rig {ours} times as bad as a typical one, LQR on one {theirs} times"


def _score(ladder: Row) -> tuple[list[str], list[str], int]:
    """Return the rungs on which ours bears more and less than the reference, and how many equal."""
    better: list[str] = []
    worse: list[str] = []
    equal = 0
    for rung in ladder["rungs"]:
        ours, theirs = (rise_of(ladder, rung["name"], c)["survives"] for c in (OURS, REFERENCE))
        ratio = spare(rung, ours) / spare(rung, theirs)
        if 1.0 / _MARGIN <= ratio <= _MARGIN:
            equal += 1
        else:
            (better if ratio > 1.0 else worse).append(rung["name"])
    return better, worse, equal


def _disks(margins: Row | None) -> tuple[str, str] | None:
    """Return the least disk margins of ours and the reference, as text."""
    if margins is None or not {OURS, REFERENCE} <= margins["margins"].keys():
        return None
    least = [
        min(x for row in margins["margins"][name]["sampled"]["disk"] for x in row if x is not None)
        for name in (OURS, REFERENCE)
    ]
    return fixed(least[0], 2), fixed(least[1], 2)


def _spare(ladder: Row, rung: Row) -> float:
    """Return how many times the typical level ours bears."""
    return spare(rung, rise_of(ladder, rung["name"], OURS)["survives"])


def _single(ladder: Row) -> list[Row]:
    """Return the rungs that are one flaw, the rail aside."""
    return [rung for rung in ladder["rungs"] if rung["name"] not in APART]


def _interval(ends: list[float]) -> str:
    """Return an interval of shares in percent."""
    low, high = (fixed(100.0 * end, 1) for end in ends)
    return f"{low} to {high} %"


def _start(text: str) -> str:
    """Return a sentence with a capital."""
    return text[:1].upper() + text[1:]


def _or(parts: list[str]) -> str:
    """Join parts as a sentence does."""
    return " or ".join(filter(None, (", ".join(parts[:-1]), *parts[-1:])))
