"""Rates of parameters that act on the motion: against D9 by hand and a Lagrangian by SymPy."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import afl_mujoco as afl
from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole_equations import plant as cart_pole
from afl_mujoco.plants.tree import terms_of
from afl_mujoco.simulation.judgement import remarks_on
from afl_mujoco.simulation.mujoco_model import SimulatedModel, rate_forces
from afl_mujoco.simulation.simulate import MovingTrees

XML = """<mujoco><worldbody><body name="cart"><joint name="z" type="slide" axis="1 0 0"/>
    <inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
    <body name="upper"><joint name="phi" axis="0 1 0"/>
    <inertial pos="0 0 0.2" mass="0.7" diaginertia="0.1 0.1 0.1"/>
    <body name="lower" pos="0 0 0.4" euler="0 30 0"><joint name="psi" axis="0 1 0"/>
    <inertial pos="0.1 0 0.2" mass="0.3" diaginertia="0.1 0.1 0.1"/>
    <body pos="0 0 0.1"><inertial pos="0.05 0 0" mass="0.2" diaginertia="0.1 0.1 0.1"/></body>
    </body></body></body></worldbody>
    <actuator><motor name="force" joint="z"/></actuator></mujoco>"""


def write(p):
    """A strut whose own centre, inertia and what it carries move with the square of a length."""
    lower = {"pos 2": 2.0 * p.reach**2, "ipos": (0.1, 0.0, p.tip**2),
             "inertia": (p.tip, 0.5 * p.tip**3, p.tip)}  # fmt: skip
    return {"body upper": afl.rod(mass=0.7, length=p.reach, center=(0.0, 0.0, p.reach**2)),
            **{f"body lower {name}": value for name, value in lower.items()}}  # fmt: skip


STRUT = afl.Plant(
    name="strut", model=XML, coordinates=("z", "phi", "psi"), inputs=("force",), write=write,
    parameters={"reach": afl.Parameter(0.4, "m", low=0.2, high=0.8, rate="enters"),
                "tip": afl.Parameter(0.3, "m", low=0.2, high=0.8, rate="enters")},
)  # fmt: skip


@cache
def lagrangian():
    """Return f and N of ``M q'' + h + f + N p'' = B u``, functions of (q, v, p, p')."""
    t = sp.symbols("t")
    q = [sp.Function(name)(t) for name in ("z", "phi", "psi")]
    p = [sp.Function(name)(t) for name in ("reach", "tip")]
    z, phi, psi = q
    reach, tip = p
    turn = phi + sp.pi / 6 + psi

    def along(angle, x, height):
        turned = (x * sp.cos(angle) + height * sp.sin(angle), height * sp.cos(angle))
        return sp.Matrix([turned[0], turned[1] - x * sp.sin(angle)])

    base = sp.Matrix([z, 0])
    upper = base + along(phi, 0, reach**2)
    lower = base + along(phi, 0, 2 * reach**2) + along(turn, sp.Rational(1, 10), tip**2)
    half, m1, m2 = sp.Rational(1, 2), sp.Rational(7, 10), sp.Rational(3, 10)
    energy = half * 2 * z.diff(t) ** 2
    energy += half * m1 * upper.diff(t).dot(upper.diff(t))
    energy += half * m2 * lower.diff(t).dot(lower.diff(t))
    energy += half * m1 * reach**2 / 12 * phi.diff(t) ** 2
    energy += half * tip**3 / 2 * turn.diff(t) ** 2
    hand = base + along(phi, 0, 2 * reach**2) + along(turn, sp.Rational(1, 20), sp.Rational(1, 10))
    energy += half / 5 * hand.diff(t).dot(hand.diff(t)) + half / 10 * turn.diff(t) ** 2
    whole = [energy.diff(x.diff(t)).diff(t) - energy.diff(x) for x in q]
    symbols = [sp.symbols(x) for x in "a0:3 s0:2 v0:3 r0:2 q0:3 p0:2".split()]
    a0, s0, v0, r0, q0, p0 = symbols
    found = [x.diff(t, n) for n in (2, 1, 0) for x in (*q, *p)]
    names = [*zip(found, [x for some in symbols for x in some], strict=True)]
    whole = sp.Matrix([x.doit().subs(names) for x in whole])
    force = whole.subs(dict.fromkeys([*s0, *a0], 0))
    force -= force.subs(dict.fromkeys(r0, 0))
    given = (q0, v0, p0, r0)
    return sp.lambdify(given, force), sp.lambdify(given, whole.jacobian(s0))


def test_the_forces_of_rates_are_those_of_the_lagrangian_in_mujoco_and_in_the_tree() -> None:
    rng, model, trees = np.random.default_rng(0), SimulatedModel(STRUT), MovingTrees(STRUT)
    force, along = lagrangian()
    for _ in range(20):
        q, v, r = rng.uniform(-3, 3, 3), rng.uniform(-4, 4, 3), rng.uniform(-1, 1, 2)
        p = rng.uniform(0.2, 0.8, 2)
        expected = np.array(force(q, v, p, r), float)[:, 0]
        still, moving = trees.at(p, r)
        own = terms_of(moving, q, v).bias - terms_of(still, q, v).bias
        np.testing.assert_allclose(own, expected, rtol=1e-10, atol=1e-10)
        model.write(p)
        drift, found = model.writer.drift(p[None], r[None])[0], np.empty(3)
        rate_forces(model.addresses, drift.ravel(), np.concatenate([q, v]), False, found)
        np.testing.assert_allclose(-found, expected, rtol=1e-10, atol=1e-10)
        rate_forces(model.addresses, drift.ravel(), np.concatenate([q, 0.0 * v]), True, found)
        momenta = np.array(along(q, v, p, r), float) @ r
        np.testing.assert_allclose(-found, momenta, rtol=1e-10, atol=1e-10)


def entering(name: str) -> afl.Plant:
    own = replace(cart_pole.parameters[name], rate="enters")
    return replace(cart_pole, name="own", parameters={**cart_pole.parameters, name: own})


COURSE = {
    "cart_mass": afl.piecewise_linear([0.3, 0.9], [2.0, 1.5]),
    "half_length": afl.piecewise_linear([0.3, 1.1, 1.5, 1.9], [0.4, 0.9, 0.9, 0.5]),
}
START = {"phi": 0.3, "phi_dot": 0.5}


def off(*_):
    return 0.0


def hold(time, state, belief):
    return float(np.dot((11.0, -187.0, 22.0, -56.5), state))


def scenario(plant: afl.Plant) -> afl.Scenario:
    return afl.Scenario(name="s", plant=plant, duration=2.5, initial_state=START, schedule=COURSE)


def by_d9() -> np.ndarray:
    """Return the states at each millisecond by the equations of D9, restarted at every kink."""
    knots = np.array([0.0, 0.3, 0.9, 1.1, 1.5, 1.9, 2.5])
    masses, lengths = np.interp(knots, [0.3, 0.9], [2.0, 1.5]), COURSE["half_length"](knots)
    rates, m, g = np.diff(lengths) / np.diff(knots), 0.05, 9.81
    grid = np.arange(2501) / 1000

    def inertia(phi, mass, length):
        coupling = -m * length * np.cos(phi)
        return np.array([[mass + m, coupling], [coupling, 4 / 3 * m * length**2]])

    def rate(t, x, k):
        mass, length = np.interp(t, knots, masses), lengths[k] + rates[k] * (t - knots[k])
        _, phi, _, phi_dot = x
        sine, cosine = np.sin(phi), np.cos(phi)
        cart = hold(t, x, None) + m * (2 * rates[k] * phi_dot * cosine)
        pole = m * g * length * sine - 8 / 3 * m * length * rates[k] * phi_dot
        right = np.array([cart - m * length * sine * phi_dot**2, pole])
        return [*x[2:], *np.linalg.solve(inertia(phi, mass, length), right)]

    found, x = [], np.array([0.0, START["phi"], 0.0, START["phi_dot"]])
    for k, (start, end) in enumerate(pairwise(knots)):
        kink = rates[k] - (rates[k - 1] if k else rates[0])
        hit = np.array([m * np.sin(x[1]) * kink, 0.0])  # the impulse of l'' on the cart
        x[2:] += np.linalg.solve(inertia(x[1], masses[k], lengths[k]), hit)
        inside = grid[(grid >= start) & (grid < end)]
        run = solve_ivp(rate, (start, end), x, "DOP853", [*inside, end], args=(k,),
                        rtol=1e-12, atol=1e-13)  # fmt: skip
        found.append(run.y[:, :-1].T)
        x = run.y[:, -1].copy()
    return np.concatenate([*found, x[None]])


def test_a_rod_that_stretches_moves_as_d9_says() -> None:
    expected, own = by_d9(), scenario(entering("half_length"))
    assert np.abs(expected - afl.simulate_ode(scenario(cart_pole), hold).state).max() > 0.1
    np.testing.assert_allclose(afl.simulate_ode(own, hold).state, expected, atol=1e-10)
    for mode, away in (("exact", 1e-9), ("continuous", 1e-7)):
        run = afl.simulate_mujoco(own, hold, mode=mode)
        np.testing.assert_allclose(run.state, expected, atol=away)


def test_as_deployed_the_error_falls_with_the_square_of_the_step_kinks_included() -> None:
    kinked = afl.piecewise_linear([0.1, 0.5, 0.6], [0.4, 0.6, 0.5])
    lengths = dict.fromkeys(STRUT.parameters, kinked)
    start = {"phi": 0.3, "psi": -0.2, "psi_dot": 1.0}
    own = afl.Scenario(name="s", plant=STRUT, duration=1.0, schedule=lengths, initial_state=start)
    exact = afl.simulate_mujoco(own, off, mode="exact").state[-1]
    runs = [afl.simulate_mujoco(own, off, timestep=h) for h in (2e-3, 1e-3, 5e-4)]
    errors = [np.abs(run.state[-1] - exact).max() for run in runs]
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, atol=0.2)


