"""Your own controller in ten lines: steer the pole, and let its lean bring the cart home."""

from math import cos, sin


def force(time, state, belief):
    """Return the force on the cart [N], from time [s], state and assumed parameters."""
    z, phi, z_dot, phi_dot = state  # position [m], angle from upright [rad], and their rates
    mass, length = belief.cart_mass + belief.pole_mass, 4.0 / 3.0 * belief.half_length
    lean = -25.0 * phi - 10.0 * phi_dot  # the angular acceleration that uprights the pole ...
    home = 3.0 * z + 5.0 * z_dot  # ... and the one that leans it towards home
    return mass * (length * (lean + home) - belief.gravity * sin(phi)) / cos(phi)
