"""A small made-up validation with a bit of everything, for the tests of the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from afl_mujoco.document.pictures import Picture, load_picture
from afl_mujoco.document.style import new_figure, save_figure
from afl_mujoco.studies.verification.claims.claim import (
    IN_PART,
    NOT_REPRODUCED,
    REPRODUCED,
    UNDETERMINED,
)
from afl_mujoco.studies.verification.criteria import CRITERIA
from afl_mujoco.studies.verification.curves import Curves
from afl_mujoco.studies.verification.decisions import DECISIONS

NASTY = "<script>alert(1)</script>"
CONTROLLERS = ("fixed", "adaptive")
SIMULATORS = ("ode", "mujoco exact", "mujoco continuous", "mujoco sampled")
APART = {"mujoco exact": 1e-13, "mujoco continuous": 1e-6, "mujoco sampled": 1e-2}

_VERDICTS = (REPRODUCED, REPRODUCED, NOT_REPRODUCED, IN_PART, UNDETERMINED, NOT_REPRODUCED)
_METRICS = {
    "objective": 2.1633, "iae_z": 11.5, "iae_phi": 0.91, "max_force": 58.9, "force_squared": 75.2,
    "settling_2pc_z": 7.76, "settling_2pc_phi": None, "overshoot_z": 4.2, "overshoot_phi": 0.35,
    "peak_z_dot": 7.4, "peak_phi_dot": 9.1, "end_time": 2.0,
}  # fmt: skip
_BUDGET = {
    "total": 0.0348, "model_form": 1.8e-12, "integrator": 4.1e-10, "control_hold": 0.0348,
    "schedule_sampling": 1.9e-5, "disturbance_timing": 0.0, "residual": 1.8e-5,
}  # fmt: skip
_LEDGER = {
    "work": 2.07, "energy_of_ramps": 0.0, "energy_of_jumps": 1.25, "energy_residual": 4.6e-13,
    "impulse": -2.03, "momentum_of_ramps": 0.0, "momentum_of_jumps": 0.5,
    "momentum_residual": 1.8e-15,
}  # fmt: skip
_QUANTILES = {"5%": -66.5, "25%": -14.8, "median": 0.1, "75%": 7.1, "95%": None}


def places(second: str) -> list[tuple[str, str]]:
    """Return scenarios and controllers, the name of the second scenario given."""
    return [(s, c) for s in ("step-step", second) for c in CONTROLLERS]


def make_report(
    *, b3: float | None = 4.7e-10, full: bool = True, second: str = NASTY
) -> dict[str, Any]:
    """Return a report as plain data; it fails if `b3` exceeds its limit."""
    values = {"A5": 8.9e-16, "B1": 5.8e-12, "B2": 4.6e-6, "B3": b3, "B5": 5.2e-4}
    checks = [
        CRITERIA["A1"].judge(1.0e-13),
        CRITERIA["A3"].judge(0.0),
        *(
            CRITERIA[id].judge(float("nan") if value is None else value, *place)
            for id, value in values.items()
            for place in places(second)
        ),
    ]
    passed = all(check.passed for check in checks)
    rows = [{"scenario": s, "controller": c} for s, c in places(second)]
    report: dict[str, Any] = {
        "schema": 1,
        "verdict": "pass" if passed else "fail",
        "versions": {"afl_mujoco": "0.1.0", "mujoco": "3.17.0", "python": "3.11.7"},
        "checks": [check.to_dict() for check in checks],
        "runs": [
            {**row, "simulator": name, "outcome": "completed", "metrics": dict(_METRICS)}
            for row in rows
            for name in SIMULATORS
        ],
        "claims": [_claim(k) for k in range(1, 13)],
        "random_schedules": {
            name: {"schedules": 1000, "share": share, "interval": near, "quantiles": _QUANTILES}
            for name, share, near in (
                ("published", 0.504, [0.4725, 0.5354]),
                ("retuned", 0.919, [0.9003, 0.9352]),
            )
        },
        "error_budgets": [
            {
                **row, **_BUDGET, "residual_share": 5.2e-4,
                "at_worst": {"state": "phi_dot", "time": 0.005, **_BUDGET},
            }
            for row in rows
        ],
        "ledgers": [{**row, **_LEDGER} for row in rows],
        "omissions": [{**row, "stretching_rod": 1.7e-13, "momenta_kept": 2.6} for row in rows],
        "studies": [
            {
                **row, "study": study, "steps": [2e-3, 1e-3, 5e-4, 2.5e-4],
                "errors": [1e-4 * 0.5 ** (order * k) for k in range(4)],
                "order": order, "expected": order,
            }
            for study, order in (("continuous", 4.0), ("sampled", 1.0))
            for row in rows
        ],
        "decisions": dict(DECISIONS),
        "settings": {"timestep": 0.001, "control_period": 0.001, "full": full},
        "command": "afl-mujoco validate --full step-step 'my scenario.toml'",
    }  # fmt: skip
    if not full:
        report |= {"ledgers": [], "omissions": [], "studies": [], "claims": []}
        report["random_schedules"] = {}
    return report


def _claim(number: int) -> dict[str, Any]:
    """Return one row of the claims ledger."""
    return {
        "id": f"C{number}",
        "claim": f"claim {number} has |F| & <angles>",
        "figure": "improvement of the objective (O1) [%]",
        "paper": None if number == 2 else 38.03,
        "here": None if number == 5 else 18.36 - number,
        "verdict": _VERDICTS[number % len(_VERDICTS)],
        "why": "values of the schedule are not in the paper (D3, D4)",
    }


def make_curves(*, fell_at: int | None = None, second: str = NASTY) -> tuple[Curves, ...]:
    """Return curves of the report's runs; MuJoCo's end early if they `fell_at` an instant."""
    time = np.arange(0.0, 2.0005, 0.001)
    ideal = np.stack(
        [
            2.0 * time * np.exp(-2.0 * time),
            -1.047 * np.exp(-3.0 * time),
            2.0 * (1.0 - 2.0 * time) * np.exp(-2.0 * time),
            3.141 * np.exp(-3.0 * time),
        ],
        axis=1,
    )
    force = 58.9 * np.exp(-20.0 * time)
    shape = np.sin(30.0 * time)[:, None]
    found = []
    for scenario, controller in places(second):
        scale = 1.0 if controller == "fixed" else 0.9
        states = {"ode": scale * ideal}
        states |= {name: scale * (ideal + apart * shape) for name, apart in APART.items()}
        states = {k: x if k == "ode" or fell_at is None else x[:fell_at] for k, x in states.items()}
        found.append(
            Curves(
                scenario=scenario,
                controller=controller,
                time=time,
                cart_mass=np.where(time < 1.0, 0.5, 1.0),
                half_length=np.clip(0.2 + 0.4 * time, 0.2, 0.6),
                push=np.where((time >= 1.2) & (time < 1.3), -10.0, 0.0),
                states=states,
                forces={name: scale * force[: len(x)] for name, x in states.items()},
            )
        )
    return tuple(found)


def make_pictures(folder: Path) -> tuple[Picture, ...]:
    """Draw a figure for each place of the page."""
    figure = new_figure(3.0, 2.0)
    figure.subplots().plot([0.0, 1.0], [0.0, 1.0])
    for suffix in ("svg", "png"):
        save_figure(figure, folder / f"line.{suffix}")
    entry = {"svg": "line.svg", "png": "line.png", "title": "A line", "caption": "It rises."}
    places = ("step-step", "#scenarios", "#checks", "#budget", "#studies", "#claims", "#gains")
    return tuple(
        load_picture({**entry, "alt": f"a line for {place}"}, folder, place) for place in places
    )


def film_entry(file: str, **changes: Any) -> dict[str, Any]:
    """Return an entry of films.json."""
    entry = {
        "file": file, "poster": None, "kind": "film", "title": f"the film {file}",
        "scenario": "step-step", "controllers": ["adaptive"], "width": 64, "height": 48,
        "fps": 10, "frames": 20, "duration": 2.0,
    }  # fmt: skip
    return entry | changes


def write_listing(folder: Path, *entries: dict[str, Any]) -> None:
    """Write films.json."""
    text = json.dumps({"schema": 1, "films": entries})
    (folder / "films.json").write_text(text, encoding="utf-8")
