from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.catalogue import as_controller, find_controller
from afl_mujoco.identification.description import load_description
from afl_mujoco.identification.export import TILT, draws, require_loggable, scenario_of, write_run
from afl_mujoco.identification.identify import identify
from afl_mujoco.identification.log import read_log
from afl_mujoco.identification.prediction import load_estimates
from tests.synthetic_logs import RIG


def test_the_scenario_is_the_cart_pole_that_was_identified(tmp_path) -> None:
    one = load_estimates()
    scenario = scenario_of(one)
    r, plant = scenario.imperfections, scenario.parameters_at(0.0)
    names = ("cart_mass", "half_length", "rail_damping", "force", "delay")
    here = [plant.cart_mass, plant.half_length, r.at("damping.z"), r.input_limit, r.delay]
    assert here == [one.find(name).value for name in names]
    assert r.at("end_stops.z") == scenario.requirements.max["z"] == 0.22
    assert scenario.ranges["delay"] == (one.find("delay").low, one.find("delay").high)
    afl.save_scenario(scenario, tmp_path / "rig.toml")
    assert afl.load_scenario(tmp_path / "rig.toml") == scenario


def test_draws_scatter_as_the_estimates_do_together() -> None:
    one = load_estimates()
    drawn = draws(one, 400, 3)
    damping = np.array([s.imperfections.at("damping.z") for s in drawn])
    force = np.array([s.imperfections.input_limit for s in drawn])
    found = one.find("rail_damping")
    assert damping.mean() == pytest.approx(found.value, rel=0.02)
    assert damping.std() == pytest.approx((found.high - found.low) / 4.0, rel=0.2)
    assert np.corrcoef(damping, force)[0, 1] > 0.9  # masses and forces in proportion to m
    ratio = damping / force  # decay and gain are known together far better than apart
    assert ratio.std() / ratio.mean() < 0.005
    tilts = [abs(s.initial_state[1]) for s in drawn]
    assert 0.9 * TILT < max(tilts) <= TILT and draws(one, 3, 3) == draws(one, 3, 3)
    assert draws(one, 3, 3) != draws(one, 3, 4)


class Lead:
    before = 0.0

    def __call__(self, time, state, belief):
        lean, self.before = state[1] - self.before, state[1]
        return np.dot(state, (0.7, -38.0, 1.8, -7.0)) - 20.0 * lean


def logged(folder: Path, scenario: afl.Scenario, controller):
    run = afl.simulate_mujoco(scenario, controller, "sampled")
    files = write_run(scenario, run, folder, "rig")
    description = load_description(files[1])
    return run, read_log(files[0], description), description


@pytest.mark.parametrize(("controller", "until"), [("lqr", 6.0), (Lead, 2.0)])
def test_commands_are_those_of_the_run_before_the_drive_and_readings_of_the_sensors(
    tmp_path: Path, controller, until
) -> None:
    scenario = replace(RIG, imperfections=replace(RIG.imperfections, delay=0.0), duration=until)
    run, log, _ = logged(tmp_path, scenario, as_controller(controller))
    assert log.command == pytest.approx(run.force[: len(log.command) * 10 : 10], rel=1e-8)
    states = run.state[: len(log.z) * 10 : 10]
    assert np.abs(log.z - states[:, 0]).max() <= 0.5001e-4
    assert 4e-4 < (log.phi - states[:, 1]).std() < 1e-3
    assert np.abs(log.phi / 1.5e-3 - np.rint(log.phi / 1.5e-3)).max() < 1e-4


@pytest.mark.slow
def test_a_lag_is_found_beside_the_delay_from_guesses_that_are_far_off(tmp_path: Path) -> None:
    of = {"cart_mass": 0.7, "half_length": 0.3, "pole_mass": 0.12}
    loop = afl.Imperfections(
        control_period=0.01, delay=0.006, lag=0.02, encoder_step={"phi": 1.5e-3, "z": 5e-4},
        damping={"z": 0.5, "phi": 1e-3}, dry_friction={"z": 0.2},
    )  # fmt: skip
    own = {"schedule": of, "imperfections": loop, "duration": 8.0}
    scenario = replace(RIG, initial_state={"phi": 0.35}, **own)

    def shaken(phase: float):
        def force(time, state, belief):
            push = 2.0 * np.sin(5.0 * time + phase) + 1.5 * np.sin(11.3 * time + 2.0 * phase)
            return np.dot(state, (2.706, -39.36, 5.33, -9.84)) + push

        return as_controller(force)

    made = [logged(tmp_path, scenario, shaken(phase)) for phase in (0.0, 1.3, 2.9)]
    logs, given = [replace(log, name=str(i)) for i, (_, log, _) in enumerate(made)], made[0][2]
    guess = replace(given.nominal, cart_mass=0.5, half_length=0.25, force=0.7)
    found = identify(logs, replace(given, nominal=guess))
    truth = {"cart_mass": 0.7, "force": 1.0, "rail_friction": 0.2, "delay": 0.006, "lag": 0.02}
    truth |= {"coupling": 1.0, "half_length": 0.3}
    assert {k: found.find(k).value for k in truth} == pytest.approx(truth, rel=0.07, abs=1e-3)


def test_runs_of_a_drive_without_a_limit_share_a_description(tmp_path: Path) -> None:
    """The largest command of one run is no limit of the drive."""
    _, first, description = logged(tmp_path, RIG, find_controller("lqr"))
    pushed = replace(RIG, initial_state=(0.0, 0.6, 0.0, 0.0))
    run = afl.simulate_mujoco(pushed, "lqr", "sampled")
    second = read_log(write_run(pushed, run, tmp_path, "pushed")[0], description)
    assert abs(second.command).max() > abs(first.command).max()
    free = replace(load_estimates(), description=description)
    assert scenario_of(free).imperfections.input_limit is None


def test_any_plant_is_logged_by_its_names(tmp_path: Path) -> None:
    scenario = afl.load_scenario(Path(__file__).parents[2] / "examples" / "quadrotor_load.toml")
    asked = afl.Requirements(target={"z": 1.0})
    scenario = replace(scenario, duration=1.0, disturbances=(), schedule={}, requirements=asked)
    require_loggable(scenario, find_controller("lqr"), "sampled")
    run = afl.simulate_mujoco(scenario, "lqr")
    (path,) = write_run(scenario, run, tmp_path, "flight")
    with path.open() as file:
        assert next(file).split() == ["time,x,z,pitch,cable,left,right"]
        rows = np.loadtxt(file, delimiter=",")
    np.testing.assert_allclose(rows[:, 0], 0.005 * np.arange(200), rtol=1e-8)
    noise = rows[:, 1:5] - run.state[:-1:5, :4]
    assert np.abs(noise[:, [0, 1, 3]]).max() < 1e-8 and 5e-4 < noise[:, 2].std() < 2e-3
    assert rows[:, 5:].max() == 12.0 < run.command.max()
