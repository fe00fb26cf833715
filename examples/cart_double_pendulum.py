"""A double pendulum on a cart: the lower link stretches, and a payload is put on the upper one.

afl-mujoco check examples/cart_double_pendulum.py:plant
"""

from math import cos, sin

import afl_mujoco as afl

RADIUS = 0.05  # of the payload [m]


def write(p):
    """Return what the parameters are in the model."""
    return {
        "body cart mass": p.cart_mass,
        "body lower": afl.rod(mass=p.lower_mass, length=p.lower_length),
        "geom lower size 1": p.lower_length / 2,
        "geom lower pos 2": p.lower_length / 2,
        "body upper": afl.rod(mass=p.upper_mass, length=p.upper_length),
        "body upper pos 2": p.lower_length,
        "geom upper size 1": p.upper_length / 2,
        "geom upper pos 2": p.upper_length / 2,
        "body payload": afl.ball(mass=p.payload, radius=RADIUS),
        "body payload pos 2": p.upper_length,
        "option gravity 2": -p.gravity,
    }


def terms(q, v, p):
    """Return M, h and B of ``M v' + h = B u``."""
    a, b = q[1], q[1] + q[2]  # both from upright
    va, vb = v[1], v[1] + v[2]
    # Point masses at r along the lower link, then s along the upper: sums of m, m r, m s, ...
    m1, m2, m3, r, s = p.lower_mass, p.upper_mass, p.payload, p.lower_length, p.upper_length
    total = p.cart_mass + m1 + m2 + m3
    mr, ms = (m1 / 2 + m2 + m3) * r, (m2 / 2 + m3) * s
    rr = (m1 / 3 + m2 + m3) * r**2
    ss = (m2 / 3 + m3) * s**2 + 0.4 * m3 * RADIUS**2
    rs = (m2 / 2 + m3) * r * s
    # in cart, a and b, then in b - a
    ca, cb, cab = -mr * cos(a), -ms * cos(b), rs * cos(a - b)
    M = ((total, ca + cb, cb), (ca + cb, rr + 2 * cab + ss, cab + ss), (cb, cab + ss, ss))
    ha = rs * sin(a - b) * vb**2 - mr * p.gravity * sin(a)
    hb = -rs * sin(a - b) * va**2 - ms * p.gravity * sin(b)
    h = (mr * sin(a) * va**2 + ms * sin(b) * vb**2 + 0.1 * v[0], ha + hb, hb)
    return M, h, ((1.0,), (0.0,), (0.0,))


plant = afl.Plant(
    name="cart-double-pendulum",
    model="cart_double_pendulum.xml",
    coordinates=("cart", "lower", "upper"),
    inputs=("force",),
    parameters={
        "cart_mass": afl.Parameter(1.0, "kg", low=0.5, high=2.0),
        "lower_mass": afl.Parameter(0.2, "kg", low=0.1, high=0.4),
        "upper_mass": afl.Parameter(0.15, "kg", low=0.1, high=0.3),
        "lower_length": afl.Parameter(0.4, "m", low=0.3, high=0.7, rate="enters"),
        "upper_length": afl.Parameter(0.5, "m", low=0.3, high=0.7),
        "payload": afl.Parameter(0.05, "kg", low=0.01, high=0.3, jump="momenta"),
        "gravity": afl.Parameter(9.81, "m/s^2", low=9.7, high=9.9),
    },
    write=write,
    terms=terms,
    upright=(0.0, 0.0, 0.0),
    wraps=("lower", "upper"),
)
