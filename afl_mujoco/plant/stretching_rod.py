"""The equations of motion of a rod that stretches at a prescribed rate (decision D9).

The paper freezes M and l in (P1) and (P2) at each instant. With the rate l' of the half-length,
uniform stretch, they are

    (M+m) z'' - m l phi'' c + m l s phi'^2 = F + m (2 l' phi' c + l'' s)
    (4/3) m l^2 phi'' - m l c z'' - m g l s = -(8/3) m l l' phi'

with c, s = cos(phi), sin(phi). Here l is piecewise linear: between breakpoints l'' = 0, and a kink
of l gives the cart the impulse m s (change of l').
"""

from __future__ import annotations

import numpy as np

from afl_mujoco.compiled import jitable
from afl_mujoco.plant.dynamics import determinant


@jitable
def stretching_accelerations(
    phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity, half_length_rate
):
    """Return (z'', phi''), the solution of the equations above.

    phi, phi_dot: Pole angle [rad] and its rate [rad/s].
    force: Force on the cart [N].
    cart_mass, pole_mass, half_length, gravity: M, m [kg], l [m], g [m/s^2].
    half_length_rate: l' [m/s].
    """
    sin, cos = np.sin(phi), np.cos(phi)
    d = determinant(phi, cart_mass, pole_mass)
    cart = force + pole_mass * phi_dot * (
        2.0 * half_length_rate * cos - half_length * phi_dot * sin
    )
    pole = pole_mass * (gravity * sin - 8.0 / 3.0 * half_length_rate * phi_dot)
    z_ddot = (4.0 / 3.0 * cart + cos * pole) / d
    phi_ddot = ((cart_mass + pole_mass) * pole / pole_mass + cos * cart) / (half_length * d)
    return z_ddot, phi_ddot
