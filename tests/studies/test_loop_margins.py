"""Margins against textbook loops, simulated delays, and MuJoCo itself."""

import cmath
import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.linalg import expm

import afl_mujoco as afl
from afl_mujoco.control.cartpole_feedback import upright_model
from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.studies.margins import HELD, Request, run
from afl_mujoco.studies.shared import loop_margins as under_test
from afl_mujoco.studies.shared.loop_margins import Loop

NOMINAL = afl.CartPoleParameters()
LIGHT_AND_SHORT = afl.CartPoleParameters(cart_mass=0.1, half_length=0.05)


def loop_margins(loop, *hardware):
    found = under_test.loop_margins(loop, *hardware)
    return None if found is None else found[0]


def at(plant, **what):
    return afl.Scenario(name="at rest", schedule=asdict(plant), **what)


def linearize(controller, plant):
    return under_test.linearize(controller, at(plant))


def companion(numerator, denominator):
    """A loop whose transfer function is a constant over a polynomial, as state feedback."""
    order = len(denominator) - 1
    a = np.eye(order, k=1)
    a[-1] = -np.array(denominator[:0:-1]) / denominator[0]
    b, k = np.zeros((order, 1)), np.zeros((1, order))
    b[-1], k[0, 0] = 1.0, numerator / denominator[0]
    return Loop(a, b, k)


def unstable_lag(gain):
    """L(s) = gain / (s - 1)."""
    return Loop(np.eye(1), np.ones((1, 1)), np.array([[gain]]))


def test_the_loop_of_seiler_packard_and_gahinet_has_the_margins_that_they_print():
    # An introduction to disk margins (2020): L = 25 / (s^3 + 10 s^2 + 10 s + 10)
    margins = loop_margins(companion(25.0, [1.0, 10.0, 10.0, 10.0]))
    assert margins.gain_increase == pytest.approx(3.6, abs=1e-9)
    assert margins.gain_decrease == 0.0 and margins.phase == pytest.approx(29.1, abs=0.05)
    assert margins.disk == pytest.approx(0.46, abs=0.005)


@pytest.mark.parametrize("gain", [1.3, 4.0, 60.0], ids=str)
def test_an_unstable_lag_has_the_margins_of_its_closed_forms(gain):
    margins = loop_margins(unstable_lag(gain))
    crossover = math.sqrt(gain**2 - 1.0)  # |L| = 1; there the phase is arctan(crossover) - pi
    assert margins.gain_decrease == pytest.approx(1.0 / gain, rel=1e-9)
    assert margins.gain_increase == math.inf
    assert margins.crossover == pytest.approx(crossover, rel=1e-9)
    assert math.radians(margins.phase) == pytest.approx(math.atan(crossover), rel=1e-9)
    assert margins.delay == pytest.approx(math.atan(crossover) / crossover, rel=1e-9)
    # (S - T)/2 = (s - 1 - gain) / (2 (s - 1 + gain)) peaks at s = 0
    assert margins.disk == pytest.approx(2.0 * (gain - 1.0) / (gain + 1.0), rel=1e-3)


@pytest.mark.parametrize("period", [0.01, 0.3], ids=str)
def test_a_held_unstable_lag_has_the_gains_and_the_crossover_of_its_closed_forms(period):
    gain, growth = 2.5, math.exp(period)
    margins = loop_margins(unstable_lag(gain), period)
    # x' = (growth - gain (growth - 1)) x is stable for gain from 1 to (growth + 1)/(growth - 1)
    assert margins.gain_decrease == pytest.approx(1.0 / gain, rel=1e-7)
    assert margins.gain_increase == pytest.approx((growth + 1.0) / (growth - 1.0) / gain, rel=1e-7)
    # L = gain (growth - 1) / (z - growth) has size 1 at this turn of z from sample to sample
    turn = math.acos((1.0 + growth**2 - (gain * (growth - 1.0)) ** 2) / (2.0 * growth))
    lag = math.pi - abs(cmath.phase(1.0 / (cmath.rect(1.0, turn) - growth)))
    assert margins.crossover == pytest.approx(turn / period, rel=1e-7)
    assert math.radians(margins.phase) == pytest.approx(lag, rel=1e-6)
    # x' = growth x + late u'' + (growth - 1 - late) u', u'' and u' the inputs one period apart
    whole = math.floor(margins.delay / period)
    late = growth - math.exp(period - (margins.delay - whole * period))
    polynomial = np.polyadd([1.0, -growth, *([0.0] * (whole + 1))],
                            [gain * (growth - 1.0 - late), gain * late])  # fmt: skip
    assert np.abs(np.roots(polynomial)).max() == pytest.approx(1.0 - 1e-9, abs=1e-10)
    assert abs(margins.delay - lag / turn * period) < period


