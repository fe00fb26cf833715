"""The analytic reference: (P3), (P4) under the controller, integrated to tight tolerance."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from afl_mujoco.compiled import Callback, borrowing_kernel, call, jitable, kernel
from afl_mujoco.control.catalogue import as_controller, require_stateless
from afl_mujoco.control.controller import Controller, Law, Laws, command
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.cartpole_equations import cart_acceleration, pole_acceleration, velocity_jump
from afl_mujoco.plants.equations import POINTS, Equations, Points, load_equations, split
from afl_mujoco.plants.plant import Floats, require_seen_limits
from afl_mujoco.plants.tree import Tree, terms_of
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.scenario.schedules import Impulse
from afl_mujoco.scenario.time_steps import time_grid
from afl_mujoco.simulation import integrator as dop853
from afl_mujoco.simulation.integrator import (
    ATOL,
    REACHED,
    RTOL,
    Solver,
    Transition,
    along_z,
    compiled_solver,
    integrate,
    longest_step_of,
    require_tolerances,
    scipy_solver,
)
from afl_mujoco.simulation.trajectory import (
    STATE_LIMIT,
    Criterion,
    Trajectory,
    assemble,
    controller_inputs,
    criterion_of,
)

SAMPLE_PERIOD = 1e-3  # spacing of the reported instants [s]


def simulate_ode(
    scenario: Scenario | str | Path,
    controller: Any,
    *,
    sample_period: float = SAMPLE_PERIOD,
    method: str = "DOP853",
    rtol: float = RTOL,
    atol: float = ATOL,
    trees: Any = None,
) -> Trajectory:
    """Simulate the equations of a plant, by default the paper's, restarted at every breakpoint.

    Parameters
    ----------
    scenario
        What happens: a scenario, a name of the catalogue, or the path of a file.
    controller
        The controller, evaluated continuously in time; as `simulate_mujoco` takes it.
    sample_period
        Spacing of the reported instants [s]; breakpoints are reported as well.
    method, rtol, atol
        Method and tolerances of `scipy.integrate.solve_ivp`.
    trees
        The plant as a tree of bodies, for parameters whose rates enter: what
        `afl_mujoco.simulate_ode` gives.

    Returns
    -------
    Trajectory
        The run; one in which the pole falls ends there, with the outcome recorded.

    Raises
    ------
    UnknownNameError
        If there is no scenario, controller or method of that name.
    InvalidValueError
        If the scenario has imperfections, the controller a memory, the plant no equations, or a
        period or tolerance is not positive.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> run = afl.simulate_ode("step-step", "adaptive")
    >>> str(run.outcome)
    'completed'
    """
    scenario = as_scenario(scenario)
    controller = as_controller(controller)
    scenario.require_ideal()
    require_stateless(controller, "the ODE")
    times = time_grid(scenario, sample_period)
    # raises before the run if a gain is not positive
    controller_inputs(scenario, controller, times)
    require_tolerances(method, rtol, atol)
    criterion, loop = criterion_of(scenario), Loop(scenario, trees, controller)
    solver = loop.solver(criterion, rtol, atol)
    if method != "DOP853":
        longest = longest_step_of(scenario)
        solver = scipy_solver(loop.derivative, criterion, method, rtol, atol, longest)
    nodes = controller.nodes_within(scenario.spans)
    states, outcome = integrate(scenario, solver, loop.arrive, times, nodes=nodes)
    settings = {"method": method, "rtol": rtol, "atol": atol, "sample_period": sample_period}
    settings |= scenario.plant.changes
    return assemble(scenario, controller, "ode", settings, times, states, outcome)


PAPERS, ACCELERATIONS, TERMS = range(3)
"""Kinds of equations: (P3) and (P4); accelerations of a plant; ``M v' + h = B u`` of one."""


class Dynamics(NamedTuple):
    """The equations of a plant as compiled code takes them."""

    kind: int
    n: int  # coordinates
    k: int  # inputs
    low: Floats  # bounds of the inputs, (k,)
    high: Floats
    address: int  # of its own equations, as `Equations.callback`
    drag: int  # of what rates of parameters do, by how much accelerations fall; 0 for nothing


class Line(NamedTuple):
    """What is prescribed along a segment."""

    start: float  # of the segment [s]
    values: Floats  # parameters at its start, (parameters,)
    rates: Floats  # and their rates [1/s]
    push: Floats  # disturbing forces on inputs, then along coordinates, (k + n,)


