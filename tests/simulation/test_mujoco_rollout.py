"""MuJoCo's closed loop against the analytic one: model form, twins in fixed steps, ends of runs."""

from dataclasses import replace
from functools import partial

import mujoco
import numpy as np
import pytest

import afl_mujoco as afl

B3 = 1e-8  # the limit of verification.md
MODES = ("exact", "continuous", "sampled")
TIPPING = afl.Scenario(name="tipping", schedule={
    "cart_mass": 20.0, "half_length": 0.05, "pole_mass": 3.0,
}, duration=2.0)  # fmt: skip


def _difference(one, other):
    assert str(one.outcome) == str(other.outcome) == "completed"
    np.testing.assert_allclose(one.time, other.time, rtol=0, atol=1e-14)
    return np.abs(one.state - other.state).max()


@pytest.mark.parametrize("hold", [1, 5], ids=["every step", "every fifth step"])
def test_b3_sampled_mode_is_the_held_loop(odd_scenario, controller, hold):
    settings = {"timestep": 1e-3, "control_period": hold * 1e-3}
    run = afl.simulate_mujoco(odd_scenario, controller, mode="sampled", **settings)
    assert _difference(run, afl.simulate_ode_held(odd_scenario, controller, **settings)) <= B3
    held_for = run.force[:-1].reshape(-1, hold)
    assert (held_for == held_for[:, :1]).all()


def test_b3_holds_with_jumps_in_the_very_middle_of_steps(odd_scenario, adaptive):
    times = tuple(0.0505 + 0.05 * k for k in range(12))  # rounding may put each on either side
    masses = tuple(1.0 + 0.1 * (-1) ** k for k in range(13))
    jumps = odd_scenario.with_schedule(cart_mass=afl.staircase(times, masses))
    scenario = replace(jumps, disturbances=())
    run = afl.simulate_mujoco(scenario, adaptive, mode="sampled")
    assert _difference(run, afl.simulate_ode_held(scenario, adaptive)) <= B3


@pytest.mark.parametrize("mass", [afl.constant(2.0), afl.trapezoid((0.1, 0.5, 0.6, 0.7), 2, 50)])
@pytest.mark.parametrize("time", [0.0, 0.3, 0.3996, 0.7995], ids=str)
def test_an_impulse_acts_at_its_instant_wherever_it_lies(smooth_scenario, time, mass):
    """The cart is free, so that it moves by a known way; held steps of 100 ms would hide 40 ms."""
    alone = replace(
        smooth_scenario.with_schedule(pole_mass=1e-9, cart_mass=mass), duration=0.8,
        initial_state=(0, 0, 0, 0), disturbances=(afl.Impulse(momentum=1.0, time=time),),
    )  # fmt: skip
    run = afl.simulate_mujoco(alone, lambda t, x, b: 0.0, timestep=1e-3)
    after = np.maximum(run.time - time, 0.0)
    np.testing.assert_allclose(run.state[:, 0], after / mass.at(time), rtol=0, atol=1e-7)
    assert run.state[-1, 2] == pytest.approx(1.0 / mass.at(time))  # also during the last step