def grows(loop, period, delay):
    """Return whether a held loop grows under a delay, input by input of each period."""
    whole, late = divmod(delay, period)
    n, rng = len(loop.a), np.random.default_rng(0)
    grown = np.vstack([np.hstack([loop.a, loop.b]), np.zeros((1, n + 1))])
    before, after = (expm(length * grown)[:n] for length in (late, period - late))
    x, sent, sizes = rng.normal(size=n), [0.0] * (int(whole) + 2), []
    for _ in range(1200):
        sent.append((-loop.k @ x).item())
        x = before @ np.append(x, sent[-2 - int(whole)])
        x = after @ np.append(x, sent[-1 - int(whole)])
        sizes.append(np.linalg.norm(x))
    return max(sizes[-100:]) > max(sizes[500:600])


@pytest.mark.parametrize(("omega", "damping", "second", "k", "period"), [
    ((11.0, 8.0), (0.04, 0.09), 0.7, (10.0, 13.0, 3.0, -2.0), 0.29),
    ((9.0, 7.0), (0.07, 0.1), 0.0, (-28.0, 2.0, -14.0, 0.0), 0.28),
    ((12.0, 6.0), (0.06, 0.09), 0.0, (11.0, 4.0, -9.0, 12.0), 0.24),
], ids=["phase never", "phase at 1.1 s", "phase at 0.6 s"])  # fmt: skip
def test_a_held_loop_grows_beyond_its_delay_margin_where_no_phase_says_so(
    omega, damping, second, k, period
):
    """Two resonances near the rate of control or above."""
    a, w = np.zeros((4, 4)), np.array(omega)
    a[:2, 2:], a[2:, :2], a[2:, 2:] = np.eye(2), -np.diag(w**2), -np.diag(2.0 * w * damping)
    loop = Loop(a, np.array([[0.0], [0.0], [1.0], [second]]), np.array([k]))
    delay = loop_margins(loop, period).delay
    assert [grows(loop, period, share * delay) for share in (0.0, 0.5, 0.95)] == [False] * 3
    assert grows(loop, period, 1.05 * delay)


def test_whole_periods_of_delay_turn_a_loop_and_change_nothing_else():
    """Thirty and sixty of them: polynomials of that order say nothing of it."""
    loop = linearize(afl.CONTROLLERS["lqr"], NOMINAL)
    at_once = loop_margins(loop, 1e-3)
    for delay in (0.03, 0.04):
        late = afl.Imperfections(delay=delay)
        found = loop_margins(loop, 1e-3, late)
        assert found.crossover == pytest.approx(at_once.crossover, rel=1e-9)
        turned = math.degrees(at_once.crossover * delay)
        assert found.phase == pytest.approx(at_once.phase - turned, abs=1e-6)
        assert found.delay == pytest.approx(at_once.delay - delay, abs=1e-9)
        for gain in (found.gain_decrease, found.gain_increase):
            for share in (1.0 - 1e-6, 1.0 + 1e-6):
                changed = replace(loop, k=gain * share * loop.k)
                stable = under_test.stable_as_held(changed, 1e-3, late)
                assert stable == ((gain > 1.0) == (share < 1.0))


