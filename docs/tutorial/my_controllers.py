"""Two controllers for the cart-pole of my_rig.toml."""

from math import cos, sin


def mine(time, state, belief):
    """Return the force on the cart [N]."""
    z, phi, z_dot, phi_dot = state
    mass = belief.cart_mass + belief.pole_mass
    length = 4.0 / 3.0 * belief.half_length  # of the simple pendulum that swings like the rod
    lean = -25.0 * phi - 10.0 * phi_dot  # the angular acceleration that raises the pole
    # and one that leans it towards z = 0, gently where the pole is long
    home = (5.0 * z + 8.3 * z_dot) / (1.0 + length)
    return mass * (length * (lean + home) - belief.gravity * sin(phi)) / cos(phi)


class Filtered:
    """The same with a filter on the rates."""

    def __init__(self):
        self.rates = [0.0, 0.0]

    def __call__(self, time, state, belief):
        """Return the force on the cart [N]."""
        z, phi, *rates = state
        pairs = zip(self.rates, rates, strict=True)
        self.rates = [old + 0.25 * (new - old) for old, new in pairs]
        return mine(time, (z, phi, *self.rates), belief)
