"""What does the adaptive controller lose if it has to estimate M and l?

Run: python benchmarks/bench_estimator.py [--seeds 8] [--only cases start pulse rest rig drive]

Sampled mode at 1 kHz on the paper's scenarios. With the estimator, the controller takes M, l and
the state from it; an informed controller gets the true M and l (or assumes the nominal ones), the
measured z and phi, and the true velocities. Errors are those of ln M and ln l. Tracking over time,
and the objective (O1) against the informed controller: `afl-mujoco estimation`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

import afl_mujoco as afl
from afl_mujoco.control.controller import Controller
from afl_mujoco.control.estimator import EstimatedController, EstimatorSettings
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.sample_space import draws_of
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.sampled.runs import simulate_estimated
from afl_mujoco.studies.estimation import CASES
from afl_mujoco.studies.estimation import NOISE as USUAL
from research.gain_tuning import paper_scales

Array = NDArray[np.float64]

FINE = Imperfections(
    noise={"z": 1e-4, "phi": 1e-4},
)
COARSE = Imperfections(
    noise={"z": 1e-4, "phi": 1e-3},
)
ENCODERS = Imperfections(
    encoder_step={"z": 3.5e-4, "phi": 2.0 * np.pi / 3600.0},
)
RIGS = {"no noise": IDEAL, "fine": FINE, "usual": USUAL, "coarse": COARSE, "encoders": ENCODERS}
TOLD = afl.CONTROLLERS["adaptive"]


@dataclass(frozen=True)
class Run:
    """A run and, with the estimator, its errors at all ticks except the first."""

    run: afl.Trajectory
    time: Array
    error: Array  # ln of estimate over truth before the tick, shape (T - 1, 2)

    @property
    def survived(self) -> bool:
        return self.run.outcome.kind == "completed"

    @property
    def integrals(self) -> float:
        """The objective (O1) less its force term."""
        scales = paper_scales()
        z, phi = (np.trapezoid(np.abs(x), self.run.time) for x in self.run.state.T[:2])
        return float(z / scales.iae_z + phi / scales.iae_phi)

    @property
    def largest_force(self) -> float:
        return float(np.abs(self.run.force).max())

    def within(self, first: float, last: float) -> Array:
        """Its errors over a stretch of time [s]."""
        return self.error[(self.time >= first - 1e-9) & (self.time < last - 1e-9)]

    def at(self, time: float) -> Array:
        """Its errors as of the last tick up to an instant [s]."""
        return np.asarray(self.error[np.searchsorted(self.time, time + 1e-9) - 1])


def settings_for(rig: Imperfections, **changes: Any) -> EstimatorSettings:
    """The estimator's settings where the noise is known and the rest of the rig is not."""
    pairs = (
        (rig.at("noise.z"), rig.at("encoder_step.z")),
        (rig.at("noise.phi"), rig.at("encoder_step.phi")),
    )
    z, phi = (max(float(np.hypot(noise, step / 12**0.5)), 1e-5) for noise, step in pairs)
    return EstimatorSettings(position_noise=z, angle_noise=phi, **changes)


def estimated(scenario: Scenario, settings: EstimatorSettings | None = None) -> Run:
    settings = settings or settings_for(scenario.imperfections)
    law = EstimatedController(name="estimated", controller=TOLD, settings=settings)
    found = simulate_estimated(scenario, law)
    ticks = found.time[1:]
    before = ticks - 0.5e-3
    truth = np.stack([scenario.cart_mass(before), scenario.half_length(before)], axis=1)
    estimates = np.stack([found.cart_mass[1:], found.half_length[1:]], axis=1)
    return Run(found.run, ticks, np.log(estimates / truth))


def told(scenario: Scenario, rig: Imperfections, law: Controller = TOLD) -> Run:
    run = afl.simulate_mujoco(replace(scenario, imperfections=rig), law, "sampled")
    return Run(run, np.empty(0), np.empty((0, 2)))


def several(
    scenario: Scenario, rig: Imperfections, seeds: int, settings: EstimatorSettings | None = None
) -> list[Run]:
    """Runs of several noises and starts within an encoder's step; one where there is neither."""
    draws = draws_of(replace(scenario, imperfections=rig), random=seeds)
    return [estimated(one, settings) for one in draws]


def rms(runs: Sequence[Run], first: float, last: float) -> Array:
    """Root mean square of both errors over a stretch of time."""
    means = [np.mean(r.within(first, last) ** 2, axis=0) for r in runs]
    return np.asarray(np.sqrt(np.mean(means, axis=0)))


