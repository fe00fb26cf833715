"""Made-up results with a bit of everything, for the tests of sections, figures and the page."""

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import afl_mujoco as afl
from afl_mujoco.identification.prediction import Errors, load_estimates
from afl_mujoco.scenario.ranges import Ranges
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.studies import attraction as attraction_study
from afl_mujoco.studies import check as check_study
from afl_mujoco.studies import compare as compare_study
from afl_mujoco.studies import estimation as estimation_study
from afl_mujoco.studies import hardware as hardware_study
from afl_mujoco.studies import identify as identify_study
from afl_mujoco.studies import margins as margins_study
from afl_mujoco.studies import montecarlo
from afl_mujoco.studies import thresholds as thresholds_study
from afl_mujoco.studies.shared.contract import find_study
from afl_mujoco.studies.shared.identified_parts import Shown
from afl_mujoco.studies.shared.record import Record, save_record
from afl_mujoco.studies.shared.robustness import Settings
from afl_mujoco.studies.shared.search import Budget
from tests.verification_result import NASTY, OWN, make_result

CONTROLLERS = ("adaptive", "lqr")
SHORT = replace(OWN, duration=0.4, disturbances=())
USED = [afl.CONTROLLERS[name] for name in CONTROLLERS]


@cache
def thresholds() -> thresholds_study.Result:
    settings = Settings(seeds=1, scan=2, tolerance=1.0)
    scenario = replace(SHORT, name=NASTY)
    return thresholds_study.run(
        thresholds_study.Request(USED, (scenario,), settings, ("delay", "end_stops.z", "combined"))
    )


@cache
def checked() -> check_study.Result:
    return check_study.check("cart-pole", samples=3)


@cache
def monte_carlo() -> montecarlo.Result:
    asked = afl.Requirements(max={"z": 0.12})
    ranges = Ranges(varied={"phi": (-0.4, 0.4), "delay": (0.0, 0.004)})
    space = SampleSpace(replace(SHORT, name=NASTY, requirements=asked, ranges=ranges))
    budget = Budget(generations=1, population=4)
    return montecarlo.run(
        montecarlo.Request(space, USED, [f"{NASTY}:{x}" for x in "ab"], samples=12, budget=budget)
    )


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


def margins(gain_increase: float | None = 16.6) -> margins_study.Result:
    def row(name: str, kind: str, mass: float, length: float, **found: float | None):
        place = {"cart_mass": mass, "half_length": length}
        return margins_study.Row(
            controller=name, loop=kind, input="force", parameters=place, stable=bool(found), **found
        )

    plants = list(itertools.product((0.1, 2.0), (0.05, 0.2, 1.0)))
    delays = (0.012, 0.03, 0.1, 0.013, 0.03)
    rows = []
    for name in CONTROLLERS:
        for (mass, length), x in zip(plants, (0.4, 0.5, 0.6) * 2, strict=True):
            whole = dict.fromkeys(margins_study.METRICS, x)
            rows.append(row(name, "continuous", mass, length, **whole))
        for (mass, length), x, delay in zip(plants, (0.4, 0.5, 0.6) * 2, delays, strict=False):
            known = {**dict.fromkeys(margins_study.METRICS, x), "delay": delay}
            rows.append(row(name, "held", mass, length, **known | {"gain_increase": gain_increase}))
        rows.append(row(name, "held", *plants[-1]))
    return margins_study.Result(
        scenario="made-up",
        imperfections="none",
        left_out=(),
        control_period=1e-3,
        units={"cart_mass": "kg", "half_length": "m"},
        plants=len(plants),
        linearisation_step=1e-5,
        rows=tuple(rows),
    )


@cache
def estimation() -> estimation_study.Result:
    asked = estimation_study.Request([afl.SCENARIOS["step-step"]], USED[0], seeds=1)
    return estimation_study.run(asked)


def identified() -> identify_study.Result:
    time = np.linspace(0.0, 2.0, 100)
    z, phi = 0.1 * np.sin(3.0 * time), np.cos(4.0 * time)
    phi[40:44] = np.nan
    part = np.arange(20).reshape(2, 10)
    shown = Shown(
        name=NASTY, time=time, z=z, phi=phi, command=np.sign(z),
        simulated_time=time[part], simulated_z=z[part] + 1e-3, simulated_phi=phi[part],
    )  # fmt: skip
    return identify_study.Result(identified=load_estimates(), shown=shown)


def hardware() -> hardware_study.Result:
    errors = tuple(
        Errors(horizon=h, rms_phi=0.02 * h, rms_z=0.01 * h, counts_phi=13.0 * h, away_phi=12.0 * h,
               counts_z=118.0 * h, explained_phi=1.0 - 0.1 * h, explained_z=0.99 - h,
               clear_phi=9.0 * h, starts=200, away=110)
        for h in (0.1, 0.2, 0.5, 1.0)
    )  # fmt: skip
    unknown = dict.fromkeys(("rms_z", "counts_z", "explained_z", "away_phi"))
    made = identified().shown
    assert made is not None
    known = {"value": 37.4, "low": 37.3, "high": 37.5, "expected": 37.25, "unit": "1/s²"}
    term = hardware_study.Term(**known, title="gravity term w2")
    judged = hardware_study.Statement(
        id="rig-0.5-z", statement="The position is predicted.", measure="share of variance",
        limit=0.9, reason="as for the angle", value=0.49, at_least=True, suspected="the drive",
    )  # fmt: skip
    survival = [
        hardware_study.Survival(
            controller=name, runs=20, survived=survived, angles={"as it is": least, "rail x4": most}
        )
        for name, survived, least, most in (("lqr", 3, 0.0, 0.5), ("adaptive", 20, 0.2, 0.2))
    ]
    return hardware_study.Result(
        logs=(NASTY, "two"),
        fitted=("two",),
        identified=load_estimates(),
        held_out=errors,
        terms={"gravity": term, "friction": replace(term, expected=None, title="friction")},
        whole=tuple(replace(e, starts=150) for e in errors),
        recorded=made,
        pole=tuple(replace(e, **unknown) for e in errors),
        nominal=errors,
        statements=(judged, replace(judged, id="rig-0.5-phi", value=0.95, suspected="")),
        band=np.array([[0.0, 0.5], [0.001, 0.01], [0.001, 0.1]]),
        survival=tuple(survival),
    )


RESULTS = {
    "validate": make_result, "check": checked, "compare": compare, "thresholds": thresholds,
    "montecarlo": monte_carlo, "attraction": attraction, "margins": margins,
    "estimation": estimation, "identify": identified, "hardware": hardware,
}  # fmt: skip


def record(name: str) -> Record:
    study = find_study(name)
    return Record(study=study, result=RESULTS[name](), command=f"afl-mujoco {name} --made-up")


def write_records(folder: Path) -> Path:
    for name in RESULTS:
        save_record(record(name), folder)
    return folder
