"""The tables of the survival studies, as rows of text."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from afl_mujoco.document.numbers import fixed, percent, short
from afl_mujoco.reporting.page.inputs.studies import Row, Study, reading_study
from afl_mujoco.reporting.page.survival.rates import at_time, rate_rows, replay_text
from afl_mujoco.reporting.page.survival.sentences import survival_sentences
from afl_mujoco.reporting.survival.ladder.words import (
    class_of,
    level_text,
    rise_of,
    threshold_text,
)
from afl_mujoco.validation.ladder.thresholds import ABOVE, BELOW

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
    """

    text: str
    kind: str = ""


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
    return {
        "survival_studies": studies,
        "survival": {name: _made(studies, name, make) for name, make in TABLES.items()},
        "survival_sentences": _all_guarded(studies, survival_sentences),
        "delays": _made(studies, "ladder", delay_rows) or [],
        "measured": _made(studies, "margins", measured_text) or "",
        "replay": _all_guarded(
            {"montecarlo": studies["montecarlo"]}, lambda found: replay_text(found["montecarlo"])
        )
        if "montecarlo" in studies
        else "",
    }


def _made(studies: Mapping[str, Study], name: str, make: Callable[[Row], Any]) -> Any:
    """Return what is made of a study, None without it."""
    if name not in studies:
        return None
    return _all_guarded({name: studies[name]}, lambda found: make(found[name].data))


def _all_guarded(studies: Mapping[str, Study], make: Callable[[Mapping[str, Study]], Any]) -> Any:
    """Return what is made of studies; what they lack is an error that names their files."""
    paths = " or ".join(str(study.path) for study in studies.values())
    with reading_study(paths, " or ".join(studies)):
        return make(studies)


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
    hint = "" if failure is None else f"{failure['failure']}{at_time(failure['time'])}"
    return {
        "survives": Cell(threshold_text(rung, rise["survives"]), _KINDS[kind]),
        "settles": Cell(threshold_text(rung, rise["settles"])),
        "typical": Cell(
            typical["failure"] or f"settles in {fixed(figures['settling_time'], 1)} s",
            "good" if typical["settles"] else "part" if typical["survives"] else "bad",
        ),
        "peak_z": Cell(fixed(figures["peak_z"], 2)),
        "max_force": Cell(fixed(figures["max_force"], 0)),
        "failure": Cell(hint or "none"),
    }


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
        held = threshold["place"] == ABOVE
        level = threshold["holds_at" if held else "fails_at"]
        ratio = level / margin["margin"] if margin["margin"] else None
        sign = {ABOVE: "> ", BELOW: "< "}.get(threshold["place"], "")
        rows.append(
            {
                "controller": margin["controller"],
                "margin": fixed(1e3 * margin["margin"], 1),
                "plant": f"{short(margin['cart_mass'])} kg, {short(margin['half_length'])} m",
                "ladder": threshold_text(rungs["delay"], threshold),
                "ratio": fixed(None, 2) if ratio is None else f"{sign}{fixed(ratio, 2)}",
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
    agree = sum(bool(row["agrees"]) for row in both)
    neither = sum(row["margin"] is None and row["measured"] is None for row in rows)
    unstable = f" On {neither} the loop is not stable at all, in neither." if neither else ""
    return (
        f"Measured, with the force held for {short(1e3 * margins['control_period'])} ms: from the "
        f"delay on at which a motion of 1 mrad no longer decays in MuJoCo. "
        f"On {len(both)} of {len(rows)} plants and laws there are both; "
        f"they differ by at most {percent(abs(worst['difference']), 2)} ({worst['controller']}, "
        f"M = {short(worst['cart_mass'])} kg, l = {short(worst['half_length'])} m), and {agree} "
        f"agree within 5 %.{unstable}"
    )


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


def estimation_rows(study: Row) -> list[dict[str, str]]:
    """Return one row for each scenario and what the law is told.

    Parameters
    ----------
    study
        What an estimation.json holds.
    """
    return [
        {
            "scenario": case["scenario"],
            "told": loop["told"] + (", with noise" if loop["noise"] else ""),
            "completed": f"{loop['completed']} of {loop['runs']}",
            "iae_z": fixed(loop["figures"]["iae_z"], 2),
            "iae_phi": fixed(loop["figures"]["iae_phi"], 3),
            "max_force": fixed(loop["figures"]["max_force"], 1),
            "largest_force": fixed(loop["largest_force"], 1),
        }
        for case in study["cases"]
        for loop in case["loops"]
    ]


def _worst(table: list[list[float | None]], stable: list[bool], pick: Any) -> float | None:
    """Return the worst of a margin over the stable plants; None if none is, or it is infinite."""
    cells = [x for row in table for x in row]
    values = [math.inf if x is None else x for x, holds in zip(cells, stable, strict=True) if holds]
    worst = float(pick(values)) if values else math.inf
    return worst if math.isfinite(worst) else None


def _in_ms(value: float | None) -> float | None:
    """Return a time in milliseconds."""
    return None if value is None else 1e3 * value


TABLES: Mapping[str, Callable[[Row], Any]] = MappingProxyType(
    {
        "ladder": ladder_rows,
        "montecarlo": rate_rows,
        "attraction": share_rows,
        "margins": margin_rows,
        "estimation": estimation_rows,
    }
)
"""What makes the table of each study."""
