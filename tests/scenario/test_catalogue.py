"""The catalogue is decisions D3 and D6, written out by hand."""

import math

import pytest

import afl_mujoco as afl

TIMES = (0.0, 0.5, 1.0, 2.0, 2.999, 3.0, 5.0, 6.0, 7.0, 8.0, 20.0)
STEP_MASS = (0.5, 0.5, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0)
STEP_LENGTH = (0.2, 0.2, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
TRAPEZOID_MASS = (0.5, 0.875, 1.25, 2.0, 2.0, 2.0, 2.0, 2.0, 1.25, 0.5, 0.5)
TRAPEZOID_LENGTH = (0.2, 0.4, 0.6, 1.0, 1.0, 1.0, 1.0, 1.0, 0.6, 0.2, 0.2)
CASES = {
    "step-step": (STEP_MASS, STEP_LENGTH), "step-trapezoid": (STEP_MASS, TRAPEZOID_LENGTH),
    "trapezoid-step": (TRAPEZOID_MASS, STEP_LENGTH),
    "trapezoid-trapezoid": (TRAPEZOID_MASS, TRAPEZOID_LENGTH),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_case_has_the_schedules_of_d3(name):
    mass, length = CASES[name]
    for scenario in (afl.SCENARIOS[name], afl.SCENARIOS[f"{name}-impulse"]):
        assert scenario.cart_mass(TIMES) == pytest.approx(mass, rel=1e-15)  # one rounding
        assert scenario.half_length(TIMES) == pytest.approx(length, rel=1e-15)


@pytest.mark.parametrize("name", afl.SCENARIOS)
def test_every_scenario_has_the_paper_s_constants_and_only_some_the_pulse_of_d6(name):
    assert list(afl.SCENARIOS) == ["nominal", *CASES, *(f"{case}-impulse" for case in CASES)]
    s, pulse = afl.SCENARIOS[name], afl.ForcePulse(force=-10.0, start=10.0, duration=0.1)
    assert s.name == name and (s.pole_mass, s.gravity, s.duration) == (0.05, 9.81, 20.0)
    assert s.initial_state == (0.0, -math.pi / 3, 0.0, 0.0)
    assert s.disturbances == ((pulse,) if name.endswith("-impulse") else ())
