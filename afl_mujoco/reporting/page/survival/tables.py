"""The tables of the survival studies, as rows of text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from afl_mujoco.reporting.page.inputs.studies import Row, Study, malformed
from afl_mujoco.reporting.page.numbers import fixed, percent, short
from afl_mujoco.reporting.page.survival.sentences import survival_sentences
from afl_mujoco.reporting.survival.ladder.words import (
    CLASSES,
    class_of,
    level_text,
    rise_of,
    threshold_text,
)

_KINDS = ("bad", "part", "good", "good")  # of the classes of a threshold


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table.

    Attributes
    ----------
    text
        What it says.
    kind
        Of its colour: ``good``, ``part``, ``bad`` or nothing.
    hint
        What else there is to say.
    """

    text: str
    kind: str = ""
    hint: str = ""


def survival_view(studies: Mapping[str, Study]) -> dict[str, Any]:
    """Return what the page's section on survival shows.

    Parameters
    ----------
    studies
        By name.

    Raises
    ------
    FileError
        If a study does not hold what its table needs.
    """
    makers = {
        "ladder": ladder_rows,
        "montecarlo": rate_rows,
        "attraction": share_rows,
        "margins": margin_rows,
    }
    tables = {}
    for name, make in makers.items():
        if name in studies:
            try:
                tables[name] = make(studies[name].data)
            except (KeyError, TypeError, ValueError, StopIteration, AttributeError) as error:
                raise malformed(f"{name}.json", name, error) from None
    return {
        "survival_studies": studies,
        "survival": tables,
        "survival_sentences": survival_sentences(studies),
        "delays": delay_rows(studies["ladder"].data) if "ladder" in studies else [],
        "measured": measured_text(studies["margins"].data) if "margins" in studies else "",
    }


def ladder_rows(ladder: Row) -> list[dict[str, Any]]:
    """Return one row for each rung: its title, the typical rig, a cell for each controller.

    Parameters
    ----------
    ladder
        What a ladder.json holds.
    """
    return [
        {
            "title": rung["title"],
            "typical": f"{level_text(rung, rung['typical'])} {rung['unit']}",
            "cells": [
                _rise_cells(rung, rise_of(ladder, rung["name"], name))
                for name in ladder["controllers"]
            ],
        }
        for rung in ladder["rungs"]
    ]


def _rise_cells(rung: Row, rise: Row) -> dict[str, Cell]:
    """Return what one controller does on one rung."""
    typical, failure = rise["typical"], rise["failure"]
    kind = class_of(rung, rise)
    figures = typical["metrics"]
    hint = "" if failure is None else f"{failure['failure']}{_at(failure['time'])}"
    return {
        "survives": Cell(threshold_text(rung, rise["survives"]), _KINDS[kind], CLASSES[kind]),
        "settles": Cell(threshold_text(rung, rise["settles"])),
        "typical": Cell(
            typical["failure"] or f"settles in {fixed(figures['settling_time'], 1)} s",
            "good" if typical["settles"] else "part" if typical["survives"] else "bad",
            f"|z| up to {fixed(figures['peak_z'], 2)} m, "
            f"force up to {fixed(figures['max_force'], 0)} N",
        ),
        "failure": Cell(hint or "none"),
    }


def _at(time: float | None) -> str:
    """Return when, if it is known."""
    return "" if time is None else f" at {fixed(time, 2)} s"


def delay_rows(ladder: Row) -> list[dict[str, str]]:
    """Return one row for each controller: least delay margin on the way, threshold of the ladder.

    Parameters
    ----------
    ladder
        What a ladder.json holds.
    """
    rungs = {rung["name"]: rung for rung in ladder["rungs"]}
    rows = []
    for margin in ladder["delay_margins"]:
        threshold = rise_of(ladder, "delay", margin["controller"])["survives"]
        level = threshold["fails_at"]
        ratio = level / margin["margin"] if level and margin["margin"] else None
        rows.append(
            {
                "controller": margin["controller"],
                "margin": fixed(1e3 * margin["margin"], 1),
                "plant": f"{short(margin['cart_mass'])} kg, {short(margin['half_length'])} m",
                "ladder": threshold_text(rungs["delay"], threshold),
                "ratio": fixed(ratio, 2),
            }
        )
    return rows


