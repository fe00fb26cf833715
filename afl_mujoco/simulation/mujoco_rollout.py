"""The closed loop in MuJoCo: exact, continuous and sampled mode."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from afl_mujoco.compiled import borrowing_kernel, jitable, kernel
from afl_mujoco.control.catalogue import as_controller, require_stateless
from afl_mujoco.control.controller import Controller, Laws, command
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.plants.library import mujoco, write_row
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.scenario.time_steps import Deployed, ticks_of, time_grid
from afl_mujoco.simulation import integrator as dop853
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.integrator import (
    ATOL,
    RTOL,
    Derivative,
    Solver,
    Transition,
    compiled_solver,
    integrate,
    longest_step_of,
)
from afl_mujoco.simulation.judgement import require_start
from afl_mujoco.simulation.mujoco_model import (
    SimulatedModel,
    carried_momenta,
    forward,
    impulse_jump,
    rate_forces,
    require_integrator,
    write_state,
)
from afl_mujoco.simulation.sampled.runs import fine_enough, simulate_sampled
from afl_mujoco.simulation.trajectory import (
    STATE_LIMIT,
    Trajectory,
    assemble,
    controller_inputs,
    criterion_of,
)


class Line(NamedTuple):
    """The parameters of a segment, and what they are in the model."""

    start: float  # of the segment [s]
    values: Floats  # parameters at its start
    rates: Floats  # and their rates [1/s]
    # what is written into the model along the segment, as Chebyshev polynomials of its share; none
    # where nothing changes, shape (targets, degrees)
    course: Floats
    length: float  # of the segment [s]
    push: Floats  # disturbing forces along coordinates [N, N m], shape (n,)
    # how bodies move in their frames along the segment, as the same; none where no rate acts, shape
    # (bodies * 15, degrees)
    drift: Floats


class Space(NamedTuple):
    """Work space of a right-hand side."""

    row: Floats  # (targets,)
    drift: Floats  # (bodies * 15,)
    values: Floats  # (parameters,)
    inputs: Floats  # (k,)
    forces: Floats  # (n,)
    drag: Floats  # (n,), those of rates
    low: Floats  # bounds of the inputs, (k,)
    high: Floats


DEGREES = (3, 5, 9, 17, 33)
"""Numbers of coefficients that are tried for what is written along a ramp."""

SMOOTH = 1e-14
"""Largest error of these, as a share of the largest number that is written in a place."""

SMOOTH_DRIFT, ROUGH_DRIFT = 1e-11, 1e-9
"""The same of how bodies move in their frames, which is known by differences; and what is taken
where no number of coefficients gives it, as their rounding is larger."""


def line_of(model: SimulatedModel, segment: Segment) -> Line:
    """Return the parameters of a segment as compiled code takes them."""
    values, rates = np.array(segment.lines, dtype=np.float64).reshape(-1, 2).T.copy()
    acting = np.where(model.plant.entering, rates, 0.0)
    push = model.along("disturbance", np.array([segment.push]))
    length = segment.end - segment.start
    course, drift = np.empty((len(model.addresses.targets), 0)), np.empty((0, 0))
    thing = f"write of plant {model.plant.name!r}"
    if rates.any():
        drawn = [one.kind == "geom" for one in model.writer.targets]  # no mass is inferred of it
        smooth = np.where(drawn, np.inf, SMOOTH)
        course = _course(thing, model.rows, values, rates * length, [smooth])
    if acting.any():

        def moving(p: Floats) -> Floats:
            return model.writer.drift(p, np.tile(acting, (len(p), 1))).reshape(len(p), -1)

        drift = _course(thing, moving, values, rates * length, [SMOOTH_DRIFT, ROUGH_DRIFT])
    model.write(values)
    return Line(segment.start, values, rates, course, length, push[0], drift)


def _course(
    thing: str, table: Callable[[Floats], Floats],
    values: Floats, step: Floats, limits: Sequence[Any],
) -> Floats:  # fmt: skip
    """Return a table from some parameters on, a step further, as Chebyshev polynomials.

    They keep the first of the limits that any of `DEGREES` keeps.
    """
    between = 0.5 * (1.0 + np.cos(np.pi * (np.arange(40) + 0.5) / 40))
    expected = table(values + between[:, None] * step)
    scale = np.abs(expected).max(axis=0) + np.finfo(float).tiny
    for limit, count in itertools.product(limits, DEGREES):
        nodes = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        rows = table(values + 0.5 * (1.0 + nodes)[:, None] * step)
        cosines = np.cos(np.arange(count)[:, None] * np.arccos(nodes))
        found = 2.0 / count * cosines @ rows
        found[0] *= 0.5
        error = np.abs(np.polynomial.chebyshev.chebval(2.0 * between - 1.0, found).T - expected)
        if (error <= limit * scale).all():
            return np.ascontiguousarray(found.T)
    raise InvalidValueError(thing, "must be smooth in the parameters along a ramp, for this mode")


@jitable
def _evaluate(course, x, out):
    """Write Chebyshev polynomials at x from -1 to 1, by Clenshaw's recurrence."""
    for i in range(len(out)):
        b1, b2 = 0.0, 0.0
        for j in range(course.shape[1] - 1, 0, -1):
            b1, b2 = course[i, j] + 2.0 * x * b1 - b2, b1
        out[i] = course[i, 0] + x * b1 - b2