def test_a_loop_that_is_not_stable_has_no_margins():
    assert loop_margins(unstable_lag(0.9)) is None
    assert loop_margins(unstable_lag(2.5), 1.0) is None  # held too long
    assert loop_margins(unstable_lag(2.5)) is not None
    with pytest.raises(InvalidValueError, match=r"^control_period must be positive, got 0.0$"):
        loop_margins(unstable_lag(2.5), 0.0)


def test_the_linearised_plant_is_the_closed_form(odd_parameters):
    for plant in (odd_parameters, NOMINAL, LIGHT_AND_SHORT):
        loop, model = linearize(afl.CONTROLLERS["lqr"], plant), upright_model(plant)
        np.testing.assert_allclose(loop.a, model.a, atol=1e-8 * np.abs(model.a).max())
        np.testing.assert_allclose(loop.b[:, 0], model.b, atol=1e-8 * np.abs(model.b).max())


@pytest.mark.parametrize(("function", "rule"), [
    (lambda time, state, belief: math.nan, "must be about an equilibrium"),
    (lambda time, state, belief: math.inf, "must be about an equilibrium"),
    (lambda time, state, belief: 1.0 - state[1], "at its target, got z accelerates by 0.98"),
    (lambda time, state, belief: math.nan if state[1] else 0.0, "must have finite slopes"),
    *((lambda time, state, belief, kink=kink: float(-100.0 * state[1] + kink * abs(state[1])),
       "must be smooth: slopes on either side may differ") for kink in (300.0, 1.0)),
    (lambda time, state, belief: -100.0 * round(float(state[1]), 2), "must have a slope at the ta"),
    (lambda time, state, belief: -100.0 * min(time, 1.0) * state[1], "must have a slope at the ta"),
])  # fmt: skip
def test_a_controller_without_an_equilibrium_or_a_slope_at_upright_is_refused(function, rule):
    with pytest.raises(InvalidValueError, match=rule):
        linearize(PythonController(name="lame", function=function), NOMINAL)


def test_a_controller_that_bends_has_its_slope_and_an_lqr_the_margins_of_every_lqr():
    def function(time, state, belief):
        return float(-100.0 * state[1] + 500.0 * state[1] ** 2 - 7.0 * state[2])

    found = linearize(PythonController(name="bent", function=function), NOMINAL).k
    np.testing.assert_allclose(found[0], (0.0, 100.0, 7.0, 0.0), rtol=1e-8, atol=1e-8)
    for mass, length in ((0.1, 0.05), (0.7, 0.3), (1.0, 0.5), (2.0, 1.0)):
        plant = afl.CartPoleParameters(cart_mass=mass, half_length=length)
        margins = loop_margins(linearize(afl.CONTROLLERS["lqr"], plant))
        assert margins.phase >= 60.0 and margins.gain_decrease <= 0.5
        assert margins.gain_increase == math.inf


@pytest.mark.parametrize("hardware", [
    afl.Imperfections(delay=0.0123, lag=0.005, damping={"z": 1.0}),
    afl.Imperfections(differentiated=True), afl.Imperfections(velocity_filter=0.02),
    afl.Imperfections(differentiated=True, velocity_filter=0.01, delay=0.0123, lag=0.005),
], ids=str)  # fmt: skip
def test_a_motion_on_imperfect_hardware_decays_up_to_the_margin(hardware) -> None:
    period, lqr = 0.005, afl.CONTROLLERS["lqr"]
    scenario = at(NOMINAL, imperfections=hardware, belief={"half_length": {"error": 0.1}})
    (margin,) = run(Request(scenario, [lqr], {}, period)).of("lqr", HELD)
    assert 0.0 < margin.delay < 0.1
    for share, decays in ((0.97, True), (1.03, False)):
        delay = hardware.of_input("delay", "force") + share * margin.delay
        late = replace(hardware, delay=delay, control_period=period)
        start = {"phi": 1e-3}
        run_ = afl.simulate_mujoco(replace(scenario, initial_state=start, imperfections=late), lqr)
        first, last = (part.max() for part in np.array_split(np.abs(run_.state[:, 1]), 5)[::4])
        assert bool(last < first) is decays


