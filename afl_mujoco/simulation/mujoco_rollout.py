"""The closed loop in MuJoCo: exact, continuous and sampled mode."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from afl_mujoco.control.catalogue import as_controller, require_stateless
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.parameter_change import QUASI_STATIC, VELOCITIES, ParameterChange
from afl_mujoco.scenario.sampling import steps, time_grid
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.simulation.integrator import ATOL, RTOL, integrate
from afl_mujoco.simulation.mujoco_dynamics import integrate_segment_rk4, solver, transition
from afl_mujoco.simulation.mujoco_model import CartPoleModel
from afl_mujoco.simulation.sampled.runs import simulate_sampled, ticks_of
from afl_mujoco.simulation.trajectory import (
    COMPLETED,
    OUTCOMES,
    Outcome,
    Trajectory,
    assemble,
    controller_inputs,
)

if TYPE_CHECKING:
    import mujoco

MODES = ("exact", "continuous", "sampled")


def simulate_mujoco(
    scenario: Scenario | str | Path,
    controller: Any,
    mode: str = "sampled",
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    dynamics: str = QUASI_STATIC,
    jumps: str = VELOCITIES,
    edit: Callable[[mujoco.MjSpec], None] | None = None,
) -> Trajectory:
    """Simulate the MuJoCo cart-pole under the controller, its parameters changed while it runs.

    Parameters
    ----------
    scenario
        What happens: a scenario, a name of the catalogue, or the path of a file.
    controller
        The controller: a name, ``module:attribute``, a function, a class or factory, or a
        `Controller`.
    mode
        ``"sampled"``: as deployed, `mj_step` with the control held for `control_period`, the
        parameters of the middle of each step, and the scenario's imperfections, which no other mode
        supports; ``"exact"``: MuJoCo's forward dynamics with the integrator of `simulate_ode`;
        ``"continuous"``: RK4 around MuJoCo's forward dynamics, controller and parameters in every
        stage, steps that end on every breakpoint.
    timestep
        Physics step [s], in exact mode the spacing of the reported instants; by default the longest
        up to 1 ms that divides the control period. Where the damping of a joint is too fast for
        RK4, sampled mode takes a finer one, which the provenance and a remark say.
    control_period
        How long sampled mode holds the force [s], a multiple of `timestep` (default: that of the
        scenario's imperfections, else one step).
    integrator
        MuJoCo's integrator in sampled mode: ``"RK4"``, ``"Euler"``, ``"implicit"`` or
        ``"implicitfast"``.
    edit
        Called with the `mujoco.MjSpec` before it is compiled, to add what the paper leaves out.
    dynamics, jumps
        What a change of M and l does, as in `ParameterChange`; sampled mode supports only the
        paper's.

    Returns
    -------
    Trajectory
        The run; one in which the pole falls ends there, with the outcome recorded.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    if mode not in MODES:
        raise UnknownNameError.among("mode", mode, MODES)
    scenario, controller = as_scenario(scenario), as_controller(controller)
    if mode != "sampled":
        scenario.require_ideal()
        require_stateless(controller, f"{mode} mode")
    ticks = ticks_of(scenario, timestep, control_period)
    model = CartPoleModel(
        scenario.parameters_at(0.0),
        timestep=ticks.timestep,
        integrator=integrator,
        edit=edit,
        imperfections=scenario.imperfections,
    )
    if edit is None:  # an edit may have added what would be left out
        model.compute_only(scenario.imperfections)
    change = ParameterChange(dynamics=dynamics, jumps=jumps)
    if mode == "sampled":
        if not change.is_the_papers:
            raise InvalidValueError("dynamics and jumps", "must be the paper's in sampled mode")
        return simulate_sampled(
            scenario,
            controller,
            timestep=timestep,
            control_period=control_period,
            integrator=integrator,
            model=model,
        )
    settings = {"timestep": ticks.timestep, **change.describe()}
    if mode == "continuous":
        return _continuous(model, scenario, controller, change, settings)
    return _exact(model, scenario, controller, change, settings)


def _exact(
    model: CartPoleModel,
    scenario: Scenario,
    controller: Controller,
    change: ParameterChange,
    settings: dict[str, Any],
) -> Trajectory:
    """Simulate MuJoCo's forward dynamics with the reference integrator."""
    times = time_grid(scenario, settings["timestep"])
    controller_inputs(
        scenario, controller, times
    )  # raises before the run if a gain is not positive
    states, outcome = integrate(
        scenario,
        solver(model, scenario, controller, change),
        transition(model, scenario, change),
        times,
        nodes=controller.nodes(scenario.plants),
    )
    settings = settings | {"method": "DOP853", "rtol": RTOL, "atol": ATOL}
    return assemble(scenario, controller, "mujoco exact", settings, times, states, outcome)


def _continuous(
    model: CartPoleModel,
    scenario: Scenario,
    controller: Controller,
    change: ParameterChange,
    settings: dict[str, Any],
) -> Trajectory:
    """Simulate by RK4 around MuJoCo's forward dynamics, with all inputs updated in every stage."""
    grid = steps(scenario, settings["timestep"])
    inputs = controller.inputs_along_run(
        grid.cart_mass, grid.half_length, scenario.pole_mass, scenario.gravity
    )
    arrive = transition(model, scenario, change)
    state, reached, status = np.array(scenario.initial_state), [], COMPLETED
    before: Segment | None = None
    for segment in scenario.segments:
        state = arrive(state, before, segment)
        before = segment
        first, last = np.searchsorted(grid.times, (segment.start, segment.end))
        part = slice(first, last)
        states, code = integrate_segment_rk4(
            model.addresses,
            state,
            grid.times[first : last + 1],
            grid.cart_mass[part],
            grid.half_length[part],
            (scenario.pole_mass, scenario.gravity),
            (segment.push, segment.half_length[1] if change.stretching else 0.0),
            controller,
            inputs[part],
        )
        state, status = states[-1], OUTCOMES[code]
        reached.append(states[:-1])
        if status != COMPLETED:
            break
    all_states = np.concatenate([*reached, state[None]])
    outcome = Outcome(status, float(grid.times[len(all_states) - 1]))
    return assemble(
        scenario, controller, "mujoco continuous", settings, grid.times, all_states, outcome
    )
