from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.scenario.catalogue import HARDWARE_RANGES, LABORATORY, START, with_ranges
from afl_mujoco.scenario.imperfections import declarations
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario
from tests.plants.plants import EXAMPLES, known

RIG = """
duration = 12.0
initial_state = [0.0, 0.2, 0.0, 0.0]
[schedule]
pole_mass = 0.2
cart_mass = 8.0
half_length = 1.5
[imperfections]
delay = 0.004
[belief]
cart_mass = { error = 0.1 }
[ranges]
cart_mass = [6.0, 12.0]
phi = [-0.3, 0.3]
half_length_error = [-0.1, 0.1]
pole_mass = [0.1, 0.3]
gravity = [9.79, 9.83]
"""


@pytest.fixture
def rig(tmp_path) -> afl.Scenario:
    (tmp_path / "rig.toml").write_text(RIG)
    return afl.load_scenario(tmp_path / "rig.toml")


def test_only_what_the_file_says_varies(rig: afl.Scenario) -> None:
    space = SampleSpace(rig)
    assert space.dimension == 1 + 8 + 1 + 2
    for i in range(50):
        sample = sample_scenario(space, i, 3)
        phi, error = sample.initial_state[1], sample.belief.error("half_length_error")
        assert abs(phi) <= 0.3 and abs(error) <= 0.1
        assert 0.1 <= sample.pole_mass <= 0.3 and 9.79 <= sample.gravity <= 9.83
        own = replace(
            sample, name="rig",
            schedule={**sample.schedule, "cart_mass": rig.cart_mass, "pole_mass": rig.pole_mass,
                      "gravity": rig.gravity}, initial_state=rig.initial_state, ranges=rig.ranges,
            belief=sample.belief.changed(half_length_error=0.0),
            imperfections=replace(sample.imperfections, seed=0),
        )  # fmt: skip
        assert own == rig
        assert 6.0 <= min(sample.cart_mass.values) <= max(sample.cart_mass.values) <= 12.0


def test_a_scenario_with_ranges_survives_its_file_and_is_its_space_s_reference(rig, tmp_path):
    for one in (rig, LABORATORY):
        afl.save_scenario(one, tmp_path / "again.toml")
        again = afl.load_scenario(tmp_path / "again.toml")
        assert (again, hash(again)) == (one, hash(one))
    space = SampleSpace(rig)
    sample = space.scenario_of(space.reference, 0, 0)
    assert sample.initial_state == pytest.approx(rig.initial_state)
    assert set(np.round(sample.cart_mass.values, 12)) == {8.0}
    assert sample.belief.error("half_length_error") == pytest.approx(0.0, abs=1e-15)
    assert sample.pole_mass == pytest.approx(0.2)


def test_a_scenario_without_ranges_keeps_what_it_has_and_gets_the_laboratorys_rest() -> None:
    own = replace(afl.SCENARIOS["step-step"], imperfections=afl.Imperfections(delay=0.03))
    assert with_ranges(own).ranges == {n: r for n, r in HARDWARE_RANGES.items() if n != "delay"}
    sample = sample_scenario(SampleSpace(with_ranges(own)), 0, 1)
    assert sample.imperfections.delay == 0.03 and sample.cart_mass == own.cart_mass
    assert with_ranges(own, start=True).ranges.keys() >= START.keys()
    assert with_ranges(LABORATORY) == LABORATORY


def test_a_range_must_be_of_one_thing_and_of_the_form_that_the_file_has() -> None:
    plant, late = known("quadrotor_load.py:plant"), afl.Imperfections(delay={"left": 0.01})
    with pytest.raises(AflMujocoError, match=r"^ranges\.delay must be a table by input, as imp"):
        afl.Scenario(name="s", plant=plant, imperfections=late, ranges={"delay": (0.0, 0.1)})
    own = replace(plant, parameters={"delay": afl.Parameter(1.0)})
    with pytest.raises(AflMujocoError, match=r"^ranges\.delay must not be an imperfection and a"):
        afl.Scenario(name="s", plant=own, ranges={"delay": (0.1, 0.2)})


def test_a_level_of_noise_is_that_of_every_sensor_and_a_plant_may_be_named() -> None:
    scenario = afl.Scenario(name="s", plant=f"{EXAMPLES}/quadrotor_load.py:plant")
    (noise,) = declarations(scenario.plant)["noise.x"].swept
    places = dict.fromkeys(("noise.x", "noise.z", "noise.pitch", "noise.cable"), 1.0)
    assert noise.fields == places | {f"{name}_dot": 10.0 for name in places}


def test_a_space_that_cannot_be_drawn_from_is_refused() -> None:
    with pytest.raises(AflMujocoError, match=r"scenario 'nominal' must say in \[ranges\] what"):
        SampleSpace(afl.SCENARIOS["nominal"])
    rail = afl.Imperfections(end_stops={"z": 1.0})
    for ranges, said in (
        ({"z": (-2.0, 2.0)}, "initial_state z must lie within the shortest end_stops.z, 1 m"),
        ({"delay": (0.0, 60.0)}, "imperfections.delay must be shorter than the duration"),
    ):
        with pytest.raises(AflMujocoError, match=rf"^at an end of \[ranges\], {said}"):
            SampleSpace(replace(LABORATORY, ranges=ranges, imperfections=rail))
    own = afl.Scenario(name="own", ranges={"cart_mass": (1.0, 2.0)}, duration=0.008)
    with pytest.raises(AflMujocoError, match=r"^duration must be more than 0\.008 s, for"):
        SampleSpace(own)
    own = replace(LABORATORY, ranges={}, imperfections=afl.Imperfections(differentiated=True))
    left_out = HARDWARE_RANGES.keys() - with_ranges(own).ranges.keys()
    assert left_out == {"noise.z_dot", "noise.phi_dot"}
    asked = replace(own, ranges={"noise.phi_dot": (0.0, 1.0)})
    with pytest.raises(InvalidValueError, match=r"^ranges\.noise.phi_dot must be left out: vel"):
        SampleSpace(asked)
