"""The page's curves are the run's, and their differences are not lost to single precision."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from numpy.typing import NDArray

from afl_mujoco.studies.verification.chart_data import MOST, chart_data, encode, shortcuts
from tests.verification_result import OWN, make_curves


def decode(text: str) -> NDArray[np.float32]:
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def test_curves_come_back_in_single_precision() -> None:
    fixed, adaptive = make_curves(OWN, "fixed"), make_curves(OWN, "adaptive")
    data = chart_data([fixed, adaptive], OWN)
    np.testing.assert_allclose(decode(data["time"]), fixed.time, rtol=1e-7)
    np.testing.assert_allclose(decode(data["prescribed"]["push"]), fixed.push)
    assert [run["controller"] for run in data["runs"]] == ["fixed", "adaptive"]
    reference = data["runs"][1]["reference"]
    np.testing.assert_allclose(decode(reference["phi"]), adaptive.states["ode"][:, 1], rtol=1e-7)
    np.testing.assert_allclose(decode(reference["force"]), adaptive.forces["ode"], rtol=1e-7)


def test_a_difference_far_below_single_precision_is_still_there() -> None:
    one = make_curves()
    data = chart_data([one], OWN)["runs"][0]["differences"]["mujoco exact"]["z"]
    wanted = (one.states["mujoco exact"] - one.states["ode"])[:, 0]
    assert 0.0 < np.abs(wanted).max() < 2e-13
    np.testing.assert_allclose(decode(data), wanted, rtol=1e-6)


def test_runs_on_different_instants_share_a_clock_and_leave_gaps() -> None:
    one, other = make_curves(OWN, "fixed"), make_curves(OWN, "adaptive")
    thin = type(one)(
        scenario=one.scenario,
        controller=one.controller,
        time=one.time[::2],
        cart_mass=one.cart_mass[::2],
        half_length=one.half_length[::2],
        push=one.push[::2],
        states={name: x[::2] for name, x in one.states.items()},
        forces={name: x[::2] for name, x in one.forces.items()},
    )
    data = chart_data([thin, other], OWN)
    first, second = (decode(run["reference"]["z"]) for run in data["runs"])
    assert len(first) == len(second) == len(other.time)
    np.testing.assert_array_equal(np.isnan(first), np.arange(len(first)) % 2 == 1)
    assert not np.isnan(second).any()


def test_a_run_that_fell_ends_early() -> None:
    data = chart_data([make_curves(fell_at=500)], OWN)["runs"][0]
    deployed = decode(data["differences"]["mujoco sampled"]["z"])
    assert not np.isnan(deployed[:500]).any()
    assert np.isnan(deployed[500:]).all()


def test_shortcuts_lead_to_the_start_and_to_each_change() -> None:
    found = shortcuts(OWN)
    assert [s["label"] for s in found] == ["start", "1 s", "1.2 s", "1.3 s"]
    assert len(found) <= MOST
    assert all(0.0 <= s["from"] < s["to"] <= 2.0 for s in found)
    assert found[1]["from"] == pytest.approx(0.9)


def test_an_empty_curve_is_an_empty_text() -> None:
    assert encode(np.empty(0)) == ""
