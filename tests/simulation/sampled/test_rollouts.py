"""Many runs: the same bits among others, on any threads, and alone; figures of the run itself."""

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.simulation.metrics import metrics

FIGURES = (
    *("status", "end_time", "peak_z", "peak_phi", "max_command", "max_force"),
    *("iae_z", "iae_phi", "settling_time", "stop_time"),
)
SETTINGS = {"integrator": "Euler", "control_period": 0.002}


@pytest.fixture
def scenarios(rng):
    """Scenarios that share nothing, some of which fall; every third is ideal."""
    scenarios = []
    for i in range(24):
        mass, length = rng.uniform(0.2, 1.5), rng.uniform(0.1, 0.8)
        imperfections = afl.Imperfections(
            noise={"z": rng.uniform(0, 1e-3), "phi": rng.uniform(0, 1e-2)},
            dry_friction={"z": rng.choice([0.0, 0.4])}, damping={"z": rng.choice([0.0, 0.3])},
            end_stops=[{}, {"z": 1.5}][i % 2], delay=rng.uniform(0.0, 0.02),
            tip_mass_share=rng.uniform(0.0, 0.3), seed=i,
        )  # fmt: skip
        schedule = {
            "cart_mass": afl.staircase((0.3,), (mass, 1.3 * mass)),
            "half_length": afl.piecewise_linear((0.1, 0.5), (length, 1.2 * length)),
        }
        scenarios.append(afl.Scenario(
            name=f"drawn-{i}", schedule=schedule, duration=[1.0, 1.5][i % 2],
            initial_state=(0.0, rng.uniform(-1.3, 1.3), 0.0, rng.normal()),
            imperfections=imperfections if i % 3 else afl.Imperfections(),
        ))  # fmt: skip
    return scenarios


def same(one, other):
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in FIGURES)


def test_threads_and_repetitions_change_no_bit_and_one_error_is_raised(scenarios, adaptive):
    one = afl.run_rollouts(scenarios, adaptive, **SETTINGS)
    for threads in (1, 2, 3):
        assert same(afl.run_rollouts(scenarios, adaptive, threads=threads, **SETTINGS), one)
    assert 0 < (one.status > 0).sum() < len(one) == 24  # some fell, some did not
    with pytest.raises(InvalidValueError, match=r"^threads must be at least 1, got 0$"):
        afl.run_rollouts(scenarios, adaptive, threads=0)
    tiny = afl.Scenario(name="tiny", schedule={"half_length": 0.001})
    with pytest.raises(InvalidValueError, match=r"^switching of the gain function at M = 1 kg"):
        afl.run_rollouts([*scenarios, tiny], afl.CONTROLLERS["adaptive"], threads=2)
    with pytest.raises(InvalidValueError, match=r"^timestep must be positive, got 0.0$"):
        afl.run_rollouts(scenarios, adaptive, timestep=0.0)


def test_figures_and_outcome_are_those_of_the_run_of_the_file(scenarios, adaptive, tmp_path):
    many = afl.run_rollouts(scenarios, adaptive, threads=2, **SETTINGS)
    for i, scenario in enumerate(scenarios):
        afl.save_scenario(scenario, file := tmp_path / "s.toml")
        again = afl.find_scenario(str(file))
        run = afl.simulate_mujoco(again, adaptive, "sampled", **SETTINGS)
        assert many.outcome(i) == run.outcome
        z, phi = np.abs(run.state[:, :2]).T
        assert many.peak_z[i] == z.max() and many.peak_phi[i] == phi.max()
        assert many.max_force[i] == run.metrics["max_force"]
        if run.outcome.kind == "completed":
            theirs = metrics(scenario, adaptive, run)
            assert many.iae_z[i] == pytest.approx(theirs["iae_z"], rel=1e-12)
            assert many.iae_phi[i] == pytest.approx(theirs["iae_phi"], rel=1e-12)