@pytest.mark.parametrize("mode", MODES)
def test_a_fall_ends_alike_on_both_sides_and_writes_no_log(mode, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    nominal = afl.CONTROLLERS["fixed-nominal"]
    reference = afl.simulate_ode(TIPPING, nominal)
    run = afl.simulate_mujoco(TIPPING, nominal, mode=mode)
    assert np.isfinite(run.state).all() and run.time[-1] <= run.outcome.time
    assert list(tmp_path.iterdir()) == []  # no MUJOCO_LOG.TXT
    assert run.outcome.kind == reference.outcome.kind == "fell"
    assert run.outcome.time == pytest.approx(reference.outcome.time, abs=5e-3)  # a few steps


SIMULATORS = {
    **{mode: partial(afl.simulate_mujoco, mode=mode) for mode in MODES},
    "ode": afl.simulate_ode, "ode RK4": afl.simulate_ode_rk4, "ode held": afl.simulate_ode_held,
}  # fmt: skip


@pytest.mark.parametrize("name", SIMULATORS)
@pytest.mark.parametrize("start", [(0, 1.569, 0, 10.0), (0, 0, 0, 9e5)], ids=["force", "state"])
def test_what_goes_beyond_all_bounds_at_the_start_ends(name, start, smooth_scenario, adaptive):
    run = SIMULATORS[name](replace(smooth_scenario, initial_state=start, duration=0.1), adaptive)
    assert run.outcome.kind != "completed" and np.isfinite(run.state).all()


@pytest.mark.parametrize(("name", "settings", "message"), [
    ("exact", {"mode": "fast"}, "mode must be one of exact, continuous, sampled, got 'fast'"),
    *((name, {"timestep": 0.003, "control_period": 0.01},
       "timestep 0.003 s must divide control_period 0.01 s") for name in ("sampled", "ode held")),
    ("ode held", {"substeps": 0}, "substeps must be at least 1, got 0"),
    ("ode held", {"substeps": 1.5}, "substeps must be a whole number, got 1.5"),
    ("continuous", {"timestep": -1e-3}, "timestep must be positive, got -0.001"),
    ("ode", {"sample_period": 1.0}, "timestep must be within 0.8 s, got 1.0"),
    ("ode", {"method": "Euler"}, "method must be one of DOP853, Radau, RK45, LSODA"),
    ("exact", {"integrator": "RK5"}, "integrator must be one of RK4, Euler"),
], ids=str)  # fmt: skip
def test_bad_settings_are_refused(name, settings, message, smooth_scenario, adaptive):
    with pytest.raises(afl.AflMujocoError, match=f"^{message}"):
        SIMULATORS[name](smooth_scenario, adaptive, **settings)


def test_friction_and_a_table_that_an_edit_adds_act() -> None:
    def rub(spec: mujoco.MjSpec) -> None:
        spec.joint("z").frictionloss = 2.0

    scenario = afl.Scenario(name="short", initial_state=(0.0, 0.3, 0.0, 0.0), duration=1.0)
    rough = replace(scenario, imperfections=afl.Imperfections(dry_friction={"z": 2.0}))
    edited = afl.simulate_mujoco(scenario, "fixed", mode="sampled", edit=rub).state
    described, smooth = (afl.simulate_mujoco(one, "fixed").state for one in (rough, scenario))
    np.testing.assert_array_equal(edited, described)
    assert not np.array_equal(edited, smooth)

    def lay(spec: mujoco.MjSpec) -> None:
        plane, pole = mujoco.mjtGeom.mjGEOM_PLANE, spec.geom("pole")
        pole.contype = pole.conaffinity = 1
        spec.worldbody.add_geom(type=plane, size=[5, 5, 1], pos=[0, 0, 0.3], contype=1)

    scenario = afl.Scenario(name="short", initial_state=(0.0, 0.9, 0.0, 0.0), duration=1.5)
    runs = [afl.simulate_mujoco(scenario, lambda *_: 0.0, "sampled", edit=x) for x in (None, lay)]
    assert [run.outcome.kind for run in runs] == ["fell", "completed"]


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_the_other_integrators_are_of_order_one(integrator, smooth_scenario, adaptive):
    errors = []
    for h in (2e-3, 1e-3, 5e-4):
        settings = {"timestep": h, "control_period": 2e-3}
        run = afl.simulate_mujoco(smooth_scenario, adaptive, integrator=integrator, **settings)
        held = afl.simulate_ode_held(smooth_scenario, adaptive, **settings)
        errors.append(np.abs(run.state[-1] - held.state[-1]).max())
    assert 0.9 <= np.polyfit(np.log((2e-3, 1e-3, 5e-4)), np.log(errors), 1)[0] <= 1.1  # A4
