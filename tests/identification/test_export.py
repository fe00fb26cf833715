import numpy as np
import pytest

from afl_mujoco.identification.export import TILT, draws, scenario_of
from afl_mujoco.identification.prediction import load_estimates
from afl_mujoco.scenario.files import load_scenario, save_scenario


def test_the_scenario_is_the_cart_pole_that_was_identified(tmp_path) -> None:
    one = load_estimates()
    scenario = scenario_of(one)
    r, plant = scenario.imperfections, scenario.parameters_at(0.0)
    assert plant.cart_mass == one.find("cart_mass").value
    assert plant.half_length == one.find("half_length").value
    assert r.at("damping.z") == one.find("rail_damping").value
    assert r.input_limit == one.find("force").value
    assert r.delay == one.find("delay").value
    assert r.at("end_stops.z") == scenario.requirements.max["z"] == 0.22
    assert scenario.ranges.varied["delay"] == (one.find("delay").low, one.find("delay").high)
    save_scenario(scenario, tmp_path / "rig.toml")
    assert load_scenario(tmp_path / "rig.toml") == scenario


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
    assert 0.9 * TILT < max(tilts) <= TILT
    assert draws(one, 3, 3) == draws(one, 3, 3)
    assert draws(one, 3, 3) != draws(one, 3, 4)
