"""The ledger of energy and momentum (A6): contributions of forces and of parameter changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.plant.energy import linear_momentum, total_energy
from afl_mujoco.scenario.parameters import CartPoleParameters, ParameterChange
from afl_mujoco.scenario.sampling import time_grid
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation.integrator import integrate, scipy_solver
from afl_mujoco.simulation.mujoco_model import CartPoleModel, forward, write_parameters
from afl_mujoco.simulation.mujoco_rollout import closed_loop, momenta, transition

SAMPLE_PERIOD = 0.1
"""Spacing of the instants at which the ledger is closed [s]."""

_WORK, _RAMP_ENERGY, _IMPULSE, _RAMP_MOMENTUM, _JUMP_ENERGY, _JUMP_MOMENTUM = range(4, 10)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ledger:
    """Energy and momentum of a run in MuJoCo, booked by the analytic equations.

    Attributes
    ----------
    scenario, controller
        What was simulated.
    work
        Work of all forces along z [J].
    energy_of_ramps, energy_of_jumps
        What the ramps and the steps of M and l add at fixed velocities [J].
    impulse
        Impulse of all forces along z [N s].
    momentum_of_ramps, momentum_of_jumps
        What the ramps and the steps add to the momentum along z [N s].
    energy_residual, momentum_residual
        The largest energy [J] and momentum [N s] over the run that MuJoCo gained and the ledger did
        not book.
    """

    scenario: str
    controller: str
    work: float
    energy_of_ramps: float
    energy_of_jumps: float
    impulse: float
    momentum_of_ramps: float
    momentum_of_jumps: float
    energy_residual: float
    momentum_residual: float


def ledger(
    scenario: Scenario, controller: Controller
) -> tuple[Ledger, dict[str, NDArray[np.float64]]]:
    """Run exact mode with the ledger beside it and close the ledger along the run.

    Work and impulse are those of the forces that MuJoCo applied; energy and momentum are MuJoCo's
    own; what a parameter change adds is booked by the analytic energy and momentum.

    Returns
    -------
    tuple
        The ledger, and that of energy over time [J]: ``time`` [s], ``gained`` (MuJoCo's own),
        ``work``, ``ramps``, ``jumps``, and the rest, ``residual``; shape (E,) each.
    """
    model = CartPoleModel(scenario.parameters_at(0.0), edit=_measure_energy)
    change = ParameterChange()
    rate = closed_loop(model, scenario, controller, change)
    arrive = transition(model, scenario, change)

    def derivative(time: float, state: NDArray[np.float64], segment: Segment) -> Sequence[float]:
        motion = rate(time, state, segment)
        force = float(model.mj_data.ctrl[0] + model.mj_data.qfrc_applied[0])
        energy, momentum = _ramp_power(scenario, state, time, segment)
        return (*motion, force * state[2], energy, force, momentum, 0.0, 0.0)

    def book(
        state: NDArray[np.float64], before: Segment | None, after: Segment
    ) -> NDArray[np.float64]:
        arrived = arrive(state, before, after)
        new = _parameters(scenario, after, after.start)
        was, now = state[:4], arrived[:4]
        if before is not None:
            old = _parameters(scenario, before, before.end)
            arrived[_JUMP_ENERGY] += total_energy(was, new) - total_energy(was, old)
            arrived[_JUMP_MOMENTUM] += linear_momentum(was, new) - linear_momentum(was, old)
        arrived[_WORK] += total_energy(now, new) - total_energy(was, new)
        arrived[_IMPULSE] += after.impulse
        return arrived

    times = time_grid(scenario, SAMPLE_PERIOD)
    solver = scipy_solver(derivative, controller=controller.name)
    nodes = controller.nodes(scenario.plants)
    states, _ = integrate(scenario, solver, book, times, nodes=nodes, quadratures=6)
    return _close(model, scenario, controller, times[: len(states)], states)


def _close(
    model: CartPoleModel,
    scenario: Scenario,
    controller: Controller,
    times: NDArray[np.float64],
    states: NDArray[np.float64],
) -> tuple[Ledger, dict[str, NDArray[np.float64]]]:
    """Compare the energy and momentum gained in MuJoCo with what was booked."""
    measured = np.array(
        [_measured(model, scenario, t, x) for t, x in zip(times.tolist(), states, strict=True)]
    )
    energy = states[:, [_WORK, _RAMP_ENERGY, _JUMP_ENERGY]].sum(axis=1)
    momentum = states[:, [_IMPULSE, _RAMP_MOMENTUM, _JUMP_MOMENTUM]].sum(axis=1)
    gained = measured - measured[0]
    last = states[-1].tolist()
    closed = Ledger(
        scenario=scenario.name,
        controller=controller.name,
        work=last[_WORK],
        energy_of_ramps=last[_RAMP_ENERGY],
        energy_of_jumps=last[_JUMP_ENERGY],
        impulse=last[_IMPULSE],
        momentum_of_ramps=last[_RAMP_MOMENTUM],
        momentum_of_jumps=last[_JUMP_MOMENTUM],
        energy_residual=float(np.abs(gained[:, 0] - energy).max()),
        momentum_residual=float(np.abs(gained[:, 1] - momentum).max()),
    )
    return closed, {
        "time": times,
        "gained": gained[:, 0],
        "work": states[:, _WORK],
        "ramps": states[:, _RAMP_ENERGY],
        "jumps": states[:, _JUMP_ENERGY],
        "residual": gained[:, 0] - energy,
    }


def _measured(
    model: CartPoleModel, scenario: Scenario, time: float, state: NDArray[np.float64]
) -> tuple[float, float]:
    """Return MuJoCo's own energy [J] and momentum along z [N s]."""
    p = scenario.parameters_at(time)
    at = model.addresses
    write_parameters(at, p.cart_mass, p.pole_mass, p.half_length, p.gravity)
    momentum = momenta(model, state[:4])
    forward(at, *state[:4].tolist(), 0.0, 0.0)
    return float(model.mj_data.energy.sum()), float(momentum[0])


def _ramp_power(
    scenario: Scenario, state: NDArray[np.float64], time: float, segment: Segment
) -> tuple[float, float]:
    """Return what the ramps add per second to energy [W] and momentum [N] at fixed velocities."""
    _, phi, z_dot, phi_dot = state[:4].tolist()
    _, length = segment.parameters_at(time)
    mass_rate, length_rate = segment.cart_mass[1], segment.half_length[1]
    m, cos = scenario.pole_mass, float(np.cos(phi))
    by_length = m * (
        4.0 / 3.0 * length * phi_dot**2 - z_dot * phi_dot * cos + scenario.gravity * cos
    )
    energy = 0.5 * z_dot**2 * mass_rate + by_length * length_rate
    return energy, z_dot * mass_rate - m * phi_dot * cos * length_rate


def _parameters(scenario: Scenario, segment: Segment, time: float) -> CartPoleParameters:
    """Return the plant at a time of a segment, the limit from inside it."""
    mass, length = segment.parameters_at(time)
    return CartPoleParameters(
        cart_mass=mass,
        pole_mass=scenario.pole_mass,
        half_length=length,
        gravity=scenario.gravity,
    )


def _measure_energy(spec: mujoco.MjSpec) -> None:
    """Make MuJoCo compute its energy."""
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
