"""Results with a bit of everything, for the tests of sections, figures and the page."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import afl_mujoco as afl
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.studies import attraction as attraction_study
from afl_mujoco.studies import check as check_study
from afl_mujoco.studies import compare as compare_study
from afl_mujoco.studies import estimation as estimation_study
from afl_mujoco.studies import montecarlo
from afl_mujoco.studies import thresholds as thresholds_study
from afl_mujoco.studies.shared.contract import find_study
from afl_mujoco.studies.shared.record import Record, load_record, save_record
from afl_mujoco.studies.shared.robustness import Settings
from afl_mujoco.studies.shared.search import Budget
from tests.verification_result import NASTY, OWN, make_result

SHIPPED = Path(__file__).parents[1] / "docs" / "results"
SHORT = replace(OWN, duration=0.4, disturbances=())
USED = [afl.CONTROLLERS[name] for name in ("adaptive", "lqr")]


@cache
def thresholds() -> thresholds_study.Result:
    settings, names = Settings(seeds=1, scan=2, tolerance=1.0), ("delay", "end_stops.z", "combined")
    asked = thresholds_study.Request(USED, (replace(SHORT, name=NASTY),), settings, names)
    return thresholds_study.run(asked)


@cache
def checked() -> check_study.Result:
    return check_study.check("cart-pole", samples=3)


@cache
def monte_carlo() -> montecarlo.Result:
    asked = afl.Requirements(max={"z": 0.12})
    ranges = {"phi": (-0.4, 0.4), "delay": (0.0, 0.004)}
    space = SampleSpace(replace(SHORT, name=NASTY, requirements=asked, ranges=ranges))
    how = {"samples": 12, "budget": Budget(generations=1, population=4)}
    return montecarlo.run(montecarlo.Request(space, USED, [f"{NASTY}:{x}" for x in "ab"], **how))


@cache
def attraction() -> attraction_study.Result:
    axes = np.linspace(-1.0, 1.0, 5), np.linspace(-2.0, 2.0, 3)
    return attraction_study.run(attraction_study.Request(SHORT, USED, ("phi", "phi_dot"), *axes))


@cache
def compare() -> compare_study.Result:
    asked = afl.Requirements(max={"z": 1.0}, settling_time=0.39)

    def broken(time: float, state: Any, belief: Any) -> float:
        raise RuntimeError(NASTY)

    return compare_study.compare(replace(SHORT, name=NASTY, requirements=asked), ["lqr", broken])


@cache
def estimation() -> estimation_study.Result:
    asked = estimation_study.Request([afl.SCENARIOS["step-step"]], USED[0], seeds=1)
    return estimation_study.run(asked)


def shipped(name: str) -> Callable[[], Any]:
    """Return what loads the result that the site rests on."""
    return lambda: load_record(find_study(name), SHIPPED).result


RESULTS = {
    "validate": make_result, "check": checked, "compare": compare, "thresholds": thresholds,
    "montecarlo": monte_carlo, "attraction": attraction, "margins": shipped("margins"),
    "estimation": estimation, "identify": shipped("identify"), "hardware": shipped("hardware"),
}  # fmt: skip


def record(name: str) -> Record:
    study = find_study(name)
    return Record(study=study, result=RESULTS[name](), command=f"afl-mujoco {name} --made-up")


def write_records(folder: Path) -> Path:
    for name in RESULTS:
        save_record(record(name), folder)
    return folder
