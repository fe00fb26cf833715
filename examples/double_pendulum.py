"""A published double pendulum, and the mistake in the model files that were shipped with it.

The identified parameters of double_pendulum.yml are those of the leaderboards of
dfki-ric-underactuated-lab/double_pendulum (commit 1e8544e, BSD-3: double_pendulum.LICENSE). Its
equations take the inertias I1 and I2 about the joint. The model files beside them put the same
numbers at the centres of mass, which changes accelerations by more than half.

    afl-mujoco check examples/double_pendulum.py:plant      # I - m r^2 at the centre of mass: holds
    afl-mujoco check examples/double_pendulum.py:published  # as it was shipped: does not

Left out are friction, damping and the rotors of the motors.
"""

from math import cos, sin
from pathlib import Path

import afl_mujoco as afl

FILE = Path(__file__).with_name("double_pendulum.yml")
VALUES = {k: float(x) for k, x in (line.split(":") for line in FILE.read_text().splitlines())}
GRAVITY = VALUES["g"]
UNITS = {"m1": "kg", "m2": "kg", "l1": "m", "r1": "m", "r2": "m", "I1": "kg m^2", "I2": "kg m^2"}


def link(name, mass, r, inertia):
    """Return a link whose inertia is about its centre of mass, at r below the joint."""
    return {
        f"body {name} mass": mass,
        f"body {name} ipos 2": -r,
        f"body {name} inertia": (inertia, inertia, 0.1 * inertia),
    }


def write(p):
    """Return what the parameters are in the model."""
    return {
        **link("upper", p.m1, p.r1, p.I1 - p.m1 * p.r1**2),
        **link("lower", p.m2, p.r2, p.I2 - p.m2 * p.r2**2),
        "body lower pos 2": -p.l1,
    }


def write_as_published(p):
    """Return the same with the inertias about the joints."""
    lower, upper = link("lower", p.m2, p.r2, p.I2), link("upper", p.m1, p.r1, p.I1)
    return {**upper, **lower, "body lower pos 2": -p.l1}


def terms(q, v, p):
    """Return M, h and B of ``M v' + h = B u``."""
    g, s1, s2, c2, s12 = GRAVITY, sin(q[0]), sin(q[1]), cos(q[1]), sin(q[0] + q[1])
    k = p.m2 * p.l1 * p.r2
    m11, m12 = p.I1 + p.I2 + p.m2 * p.l1**2 + 2 * k * c2, p.I2 + k * c2
    weight = p.m2 * g * p.r2 * s12
    h1 = -2 * k * s2 * v[0] * v[1] - k * s2 * v[1] ** 2 + (p.m1 * p.r1 + p.m2 * p.l1) * g * s1
    h = (h1 + weight, k * s2 * v[0] ** 2 + weight)
    return ((m11, m12), (m12, p.I2)), h, ((1.0, 0.0), (0.0, 1.0))


def made(name, write):
    """Return the plant with one of the two."""
    return afl.Plant(
        name=name,
        model="double_pendulum.xml",
        coordinates=("shoulder", "elbow"),
        inputs=("shoulder_torque", "elbow_torque"),
        parameters={
            key: afl.Parameter(VALUES[key], unit, low=0.98 * VALUES[key], high=1.02 * VALUES[key])
            for key, unit in UNITS.items()
        },
        write=write,
        terms=terms,
        upright=(3.141592653589793, 0.0),
        wraps=("shoulder", "elbow"),
    )


plant = made("double-pendulum", write)
published = made("double-pendulum-as-published", write_as_published)
