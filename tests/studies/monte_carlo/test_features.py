"""The features of a hardware sample against one whose numbers were chosen to be distinct."""

from __future__ import annotations

import math

import pytest

import afl_mujoco as afl
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.ranges import Ranges
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.monte_carlo.features import FEATURES, features_of

RIG = Scenario(
    name="scenario",
    cart_mass=afl.staircase((1.0, 2.0), (1.5, 0.5, 2.0)),
    half_length=afl.trapezoid((1.0, 2.0, 3.0, 4.0), 0.3, 0.9),
    initial_state=(0.01, math.radians(-20.0), -0.7, 0.6),
    imperfections=Imperfections(
        rail_damping=3.0, rail_friction=0.4, hinge_damping=5e-4, delay=2e-3, actuator_lag=7e-3,
        noise_phi=1.1e-3, noise_phi_dot=13e-3, encoder_step_phi=1.7e-3,
        noise_z=3e-4, noise_z_dot=8e-3, encoder_step_z=5e-5,
    ),
)  # fmt: skip


def test_every_feature_is_the_number_that_its_label_says() -> None:
    assert {name: feature(RIG) for name, feature in FEATURES.items()} == pytest.approx(
        {
            "start angle |φ₀| [deg]": 20.0,
            "start position |z₀| [m]": 0.01,
            "start velocity z′₀ [m/s]": -0.7,
            "start rate away from upright [rad/s]": -0.6,  # it leans left and swings to the right
            "cart mass at the start [kg]": 1.5,
            "least cart mass [kg]": 0.5,
            "half-length at the start [m]": 0.3,
            "least half-length [m]": 0.3,
            "rail damping [N s/m]": 3.0,
            "rail damping / least cart mass [1/s]": 6.0,
            "dry friction [N]": 0.4,
            "hinge damping [mN m s/rad]": 0.5,
            "delay + lag [ms]": 9.0,
            "noise of φ [mrad]": 1.1,
            "noise of φ′ [mrad/s]": 13.0,
            "encoder step of φ [mrad]": 1.7,
            "transport delay [ms]": 2.0,
            "actuator lag [ms]": 7.0,
            "noise of z [mm]": 0.3,
            "noise of z′ [mm/s]": 8.0,
            "encoder step of z [mm]": 0.05,
        }
    )


def test_whatever_varies_is_among_the_features() -> None:
    varied = {"noise_z": (0.0, 1e-3), "velocity_filter": (0.0, 0.01), "z": (-0.1, 0.1)}
    varied["force_limit"] = (20.0, 40.0)
    space = SampleSpace(Scenario(name="drawn", ranges=Ranges(varied=varied)))
    assert features_of(space, 5, 1).keys() == {
        "start position |z₀| [m]", "noise of z [mm]", "velocity_filter [s]", "force limit [N]",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("phi", "rate", "away"),
    [(0.2, 0.6, 0.6), (-0.2, -0.6, 0.6), (0.2, -0.6, -0.6), (-0.2, 0.6, -0.6)],
)
def test_a_rate_leads_away_from_upright_where_the_angle_grows(phi, rate, away) -> None:
    scenario = Scenario(name="start", initial_state=(0.0, phi, 0.0, rate))
    assert FEATURES["start rate away from upright [rad/s]"](scenario) == away