class Space(NamedTuple):
    """Work space of a right-hand side."""

    values: Floats  # parameters, (parameters,)
    inputs: Floats  # of the controller, (k,)
    acting: Floats  # on the plant, (k,)
    found: Floats  # what the equations give
    drag: Floats  # (n,)


def line_of(segment: Segment) -> Line:
    """Return what is prescribed along a segment, as compiled code takes it."""
    values, rates = np.array(segment.lines, dtype=np.float64).reshape(-1, 2).T.copy()
    return Line(segment.start, values, rates, np.array(segment.push))


@jitable
def values_at(line, time, values):
    """Write the parameters at a time."""
    for i in range(len(values)):
        values[i] = line.values[i] + line.rates[i] * (time - line.start)


@jitable
def held_rates(arguments, time, state, rates):
    """Write the rates of a plant under ``space.inputs``, NaN where the controller has none."""
    dynamics, line, space = arguments
    n, k = dynamics.n, dynamics.k
    values_at(line, time, space.values)
    for i in range(k):
        if not abs(space.inputs[i]) < STATE_LIMIT:  # the run ends there
            for j in range(2 * n):
                rates[j] = np.nan
            return
    for i in range(n):
        rates[i] = state[n + i]
    if dynamics.kind == PAPERS:
        _papers_accelerations(line, space, state, rates)
    else:
        _own_accelerations(dynamics, line, space, time, state, rates)


@jitable
def _own_accelerations(dynamics, line, space, time, state, rates):
    n, k = dynamics.n, dynamics.k
    for i in range(k):
        limited = min(max(space.inputs[i], dynamics.low[i]), dynamics.high[i])
        space.acting[i] = limited + line.push[i]
    found = space.found
    for i in range(len(found)):
        found[i] = np.nan  # where the equations raise
    call(dynamics.address, time, state, space.acting, space.values, found)
    if dynamics.kind == TERMS:  # M v' = B u + forces along coordinates - h
        for i in range(n):
            total = line.push[k + i] - found[n * n + i]
            for j in range(k):
                total += found[n * n + n + i * k + j] * space.acting[j]
            rates[n + i] = total
        _solve_in_place(found[: n * n], rates[n:])
    else:
        for i in range(n):
            rates[n + i] = found[i]
    if dynamics.drag != 0:
        for i in range(n):
            space.drag[i] = np.nan
        call(dynamics.drag, time, state, space.acting, space.values, space.drag)
        for i in range(n):
            rates[n + i] -= space.drag[i]


@jitable
def _papers_accelerations(line, space, state, rates):
    p = space.values
    given = (
        state[1], state[3], space.inputs[0] + (line.push[0] + line.push[1]), p[0], p[1], p[2], p[3]
    )  # fmt: skip
    rates[2], rates[3] = cart_acceleration(*given), pole_acceleration(*given)


