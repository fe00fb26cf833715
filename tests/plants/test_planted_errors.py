"""Mistakes planted in the plants of the examples and in the paper's: all are found, most named."""

import shutil
import sys
from pathlib import Path

import pytest

import afl_mujoco as afl
from afl_mujoco.plants.plant import load_plant
from tests.plants.plants import EXAMPLES

CART, QUAD, TWO = "cart_double_pendulum.py", "quadrotor_load.py", "double_pendulum.py"
PAPER = "paper.py"  # accelerations, where no term stands by itself
SOURCE = """
from dataclasses import replace
from math import cos, sin
from afl_mujoco.plants.cartpole import CART_POLE
def accelerations(q, v, u, p):
    M, m, l, g = p.cart_mass, p.pole_mass, p.half_length, p.gravity
    s, c, u = sin(q[1]), cos(q[1]), u[0]
    k, w, d = m * l * v[1] ** 2 * s, m * g * s, 4 / 3 * (M + m) - m * c ** 2
    return (w * c + 4 / 3 * (u - k)) / d, ((M + m) * g * s + (u - k) * c) / (l * d)
plant = replace(CART_POLE, name="planted", accelerations=accelerations)
"""
RETURN = "return (w * c + 4 / 3 * (u - k)) / d, ((M + m) * g * s + (u - k) * c) / (l * d)"
SINGLE = (
    RETURN.replace("return ", "from numpy import array\n    return array([") + "]).astype('f4')"
)

