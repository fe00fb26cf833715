"""Made-up results with a bit of everything, for the tests of sections, figures and the page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from afl_mujoco.document.blocks import Section
from afl_mujoco.identification.prediction import Errors
from afl_mujoco.identification.shipped import load_estimates
from afl_mujoco.scenario.laboratory import LABORATORY
from afl_mujoco.scenario.requirements import Requirements
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.simulation.attraction.grid import AttractionMap, Settling, state_grid
from afl_mujoco.simulation.judgement import Judgement
from afl_mujoco.simulation.metrics import UNITS
from afl_mujoco.studies.attraction import result as attraction_result
from afl_mujoco.studies.attraction.comparison import Comparison
from afl_mujoco.studies.bisection import BRACKETED, LOWER, UPPER, Threshold
from afl_mujoco.studies.compare import result as compare_result
from afl_mujoco.studies.delay_margin import LeastMargin
from afl_mujoco.studies.estimation import result as estimation_result
from afl_mujoco.studies.estimation.loops import ESTIMATED, TRUE, Loop
from afl_mujoco.studies.estimation.tracking import Ramp, Step, Tracking
from afl_mujoco.studies.hardware import result as hardware_result
from afl_mujoco.studies.identify import result as identify_result
from afl_mujoco.studies.margins import result as margins_result
from afl_mujoco.studies.margins.measured_delay import DelayComparison
from afl_mujoco.studies.monte_carlo import result as monte_carlo_result
from afl_mujoco.studies.record import Record, load_records, save_record
from afl_mujoco.studies.registry import find_study
from afl_mujoco.studies.thresholds import result as thresholds_result
from afl_mujoco.studies.thresholds.imperfections import find_imperfection
from afl_mujoco.studies.thresholds.result import Sweep, Verdict
from afl_mujoco.studies.thresholds.sweep import added
from tests.verification_result import NASTY, OWN, make_result

CONTROLLERS = ("adaptive", "lqr")

# (survives: bound, level), (settles: bound, level), at the reference: survives, settles
SWEEPS: dict[str, dict[str, tuple[Any, ...]]] = {
    "delay": {
        "adaptive": (BRACKETED, 0.047, BRACKETED, 0.040, True, True),
        "lqr": (BRACKETED, 0.036, BRACKETED, 0.036, True, True),
    },
    "control-period": {
        "adaptive": (LOWER, 0.05, LOWER, 0.05, True, True),
        "lqr": (BRACKETED, 0.041, BRACKETED, 0.041, True, True),
    },
    "force-limit": {
        "adaptive": (BRACKETED, 10.0, BRACKETED, 10.0, True, True),
        "lqr": (BRACKETED, 9.9, BRACKETED, 9.9, True, True),
    },
    "rail-damping": {
        "adaptive": (BRACKETED, 7.3, BRACKETED, 3.6, True, False),
        "lqr": (BRACKETED, 11.0, BRACKETED, 9.7, True, True),
    },
    "rail": {
        "adaptive": (BRACKETED, 3.7, BRACKETED, 3.7, False, False),
        "lqr": (UPPER, 100.0, UPPER, 100.0, False, False),
    },
    "combined": {
        "adaptive": (BRACKETED, 1.1, BRACKETED, 0.33, True, False),
        "lqr": (BRACKETED, 1.3, BRACKETED, 0.73, True, False),
    },
}

_METRICS = {
    "settling_time": 6.6, "peak_z": 4.05, "peak_phi": 1.05, "max_command": 60.0,
    "max_force": 59.0, "iae_z": 9.1, "iae_phi": 0.8,
}  # fmt: skip


def verdict(survives: bool, settles: bool, name: str = "", level: float = 1.0) -> Verdict:
    """Return the outcome of a controller at a level."""
    failure = "" if survives else "end_stops" if name == "rail" else "fell"
    return Verdict(
        level=level,
        survives=survives,
        settles=settles,
        failure=failure,
        scenario=None if settles else "step-step",
        time=1.25 if failure else None,
        metrics=_METRICS | ({} if settles else {"settling_time": None}),
    )


def threshold(bound: str, level: float) -> Threshold:
    """Return a threshold at a level."""
    return Threshold(
        bound=bound,
        holds_at=level if bound == LOWER else None if bound == UPPER else level * 0.99,
        fails_at=None if bound == LOWER else level,
        islands=0,
    )


def sweep(name: str, controller: str, found: tuple[Any, ...]) -> Sweep:
    """Return one controller under one imperfection."""
    bound, level, settles_bound, settles, survives_reference, settles_reference = found
    return Sweep(
        imperfection=name,
        controller=controller,
        reference=verdict(survives_reference, settles_reference, name),
        survives=threshold(bound, level),
        settles=threshold(settles_bound, settles),
        failure=None if bound == LOWER else verdict(False, False, name, level),
    )


def thresholds(
    changes: dict[str, tuple[Any, ...]] | None = None, only: tuple[str, ...] = tuple(SWEEPS)
) -> thresholds_result.Result:
    """Return thresholds, the adaptive controller's changed, of some imperfections only."""
    found = {
        n: {**of, "adaptive": (changes or {}).get(n, of["adaptive"])} for n, of in SWEEPS.items()
    }
    names = tuple(one.name for one in added())
    margins = (
        LeastMargin(controller="adaptive", margin=0.0323, cart_mass=0.5, half_length=0.2),
        LeastMargin(controller="lqr", margin=0.0, cart_mass=0.5, half_length=0.2),
    )
    return thresholds_result.Result(
        settings=thresholds_result.Settings(
            scenarios=("step-step",), seeds=4, scan=13, tolerance=0.02, integrator="RK4",
            timestep=1e-3,
        ),
        controllers=CONTROLLERS,
        imperfections=tuple(find_imperfection(name) for name in only),
        sweeps=tuple(sweep(n, c, found[n][c]) for n in only for c in CONTROLLERS),
        added=names,
        combined={
            "adaptive": tuple(verdict(i < 10, i < 8) for i in range(len(names))),
            "lqr": tuple(verdict(True, True) for _ in names),
        },
        delay_margins=margins if "delay" in only else (),
    )  # fmt: skip


