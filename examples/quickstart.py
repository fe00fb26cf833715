"""Compare a controller of one's own with LQR and the paper's."""

import afl_mujoco as afl


def mine(time, state, belief):
    """Return the force on the cart [N]."""
    z, phi, z_dot, phi_dot = state  # as measured; phi = 0 is upright, > 0 leans towards -z
    total = belief.cart_mass + belief.pole_mass  # the parameters that the controller assumes
    return total * (3.3 * z + 6.5 * z_dot - 64.0 * phi - 29.0 * phi_dot)


result = afl.compare("examples/rig.toml", ["lqr", "adaptive", mine])
print(result)  # who meets which requirement, and how much of each is left
result.plot().savefig("renders/quickstart.png")
