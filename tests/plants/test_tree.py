"""The tree reference against SymPy's derivations, MuJoCo, and finite differences."""

import mujoco
import numpy as np
import pytest
import sympy as sp

import afl_mujoco as afl
from afl_mujoco.plants.plant import Plant
from afl_mujoco.plants.tree import Tree, terms_of
from afl_mujoco.plants.writer import PlantModel
from tests.plants.plants import known

SPATIAL = """<mujoco><compiler angle="radian"/><option gravity="0.3 -0.2 -9.7"/><worldbody>
<body name="base" pos=".1 .2 .3" quat=".8 .2 -.4 .4">
 <joint name="a" axis="1 2 3" pos=".1 -.2 .3" damping=".3" stiffness="2" springref=".4" ref=".2"/>
 <joint name="b" type="slide" axis="-1 .3 .5" pos=".1 .1 .1" armature=".2" ref="-.1"/>
 <inertial pos=".1 .05 -.2" quat=".9 .1 .3 -.2" mass="1.2" diaginertia=".05 .04 .03"/>
 <body name="fixed" pos=".2 .1 0" quat=".7 .7 0 .1">
  <inertial pos="0 .1 0" mass=".4" diaginertia=".01 .02 .015"/>
  <body name="arm" pos="0 .3 .1" quat="1 0 .5 0"><joint name="c" axis="0 1 0"/>
   <inertial pos="0 0 .3" quat="1 1 0 0" mass=".7" diaginertia=".02 .02 .01"/>
   <site name="jet" pos=".1 .2 .3" quat=".5 .5 .1 -.5"/></body></body>
 <body name="leaf" pos="-.2 0 .4"><joint name="d" axis=".2 .9 0" damping=".1"/>
  <inertial pos=".2 0 .1" mass=".3" diaginertia=".004 .005 .006"/></body>
</body></worldbody><actuator>
<motor name="torque" joint="c" gear="3"/><motor name="jet" site="jet" gear="1 2 3 .4 .5 .6"/>
</actuator></mujoco>"""


T = sp.Symbol("t")


def made(xml: str) -> PlantModel:
    names = {"coordinates": ("a", "b", "c", "d"), "inputs": ("torque", "jet")}
    return PlantModel(Plant(name="spatial", model=xml, **names), compared=True)


def test_terms_are_mujocos_in_any_frame_and_far_from_the_origin() -> None:
    model, rng = made(SPATIAL), np.random.default_rng(0)
    tree = Tree(**model.tree(np.empty(0)))
    for _ in range(100):
        q, v, u = rng.uniform(-3, 3, 4), rng.uniform(-5, 5, 4), rng.uniform(-5, 5, 2)
        engine, own = model.at(q, v, u), terms_of(tree, q, v)
        for its, mine in zip(engine[:3], own[:3], strict=True):
            np.testing.assert_allclose(mine, its, rtol=0, atol=1e-12 * np.abs(its).max())
    far = Tree(**made(SPATIAL.replace('pos=".1 .2 .3"', 'pos="1e4 .2 .3"', 1)).tree(np.empty(0)))
    for _ in range(10):
        q, v = rng.uniform(-3, 3, 4), rng.uniform(-5, 5, 4)
        here, there = terms_of(tree, q, v), terms_of(far, q, v)
        for one, other in zip(here[:3], there[:3], strict=True):
            np.testing.assert_allclose(other, one, rtol=0, atol=1e-10 * np.abs(one).max())
        lift = -tree.gravity[0] * tree.body_mass[1:].sum() * (1e4 - 0.1)
        assert there.energy - here.energy == pytest.approx([0.0, lift], abs=1e-8 * abs(lift))