def monte_carlo() -> monte_carlo_result.Result:
    """Return rates, a comparison and worst cases; the controllers were asked for nastily."""
    space = SampleSpace(LABORATORY)
    return monte_carlo_result.Result(
        seed=1,
        samples=60,
        integrator="RK4",
        timestep=1e-3,
        confidence=0.95,
        space=space,
        controllers=tuple(
            monte_carlo_result.ControllerRates(
                controller=name, asked=NASTY, samples=60, passed=survived, rate=survived / 60,
                interval=(0.8608, 0.9896), settled=18, settled_rate=0.3,
                settled_interval=(0.1884, 0.4321), median_displacement=1.234,
                largest_displacement=5.6,
                failures_by_kind={"fell": 60 - survived}, margins=(), unmargined=60,
                missed={},
                failures=tuple(
                    monte_carlo_result.Failure(
                        index=i, outcome="fell", end_time=2.5, message=None, missed=("completes",),
                        failure="fell", margin=None,
                        file=f"montecarlo/{name}/failure-0007.toml" if i == 7 else None,
                    )
                    for i in range(7, 67 - survived)
                ),
            )
            for name, survived in zip(CONTROLLERS, (57, 55), strict=True)
        ),
        comparisons=(
            monte_carlo_result.Comparison(
                first="adaptive", second="lqr", both=52, only_first=5, only_second=3, neither=0,
                p_value=0.7266,
            ),
        ),
        worst_cases=tuple(
            monte_carlo_result.WorstCase(
                controller=name, question="hardest", failed=failed, outcome="fell", end_time=9.9,
                message=None, failure="fell" if failed else "", missed=(), margin=None,
                severity=1.5, distance=0.43, runs=33,
                changes={"rail_friction": 0.99, "delay": 0.5},
                point=tuple(space.reference.tolist()), noise=3,
                file=f"montecarlo/{name}/hardest.toml",
            )
            for name, failed in zip(CONTROLLERS, (True, False), strict=True)
        ),
    )  # fmt: skip


def margins(gain_increase: float | None = 16.6) -> margins_result.Result:
    """Return margins of two masses and three lengths; one plant is not stable where held."""
    table = ((0.4, 0.5, 0.6), (0.4, 0.5, None))
    held = margins_result.LoopGrid(
        stable=((True, True, True), (True, True, False)),
        **dict.fromkeys(("gain_decrease", "phase", "crossover", "disk", "disk_gain"), table),
        disk_phase=table,
        gain_increase=((gain_increase, None, None), (gain_increase, gain_increase, None)),
        delay=((0.012, 0.03, 0.1), (0.013, 0.03, None)),
    )
    full = ((0.4, 0.5, 0.6), (0.4, 0.5, 0.6))
    continuous = margins_result.LoopGrid(
        stable=((True,) * 3,) * 2, **dict.fromkeys(margins_result.METRICS, full)
    )
    both = margins_result.ControllerMargins(continuous=continuous, sampled=held)
    return margins_result.Result(
        imperfections="none",
        control_period=1e-3,
        cart_masses=(0.1, 2.0),
        half_lengths=(0.05, 0.2, 1.0),
        pole_mass=0.05,
        gravity=9.81,
        linearisation_step=1e-5,
        margins=dict.fromkeys(CONTROLLERS, both),
        measured=tuple(
            DelayComparison(
                controller="adaptive", cart_mass=0.1, half_length=length, margin=margin,
                measured=measured,
            )
            for length, margin, measured in ((0.05, 0.012, 0.01206), (0.2, 0.03, None))
        ),
    )  # fmt: skip