def test_environments_step_as_the_run_does_and_a_mass_has_no_rate() -> None:
    own = scenario(entering("half_length"))
    run = afl.simulate_mujoco(own, hold, control_period=0.01)
    env = afl.load(own, control_period=0.01)
    step = env.reset()
    for k in range(120):
        np.testing.assert_array_equal(env.physics.world.state, run.state[10 * k])
        step = env.step(np.array([hold(0.0, run.state[10 * k], None)]))
    assert step.reward is not None
    with pytest.raises(InvalidValueError, match="rate of a parameter must not enter here"):
        afl.simulate_ode_rk4(own, hold)
    with pytest.raises(InvalidValueError, match="body cart mass must not change with a parameter"):
        afl.simulate_mujoco(scenario(entering("cart_mass")), hold)


CRANE = afl.Plant(
    name="crane",
    model="""<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
        <inertial pos="0 0 0" mass="20" diaginertia="1 1 1"/>
        <body name="load"><joint name="swing" axis="0 -1 0"/>
        <inertial pos="0 0 -2" mass="3" diaginertia="1e-6 1e-6 1e-6"/></body></body></worldbody>
        <actuator><motor name="drive" joint="x"/></actuator></mujoco>""",
    coordinates=("x", "swing"), inputs=("drive",),
    write=lambda p: {"body load ipos 2": -p.length, "body load mass": p.load},
    parameters={"load": afl.Parameter(3.0, "kg", low=0.0, high=2e3, jump="momenta"),
                "length": afl.Parameter(2.0, "m", low=0.1, high=5.0, rate="enters")},
    terms=lambda q, v, p: (
        ((20.0 + p.load, p.load * p.length * np.cos(q[1])),
         (p.load * p.length * np.cos(q[1]), p.load * p.length**2 + 1e-6)),
        (-p.load * p.length * np.sin(q[1]) * v[1] ** 2, 9.81 * p.load * p.length * np.sin(q[1])),
        ((1.0,), (0.0,)),
    ),
)  # fmt: skip


