"""The analytic reference: (P3), (P4) under the law, integrated to tight tolerance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.control.controllers import Controller, scheduled_force
from afl_mujoco.errors import UnknownNameError
from afl_mujoco.plant.dynamics import cart_acceleration, pole_acceleration, velocity_jump
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.sampling import time_grid
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.integrator import ATOL, METHODS, RTOL, Derivative, Strike, integrate
from afl_mujoco.simulation.trajectory import Trajectory, assemble, law_along

SAMPLE_PERIOD = 1e-3
"""Spacing of the reported instants [s]."""


def simulate_ode(
    scenario: Scenario,
    controller: Controller,
    *,
    sample_period: float = SAMPLE_PERIOD,
    method: str = "DOP853",
    rtol: float = RTOL,
    atol: float = ATOL,
) -> Trajectory:
    """Simulate the paper's ideal equations, restarted at every breakpoint.

    Parameters
    ----------
    scenario
        What happens.
    controller
        What is commanded, continuously in time.
    sample_period
        Spacing of the reported instants [s]; breakpoints are reported as well.
    method, rtol, atol
        Method and tolerances of `scipy.integrate.solve_ivp`.

    Returns
    -------
    Trajectory
        The run; one in which the pole falls ends there, with the outcome recorded.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    if method not in METHODS:
        raise UnknownNameError.among("method", method, METHODS)
    times = time_grid(scenario, sample_period)
    law_along(scenario, controller, times)  # raises before the run if a gain is not positive
    states, outcome = integrate(
        scenario,
        closed_loop(scenario, controller),
        _strike(scenario),
        times,
        method=method,
        rtol=rtol,
        atol=atol,
    )
    settings = {"method": method, "rtol": rtol, "atol": atol, "sample_period": sample_period}
    return assemble(scenario, controller, "ode", settings, times, states, outcome)


@kernel
def _derivative(state, cart_mass, pole_mass, half_length, gravity, push, believed, w):
    """Return (z_dot, phi_dot, z'', phi'') under the law; NaN where the law has no value."""
    z, phi, z_dot, phi_dot = state[0], state[1], state[2], state[3]
    force = push + scheduled_force(z, phi, z_dot, phi_dot, believed, w)
    return (
        z_dot,
        phi_dot,
        cart_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity),
        pole_acceleration(phi, phi_dot, force, cart_mass, pole_mass, half_length, gravity),
    )


def closed_loop(scenario: Scenario, controller: Controller) -> Derivative:
    """Return the right-hand side of the closed loop of plant and law.

    Parameters
    ----------
    scenario
        Gives m and g.
    controller
        The law.
    """
    pole_mass, gravity = scenario.pole_mass, scenario.gravity
    coefficients = controller.gain_function.coefficients

    def derivative(
        state: NDArray[np.float64], cart_mass: float, half_length: float, push: float
    ) -> tuple[float, ...]:
        believed = controller.believed(cart_mass, pole_mass, half_length, gravity)
        result: tuple[float, ...] = _derivative(
            state, cart_mass, pole_mass, half_length, gravity, push, believed, coefficients
        )
        return result

    return derivative


def _strike(scenario: Scenario) -> Strike:
    """Return the velocity jump under an ideal impulse, from the mass matrix."""

    def strike(
        state: NDArray[np.float64], cart_mass: float, half_length: float, impulse: float
    ) -> NDArray[np.float64]:
        p = CartPoleParameters(
            cart_mass=cart_mass,
            pole_mass=scenario.pole_mass,
            half_length=half_length,
            gravity=scenario.gravity,
        )
        return velocity_jump(state, impulse, p)

    return strike
