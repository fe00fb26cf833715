"""Made-up survival studies with a bit of everything, for the tests of figures, tables and page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from page_case import NASTY

from afl_mujoco.document.style import new_figure, save_figure
from afl_mujoco.validation.ladder.climb import END_STOP, UNSETTLED, climbed
from afl_mujoco.validation.ladder.rungs import find_rung
from afl_mujoco.validation.ladder.thresholds import ABOVE, BELOW, BETWEEN

CONTROLLERS = ("adaptive", "lqr")

# (survives: place, level), (settles: place, level), at the typical rig: survives, settles
RISES: dict[str, dict[str, tuple[Any, ...]]] = {
    "delay": {
        "adaptive": (BETWEEN, 0.047, BETWEEN, 0.040, True, True),
        "lqr": (BETWEEN, 0.036, BETWEEN, 0.036, True, True),
    },
    "control-period": {
        "adaptive": (ABOVE, 0.05, ABOVE, 0.05, True, True),
        "lqr": (BETWEEN, 0.041, BETWEEN, 0.041, True, True),
    },
    "force-limit": {
        "adaptive": (BETWEEN, 10.0, BETWEEN, 10.0, True, True),
        "lqr": (BETWEEN, 9.9, BETWEEN, 9.9, True, True),
    },
    "rail-damping": {
        "adaptive": (BETWEEN, 7.3, BETWEEN, 3.6, True, False),
        "lqr": (BETWEEN, 11.0, BETWEEN, 9.7, True, True),
    },
    "rail": {
        "adaptive": (BETWEEN, 3.7, BETWEEN, 3.7, False, False),
        "lqr": (BELOW, 100.0, BELOW, 100.0, False, False),
    },
    "together": {
        "adaptive": (BETWEEN, 1.1, BETWEEN, 0.33, True, False),
        "lqr": (BETWEEN, 1.3, BETWEEN, 0.73, True, False),
    },
}

_METRICS = {
    "settling_time": 6.6, "peak_z": 4.05, "peak_phi": 1.05, "max_force": 59.0,
    "iae_z": 9.1, "iae_phi": 0.8,
}  # fmt: skip


def verdict(survives: bool, settles: bool, rung: str = "", level: float = 1.0) -> dict[str, Any]:
    """Return what became of a law at a level."""
    fatal = END_STOP if rung == "rail" else "fell"
    failure = "" if settles else UNSETTLED if survives else fatal
    return {
        "level": level, "survives": survives, "settles": settles, "failure": failure,
        "scenario": "step-step" if failure else None, "time": 1.25 if failure else None,
        "metrics": _METRICS | ({} if settles else {"settling_time": None}),
    }  # fmt: skip


def threshold(place: str, level: float) -> dict[str, Any]:
    """Return a threshold."""
    return {
        "place": place,
        "holds_at": level if place == ABOVE else None if place == BELOW else level * 0.99,
        "fails_at": None if place == ABOVE else level,
        "islands": 0,
    }


def make_ladder() -> dict[str, Any]:
    """Return what a ladder.json holds."""
    rises = []
    for rung, of in RISES.items():
        for name, (place, level, settled_place, settled, survives, settles) in of.items():
            failure = None if place == ABOVE else verdict(False, False, rung, level)
            rises.append(
                {
                    "rung": rung, "controller": name,
                    "typical": verdict(survives, settles, rung),
                    "survives": threshold(place, level),
                    "settles": threshold(settled_place, settled), "failure": failure,
                }
            )  # fmt: skip
    keys = ("name", "title", "unit", "scale", "typical", "less_is_worse")
    names = [rung.name for rung in climbed()]
    return study(
        "ladder",
        settings={"scenarios": ["step-step"], "seeds": 4, "tolerance": 0.02},
        controllers=list(CONTROLLERS),
        rungs=[{key: getattr(find_rung(name), key) for key in keys} for name in RISES],
        rises=rises,
        together={
            "rungs": names,
            "verdicts": {
                "adaptive": [verdict(i < 10, i < 8) for i in range(len(names))],
                "lqr": [verdict(True, True) for _ in names],
            },
        },
        delay_margins=[
            {"controller": "adaptive", "margin": 0.0323, "cart_mass": 0.5, "half_length": 0.2},
            {"controller": "lqr", "margin": 0.0, "cart_mass": 0.5, "half_length": 0.2},
        ],
    )


def make_montecarlo() -> dict[str, Any]:
    """Return what the page takes from a montecarlo.json; a file is named nastily."""
    controllers = [
        {
            "controller": name, "samples": 60, "survived": survived, "rate": survived / 60,
            "interval": [0.8608, 0.9896], "settled": 18, "settled_rate": 0.3,
            "settled_interval": [0.1884, 0.4321], "failures": [{"index": 27, "file": NASTY}],
            "replay": f"afl-mujoco simulate FILE --controller {name}",
        }
        for name, survived in zip(CONTROLLERS, (57, 55), strict=True)
    ]  # fmt: skip
    worst = [
        {
            "controller": name, "question": "hardest", "failed": failed, "outcome": "fell",
            "end_time": 9.9, "distance": 0.43, "changes": {"rail_friction": 0.99, "delay": 0.5},
            "file": f"montecarlo/{name}/hardest.toml",
        }
        for name, failed in zip(CONTROLLERS, (True, False), strict=True)
    ]  # fmt: skip
    pair = {
        "first": "adaptive", "second": "lqr", "both": 52, "only_first": 5, "only_second": 3,
        "neither": 0, "p_value": 0.7266,
    }  # fmt: skip
    return study("montecarlo", controllers=controllers, worst_cases=worst, comparisons=[pair])


def make_margins() -> dict[str, Any]:
    """Return what a margins.json holds, of two masses and three lengths, one plant not stable."""
    table = [[0.4, 0.5, 0.6], [0.4, 0.5, None]]
    names = ("gain_decrease", "gain_increase", "phase", "disk", "delay")
    found = {name: table for name in names} | {
        "gain_increase": [[16.6, None, None], [17.0, 18.0, None]],
        "delay": [[0.012, 0.03, 0.1], [0.013, 0.03, None]],
        "stable": [[True, True, True], [True, True, False]],
    }
    measured = [
        {"controller": "adaptive", "cart_mass": 0.1, "half_length": length, "margin": margin,
         "measured": measured, "difference": difference, "agrees": agrees}
        for length, margin, measured, difference, agrees in (
            (0.05, 0.012, 0.01206, 0.005, True), (0.2, 0.03, None, None, False),
        )
    ]  # fmt: skip
    return study(
        "margins",
        control_period=1e-3,
        cart_masses=[0.1, 2.0],
        half_lengths=[0.05, 0.2, 1.0],
        margins={name: {"continuous": found, "sampled": found} for name in CONTROLLERS},
        measured=measured,
    )


def make_attraction() -> dict[str, Any]:
    """Return what the page takes from an attraction.json."""
    return study(
        "attraction",
        maps=[
            {
                "plane": "states", "controller": "lqr", "cells": 25,
                "ode": {"shares": {"settled": 0.8}}, "mujoco": {"shares": {"settled": 0.84}},
                "disagreement": {"differ": 2, "on_border": 1, "inside": 1},
            }
        ],
    )  # fmt: skip


def study(name: str, **content: Any) -> dict[str, Any]:
    """Return a study with its frame."""
    frame = {"schema": 1, "study": name, "command": f"afl-mujoco {name} --made-up"}
    return {**frame, **content, "figures": []}


def write_studies(folder: Path) -> Path:
    """Write every study, each with a figure."""
    figure = new_figure(3.0, 2.0)
    figure.subplots().plot([0.0, 1.0], [0.0, 1.0])
    for made in (make_ladder(), make_montecarlo(), make_margins(), make_attraction()):
        name = f"{made['study']}-line"
        for suffix in ("svg", "png"):
            save_figure(figure, folder / f"{name}.{suffix}")
        entry = {"name": name, "title": f"Line of {made['study']}", "caption": "It rises."}
        files = {"alt": "a line", "svg": f"{name}.svg", "png": f"{name}.png"}
        text = json.dumps({**made, "figures": [entry | files]})
        (folder / f"{made['study']}.json").write_text(text, encoding="utf-8")
    return folder