TWO_CARTS = afl.Plant(
    name="two-carts", coordinates=("left", "right"), inputs=("first", "second"),
    model="""<mujoco><option gravity="0 0 0"/><worldbody>
        <body><joint name="left" type="slide" axis="1 0 0"/>
        <inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
        <body><joint name="right" type="slide" axis="1 0 0"/>
        <inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/></body></body></worldbody><actuator>
        <motor name="first" joint="left"/><motor name="second" joint="right"/></actuator>
        </mujoco>""",
)  # fmt: skip


def both(time, state, belief):
    left, right, left_dot, right_dot = state
    return -40.0 * left - 9.0 * left_dot - right, -30.0 * right - 6.0 * right_dot + 2.0 * left_dot


@pytest.mark.parametrize("period", [None, 0.02])
def test_each_input_is_broken_with_the_other_closed(period):
    """Against poles: at the gain margin of an input a pole of the whole loop is on the border."""
    controller = PythonController(name="both", function=both, plant=TWO_CARTS)
    delays = {"first": 0.03, "second": 0.0}
    rough = afl.Imperfections(delay=delays, lag={"second": 0.01}, differentiated=True)
    scenario = afl.Scenario(name="two", plant=TWO_CARTS, imperfections=rough)
    loop = under_test.linearize(controller, scenario)
    np.testing.assert_allclose(loop.k[0, :4], (40.0, 1.0, 9.0, 0.0), atol=1e-7)
    assert loop.a.shape == (5, 5) and loop.b[4, 1] == 100.0
    found = under_test.loop_margins(loop, period, scenario.imperfections)
    gains = [(i, x) for i, one in enumerate(found) for x in (one.gain_decrease, one.gain_increase)]
    finite = [(i, gain) for i, gain in gains if 0.0 < gain < math.inf]
    assert len(finite) == (0 if period is None else 2)
    for i, gain in finite:
        for share, holds in ((1.0 - 1e-4, gain > 1.0), (1.0 + 1e-4, gain < 1.0)):
            changed = loop.k.copy()
            changed[i] *= gain * share
            changed = replace(loop, k=changed)
            there = under_test.loop_margins(changed, period, scenario.imperfections)
            assert (there is not None) == holds


@pytest.mark.parametrize("damping", [1e-2, 1e-4, 1e-6])
def test_the_disk_of_a_loop_that_hardly_decays_is_not_between_two_frequencies(damping) -> None:
    """By the distance of 1/max|S - 1/2| on a grid around the only peak."""
    a, b = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[0.0], [1.0]])
    loop = Loop(a, b, np.array([[0.3, damping]]))
    omega = 1.3**0.5 + damping * np.linspace(-50.0, 50.0, 200_001)
    transfer = (0.3 + 1j * omega * damping) / (1.0 - omega**2)
    expected = 1.0 / np.abs(1.0 / (1.0 + transfer) - 0.5).max()
    assert loop_margins(loop).disk == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("hardware", [
    {"differentiated": True}, {"velocity_filter": 0.003},
    {"differentiated": True, "velocity_filter": 0.003, "delay": {"force": 0.004}},
], ids=str)  # fmt: skip
def test_where_the_cart_stands_is_no_matter_also_to_sensors_that_difference_it(hardware) -> None:
    """Rounding decided of each plant whether a pole at 1, where it stands, was a stable one."""
    period, gains = 0.005, (0.0, -64.0, 6.5, -29.0)
    controller = as_controller(lambda t, x, p: (p.cart_mass + p.pole_mass) * np.dot(gains, x))
    r = Imperfections(control_period=period, **hardware)
    for mass in (0.6, 0.85, 1.1, 1.6, 2.0):
        scenario = afl.Scenario(name="s", schedule={"cart_mass": mass}, imperfections=r)
        loop = under_test.linearize(controller, scenario)
        (found,) = under_test.loop_margins(loop, period, r) or [None]
        late = under_test.loop_margins(loop, period, Imperfections(control_period=period))
        assert found is not None and late is not None
        assert 0.5 < found.delay / late[0].delay < 1.2 and found.phase > 60.0
        for factor, stable in ((0.99, True), (1.01, False)):
            own = hardware | {"delay": factor * found.delay + r.of_input("delay", "force")}
            more = Imperfections(control_period=period, **own)
            assert (under_test.loop_margins(loop, period, more) is not None) == stable


