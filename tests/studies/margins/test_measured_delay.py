"""The delay margin of the linearised loop against small motions in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.delay_margin import delay_margin, least_margin
from afl_mujoco.studies.margins import measured_delay
from afl_mujoco.studies.margins.measured_delay import (
    REACH,
    Deployment,
    compare_delay,
    measured_plants,
    motion_decays,
)

pytestmark = pytest.mark.slow

LQR, ADAPTIVE = afl.CONTROLLERS["lqr"], afl.CONTROLLERS["adaptive"]


def plant(cart_mass: float, half_length: float, **others: float) -> afl.CartPoleParameters:
    return afl.CartPoleParameters(cart_mass=cart_mass, half_length=half_length, **others)


def test_margin_and_measurement_agree_on_a_plant_far_from_the_paper_s() -> None:
    heavy = plant(8.0, 1.5, pole_mass=2.0, gravity=3.7)
    found = compare_delay((LQR, heavy, Deployment()))
    assert abs(found.difference) < 0.01
    assert found.margin != pytest.approx(delay_margin(LQR, plant(8.0, 1.5)), rel=0.05)


def test_the_least_margin_is_of_the_scenario_s_own_pole_and_gravity() -> None:
    scenario = afl.Scenario(name="heavy", pole_mass=2.0, gravity=3.7, duration=0.5)
    own = plant(1.0, 0.5, pole_mass=2.0, gravity=3.7)
    assert least_margin((LQR, (scenario,))).margin == delay_margin(LQR, own)


@pytest.mark.parametrize("name", ["adaptive", "lqr", "partial-linearization"])
def test_margin_and_measurement_agree(name: str) -> None:
    found = compare_delay((afl.CONTROLLERS[name], plant(0.5, 0.2), Deployment()))
    assert found.agrees
    assert abs(found.difference) < 0.01  # far within REACH


def test_a_wrong_margin_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    true = delay_margin(LQR, plant(1.0, 0.5))
    monkeypatch.setattr(measured_delay, "delay_margin", lambda *plant: true * (1.0 + 2.0 * REACH))
    found = compare_delay((LQR, plant(1.0, 0.5), Deployment()))
    assert not found.agrees
    assert found.difference == pytest.approx(1.0 / (1.0 + 2.0 * REACH) - 1.0, abs=0.01)


def test_a_limit_cycle_is_no_decay() -> None:
    margin = delay_margin(ADAPTIVE, plant(2.0, 0.05))
    assert motion_decays(ADAPTIVE, plant(2.0, 0.05), 0.98 * margin)
    for factor in (1.02, 1.3, 1.6, 1.9):  # it falls no more than it decays
        assert not motion_decays(ADAPTIVE, plant(2.0, 0.05), factor * margin)


def test_a_loop_that_is_not_stable_has_no_margin_and_no_threshold() -> None:
    found = compare_delay((afl.CONTROLLERS["adaptive-nominal"], plant(0.1, 0.05), Deployment()))
    assert (found.margin, found.measured, found.difference) == (None, None, None)
    assert found.agrees


def test_the_least_margin_is_that_of_the_worst_plant_on_the_way() -> None:
    scenario = afl.SCENARIOS["step-step"]
    found = least_margin((LQR, (scenario,)))
    pairs = {
        (float(scenario.cart_mass(t)), float(scenario.half_length(t))) for t in (0.5, 1.5, 2.5, 4.0)
    }
    expected = min((delay_margin(LQR, plant(*pair)), *pair) for pair in pairs)
    assert (found.margin, found.cart_mass, found.half_length) == expected


def test_a_plant_that_stands_for_a_tenth_of_a_second_is_on_the_way_too() -> None:
    brief = Scenario(
        name="brief",
        duration=8.0,
        cart_mass=afl.staircase((2.25, 2.36), (1.0, 0.1, 1.0)),
        half_length=afl.staircase((2.25, 2.36), (0.5, 0.05, 0.5)),
    )
    found = least_margin((LQR, (brief,)))
    assert (found.cart_mass, found.half_length) == (0.1, 0.05)
    assert found.margin == delay_margin(LQR, plant(0.1, 0.05)) < delay_margin(LQR, plant(1.0, 0.5))


def test_the_delay_is_measured_with_the_force_held_as_long_as_the_margin_says():
    """Against the eigenvalues of the sampled loop, which for LQR on this plant cross at 15.6 ms."""
    found = compare_delay((LQR, plant(2.0, 0.2), Deployment(0.02)))
    assert (
        found.margin
        == delay_margin(LQR, plant(2.0, 0.2), 0.02)
        != delay_margin(LQR, plant(2.0, 0.2))
    )
    assert found.measured == pytest.approx(15.6e-3, rel=0.03)
    assert not found.agrees


def test_the_plants_that_are_measured_are_of_the_grid():
    assert measured_plants([1.0], [0.5]) == [(1.0, 0.5)]
    masses, lengths = [0.1 * i for i in range(1, 21)], [0.05 * i for i in range(1, 21)]
    paper = [(m, x) for m in (0.1, 2.0) for x in (0.05, 0.2, 1.0)]
    np.testing.assert_allclose(measured_plants(masses, lengths), paper, rtol=1e-12)
    assert measured_plants(masses, lengths, few=True) == [(masses[0], lengths[0]), (2.0, 1.0)]