@jitable
def _write_at(at, line, space, time):
    """Set parameters and model to a time of a segment."""
    elapsed = time - line.start
    for i in range(len(line.values)):
        space.values[i] = line.values[i] + line.rates[i] * elapsed
    if line.course.shape[1] == 0:  # the model has them since the start of the segment
        return
    x = 2.0 * elapsed / line.length - 1.0
    _evaluate(line.course, x, space.row)
    write_row(at.structures, at.targets, space.row)
    if len(line.drift) > 0:
        _evaluate(line.drift, x, space.drift)


@jitable
def _write_rates(at, line, space, state, rates):
    """Write the rates of the plant under the inputs, NaN where the controller has none."""
    n = at.n
    for i in range(at.k):
        if not abs(space.inputs[i]) < STATE_LIMIT:
            for j in range(2 * n):
                rates[j] = np.nan
            return
        space.inputs[i] = min(max(space.inputs[i], space.low[i]), space.high[i])
    for i in range(n):
        space.forces[i] = line.push[i]
        rates[i] = state[n + i]
    if len(line.drift) > 0:
        rate_forces(at, space.drift, state, False, space.drag)
        for i in range(n):
            space.forces[i] += space.drag[i]
    forward(at, state, space.inputs, space.forces, rates[n:])


@jitable
def loop_rates(arguments, time, state, rates):
    """Write the rates of the loop, of the addresses, the line, the work space and the law."""
    at, line, space, law = arguments
    _write_at(at, line, space, time)
    command(law, time, state, space.values, space.inputs)
    _write_rates(at, line, space, state, rates)


@kernel
def _rates(loop, time, state, rates):
    loop_rates(loop, time, state, rates)


@borrowing_kernel
def _solve(loop, limits, start, end, state, times, options, work, found):
    return dop853.solve(loop_rates, loop, limits, start, end, state, times, options, work, found)


@borrowing_kernel
def _step(loop, limits, start, end, state, times, options, work, found):
    return dop853.solve_rk4(
        loop_rates, loop, limits, start, end, state, times, options, work, found
    )


def work_space(model: SimulatedModel) -> Space:
    """Return the work space of a right-hand side."""
    at, parameters = model.addresses, len(model.plant.parameters)
    sizes = (len(at.targets), 15 * len(at.parents), parameters, at.k, at.n, at.n)
    return Space(*(np.zeros(size) for size in sizes), *model.plant.limits.T.copy())


def solver(model: SimulatedModel, scenario: Scenario, controller: Controller, mode: str) -> Solver:
    """Return the solver of the closed loop of MuJoCo's forward dynamics and the controller."""
    laws, space = Laws(controller, scenario, continuous=mode == "exact"), work_space(model)
    integrated = _step if mode == "continuous" else _solve
    criterion = criterion_of(scenario)

    def solve(segment: Segment, *rest: Any) -> Any:
        loop = model.addresses, line_of(model, segment), space, laws.along(segment)
        with laws.watched():
            return integrated(loop, criterion, segment.start, segment.end, *rest)

    return compiled_solver(solve, criterion, longest=longest_step_of(scenario))


def closed_loop(model: SimulatedModel, scenario: Scenario, controller: Controller) -> Derivative:
    """Return the right-hand side of the same loop for an integrator in Python."""
    laws, space, n = Laws(controller, scenario), work_space(model), model.addresses.n
    line = functools.lru_cache(maxsize=1)(functools.partial(line_of, model))

    def derivative(time: float, state: Floats, segment: Segment) -> Any:
        loop = model.addresses, line(segment), space, laws.along(segment)
        x, rates = np.array(state[: 2 * n]), np.empty(2 * n)
        with laws.watched():
            _rates(loop, time, x, rates)
        return rates

    return derivative


def transition(model: SimulatedModel, scenario: Scenario) -> Transition:
    """Return the effect of a breakpoint on the state, from MuJoCo's own mass matrix."""
    n, events = model.addresses.n, scenario.events

    def arrive(state: Floats, before: Segment | None, after: Segment) -> Floats:
        state = state.copy()
        impulse = model.along("impulse on an input", np.array([after.impulse]))
        if (event := events.get(after.start)) is not None:  # M v + N p' stays
            old, new = event.rates
            kept = carried_momenta(model, event.before, old, state) + momenta(model, state)
            kept -= carried_momenta(model, event.after, new, state)
            state[n : 2 * n] = velocities(model, state, kept)
        if impulse.any():
            model.write(after.values_at(after.start))
            jump = np.empty(n)
            write_state(model.addresses, state)
            impulse_jump(model.addresses, impulse[0], jump)
            state[n : 2 * n] += jump
        return state

    return arrive