def attraction() -> attraction_result.Result:
    """Return one pair of maps, of three rows and five columns, that differ in one grid point."""
    grid = state_grid(np.linspace(-1.0, 1.0, 5), np.linspace(-2.0, 2.0, 3))
    outcome = np.array([[0, 1, 2, 0, 0], [0, 0, 0, 0, 1], [0, 0, 0, 0, 0]], dtype=np.uint8)
    other = outcome.copy()
    other[1, 4] = 0
    times = np.full(outcome.shape, 3.2)
    maps = (
        AttractionMap(
            grid=grid, controller="lqr", simulator=simulator, outcome=found,
            settings=Settling().describe() | {"timestep": 2e-3},
            time=times, peak_z=times, peak_force=times,
        )
        for simulator, found in (("ode", outcome), ("mujoco", other))
    )  # fmt: skip
    return attraction_result.result_of([Comparison(*maps)])


def estimation() -> estimation_result.Result:
    """Return one schedule."""
    time = np.linspace(0.0, 12.0, 50)
    mass = Tracking(
        rms={"0.05-1 s": 0.01, "1-6 s": 0.02, "6 s to the end": None},
        steps=(Step(at=1.0, reached_after=0.25, found_after=0.3),),
        ramps=(),
    )
    length = Tracking(rms=mass.rms, steps=(), ramps=(Ramp(start=2.0, end=3.0, lag=0.1),))
    loops = tuple(
        Loop(
            parameters=parameters, noise=noise, runs=2, completed=completed,
            metrics={"objective": 2.0, "iae_z": 9.0, "iae_phi": phi, "max_force": 59.0},
            largest_force=61.0,
        )
        for parameters, noise, completed, phi in (
            (TRUE, False, 2, 1.0), (TRUE, True, 2, 1.01), (ESTIMATED, True, 1, 1.2),
        )
    )  # fmt: skip
    return estimation_result.Result(
        controller="adaptive",
        windows=("0.05-1 s", "1-6 s", "6 s to the end"),
        found_within=0.1,
        noise_z=1e-4,
        noise_phi=5e-4,
        cases=(
            estimation_result.Case(
                scenario="step-step",
                cart_mass=(mass,),
                half_length=(length,),
                loops=loops,
                curves=estimation_result.Curves(
                    **dict.fromkeys(
                        (
                            "time", "cart_mass", "half_length", "true_cart_mass",
                            "true_half_length", "estimated_time", "estimated_angle", "true_time",
                            "true_angle",
                        ),
                        time,
                    )
                ),
            ),
        ),
    )  # fmt: skip


def compare() -> compare_result.Result:
    """Return two controllers on a scenario with a nasty name: one falls, the other is good."""
    scenario = replace(
        OWN,
        name=NASTY,
        requirements=Requirements(max_position=1.0, settling_time=1.1, recover_within=0.6),
    )
    time = np.linspace(0.0, 2.0, 40)

    def run(controller: str, reached: int, outcome: str, values: tuple[Any, ...]) -> Any:
        judged = {
            "completes": (2.0, values[0], values[0] - 2.0),
            "max_position": (1.0, 0.4, values[1]),
            "settling_time": (1.1, values[2], values[3]),
            "recover_within": (0.6, values[2], values[3]),
        }
        curves = compare_result.Curves(
            time=time[:reached],
            state=np.outer(np.cos(3.0 * time[:reached]), (0.4, 0.2, 1.0, 1.0)),
            force=20.0 * np.exp(-time[:reached]),
            command=21.0 * np.exp(-time[:reached]),
        )
        compared = compare_result.ComparedRun(
            scenario=NASTY,
            controller=controller,
            outcome=outcome,
            metrics=dict.fromkeys(UNITS, 1.5) if outcome == "completed" else {},
            requirements=tuple(
                Judgement(requirement=name, limit=limit, value=value, left=left)
                for name, (limit, value, left) in judged.items()
            ),
            failure="" if outcome == "completed" else "fell",
            settled=outcome == "completed",
            remarks=("Its gains are extrapolated.",),
        )
        return compared, curves

    found = {
        "lqr": run("lqr", 40, "completed", (2.0, 0.6, 0.5, 0.1)),
        "adaptive": run("adaptive", 15, "fell at t = 0.7 s", (0.7, None, None, -0.4)),
    }
    return compare_result.Result(
        scenarios=(scenario,),
        runs=tuple(compared for compared, _ in found.values()),
        curves={f"{NASTY}/{name}": curves for name, (_, curves) in found.items()},
        timestep=1e-3,
        control_period=None,
        integrator="RK4",
    )