def cases(seeds: int) -> None:
    print("\n(T1) objective (O1) less its force term, largest force [N], how many runs survived")
    for name, scenario in afl.SCENARIOS.items():
        print(f"  {name}")
        for law in ("adaptive", "fixed", "adaptive-nominal", "fixed-nominal"):
            show_case(law, [told(scenario, IDEAL, afl.CONTROLLERS[law])])
        for label, rig in RIGS.items():
            runs = several(scenario, rig, seeds)
            show_case(f"estimated, {label}", runs)


def show_case(label: str, runs: Sequence[Run]) -> None:
    alive = [r for r in runs if r.survived]
    cost = np.mean([r.integrals for r in alive])
    force = max(r.largest_force for r in runs)
    print(f"    {label:<30} {cost:6.3f}   {force:6.1f}   {len(alive)}/{len(runs)}")


def start(seeds: int) -> None:
    print("\n(T2) the start, by the initial belief: the paper's scenarios, and 36 constant plants")
    print("  survived (3 s of the plants); largest force, and its ratio to that with true M and l")
    print("  rms of ln M / ln l over the plants after 10, 20, 50, 100, 300 ms")
    beliefs = {
        "light": (0.1, 0.5),
        "first truth": (0.5, 0.2),
        "nominal": (1.0, 0.5),
        "heavy": (2.0, 1.0),
    }
    for period in (1e-3, 5e-3, 1e-2):
        rig = replace(USUAL, control_period=period)
        plants = [
            constant_plant(m, x, duration=3.0)
            for m in (0.1, 0.2, 0.5, 1.0, 1.5, 2.0)
            for x in (0.05, 0.1, 0.2, 0.4, 0.7, 1.0)
        ]
        oracle = [told(s, rig) for s in plants]
        alive = sum(r.survived for r in oracle)
        print(f"  control period {1e3 * period:g} ms; with true M and l {alive}/36 survive")
        for label, (mass, length) in beliefs.items():
            settings = settings_for(rig, initial_cart_mass=mass, initial_half_length=length)
            nine, runs = (
                [estimated(replace(s, imperfections=rig), settings) for s in some]
                for some in (afl.SCENARIOS.values(), plants)
            )
            pairs = [(r, t) for r, t in zip(runs, oracle, strict=True) if r.survived]
            ratio = max(r.largest_force / t.largest_force for r, t in pairs)
            force = max(r.largest_force for r in nine)
            errors = [[r.at(t) for t in (0.01, 0.02, 0.05, 0.1, 0.3)] for r, _ in pairs]
            text = "  ".join(f"{m:.2f}/{x:.2f}" for m, x in np.sqrt(np.mean(np.square(errors), 0)))
            print(
                f"    {label:<12} {sum(r.survived for r in nine)}/9 (largest {force:5.0f} N)  "
                f"{len(pairs)}/36 (ratio {ratio:5.1f})   {text}"
            )


def constant_plant(mass: float, length: float, **changes: Any) -> Scenario:
    return afl.Scenario(
        name="constant",
        schedule={"cart_mass": afl.constant(mass), "half_length": afl.constant(length)},
        **changes,
    )


def pulse(seeds: int) -> None:
    print(
        "\n(T3) pulse of -10 N at 10 s: rms of ln M / ln l in 9-10, 10-10.1, 10.1-10.3, 10.3-11, "
        "15-20 s"
    )
    spans = ((9.0, 10.0), (10.0, 10.1), (10.1, 10.3), (10.3, 11.0), (15.0, 20.0))
    for label, rig in (("no noise", IDEAL), ("usual", USUAL)):
        for case in CASES:
            scenario = afl.SCENARIOS[f"{case}-impulse"]
            runs = several(scenario, rig, seeds)
            text = "  ".join("{:.2f}/{:.2f}".format(*rms(runs, *span)) for span in spans)
            after = np.mean([peaks(r) for r in runs], axis=0)
            was = peaks(told(scenario, IDEAL))
            print(
                f"  {label:<10} {case:<22} {text}   peaks {after[0]:.3f} m, {after[1]:.3f} rad"
                f" (true: {was[0]:.3f}, {was[1]:.3f})"
            )


def peaks(run: Run) -> Array:
    """Largest abs(z) [m] and abs(phi) [rad] from the pulse on."""
    return np.asarray(np.abs(run.run.state[run.run.time >= 10.0, :2]).max(axis=0))


