"""A planar quadrotor that picks up a load and lets it down on a cable.

afl-mujoco check examples/quadrotor_load.py:plant
"""

from math import cos, sin

import afl_mujoco as afl

ARM = 0.2  # from the middle to each rotor [m]
RADIUS = 0.06  # of the load [m]


def write(p):
    """Return what the parameters are in the model."""
    inertia = (p.inertia, p.inertia, p.inertia)
    return {
        "body frame mass": p.mass / 2,
        "body quadrotor mass": p.mass / 2,
        "body quadrotor inertia": inertia,
        "body cable": afl.ball(mass=p.load, radius=RADIUS, center=(0.0, 0.0, -p.length)),
        "geom cable size 1": p.length / 2,
        "geom cable pos 2": -p.length / 2,
        "geom load pos 2": -p.length,
        "option gravity 2": -p.gravity,
    }


def terms(q, v, p):
    """Return M, h and B of ``M v' + h = B u``."""
    pitch, a = q[2], q[3]
    total, ml = p.mass + p.load, p.load * p.length
    M = (
        (total, 0.0, 0.0, ml * cos(a)),
        (0.0, total, 0.0, ml * sin(a)),
        (0.0, 0.0, p.inertia, 0.0),
        (ml * cos(a), ml * sin(a), 0.0, ml * p.length + 0.4 * p.load * RADIUS**2),
    )
    pull = ml * v[3] ** 2
    h = (-pull * sin(a), pull * cos(a) + total * p.gravity, 0.0, ml * p.gravity * sin(a))
    B = ((-sin(pitch), -sin(pitch)), (cos(pitch), cos(pitch)), (-ARM, ARM), (0.0, 0.0))
    return M, h, B


plant = afl.Plant(
    name="quadrotor-load",
    model="quadrotor_load.xml",
    coordinates=("x", "z", "pitch", "cable"),
    inputs=("left", "right"),
    parameters={
        "mass": afl.Parameter(1.0, "kg", low=0.8, high=1.2),
        "inertia": afl.Parameter(0.02, "kg m^2", low=0.01, high=0.03),
        "load": afl.Parameter(0.02, "kg", low=0.01, high=0.6, jump="momenta"),
        "length": afl.Parameter(0.5, "m", low=0.4, high=1.2, rate="enters"),
        "gravity": afl.Parameter(9.81, "m/s^2", low=9.7, high=9.9),
    },
    write=write,
    terms=terms,
    upright=(0.0, 0.0, 0.0, 0.0),
    signals={"load_height": lambda q, v, p: q[1] - p.length * cos(q[3])},
)