def crane(load) -> afl.Scenario:
    hoist = {"load": load, "length": afl.piecewise_linear([0.2, 0.8, 1.0], [2.0, 1.4, 1.5])}
    what = {"schedule": hoist, "initial_state": {"swing": 0.5, "swing_dot": 0.4}}
    return afl.Scenario(name="hoist", plant=CRANE, duration=1.2, **what)


@pytest.mark.parametrize("at", [0.5, 0.8])
def test_a_load_that_joins_at_rest_keeps_the_momenta_of_a_cable_that_is_reeled_in(at) -> None:
    scenario = crane(afl.staircase([at], [3.0, 8.0]))
    exact = afl.simulate_mujoco(scenario, off, mode="exact", timestep=1e-3)

    def momenta(k: int, load: float, rate: float) -> np.ndarray:
        (_, swing, x_dot, swing_dot), length = exact.state[k], exact.parameters["length"][k]
        along = length * swing_dot + x_dot * np.cos(swing)
        across = length * np.cos(swing) * swing_dot + rate * np.sin(swing)
        return np.array([20.0 * x_dot + load * (x_dot + across), load * length * along])

    k = round(at * 1e3)
    after, before = momenta(k, 8.0, -1.0 if at < 0.8 else 0.5), momenta(k - 1, 3.0, -1.0)
    np.testing.assert_allclose(after, before, atol=0.05)
    assert 5.0 * abs(np.sin(exact.state[k, 1])) > 0.5  # what the rate carries of a load that joins
    ode = afl.simulate_ode(scenario, off, sample_period=1e-3)
    np.testing.assert_allclose(ode.state, exact.state, atol=1e-9)
    runs = [afl.simulate_mujoco(scenario, off, timestep=h) for h in (1e-3, 5e-4)]
    coarse, fine = (np.abs(run.state[-1] - ode.state[-1]).max() for run in runs)
    assert fine < 0.3 * coarse < 1e-4


