"""Your own controller in a few lines: steer the pole, and let its lean bring the cart home."""

from math import cos, sin


def force(time, state, belief):
    """Return the force on the cart [N], from time [s], state and assumed parameters."""
    z, phi, z_dot, phi_dot = state  # position [m], angle from upright [rad], and their rates
    mass, length = belief.cart_mass + belief.pole_mass, 4.0 / 3.0 * belief.half_length
    lean = -25.0 * phi - 10.0 * phi_dot  # the angular acceleration that uprights the pole ...
    home = (5.0 * z + 8.3 * z_dot) / (1.0 + length)  # ... and the one that leans it towards home
    return mass * (length * (lean + home) - belief.gravity * sin(phi)) / cos(phi)


class Integrating:
    """A stateful controller, made anew for each run: the same with an integral of z."""

    def __init__(self):
        self.sum, self.before = 0.0, 0.0

    def __call__(self, time, state, belief):
        """Return the force on the cart [N]."""
        self.sum, self.before = self.sum + (time - self.before) * state[0], time
        z = state[0] + 0.1 * self.sum
        return force(time, (z, *state[1:]), belief)