def test_terms_follow_from_the_kinetic_and_potential_energy_of_mujocos_bodies() -> None:
    """M and h by finite differences of where MuJoCo puts bodies, so not by any recursion."""
    model = made(SPATIAL)
    m, d = model.mj_model, model.mj_data
    tree, rng = Tree(**model.tree(np.empty(0))), np.random.default_rng(1)
    q, v, eps = rng.uniform(-1, 1, 4), rng.uniform(-1, 1, 4), 1e-4

    def lagrangian(q: np.ndarray, v: np.ndarray) -> float:
        def places(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            d.qpos[:] = q
            mujoco.mj_kinematics(m, d)
            return d.xipos.copy(), d.ximat.reshape(-1, 3, 3).copy()

        (x, r), (y, s), (z, t) = places(q), places(q + eps * v), places(q - eps * v)
        speed, turn = (y - z) / (2 * eps), np.swapaxes(r, 1, 2) @ (s - t) / (2 * eps)
        spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        kinetic = 0.5 * (m.body_mass * (speed**2).sum(1) + (m.body_inertia * spin**2).sum(1))
        weight = m.body_mass @ (x @ m.opt.gravity)
        spring = 0.5 * np.sum(m.jnt_stiffness.reshape(4, -1)[:, 0] * (q - m.qpos_spring) ** 2)
        return float(kinetic.sum() + 0.5 * np.sum(m.dof_armature * v**2) + weight - spring)

    unit, step = np.eye(4), 1e-2
    first = [lagrangian(q + 1e-4 * e, v) - lagrangian(q - 1e-4 * e, v) for e in unit]

    def momentum(q: np.ndarray) -> np.ndarray:
        found = [lagrangian(q, v + step * e) - lagrangian(q, v - step * e) for e in unit]
        return np.array(found) / (2 * step)

    rate = (momentum(q + 1e-4 * v) - momentum(q - 1e-4 * v)) / 2e-4
    bias = rate - np.array(first) / 2e-4 + m.dof_damping * v
    np.testing.assert_allclose(terms_of(tree, q, v).bias, bias, rtol=0, atol=2e-5)
    alone, rest = [lagrangian(q, one) for one in unit], lagrangian(q, 0 * q)
    expected = [[lagrangian(q, one + other) for other in unit] for one in unit]
    expected = np.array(expected) - np.add.outer(alone, alone) + rest
    np.testing.assert_allclose(terms_of(tree, q, v).mass, expected, rtol=0, atol=1e-6)


def dynamic(names: str):
    return [sp.Function(name)(T) for name in names.split()]


def derived(kinetic, potential, q, work, u):
    """M and forcing of Lagrange's equations; work: generalised forces of inputs and damping."""
    v = [x.diff(T) for x in q]
    lagrangian = kinetic - potential
    whole, a = zip(q, v, work, strict=True), [x.diff(T, 2) for x in q]
    equations = sp.Matrix(
        [lagrangian.diff(w).diff(T) - lagrangian.diff(x) - f for x, w, f in whole]
    )
    return equations.jacobian(a), -equations.subs(dict.fromkeys(a, 0)), v


def cart_double_pendulum():
    z, a, b = q = dynamic("z a b")
    names = "f cart_mass lower_mass upper_mass lower_length upper_length payload gravity"
    f, *p = sp.symbols(names)
    mc, m1, m2, r, s, m3, g = p
    up, out = lambda d, t: d * sp.cos(t), lambda d, t: -d * sp.sin(t)
    points = {
        m1: (z + out(r / 2, a), up(r / 2, a)),
        m2: (z + out(r, a) + out(s / 2, a + b), up(r, a) + up(s / 2, a + b)),
        m3: (z + out(r, a) + out(s, a + b), up(r, a) + up(s, a + b)),
    }
    kinetic = mc * z.diff(T) ** 2 / 2
    kinetic += sum(m * (x.diff(T) ** 2 + y.diff(T) ** 2) / 2 for m, (x, y) in points.items())
    turn = (a + b).diff(T)
    spin = m1 * r**2 / 12 * a.diff(T) ** 2 + (m2 * s**2 / 12 + m3 * sp.Rational(1, 1000)) * turn**2
    potential = sum(m * g * y for m, (_, y) in points.items())
    return derived(kinetic + spin / 2, potential, q, [f - z.diff(T) / 10, 0, 0], [f]), q, [f], p


def quadrotor_load():
    x, z, pitch, a = q = dynamic("x z pitch a")
    left, right, *p = sp.symbols("left right mass inertia load length gravity")
    m, i, ml, r, g = p
    at = (x + r * sp.sin(a), z - r * sp.cos(a))
    kinetic = m * (x.diff(T) ** 2 + z.diff(T) ** 2) / 2 + i * pitch.diff(T) ** 2 / 2
    kinetic += ml * sum(c.diff(T) ** 2 for c in at) / 2
    kinetic += sp.Rational(2, 5) * ml * sp.Rational(36, 10**4) * a.diff(T) ** 2 / 2
    thrust, torque = left + right, (right - left) / 5
    work = [-sp.sin(pitch) * thrust, sp.cos(pitch) * thrust, torque, 0]
    return derived(kinetic, m * g * z + ml * g * at[1], q, work, [left, right]), q, [left, right], p


def furuta():
    arm, pole = q = dynamic("arm pole")
    u, *p = sp.symbols("u pole_mass pole_length")
    m, r = p
    radius, across, along = sp.Rational(1, 5), m * r**2 / 12, m * (r / 100) ** 2 / 2
    turn = sp.rot_axis3(-arm) * sp.rot_axis1(-pole)  # about z, then about the arm's own x
    at = sp.rot_axis3(-arm) * sp.Matrix([radius, 0, 0]) + turn * sp.Matrix([0, 0, r / 2])
    omega = turn.T * turn.diff(T)
    spin = sp.Matrix([omega[2, 1], omega[0, 2], omega[1, 0]])
    kinetic = m * at.diff(T).dot(at.diff(T)) / 2 + sp.Rational(1, 100) * arm.diff(T) ** 2 / 2
    kinetic += (across * (spin[0] ** 2 + spin[1] ** 2) + along * spin[2] ** 2) / 2
    work = [u, -pole.diff(T) / 1000]
    return derived(kinetic, m * sp.Rational(981, 100) * at[2], q, work, [u]), q, [u], p


FURUTA = """<mujoco><compiler angle="radian"/><worldbody><body name="arm">
<joint name="arm" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/>
<body name="pole" pos=".2 0 0"><joint name="pole" axis="1 0 0" damping=".001"/>
<inertial pos="0 0 .1" mass="1" diaginertia=".01 .01 .01"/></body></body></worldbody>
<actuator><motor name="u" joint="arm"/></actuator></mujoco>"""


ROTARY = Plant(
    name="furuta", model=FURUTA, coordinates=("arm", "pole"), inputs=("u",),
    parameters={"pole_mass": afl.Parameter(0.13, "kg", low=0.05, high=0.3),
                "pole_length": afl.Parameter(0.3, "m", low=0.2, high=0.5)},
    write=lambda p: {"body pole": afl.rod(mass=p.pole_mass, length=p.pole_length)},
)  # fmt: skip


@pytest.mark.parametrize("derivation", [cart_double_pendulum, quadrotor_load, furuta])
def test_the_tree_is_what_sympy_derives_from_the_lagrangian(derivation) -> None:
    plant = ROTARY if derivation is furuta else known(f"{derivation.__name__}.py:plant")
    (mass, forcing, v), q, u, p = derivation()
    terms = afl.from_sympy(mass, forcing, q, v, u, p)
    model, rng = PlantModel(plant, compared=True), np.random.default_rng(2)
    n, k = len(q), len(u)
    low, high = np.array([(x.low, x.high) for x in plant.parameters.values()]).T
    for _ in range(50):
        at, rate, values = rng.uniform(-3, 3, n), rng.uniform(-5, 5, n), rng.uniform(low, high)
        own = terms_of(Tree(**model.tree(model.rows(values)[0])), at, rate)
        given = zip(terms(at, rate, plant.named(values)), ((n, n), (n,), (n, k)), strict=True)
        for mine, its in zip(own[:3], [np.reshape(x, shape) for x, shape in given], strict=True):
            np.testing.assert_allclose(mine, its, rtol=0, atol=1e-12 * np.abs(its).max())