def momenta(model: SimulatedModel, state: Floats) -> Floats:
    """Return the generalised momenta, MuJoCo's mass matrix times the velocities, shape (n,)."""
    model.accelerations(state)  # lets MuJoCo compute everything there, without any input
    n = model.addresses.n
    result = np.empty(n)
    mujoco.mj_mulM(model.mj_model, model.mj_data, result, state[n : 2 * n])
    return result


def velocities(model: SimulatedModel, state: Floats, momentum: Floats) -> Floats:
    """Return the velocities of generalised momenta, the inverse of `momenta`, shape (n,)."""
    model.accelerations(state)
    result: Floats = np.empty(model.addresses.n)
    mujoco.mj_solveM(model.mj_model, model.mj_data, result[None], momentum[None])
    return result


MODES = ("exact", "continuous", "sampled")


def require_not_held(mode: str, control_period: float | None, integrator: str | None) -> None:
    """Raise if something is given that acts in sampled mode alone."""
    require_integrator(integrator or "RK4")
    for name, value in {"control_period": control_period, "integrator": integrator}.items():
        if value not in (None, "RK4"):
            rule = f"must be left out with {mode}: sampled alone has it"
            raise InvalidValueError(name, rule, value)


def simulate_mujoco(
    scenario: Scenario | str | Path,
    controller: Any,
    mode: str = "sampled",
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    edit: Callable[[mujoco.MjSpec], None] | None = None,
) -> Trajectory:
    """Simulate a plant in MuJoCo under a controller, its parameters changed while it runs.

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
        up to 1 ms that divides the control period. Where dampers or springs are too fast for it,
        sampled and continuous mode take a finer one, as the provenance and a remark say.
    control_period
        How long sampled mode holds the force [s], a multiple of `timestep` (default: that of the
        scenario's imperfections, else one step).
    integrator
        MuJoCo's integrator in sampled mode: ``"RK4"``, ``"Euler"``, ``"implicit"`` or
        ``"implicitfast"``.
    edit
        Called with the `mujoco.MjSpec` before it is compiled, to add what the paper leaves out.

    Returns
    -------
    Trajectory
        The run; one in which the pole falls ends there, with the outcome recorded.

    Raises
    ------
    UnknownNameError
        If there is no scenario, controller, mode or integrator of that name.
    InvalidValueError
        If the step is not positive or does not divide the control period, or if the scenario has
        imperfections, the controller a memory, or a control period or another integrator is given,
        and the mode is not sampled.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> run = afl.simulate_mujoco("step-step", "adaptive")
    >>> str(run.outcome)
    'completed'
    """
    if mode not in MODES:
        raise UnknownNameError.among("mode", mode, MODES)
    scenario = as_scenario(scenario)
    controller = bound(as_controller(controller), scenario)
    if mode != "sampled":
        require_not_held(mode, control_period, integrator)
        scenario.require_ideal()
        require_start(scenario)
        require_stateless(controller, f"{mode} mode")
    ticks = ticks_of(scenario, timestep, control_period)
    model = SimulatedModel(
        scenario.plant,
        timestep=ticks.timestep,
        integrator=integrator,
        edit=edit,
        imperfections=scenario.imperfections,
    )
    model.write(scenario.values_at(0.0))
    if edit is None:  # an edit may have added what would be left out
        model.compute_only()
    if mode == "sampled":
        deployed = Deployed(integrator, timestep, control_period)
        return simulate_sampled(scenario, controller, deployed, model=model)
    asked = ticks.timestep
    if mode == "continuous":  # by RK4, too
        ticks = fine_enough(ticks, model.fastest_rate(scenario, scenario.spans))
    times = time_grid(scenario, ticks.timestep)
    # raises before the run if a gain is not positive
    controller_inputs(scenario, controller, times)
    settings = {"timestep": ticks.timestep, **scenario.plant.changes}
    if ticks.timestep != asked:
        settings["asked_timestep"] = asked
    nodes = {}  # a fixed step crosses them
    if mode == "exact":
        settings |= {"method": "DOP853", "rtol": RTOL, "atol": ATOL}
        nodes = controller.nodes_within(scenario.spans)
    loop = solver(model, scenario, controller, mode)
    states, outcome = integrate(scenario, loop, transition(model, scenario), times, nodes=nodes)
    return assemble(scenario, controller, f"mujoco {mode}", settings, times, states, outcome)
