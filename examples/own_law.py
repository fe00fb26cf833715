"""A law of one's own: balance the pole by a torque-like push, and pull the cart home."""

from math import cos, sin


def law(time, state, belief):
    """Return the force [N] on the cart; belief has cart_mass, pole_mass, half_length, gravity."""
    z, phi, z_dot, phi_dot = state  # m, rad, m/s, rad/s
    wanted = -10.0 * phi - 5.0 * phi_dot - 1.0 * z - 1.5 * z_dot
    return wanted