# name: file, what becomes what, what the headline says ("" where it names nothing)
MISTAKES = {
    "inertia about the joint, in the MJCF": (TWO, "p.I1 - p.m1 * p.r1**2", "p.I1",
        "I - m r^2 of body upper"),
    "inertia about the joint, in the equations": (QUAD, "ml * p.length + 0.4 * p.load * RADIUS**2",
        "2 * ml * p.length + 0.4 * p.load * RADIUS**2", "I + m r^2 of body cable"),
    "inertia of the ball left out": (QUAD, " + 0.4 * p.load * RADIUS**2", "",
        "inertia of body cable is missing"),
    "inertia of a shell": (QUAD, "0.4 * p.load * RADIUS", "2 / 3 * p.load * RADIUS",
        "inertia of body cable is 1.66667 times"),
    "rod about its middle": (CART, "(m1 / 3 + m2 + m3) * r**2", "(m1 / 12 + m2 + m3) * r**2",
        "body lower"),
    "rod about its end 4/3": (CART, "(m2 / 3 + m3) * s**2", "(m2 / 3 * 4 / 3 + m3) * s**2",
        "body upper"),
    "centre of mass at the tip": (QUAD, "center=(0.0, 0.0, -p.length)",
        "center=(0.0, 0.0, -p.length / 2)", "centre of mass of body cable"),
    "centre of mass on the other side": (QUAD, "center=(0.0, 0.0, -p.length)",
        "center=(0.0, 0.0, p.length)", "centre of mass of body cable"),
    "half-length": (CART, "p.lower_length, p.upper_length\n",
        "2 * p.lower_length, p.upper_length\n", "0.5 lower_length"),
    "sign of gravity": (QUAD, '"option gravity 2": -p.gravity', '"option gravity 2": p.gravity',
        "gravity has the other sign"),
    "gravity missing on one body": (QUAD, "0.0, ml * p.gravity * sin(a))", "0.0, 0.0)",
        "gravity on cable is missing"),
    "sign of a gravity term": (CART, "- ms * p.gravity * sin(b)", "+ ms * p.gravity * sin(b)", ""),
    "standard gravity": (TWO, 'GRAVITY = VALUES["g"]', "GRAVITY = 9.80665",
        "gravity is 0.999659 times"),
    "centripetal term missing": (QUAD, "h = (-pull * sin(a), ", "h = (0.0, ",
        "cable_dot^2 on x is missing"),
    "centripetal term halved": (QUAD, "pull = ml * v[3] ** 2", "pull = ml * v[3] ** 2 / 2",
        "is halved"),
    "Coriolis term missing": (TWO, "-2 * k * s2 * v[0] * v[1] ", "0.0 ",
        "shoulder_dot elbow_dot is missing"),
    "Coriolis term halved": (TWO, "-2 * k * s2 * v[0] * v[1] ", "-k * s2 * v[0] * v[1] ",
        "shoulder_dot elbow_dot is halved"),
    "Coriolis term on the wrong side": (TWO, "k * s2 * v[0] ** 2", "-k * s2 * v[0] ** 2",
        "shoulder_dot^2 has the other sign"),
    "coupling of the mass matrix": (TWO, "p.I2 + k * c2\n", "p.I2\n", ""),
    "sign of the coupling": (QUAD, "(ml * cos(a), ml * sin(a), 0.0, ml",
        "(-ml * cos(a), ml * sin(a), 0.0, ml", "cable x has the other sign"),
    "cosine for sine": (QUAD, "0.0, ml * p.gravity * sin(a))", "0.0, ml * p.gravity * cos(a))",
        "gravity has sine and cosine of cable exchanged in the equations"),
    "cosine for sine of a Coriolis term": (TWO, "-2 * k * s2 * v[0] * v[1] ",
        "-2 * k * c2 * v[0] * v[1] ", "elbow_dot has sine and cosine of elbow exchanged"),
    "stale constant": (QUAD, "total, ml = p.mass + p.load", "total, ml = 1.0 + p.load",
        "stale constant: the equations have mass = 1 "),
    "grams": (QUAD, "p.load * p.length\n", "p.load / 1000 * p.length\n", ""),
    "degrees": (QUAD, "pitch, a = q[2], q[3]", "pitch, a = q[2] * 57.29577951308232, q[3]",
        "pitch is in degrees"),
    "sign of an input": (QUAD, "(-ARM, ARM)", "(ARM, -ARM)", "inputs left and right are exchanged"),
    "lever of an input": (QUAD, "(-ARM, ARM)", "(-ARM, 2 * ARM)",
        "input right on pitch is doubled"),
    "gear": (TWO, "((1.0, 0.0), (0.0, 1.0))", "((1.0, 0.0), (0.0, 6.0))",
        "gear of input elbow_torque is 6 times"),
    "damping left out": (CART, " + 0.1 * v[0]", "",
        "damping of cart is 0 in the equations and 0.1"),
    "damping in the wrong direction": (CART, " + 0.1 * v[0]", " - 0.1 * v[0]",
        "damping of cart is -0.1"),
    "angle from the other side": (TWO, "sin(q[0] + q[1])\n", "sin(q[0] - q[1])\n", ""),
    "absolute angle": (CART, "a, b = q[1], q[1] + q[2]", "a, b = q[1], q[2]",
        "upper of the equations is upper + lower of MuJoCo, not its rate: relative or absolute?"),
    "relative rate": (CART, "va, vb = v[1], v[1] + v[2]", "va, vb = v[1], v[2]",
        "upper of the equations is upper + lower of MuJoCo, of rates only: relative or absolute?"),
    "place that is not written": (CART, '        "body upper pos 2": p.lower_length,\n', "",
        "place of body upper goes with lower_length in the equations only: not written?"),
    "factor left out": (QUAD, "0.0, ml * p.gravity * sin(a))", "0.0, ml * sin(a))",
        "gravity on cable is without a factor gravity in the equations?"),
    "rate of the mass matrix left out": (TWO,
        "- k * s2 * v[1] ** 2 + (p.m1 * p.r1 + p.m2 * p.l1) * g * s1\n"
        "    h = (h1 + weight, k * s2 * v[0] ** 2 + weight)",
        "+ 2 * k * s2 * v[0] * v[1] + (p.m1 * p.r1 + p.m2 * p.l1) * g * s1\n"
        "    h = (h1 + weight, k * s2 * v[0] ** 2 + k * s2 * v[0] * v[1] + weight)",
        "the term M' v is missing in the equations?"),
    "mass of the payload twice": (CART, "afl.ball(mass=p.payload", "afl.ball(mass=2 * p.payload",
        "payload"),
    "two parameters exchanged": (CART, "m1, m2, m3, r, s = p.lower_mass, p.upper_mass",
        "m1, m2, m3, r, s = p.upper_mass, p.lower_mass", "lower_mass and upper_mass are exchanged"),
    "single precision": (PAPER, RETURN, SINGLE, "the equations are in single precision?"),
    "everything a tenth more": (PAPER, " / d, (", " / d * 1.1, 1.1 * (",
        "every acceleration is 1.1 times"),
    "nothing": (PAPER, RETURN, "return 0.0, 0.0",
        "every acceleration is missing in the equations?"),
    "sign of the centripetal term in z": (PAPER, "4 / 3 * (u - k)", "4 / 3 * (u + k)",
        "phi_dot^2 in the acceleration of z has the other sign"),
    "sign of the centripetal term in both": (PAPER, "k, w, d = m", "k, w, d = -m", "phi_dot^2"),
    "4/3 missing from D": (PAPER, "d = m * l * v[1] ** 2 * s, m * g * s, 4 / 3 *",
        "d = m * l * v[1] ** 2 * s, m * g * s, ", "which is not 1: the determinant?"),
    "gravity missing from z": (PAPER, "(w * c + ", "(0.0 * c + ",
        "gravity in the acceleration of z is missing"),
    "weight of the pole only": (PAPER, "(M + m) * g * s", "m * g * s", ""),
    "inertia of a point": (PAPER, "4 / 3 * (M + m) - ", "(M + m) - ",
        "which is not 1: the determinant?"),
    "force counted twice": (PAPER, "u[0]\n", "2 * u[0]\n", "gear of input force is doubled"),
    "stale mass": (PAPER, "p.cart_mass,", "1.0,",
        "stale constant: the equations have cart_mass = 1 "),
    "stale gravity": (PAPER, "p.gravity\n", "9.81\n",
        "stale constant: the equations have gravity = 9.81 "),
    "length for half the length": (PAPER, "p.half_length", "2.0 * p.half_length",
        "the length of body pole"),
    "angle from hanging down": (PAPER, "sin(q[1]), cos(q[1])", "-sin(q[1]), -cos(q[1])",
        "centre of mass of body pole"),
    "angle to the other side": (PAPER, "q[1]), u[0]", "q[1]), -u[0]",
        "gear of input force has the other sign"),
    "degrees in accelerations": (PAPER, "    s, c", "    q = 57.29577951308232 * q\n    s, c",
        "phi is in degrees"),
}  # fmt: skip

