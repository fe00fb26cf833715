"""Why did the hardware samples fail? Every failure again, with one imperfection removed.

Run: python benchmarks/bench_failure_causes.py [renders/validation]

Reads `montecarlo.json` and the scenario files of the failures of a full `afl-mujoco montecarlo`
without options (seed 1, RK4 at 1 ms). Prints how many of each controller's failures survive without
rail damping, and so on, and how often it fails by start angle and by damping per cart mass.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import afl_mujoco as afl
from afl_mujoco.scenario.catalogue import LABORATORY
from afl_mujoco.scenario.imperfections import IDEAL
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario
from afl_mujoco.studies.montecarlo import file_of
from afl_mujoco.studies.shared.contract import find_study
from afl_mujoco.studies.shared.record import load_record

SENSORS = ("noise.z", "noise.phi", "noise.z_dot", "noise.phi_dot")
TAKEN_AWAY = {
    "nothing": (),
    "rail damping": ("damping.z",),
    "dry friction": ("dry_friction.z",),
    "hinge damping": ("damping.phi",),
    "delay and lag": ("delay", "lag"),
    "noise and encoder steps": (*SENSORS, "encoder_step.z", "encoder_step.phi"),
    "all of these": (
        *("damping.z", "dry_friction.z", "damping.phi", "delay", "lag"),
        *(*SENSORS, "encoder_step.z", "encoder_step.phi"),
    ),
}
ANGLE, DAMPING = "start angle |φ₀| [deg]", "rail damping / least cart mass [1/s]"
FEATURES = {
    ANGLE: lambda rig: math.degrees(abs(rig.initial_state[1])),
    DAMPING: lambda rig: rig.imperfections.at("damping.z") / min(rig.cart_mass.values),
}


def survivors(files: list[Path], law: Any, names: tuple[str, ...], threads: int) -> int:
    """Count the runs of some files that survive if some options are ideal."""
    ideal = {name: IDEAL.at(name) for name in names}
    rigs = [afl.load_scenario(file) for file in files]
    rigs = [replace(rig, imperfections=rig.imperfections.changed(ideal)) for rig in rigs]
    return sum(run.outcome == "completed" for run in afl.run_all(law, rigs, threads=threads))


def fifths(feature: NDArray[np.float64], failed: NDArray[np.bool_]) -> str:
    """Return the share of failures in each fifth of the samples, ordered by a feature."""
    parts = np.array_split(np.argsort(feature), 5)
    ends = [f"to {feature[part[-1]]:.3g}: {100.0 * failed[part].mean():.0f} %" for part in parts]
    return ", ".join(ends)


def main() -> None:
    parser = argparse.ArgumentParser(description="Remove one imperfection at a time.")
    parser.add_argument("folder", type=Path, nargs="?", default=Path("renders/validation"))
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    result = load_record(find_study("montecarlo"), options.folder).result
    count, seed = result.samples, result.seed
    rigs = [sample_scenario(SampleSpace(LABORATORY), i, seed) for i in range(count)]
    for name, runs in result.runs.items():
        failed = np.array([bool(run.failure) for run in runs])
        files = [options.folder / file_of(name, run) for run in runs if run.failure]
        print(f"\n{name}: {len(files)} of {count} fail; of these survive without")
        for label, names in TAKEN_AWAY.items():
            up = survivors(files, afl.find_controller(name), names, options.threads)
            print(f"  {label:<26} {up:>4}", flush=True)
        print("  share of failures in each fifth of the samples, by")
        for label in (ANGLE, DAMPING):
            feature = np.array([FEATURES[label](rig) for rig in rigs])
            print(f"  {label}: {fifths(feature, failed)}")
        steep = np.array([FEATURES[ANGLE](rig) > 60.0 for rig in rigs])
        print(
            f"  beyond 60 degrees {100.0 * failed[steep].mean():.1f} %, "
            f"below {100.0 * failed[~steep].mean():.1f} %"
        )


if __name__ == "__main__":
    main()