def measured_text(margins: Row) -> str:
    """Say how margins and measured delays of small motions agree; nothing if none was measured.

    Parameters
    ----------
    margins
        What a margins.json holds.
    """
    rows = margins["measured"]
    both = [row for row in rows if row["difference"] is not None]
    if not both:
        return ""
    worst = max(both, key=lambda row: abs(row["difference"]))
    agree = sum(bool(row["agrees"]) for row in rows)
    return (
        f"A motion of 1 mrad in MuJoCo grows from a delay that differs from the margin by at most "
        f"{percent(abs(worst['difference']), 2)} ({worst['controller']}, M = "
        f"{short(worst['cart_mass'])} kg, l = {short(worst['half_length'])} m); within 5 % they "
        f"agree on {agree} of {len(rows)}."
    )


def rate_rows(study: Row) -> dict[str, list[dict[str, Any]]]:
    """Return rates, comparisons and worst cases of a Monte Carlo.

    Parameters
    ----------
    study
        What a montecarlo.json holds.
    """
    rates = [
        {
            "controller": row["controller"],
            "survived": f"{row['survived']} of {row['samples']}",
            "rate": percent(row["rate"], 3),
            "interval": _percents(row["interval"]),
            "settled": percent(row["settled_rate"], 3),
            "settled_interval": _percents(row["settled_interval"]),
            "files": sum(1 for failure in row["failures"] if failure["file"]),
            "replay": row["replay"].replace("FILE", _first_file(row)),
        }
        for row in study["controllers"]
    ]
    counts = ("first", "second", "both", "only_first", "only_second", "neither")
    pairs = [
        {**{key: pair[key] for key in counts}, "p": short(pair["p_value"], 2)}
        for pair in study["comparisons"]
    ]
    worst = [
        {
            "controller": case["controller"],
            "question": case["question"],
            "outcome": case["outcome"] + _at(case["end_time"]) if case["failed"] else "survives",
            "kind": "bad" if case["failed"] else "good",
            "distance": fixed(case["distance"], 2),
            "changes": ", ".join(list(case["changes"])[:4]),
            "file": case["file"],
        }
        for case in study["worst_cases"]
    ]
    return {"rates": rates, "pairs": pairs, "worst": worst}


def _first_file(row: Row) -> str:
    """Return the first failure that is kept as a file."""
    return next((failure["file"] for failure in row["failures"] if failure["file"]), "FILE")


def _percents(ends: list[float]) -> str:
    """Return an interval of shares in percent."""
    return f"{fixed(100.0 * ends[0], 1)} to {fixed(100.0 * ends[1], 1)}"


def share_rows(study: Row) -> list[dict[str, str]]:
    """Return one row for each map of attraction.

    Parameters
    ----------
    study
        What an attraction.json holds.
    """
    return [
        {
            "plane": entry["plane"],
            "controller": entry["controller"],
            "ode": percent(entry["ode"]["shares"]["settled"], 3),
            "mujoco": percent(entry["mujoco"]["shares"]["settled"], 3),
            "differ": f"{entry['disagreement']['differ']} of {entry['cells']}",
            "inside": str(entry["disagreement"]["inside"]),
        }
        for entry in study["maps"]
    ]


def margin_rows(study: Row) -> list[dict[str, str]]:
    """Return the worst margin of each controller over the plants, its force held.

    Parameters
    ----------
    study
        What a margins.json holds.
    """
    rows = []
    for name, kinds in study["margins"].items():
        found = kinds["sampled"]
        stable = [flag for row in found["stable"] for flag in row]
        rows.append(
            {
                "controller": name,
                "unstable": str(stable.count(False)),
                "gain_down": fixed(_worst(found["gain_decrease"], stable, max), 2),
                "gain_up": fixed(_worst(found["gain_increase"], stable, min), 1),
                "phase": fixed(_worst(found["phase"], stable, min), 0),
                "disk": fixed(_worst(found["disk"], stable, min), 2),
                "delay": fixed(_in_ms(_worst(found["delay"], stable, min)), 1),
            }
        )
    return rows


def _worst(table: list[list[float | None]], stable: list[bool], pick: Any) -> float | None:
    """Return the worst of a margin over the stable plants; None if none is, or it is infinite."""
    cells = [x for row in table for x in row]
    values = [math.inf if x is None else x for x, holds in zip(cells, stable, strict=True) if holds]
    worst = float(pick(values)) if values else math.inf
    return worst if math.isfinite(worst) else None


def _in_ms(value: float | None) -> float | None:
    """Return a time in milliseconds."""
    return None if value is None else 1e3 * value
