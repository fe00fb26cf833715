"""Departures from the ideal are validated, survive a file, and are refused where ignored."""

import dataclasses
import re
from functools import partial

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.imperfections import IDEAL, IMPERFECTIONS, Imperfections, declarations
from tests.messages import line

REAL = Imperfections(
    control_period=0.004, input_limit=60.5, slew_rate=4000.0, lag=0.003, delay=0.0025,
    encoder_step={"z": 1e-4, "phi": 2e-3},
    noise={"z": 1.5e-3, "phi": 2.5e-3, "z_dot": 0.011, "phi_dot": 0.012}, differentiated=True,
    velocity_filter=0.007, damping={"z": 0.21, "phi": 0.0011},
    dry_friction={"z": 0.31, "phi": 2e-4}, armature={"z": 0.041, "phi": 0.00051},
    end_stops={"z": 1.9}, tip_mass_share=0.23, pole_radius=0.013, parameter_delay=0.09,
    seed=2**63 - 1,
)  # fmt: skip
"""It differs from the ideal in every field."""

FIELDS = [field.name for field in dataclasses.fields(Imperfections)]


def test_every_option_survives_a_file_alone_and_with_all_others(tmp_path):
    assert [name for name in FIELDS if getattr(REAL, name) == getattr(IDEAL, name)] == []
    for imperfections in (REAL, *[Imperfections(**{name: getattr(REAL, name)}) for name in FIELDS]):
        scenario = afl.Scenario(name="real", imperfections=imperfections)
        afl.save_scenario(scenario, tmp_path / "s.toml")
        assert afl.load_scenario(tmp_path / "s.toml") == scenario


@pytest.mark.parametrize("simulate", [
    afl.simulate_ode, afl.simulate_ode_rk4, afl.simulate_ode_held,
    *(partial(afl.simulate_mujoco, mode=mode) for mode in ("exact", "continuous")),
])  # fmt: skip
def test_what_would_ignore_imperfections_refuses_it(simulate):
    said = line("scenario 'mine' has imperfections, which only mode \"sampled\" simulates: ", ...)
    for name in FIELDS:
        real = Imperfections(**{name: getattr(REAL, name)})
        with pytest.raises(InvalidValueError, match=said):
            simulate(afl.Scenario(name="mine", imperfections=real), "fixed")


def test_a_plant_that_has_the_cart_pole_s_coordinates_is_not_the_cart_pole():
    text = afl.Scenario(name="s").plant.model.read_text()
    plant = afl.Plant(name="mine", model=text, coordinates=("z", "phi"), inputs=("force",),
                      parameters={"load": afl.Parameter(1.0, "kg")},
                      write=lambda p: {"body cart mass": p.load})  # fmt: skip
    known = declarations(plant)
    assert "tip_mass_share" not in known and "load_error" in known
    mine = PythonController(name="mine", function=lambda t, x, p: p.load, plant=plant)
    assert mine.command(0.0, np.zeros(4), np.array([3.0])) == 3.0


def test_levels_are_shown_in_the_unit_that_is_said_those_of_an_encoder_in_rad_and_dm() -> None:
    prefixed = re.compile(r"m(s|rad|m|N m s)$|g m²$")
    for one in IMPERFECTIONS:
        expected = 100.0 if one.unit == "%" else 1000.0 if prefixed.match(one.unit) else 1.0
        assert one.scale == expected, one.name
    (one,) = (x for x in IMPERFECTIONS if x.name == "encoder_step")
    assert one.options(0.02) == {"encoder_step.phi": 0.02, "encoder_step.z": 0.002}
