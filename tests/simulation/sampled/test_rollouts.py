"""Many runs: the same bits among others, on any threads, and alone; figures of the run itself."""

from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.simulation.metrics import metrics
from tests.plants.plants import cart

SETTINGS = {"integrator": "Euler", "control_period": 0.002}
EULER = afl.Deployed(**SETTINGS)


@pytest.fixture
def scenarios(rng):
    scenarios = []
    for i in range(12):
        mass, length = rng.uniform(0.2, 1.5), rng.uniform(0.1, 0.8)
        imperfections = afl.Imperfections(
            noise={"z": rng.uniform(0, 1e-3), "phi": rng.uniform(0, 1e-2)},
            dry_friction={"z": rng.choice([0.0, 0.4])}, damping={"z": rng.choice([0.0, 0.3])},
            end_stops=[{}, {"z": 1.5}][i % 2], delay=rng.uniform(0.0, 0.02),
            tip_mass_share=rng.uniform(0.0, 0.3), seed=i,
        )  # fmt: skip
        scenarios.append(afl.Scenario(
            name=f"drawn-{i}", duration=[1.0, 1.5][i % 2],
            schedule={"cart_mass": afl.staircase((0.3,), (mass, 1.3 * mass)),
                      "half_length": afl.piecewise_linear((0.1, 0.5), (length, 1.2 * length))},
            initial_state=(0.0, rng.uniform(-1.3, 1.3), 0.0, rng.normal()),
            imperfections=imperfections if i % 3 else afl.Imperfections(),
        ))  # fmt: skip
    return scenarios


def test_threads_and_repetitions_change_no_bit_and_one_error_is_raised(scenarios, adaptive):
    one = afl.run_all(adaptive, scenarios, EULER)
    for threads in (1, 2, 3):
        assert afl.run_all(adaptive, scenarios, EULER, threads=threads) == one
    assert 0 < sum(run.outcome == "fell" for run in one) < len(one) == 12
    with pytest.raises(InvalidValueError, match=r"^threads must be at least 1, got 0$"):
        afl.run_all(adaptive, scenarios, threads=0)
    with pytest.raises(InvalidValueError, match=r"^timestep must be positive, got 0.0$"):
        afl.run_all(adaptive, scenarios, afl.Deployed(timestep=0.0), threads=2)
    (failed,) = afl.run_all("adaptive", afl.Scenario(name="tiny", schedule={"half_length": 0.001}))
    assert failed.failure == "controller failed" and "at M = 1 kg, l = 0.001" in failed.message


def test_figures_and_outcome_are_those_of_the_run_of_the_file(scenarios, adaptive, tmp_path):
    many = afl.run_all(adaptive, scenarios, EULER, threads=2)
    for row, scenario in zip(many, scenarios, strict=True):
        afl.save_scenario(scenario, file := tmp_path / "s.toml")
        run = afl.simulate_mujoco(afl.find_scenario(str(file)), adaptive, "sampled", **SETTINGS)
        assert row.ending == str(run.outcome)
        found, theirs = row.metrics, metrics(scenario, adaptive, run)
        peaks = np.abs(run.state[:, :2]).max(axis=0).tolist()
        assert [found[x] for x in ("peak_z", "peak_phi")] == peaks
        assert found["max_force"] == theirs["max_force"]
        assert found["iae_z"] == (theirs["iae_z"] and pytest.approx(theirs["iae_z"], rel=1e-12))


def test_an_end_stop_is_judged_from_0_where_the_target_is_not_there() -> None:
    plant = replace(cart(), upright=(2.0,))
    rail = afl.Imperfections(end_stops={"x": 2.1})
    start = {"initial_state": {"x": 2.0, "x_dot": 1.0}, "imperfections": rail, "duration": 0.5}
    (row,) = afl.run_all(lambda *_: 0.0, afl.Scenario(name="s", plant=plant, **start))
    assert row.failure == "end_stops" and row.time == pytest.approx(0.1, abs=2e-3)