GAP = afl.Plant(
    name="two", coordinates=("x", "y"), inputs=("left", "right"),
    parameters={"mass": afl.Parameter(1.0, "kg", low=0.5, high=2.0)},
    write=lambda p: {"body first": afl.ball(mass=p.mass, radius=0.1)},
    model="""<mujoco><worldbody>
      <body name="first"><joint name="x" type="slide" axis="1 0 0" damping="2"/>
      <inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body>
      <body><joint name="y" type="slide" axis="1 0 0" damping="3"/>
      <inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/></body></worldbody>
      <actuator><motor name="left" joint="x"/><motor name="right" joint="y"/></actuator>
      </mujoco>""",
)  # fmt: skip


def test_a_mode_that_neither_grows_nor_returns_is_stable_for_no_plant() -> None:
    """A gap is held, not a place: the characteristic polynomial has a factor s for any mass."""

    def gap(time, state, p):
        u = 30.0 * (state[1] - state[0]) + 8.0 * (state[3] - state[2])
        return u, -u

    for mass in np.linspace(0.5, 2.0, 16).tolist():
        scenario = afl.Scenario(name="s", plant=GAP, schedule={"mass": mass})
        loop = under_test.linearize(bound(as_controller(gap), scenario), scenario)
        assert not loop.stable and under_test.loop_margins(loop) is None
        assert under_test.loop_margins(loop, 1e-3) is None


HELD_ARM = """<mujoco><option integrator="RK4"/><worldbody><body>
<joint name="arm" axis="0 1 0" damping="0.02"/>
<inertial pos="0 0 -0.4" mass="1.5" diaginertia="0.08 0.08 0.01"/></body></worldbody>
<actuator><motor name="motor" joint="arm"/></actuator></mujoco>"""
NAMES = {"coordinates": ("arm",), "inputs": ("motor",), "upright": (math.pi / 2.0,)}
PLANT = afl.Plant(name="held-arm", model=HELD_ARM, **NAMES)
HARDWARE = {"control_period": 0.005, "delay": 0.003, "lag": 0.004}
SCENARIO = afl.Scenario(
    name="out", plant=PLANT, duration=2.0, imperfections=afl.Imperfections(**HARDWARE),
    requirements=afl.Requirements(max={"arm": 0.5}, bands={"arm": 0.05}),
)  # fmt: skip


def test_margins_hold_where_inputs_act_at_rest() -> None:
    lqr = afl.find_controller("lqr")
    (held,) = run(Request(SCENARIO, [lqr], {}, 0.005)).of("lqr", HELD)
    needed = 9.81 * 1.5 * 0.4  # at a quarter turn from hanging [N m]
    assert needed == pytest.approx(under_test.linearize(bound(lqr, SCENARIO), SCENARIO).held[0])
    for share, decays in ((0.97, True), (1.03, False)):
        late = replace(SCENARIO.imperfections, delay=HARDWARE["delay"] + share * held.delay)
        start = {"arm": math.pi / 2.0 + 1e-3}
        moved = replace(SCENARIO, initial_state=start, duration=6.0, imperfections=late)
        away = np.abs(afl.simulate_mujoco(moved, lqr).state[:, 0] - math.pi / 2.0)
        first, last = (part.max() for part in np.array_split(away, 3)[:3:2])
        assert bool(last < first) is decays
    # the LQR is the same whatever the hardware
    limited = replace(SCENARIO, imperfections=afl.Imperfections(input_limit=9.0))
    gains = [bound(afl.find_controller("lqr"), one).gains(()) for one in (SCENARIO, limited)]
    assert gains[0][1].tolist() == gains[1][1].tolist()