def test_a_heavy_load_is_hoisted_like_a_light_one_and_a_jump_is_remarked_on() -> None:
    scenario = crane(1234.5)
    exact = afl.simulate_mujoco(scenario, off, mode="exact", timestep=1e-3)
    ode = afl.simulate_ode(scenario, off, sample_period=1e-3)
    np.testing.assert_allclose(ode.state, exact.state, rtol=1e-8, atol=1e-8)
    jump = afl.staircase([0.5], [2.0, 2.5])
    own = afl.Scenario(name="jump", plant=CRANE, duration=1.0, schedule={"length": jump})
    (remark, *_) = remarks_on(afl.simulate_mujoco(own, off), own, as_controller(off))
    assert remark.startswith("length jumps at 0.5 s, which only a ramp can make do work")


def test_a_kink_along_a_ramp_is_refused_unless_only_the_drawing_has_it() -> None:
    def run(kinked) -> afl.Trajectory:
        def write(p):
            return {**cart_pole.write(p), kinked: 0.1 + abs(p.half_length - 0.6)}

        own = scenario(replace(cart_pole, name="kinked", write=write))
        return afl.simulate_mujoco(own, hold, mode="exact")

    assert run("geom pole size 0").outcome.kind == "completed"
    with pytest.raises(InvalidValueError, match="must be smooth in the parameters along a ramp"):
        run("body pole pos 0")


@pytest.mark.parametrize("gear", [1.02, 1.1, 1.9])
def test_two_parameters_that_move_a_load_together_keep_its_angular_momentum(gear) -> None:
    xml = """<mujoco><worldbody><body name="arm"><joint name="arm" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body name="load" pos="0.2 0 0">
      <inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body></body></worldbody></mujoco>"""
    ends = {"turn": 2.0, "gear": gear}
    what = {"write": lambda p: {"body load pos 0": 0.2 * p.turn * p.gear},
            "parameters": dict.fromkeys(ends, afl.Parameter(1.0, rate="enters"))}  # fmt: skip
    plant = afl.Plant(name="reel", model=xml, coordinates=("arm",), **what)
    ramps = {x: afl.piecewise_linear([0.0, 1.0], [1.0, end]) for x, end in ends.items()}
    what = {"schedule": ramps, "initial_state": {"arm_dot": 1.0}}
    scenario = afl.Scenario(name="reel", plant=plant, duration=1.0, **what)
    expected = (1.1 + 0.2**2) / (1.1 + (0.2 * 2.0 * gear) ** 2)
    for mode, away in (("exact", 1e-9), ("continuous", 1e-9), ("sampled", 1e-5)):
        run = afl.simulate_mujoco(scenario, lambda *_: (), mode=mode)
        assert run.state[-1, 1] == pytest.approx(expected, rel=away)
