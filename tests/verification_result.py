"""A small made-up verification with a bit of everything, for the tests of sections and page."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import afl_mujoco as afl
from afl_mujoco.files import write_json
from afl_mujoco.films.listing import LISTING, Entry, Listing
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.metrics import metric_names
from afl_mujoco.studies.validate import Result, verdict_of
from afl_mujoco.studies.verify import claims
from afl_mujoco.studies.verify.cases import REPORTED, Settings, Simulated
from afl_mujoco.studies.verify.checks import CRITERIA, Check
from afl_mujoco.studies.verify.explanation import AtWorst, ErrorBudget, Omission

NASTY = '<script>alert(1)<!-- & "quoted"'
CONTROLLERS = ("fixed", "adaptive")
OWN = afl.Scenario(
    name="step-step", duration=2.0,
    schedule={"cart_mass": afl.staircase((1.0,), (0.5, 1.0)),
              "half_length": afl.piecewise_linear((0.0, 1.0), (0.2, 0.6))},
    disturbances=(afl.ForcePulse(force=-10.0, start=1.2, duration=0.1),),
)  # fmt: skip
"""A scenario of one's own under a name of the paper."""

SCENARIOS = (OWN, replace(OWN, name=NASTY))

_VERDICTS = [getattr(claims, x) for x in "REPRODUCED NOT_REPRODUCED IN_PART UNDETERMINED".split()]
_METRICS = {
    "objective": 2.1633, "iae_z": 11.5, "iae_phi": 0.91, "max_force": 58.9, "force_squared": 75.2,
    "settling_2pc_z": 7.76, "overshoot_z": 4.2, "overshoot_phi": 0.35,
    "peak_z_dot": 7.4, "peak_phi_dot": 9.1, "end_time": 2.0,
}  # fmt: skip
_PARTS = {
    "total": 0.0348, "model_form": 1.8e-12, "integrator": 4.1e-10, "control_hold": 0.0348,
    "schedule_sampling": 1.9e-5, "disturbance_timing": 0.0, "residual": 1.8e-5,
}  # fmt: skip
_QUANTILES = {"5%": -66.5, "25%": -14.8, "median": 0.1, "75%": 7.1, "95%": None}


def make_result(*, b3=4.7e-10, full=True, fell_at=None, outcome="completed") -> Result:
    places = [{"scenario": s.name, "controller": c} for s in SCENARIOS for c in CONTROLLERS]
    checks, metrics = make_checks(places, b3), dict.fromkeys(metric_names()) | _METRICS
    ended = {"outcome": outcome, "metrics": metrics}
    runs = [Simulated(**place, simulator=name, **ended) for place in places for name in REPORTED]
    pairs = {f"{s.name}/{c}": (s, c) for s in SCENARIOS for c in CONTROLLERS}
    omitted = {"stretching_rod": 1.7e-13, "momenta_kept": 2.6}
    more = {
        "claims": tuple(make_claim(k) for k in range(1, 13)),
        "random_schedules": {"published": comparison(0.504, (0.4725, 0.5354)),
                             "retuned": comparison(0.919, (0.9003, 0.9352))},
        "omissions": tuple(Omission(**place, **omitted) for place in places),
    }  # fmt: skip
    return Result(
        verdict=verdict_of(checks), checks=checks, runs=tuple(runs), settings=Settings(full=full),
        error_budgets=tuple(make_budget(k + 1, **place) for k, place in enumerate(places)),
        scenarios=SCENARIOS, **(more if full else {}),
        curves={name: make_curves(*pair, fell_at=fell_at) for name, pair in pairs.items()},
    )  # fmt: skip


def make_checks(places: Sequence[dict[str, str]], b3: float | None) -> tuple[Check, ...]:
    values = {"A5": 8.9e-16, "B1": 5.8e-12, "B2": 4.6e-6, "B3": b3, "B5": 5.2e-4}
    found = {id: float("nan") if value is None else value for id, value in values.items()}
    judged = [CRITERIA[id].judge(value, **at) for id, value in found.items() for at in places]
    return CRITERIA["A1"].judge(1.0e-13), CRITERIA["A3"].judge(0.0), *judged


def comparison(share: float, interval: tuple[float, float]) -> claims.Comparison:
    return claims.Comparison(schedules=1000, share=share, interval=interval, quantiles=_QUANTILES)


def make_budget(size: int, **place: str) -> ErrorBudget:
    signed = {name: -0.1 * size * value for name, value in _PARTS.items()}
    sizes = {name: abs(value) for name, value in signed.items()}
    signed["residual"] = 2.0 * signed["total"] - sum(signed.values()) + signed["residual"]
    worst = AtWorst(state="phi_dot", unit="rad/s", time=0.005, **signed)
    return ErrorBudget(**place, **sizes, at_worst=worst)


def make_claim(number: int) -> claims.Claim:
    said = {"id": f"C{number}", "claim": f"claim {number} has |F| & <angles>",
            "figure": "improvement of the objective (O1) [%]",
            "why": "values of the schedule are not in the paper (D3, D4)"}  # fmt: skip
    paper, here = None if number == 2 else 38.03, None if number == 5 else 18.36 - number
    verdict = _VERDICTS[(0, 0, 1, 2, 3, 1)[number % 6]]
    return claims.Claim(paper=paper, here=here, verdict=verdict, **said)


def make_curves(scenario=OWN, controller="fixed", *, fell_at: int | None = None) -> tuple:
    step = 1e-3 if scenario.duration <= 2.0 else 1e-2
    time = step * np.arange(round(scenario.duration / step) + 1)[:fell_at]
    slow, fast = 2.0 * np.exp(-2.0 * time), np.exp(-3.0 * time)
    states = np.stack([slow * time, -1.047 * fast, slow * (1.0 - 2.0 * time), 3.141 * fast], axis=1)
    return time, (1.0 if controller == "fixed" else 0.9) * states


def film_entry(file: str, **changes: Any) -> Entry:
    values: dict[str, Any] = {
        "file": file, "poster": "none.png", "title": f"the film {file}",
        "scenario": "step-step", "controllers": ("adaptive",), "width": 64, "height": 48,
        "deployment": Deployed(), "command": f"afl-mujoco render {file}",
    }  # fmt: skip
    return Entry(**values | changes)


def write_listing(folder: Path, *entries: Entry) -> None:
    write_json(folder / LISTING, Listing(films=entries))