def identified() -> identify_result.Result:
    """Return the shipped estimates beside a made-up log."""
    time = np.linspace(0.0, 2.0, 100)
    z, phi = 0.1 * np.sin(3.0 * time), np.cos(4.0 * time)
    phi[40:44] = np.nan
    part = np.arange(20).reshape(2, 10)
    shown = identify_result.Shown(
        name=NASTY, time=time, z=z, phi=phi, command=np.sign(z),
        simulated_time=time[part], simulated_z=z[part] + 1e-3, simulated_phi=phi[part],
    )  # fmt: skip
    return identify_result.Result(identified=load_estimates(), shown=shown)


def hardware() -> hardware_result.Result:
    """Return a validation in which one statement does not hold."""
    errors = tuple(
        Errors(
            horizon=h, rms_phi=0.02 * h, rms_z=0.01 * h, counts_phi=13.0 * h, counts_z=118.0 * h,
            explained_phi=1.0 - 0.1 * h, explained_z=0.99 - h, away_phi=12.0 * h,
            clear_phi=9.0 * h, starts=200, away=110,
        )
        for h in (0.1, 0.2, 0.5, 1.0)
    )  # fmt: skip
    blind = tuple(
        replace(e, rms_z=None, counts_z=None, explained_z=None, away_phi=None) for e in errors
    )
    made = identified().shown
    assert made is not None
    term = hardware_result.Term(
        value=37.4, low=37.3, high=37.5, expected=37.25, unit="1/s²", title="gravity term w2"
    )
    judged = hardware_result.Judged(
        id="rig-0.5-z", statement="The position is predicted.", measure="share of variance",
        limit=0.9, reason="as for the angle", value=0.49, at_least=True, suspected="the drive",
    )  # fmt: skip
    return hardware_result.Result(
        source="logs",
        logs=(NASTY, "two"),
        fitted=("two",),
        identified=load_estimates(),
        terms={"gravity": term, "friction": replace(term, expected=None, title="friction")},
        held_out=errors,
        whole=tuple(replace(e, starts=150) for e in errors),
        pole=blind,
        baselines={name: errors for name in ("nominal", "uncoupled", "constant_velocity")},
        statements=(judged, replace(judged, id="rig-0.5-phi", value=0.95, suspected="")),
        speeds=(0.5, 12.0),
        reach=0.2,
        turned=7.0,
        band=np.array([[0.0, 0.5], [0.001, 0.01], [0.001, 0.1]]),
        recorded=hardware_result.Recorded(
            name=made.name, time=made.time, z=made.z, phi=made.phi, command=made.command,
            starts=made.simulated_time[:, 0], predicted_time=made.simulated_time,
            predicted_z=made.simulated_z, predicted_phi=made.simulated_phi,
        ),
        survival=(
            hardware_result.Survival(
                controller="lqr", angles={"as it is": 0.0, "rail x4": 0.5}, runs=20, survived=3
            ),
            hardware_result.Survival(
                controller="adaptive", angles={"as it is": 0.2, "rail x4": 0.2}, runs=20,
                survived=20,
            ),
        ),
    )  # fmt: skip


RESULTS = {
    "validate": make_result, "compare": compare,
    "thresholds": thresholds, "montecarlo": monte_carlo, "attraction": attraction,
    "margins": margins, "estimation": estimation,
    "identify": identified, "hardware": hardware,
}  # fmt: skip


def record(name: str) -> Record:
    """Return a made-up record of a study."""
    study = find_study(name)
    return Record(study=study, result=RESULTS[name](), command=f"afl-mujoco {name} --made-up")


def write_records(folder: Path) -> Path:
    """Write a record of every study."""
    for name in RESULTS:
        save_record(record(name), folder)
    return folder


def sections_of(folder: Path) -> list[Section]:
    """Return what the records in a folder say."""
    return [section for record in load_records(folder) for section in record.sections]