def rest(seeds: int) -> None:
    print("\n(T4) constant plants, usual noise: error of ln M / ln l at 4 s, 8 s and 20 s,")
    print("  mean over the seeds, and at 20 s its standard deviation")
    never = {"least_cart_acceleration": 1e-9, "least_pole_acceleration": 1e-9}
    for name, changes in (("as chosen", {}), ("never frozen", never)):
        print(f"  {name}")
        settings = settings_for(USUAL, **changes)
        for mass in (0.1, 0.5, 2.0):
            for length in (0.05, 0.2, 1.0):
                plant = constant_plant(mass, length)
                runs = several(plant, USUAL, seeds, settings)
                errors = np.array([[r.at(t) for t in (4.0, 8.0, 20.0)] for r in runs])
                means = "   ".join(f"{m:+.2f}/{x:+.2f}" for m, x in errors.mean(axis=0))
                spread = "{:.2f}/{:.2f}".format(*errors[:, -1].std(axis=0))
                print(f"    M {mass:3g} kg, l {length:4g} m   {means}   +- {spread}")


def rig(seeds: int) -> None:
    print("\n(T5) what else a rig has and the estimator does not know, usual noise, the four cases")
    print("  survived; objective (O1) less its force term; rms of ln M / ln l, 0.05-6 s")
    lines: dict[str, tuple[dict[str, Any], EstimatorSettings]] = {
        "nothing": ({}, settings_for(USUAL)),
        "noise thought 3 times less": (
            {},
            settings_for(
                Imperfections(
                    noise={"z": 3e-5, "phi": 1.7e-4},
                )
            ),
        ),
        "noise thought 3 times more": (
            {},
            settings_for(
                Imperfections(
                    noise={"z": 3e-4, "phi": 1.5e-3},
                )
            ),
        ),
        "5 ms control period": ({"control_period": 5e-3}, settings_for(USUAL)),
        "10 ms control period": ({"control_period": 1e-2}, settings_for(USUAL)),
        "damping 0.1 N s/m": ({"damping.z": 0.1}, settings_for(USUAL)),
        "damping 0.5 N s/m": ({"damping.z": 0.5}, settings_for(USUAL)),
        "dry friction 0.1 N": ({"dry_friction.z": 0.1}, settings_for(USUAL)),
        "dry friction 0.5 N": ({"dry_friction.z": 0.5}, settings_for(USUAL)),
    }
    for unknown in (0.001, 0.003, 0.03, 0.1):
        settings = settings_for(USUAL, acceleration_noise=unknown)
        lines[f"unknown acceleration {unknown:g}"] = ({}, settings)
    for accuracy in (0.03, 0.3):
        changes = {"cart_mass_accuracy": accuracy, "half_length_accuracy": accuracy}
        lines[f"accuracy claimed {accuracy:g}"] = ({}, settings_for(USUAL, **changes))
    for label, (has, settings) in lines.items():
        own = USUAL.changed(has)
        runs = [several(afl.SCENARIOS[case], own, seeds, settings) for case in CASES]
        print(f"  {label:<30} {summary([*chain(*runs)])}")


def summary(runs: Sequence[Run]) -> str:
    """How many runs survived, what those cost, and how well those that estimate did it."""
    alive = [r for r in runs if r.survived]
    text = f"{len(alive):>3}/{len(runs)}"
    if alive:
        text += f", {np.mean([r.integrals for r in alive]):.3f}"
    if alive and len(alive[0].error):
        text += ", {:.3f}/{:.3f}".format(*rms(alive, 0.05, 6.0))
    return text


def drive(seeds: int) -> None:
    print("\n(T6) what the drive does, usual noise, the four cases")
    print("  survived; objective (O1) less its force term; rms of ln M / ln l, 0.05-6 s")
    drives: dict[str, dict[str, Any]] = {
        "nothing": {},
        "force limit 30 N": {"input_limit": 30.0},
        **{f"lag {ms} ms": {"lag": 1e-3 * ms} for ms in (2, 5, 10)},
        **{f"delay {ms} ms": {"delay": 1e-3 * ms} for ms in (2, 5, 10)},
        **{f"slew {rate} N/s": {"slew_rate": float(rate)} for rate in (1000, 300)},
    }
    print(f"  {'':<20} {'true M and l':<22} {'force commanded':<28} force sensed")
    for label, has in drives.items():
        own = USUAL.changed(has)
        rigs = [replace(afl.SCENARIOS[case], imperfections=own) for case in CASES]
        draws = [*chain(*(draws_of(one, random=seeds) for one in rigs))]
        texts = [summary([told(one, one.imperfections) for one in draws])]
        for sensed in (False, True):
            settings = settings_for(USUAL, force_sensed=sensed)
            texts.append(summary([estimated(one, settings) for one in draws]))
        print(f"  {label:<20} {texts[0]:<22} {texts[1]:<28} {texts[2]}")


TABLES = {f.__name__: f for f in (cases, start, pulse, rest, rig, drive)}


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the loop with the estimator.")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--only", nargs="+", choices=TABLES, default=list(TABLES))
    options = parser.parse_args()
    for name in options.only:
        TABLES[name](options.seeds)


if __name__ == "__main__":
    main()