ABSOLUTE = (  # a cart and two links as if the angle of the second were from upright too
    ("    ca, cb, cab = ", "    a, b, va, vb = q[1], q[2], v[1], v[2]\n    ca, cb, cab = "),
    ("(ca + cb, rr + 2 * cab + ss, cab + ss)", "(ca, rr, cab)"),
    ("(total, ca + cb, cb)", "(total, ca, cb)"), ("(cb, cab + ss, ss)", "(cb, cab, ss)"),
    ("ha + hb, hb)", "ha, hb)"),
)  # fmt: skip
TURNED = [(f'name="{x}" axis="0 -1', f'name="{x}" axis="0 1') for x in ("lower", "upper")]


def found(folder: Path, file: str, *changes: tuple[str, str]) -> str:
    for one in EXAMPLES.glob("*"):
        if one.suffix in (".py", ".xml", ".yml"):
            shutil.copy(one, folder)
    (folder / PAPER).write_text(SOURCE)
    text = (folder / file).read_text()
    for old, new in changes:
        assert text.count(old) == 1, (file, old)
        text = text.replace(old, new)
    (folder / file).write_text(text)
    plant = file.replace(".xml", ".py")
    result = afl.check(load_plant(f"{plant}:plant", folder), samples=100)
    assert result.passed == (not changes)
    return result.headline


@pytest.fixture(autouse=True)
def own_modules(monkeypatch: pytest.MonkeyPatch, interpreted: None) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in (CART, QUAD, TWO, PAPER):
        monkeypatch.delitem(sys.modules, name.removesuffix(".py"), raising=False)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_found_and_named(mistake: str, tmp_path: Path) -> None:
    file, old, new, named = MISTAKES[mistake]
    headline = found(tmp_path, file, (old, new))
    if named:
        assert named in headline
    else:  # it says nothing rather than something wrong
        assert "equations and MJCF differ by up to" in headline


@pytest.mark.parametrize(("file", "changes", "named"), [
    (CART, ABSOLUTE, "upper of the equations is upper + lower of MuJoCo: relative or"),
    (CART.replace(".py", ".xml"), TURNED, "lower and upper have the other sign in the"),
], ids=["absolute", "turned"])  # fmt: skip
def test_other_coordinates_throughout_are_named(file, changes, named, tmp_path: Path) -> None:
    assert named in found(tmp_path, file, *changes)


def test_most_mistakes_have_a_name_as_have_those_of_the_published_model(tmp_path) -> None:
    assert "MuJoCo obeys the equations" in found(tmp_path, PAPER)
    assert len(MISTAKES) >= 54 and sum(bool(named) for *_, named in MISTAKES.values()) >= 46
    result = afl.check(f"{EXAMPLES / TWO}:published", samples=200)
    assert "inertia about another point" in result.headline
    assert "I - m r^2 of body upper" in result.headline
    assert "I - m r^2 of body lower" in result.headline and result.worst.term == "mass matrix"