@jitable
def _solve_in_place(matrix, right):
    """Replace b by the solution of A x = b, by elimination with the largest pivots."""
    n = len(right)
    for i in range(n):
        best = i
        for j in range(i + 1, n):
            if abs(matrix[j * n + i]) > abs(matrix[best * n + i]):
                best = j
        for j in range(n):
            one, other = matrix[i * n + j], matrix[best * n + j]
            matrix[i * n + j], matrix[best * n + j] = other, one
        one, other = right[i], right[best]
        right[i], right[best] = other, one
        for j in range(i + 1, n):
            factor = matrix[j * n + i] / matrix[i * n + i]
            for m in range(i + 1, n):
                matrix[j * n + m] -= factor * matrix[i * n + m]
            right[j] -= factor * right[i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            right[i] -= matrix[i * n + j] * right[j]
        right[i] /= matrix[i * n + i]


@jitable
def loop_rates(arguments, time, state, rates):
    """Write the rates of the loop: dynamics, the line that acts, the true one, law, space."""
    dynamics, line, true, law, space = arguments
    values_at(true, time, space.values)  # (D7): the controller knows M(t) and l(t)
    command(law, time, state, space.values, space.inputs)
    held_rates((dynamics, line, space), time, state, rates)


@kernel
def _rates(loop, time, state, rates):
    loop_rates(loop, time, state, rates)


@borrowing_kernel
def _solve(loop, limits, start, end, state, times, options, work, found):
    return dop853.solve(loop_rates, loop, limits, start, end, state, times, options, work, found)


class Loop:
    """The equations of a plant under a controller, or under inputs that are given.

    Where rates of parameters act, a tree says what they do: `simulate.MovingTrees`.
    """

    def __init__(
        self,
        scenario: Scenario,
        trees: Any = None,
        controller: Controller | None = None,
        *,
        continuous: bool = True,
    ) -> None:
        plant, self.scenario, self.trees = scenario.plant, scenario, trees
        n, k, j = len(plant.coordinates), len(plant.inputs), len(plant.parameters)
        self.equations: Equations | None = None
        self.called: list[Callback] = []
        kind, size, address = PAPERS, 0, 0
        if scenario.is_cart_pole:
            for segment in scenario.segments:
                along_z(segment.push)  # raises if it acts elsewhere
        else:
            require_equations(scenario)
            require_seen_limits(plant.limited_joints)
            self.equations = load_equations(plant, _points(scenario))
            kind, size = TERMS if plant.terms else ACCELERATIONS, self.equations.size
            address = self.equations.callback.address
            self.called.append(self.equations.callback)
        self.drag = 0
        if plant.entering.any():
            self.called.append(Callback(self._drag, (2 * n, k, j, n)))
            self.drag = self.called[-1].address
        low, high = plant.limits.T.copy()
        self.segment = scenario.segments[0]  # what is integrated now
        self.dynamics = Dynamics(kind, n, k, low, high, address, 0)
        self.space = Space(*(np.zeros(count) for count in (j, k, k, size, n)))
        if controller is not None:
            self.laws = Laws(controller, scenario, continuous=continuous)
            if self.laws.callback is not None:
                self.called.append(self.laws.callback)

    def _drag(self, time: float, state: Any, _: Any, __: Any, out: Floats) -> None:
        """Write by how much rates of parameters lower the accelerations."""
        trees = _given(self.trees).along(self.segment, time)
        needed, inertia = _needed(*trees, *np.split(state, 2))
        out[:] = np.linalg.solve(inertia, needed)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Run compiled code that calls what is not compiled; raise what that raised."""
        with ExitStack() as stack:
            for one in self.called:
                stack.enter_context(one.watched())
            yield

    def along(self, segment: Segment) -> Dynamics:
        """Return the equations along a segment, with what rates do where they act."""
        pairs = zip(self.scenario.plant.entering, segment.lines, strict=True)
        acts = any(rate for enters, (_, rate) in pairs if enters)
        return self.dynamics._replace(drag=self.drag if acts else 0)

    def require_equations_at(self, state: Floats, time: float, segment: Segment) -> None:
        """Raise what the equations raise at a state where a run ended."""
        if self.equations is not None and np.isfinite(state).all():
            n, none = self.dynamics.n, np.empty(self.equations.size)
            p, inputs = segment.values_at(time), np.zeros(self.dynamics.k)
            self.equations.fill(state[:n].copy(), state[n : 2 * n].copy(), inputs, p, none)

    @property
    def arrive(self) -> Transition:
        """The effect of a breakpoint on the state."""
        if self.equations is None:
            return hit
        return _arrival(self.scenario, self.equations, self.trees)

    def _on(self, segment: Segment) -> tuple[Dynamics, Line, Line, Law, Space]:
        self.segment, line = segment, line_of(segment)
        return self.along(segment), line, line, self.laws.along(segment), self.space

    def derivative(self, time: float, state: Floats, segment: Segment) -> Any:
        """Return the rates of the loop, called from Python."""
        rates = np.empty(2 * self.dynamics.n)
        with self.watched():
            _rates(self._on(segment), time, np.array(state[: len(rates)]), rates)
        return rates

    def solver(self, criterion: Criterion, rtol: float = RTOL, atol: float = ATOL) -> Solver:
        """Return DOP853 of the loop over a segment."""

        def solve(segment: Segment, *rest: Any) -> Any:
            with self.watched():
                found = _solve(self._on(segment), criterion, segment.start, segment.end, *rest)
            if found[2] != REACHED:
                self.require_equations_at(rest[0], found[1], segment)
            return found

        return compiled_solver(solve, criterion, rtol, atol, longest_step_of(self.scenario))


def hit(state: Floats, before: Segment | None, after: Segment) -> Floats:
    """Return the state of the cart-pole after a breakpoint, by the analytic mass matrix."""
    impulse, state = along_z(after.impulse), state.copy()
    if impulse != 0.0:
        p = CART_POLE.named(after.values_at(after.start))
        state[2:4] += velocity_jump(state[:4], impulse, p)
    return state


def _arrival(scenario: Scenario, equations: Equations, trees: Any) -> Transition:
    """Return the effect of a breakpoint on the state of any plant, from its own equations."""
    plant = scenario.plant
    n, k, events = len(plant.coordinates), len(plant.inputs), scenario.events

    def terms(q: Floats, v: Floats, p: Floats) -> Any:
        found = np.empty(equations.size)
        equations.fill(q, v, np.zeros(k), p, found)
        return split(plant, found[None])

    def arrive(state: Floats, before: Segment | None, after: Segment) -> Floats:
        impulse, state = np.array(after.impulse), state.copy()
        event, p = events.get(after.start), after.values_at(after.start)
        if event is not None and event.joins:  # M v + N p' stays, as M changes
            old, mass = (
                terms(state[:n].copy(), state[n:].copy(), values)[0][0]
                for values in (event.before, event.after)
            )
            kept = old @ state[n:] + _carried(trees, event.before, event.rates[0], state[:n])[0]
            kept -= _carried(trees, event.after, event.rates[1], state[:n])[0]
            state[n:] = np.linalg.solve(mass, kept)
        elif event is not None:
            kink = event.rates[1] - event.rates[0]
            momenta, inertia = _carried(trees, event.after, kink, state[:n])
            state[n:] -= np.linalg.solve(inertia, momenta)
        if impulse.any():
            mass, _, inputs = terms(state[:n].copy(), state[n:].copy(), p)
            state[n:] += np.linalg.solve(mass[0], inputs[0] @ impulse[:k] + impulse[k:])
        return state

    return arrive


def _carried(trees: Any, values: Floats, rates: Floats, q: Any) -> tuple[Floats, Floats]:
    """Return the momenta that rates give a plant at rest, N p', and its mass matrix."""
    if not rates.any():
        return np.zeros(len(q)), np.eye(len(q))
    still, moving = _given(trees).at(values, rates)
    drift = np.zeros_like(moving.drift)  # a jump of d' is an impulse of d''
    drift[:, [1, 3]] = moving.drift[:, [0, 2]]
    return _needed(still, moving._replace(drift=drift), q, np.zeros(len(q)))


def _given(trees: Any) -> Any:
    if trees is None:
        rule = "must not enter here: simulate_ode and MuJoCo take it"
        raise InvalidValueError("rate of a parameter", rule)
    return trees


def _needed(still: Tree, moving: Tree, q: Any, v: Any) -> tuple[Floats, Floats]:
    """Return the forces that motion under rates needs besides, and the mass matrix."""
    q, v = np.array(q), np.array(v)
    without = terms_of(still, q, v)
    return terms_of(moving, q, v).bias - without.bias, without.mass


def require_equations(scenario: Scenario) -> None:
    """Raise unless the equations of a plant can say what happens in a scenario."""
    plant = scenario.plant
    if not plant.has_equations:
        rule = "must have accelerations or terms, its equations, to be integrated"
        raise InvalidValueError(f"plant {plant.name!r}", rule)
    asked = ["an impulse" for one in scenario.disturbances if isinstance(one, Impulse)]
    asked += [f"a force along {one.coordinate}" for one in scenario.disturbances if one.coordinate]
    asked += [f"what joins at rest at {t:g} s" for t, one in scenario.events.items() if one.joins]
    if asked and plant.terms is None:
        rule = "needs equations as terms: accelerations do not say what momenta do"
        raise InvalidValueError(f"plant {plant.name!r}, {asked[0]}", rule)


def _points(scenario: Scenario) -> Points:
    """Return random states, inputs and parameters of a scenario, as `load_equations` takes them."""
    plant = scenario.plant
    n, k = len(plant.coordinates), len(plant.inputs)
    rng = np.random.default_rng(0)
    low, high = np.array([*scenario.spans.values()]).reshape(-1, 2).T
    return Points(
        q=np.array(scenario.target) + rng.uniform(-0.5, 0.5, (POINTS, n)),
        v=rng.uniform(-1.0, 1.0, (POINTS, n)),
        u=rng.uniform(-1.0, 1.0, (POINTS, k)),
        p=rng.uniform(low, high, (POINTS, len(low))),
    )
