"""The tables of a Monte Carlo, as rows of text."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from afl_mujoco.document.numbers import fixed, interval, percent, short
from afl_mujoco.reporting.page.inputs.studies import Row, Study


def at_time(time: float | None) -> str:
    """Return when, if it is known.

    Parameters
    ----------
    time
        When [s].
    """
    return "" if time is None else f" at {fixed(time, 2)} s"


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
            "interval": interval(row["interval"]),
            "settled": percent(row["settled_rate"], 3),
            "settled_interval": interval(row["settled_interval"]),
            "files": sum(1 for failure in row["failures"] if failure["file"]),
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
            "outcome": case["outcome"] + at_time(case["end_time"])
            if case["failed"]
            else "survives",
            "kind": "bad" if case["failed"] else "good",
            "distance": fixed(case["distance"], 2),
            "changes": ", ".join(list(case["changes"])[:4]),
            "file": case["file"],
        }
        for case in study["worst_cases"]
    ]
    return {"rates": rates, "pairs": pairs, "worst": worst}


def replay_text(study: Study) -> str:
    """Return the command that replays the first failure that is kept; nothing without one.

    Parameters
    ----------
    study
        A Monte Carlo.
    """
    found = (replay_command(row, study.path.parent) for row in study.data["controllers"])
    return next(filter(None, found), "")


def replay_command(row: Row, folder: Path) -> str:
    """Return the command that replays a controller's first failure that is kept; nothing without.

    Parameters
    ----------
    row
        One of ``controllers`` in montecarlo.json.
    folder
        Of the study.
    """
    for failure in row["failures"]:
        if failure["file"]:
            file = shlex.quote(str(folder / failure["file"]))
            return str(row["replay"].replace(" FILE ", f" {file} ", 1))
    return ""
