"""What every controller is, and the compiled forms that loops call without an interpreter."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from afl_mujoco.compiled import Callback, call, jitable, kernel
from afl_mujoco.control.gains import scheduled_gain
from afl_mujoco.control.law import afl_force, force_kernel, linearizing_force
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.scenario.parameters import CartPoleParameters, PlantRange
from afl_mujoco.scenario.scenario import Scenario, Segment

AFL, LINEAR, PARTIAL, AFFINE, CALLED = 0, 1, 2, 3, 4
"""Kinds of controller: the paper's control law (L1)-(L10); state feedback ``F = -k x``; state
feedback ``u = -k x`` through the input map (L1); of any plant, ``u = u0 - K (x - target)``; and, in
loops of continuous time, what is called by its address."""


class CompiledController(NamedTuple):
    """A controller as the compiled functions of this module take it, in this order."""

    kind: int  # `AFL`, `LINEAR` or `PARTIAL`
    # its numbers, float64, C-contiguous, of three dimensions, as `compiled_force` describes them
    table: Floats
    masses: Floats  # nodes M [kg] and l [m] of the table
    lengths: Floats
    home: float = 0.0  # where it brings the cart [m]


@kernel
def _weights(grid, value):
    """Return four nodes around a value and their weights in a cubic with a continuous slope.

    The slope at a node is that of the line through its neighbours. Beyond the grid by more than
    round-off the weights are NaN: nothing is known there.
    """
    last = len(grid) - 1
    if last == 0:
        return (0, 0, 0, 0), (1.0, 0.0, 0.0, 0.0)
    slack = 1e-9 * grid[last]
    if not grid[0] - slack <= value <= grid[last] + slack:
        return (0, 0, 0, 0), (np.nan, np.nan, np.nan, np.nan)
    left = min(max(np.searchsorted(grid, value, side="right") - 1, 0), last - 1)
    right, before, after = left + 1, max(left - 1, 0), min(left + 2, last)
    width = grid[right] - grid[left]
    t = min(max((value - grid[left]) / width, 0.0), 1.0)
    rising = t * t * (3.0 - 2.0 * t)
    slope_left = t * (1.0 - t) * (1.0 - t) * width / (grid[right] - grid[before])
    slope_right = -t * t * (1.0 - t) * width / (grid[after] - grid[left])
    weights = -slope_left, 1.0 - rising - slope_right, rising + slope_left, slope_right
    return (before, left, right, after), weights


@kernel
def interpolated_gains(table, masses, lengths, cart_mass, half_length):
    """Return the four gains of a plant, bicubic between the nodes, NaN beyond them.

    Their slopes are continuous, so that fixed steps stay accurate along a ramp of M or l; the
    reference integrator ends a step at every node.
    """
    rows, row_weights = _weights(masses, cart_mass)
    columns, column_weights = _weights(lengths, half_length)
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        for j in range(4):
            weight = row_weights[i] * column_weights[j]
            node = table[rows[i], columns[j]]
            a += weight * node[0]
            b += weight * node[1]
            c += weight * node[2]
            d += weight * node[3]
    return a, b, c, d


@kernel
def _feedback_force(kind, z, phi, z_dot, phi_dot, assumed, gains):
    """Return the force [N] of state feedback; NaN for an unknown kind."""
    feedback = -(gains[0] * z + gains[1] * phi + gains[2] * z_dot + gains[3] * phi_dot)
    if kind == LINEAR:
        return feedback
    if kind == PARTIAL:
        cart_mass, pole_mass, half_length, gravity = assumed
        return linearizing_force(feedback, phi, phi_dot, cart_mass, pole_mass, half_length, gravity)
    return np.nan


@kernel
def compiled_force(kind, table, masses, lengths, home, z, phi, z_dot, phi_dot, assumed):
    """Return the force [N] of a controller at one state, or NaN where it has no value.

    table: Float64, C-contiguous. For `AFL`: coefficients of the gain function (G1), shape (1, 3,
        5). For the others: gains k by M and l, shape (len(masses), len(lengths), 4), interpolated
        at the assumed M and l; a single node applies to every plant.
    masses, lengths: Nodes M [kg] and l [m], increasing; `AFL` does not use them.
    """
    z -= home
    if kind == AFL:
        cart_mass, pole_mass, half_length, gravity = assumed
        return force_kernel(
            z, phi, z_dot, phi_dot, cart_mass, pole_mass, half_length, gravity,
            scheduled_gain(cart_mass, half_length, table[0, 0]),
            scheduled_gain(cart_mass, half_length, table[0, 1]),
            scheduled_gain(cart_mass, half_length, table[0, 2]),
        )  # fmt: skip
    gains = interpolated_gains(table, masses, lengths, assumed[0], assumed[2])
    return _feedback_force(kind, z, phi, z_dot, phi_dot, assumed, gains)


@kernel
def force_from_inputs(kind, state, inputs, out):
    """Write the inputs [N] from gains already looked up, equal to `compiled_force` bit for bit."""
    if kind == AFL:
        out[0] = afl_force(state, inputs, inputs[7])
    elif kind == AFFINE:  # u0 (k), the rows of K (k, 2n), the target and what comes round (2n)
        k, states = len(out), len(state)
        target = k + k * states
        for i in range(k):
            out[i] = inputs[i]
            for j in range(states):
                away = state[j] - inputs[target + j]
                turn = inputs[target + states + j]
                if turn > 0.0:  # the shorter way
                    away -= turn * np.rint(away / turn)
                out[i] -= inputs[k + i * states + j] * away
    else:
        out[0] = _feedback_force(
            kind, state[0] - inputs[8], state[1], state[2], state[3],
            (inputs[0], inputs[1], inputs[2], inputs[3]),
            (inputs[4], inputs[5], inputs[6], inputs[7]),
        )  # fmt: skip


@kernel
def forces_along(kind, states, inputs, out):
    """Write the inputs at each of many states, shape (N, k)."""
    for i in range(len(states)):
        force_from_inputs(kind, states[i], inputs[i], out[i])


@kernel
def inputs_along(kind, table, masses, lengths, home, assumed):
    """Return the inputs of a controller for many assumed (M, m, l, g): these, gains and home."""
    count = 7 if kind == AFL else 8
    inputs = np.empty((len(assumed), count + 1))
    for i in range(len(assumed)):
        inputs[i, count] = home
        for j in range(4):
            inputs[i, j] = assumed[i, j]
        cart_mass, half_length = assumed[i, 0], assumed[i, 2]
        if i > 0 and cart_mass == assumed[i - 1, 0] and half_length == assumed[i - 1, 2]:
            for j in range(4, count):  # most schedules are constant most of the time
                inputs[i, j] = inputs[i - 1, j]
        elif kind == AFL:
            for j in range(3):
                inputs[i, 4 + j] = scheduled_gain(cart_mass, half_length, table[0, j])
        else:
            gains = interpolated_gains(table, masses, lengths, cart_mass, half_length)
            inputs[i, 4], inputs[i, 5], inputs[i, 6], inputs[i, 7] = gains
    return inputs


class Estimator(NamedTuple):
    """A compiled controller with the estimator of M, l and the state, for compiled loops."""

    compiled: CompiledController  # the controller
    settings: Any  # settings of the estimator, the record of `EstimatorSettings.on`


class Controller(Protocol):
    """A controller of the force: its gains, and the parameters that it assumes of the plant.

    Attributes
    ----------
    name
        Name for reports and files.
    belief
        Constant parameters that the controller assumes; ``None`` for the true M(t) and l(t)
        (decision D7).
    plant
        What it controls: the cart-pole, unless it says otherwise.
    interpreted, not_compiled
        Whether it is called by the interpreter, through `command`; why it has no compiled form.
    estimates
        Whether M, l and the state are estimated from measured positions, in sampled mode only.
    """

    name: str
    belief: CartPoleParameters | None = None
    plant: Plant = CART_POLE
    interpreted: ClassVar[bool] = False
    not_compiled: ClassVar[str] = ""
    estimates: ClassVar[bool] = False

    @property
    def kind(self) -> int:
        """Which control law it is in compiled loops; raises if it has no compiled form."""
        raise InvalidValueError(f"controller {self.name!r}", self.not_compiled)

    def compiled_for(self, plants: PlantRange) -> CompiledController:
        """Return the controller as compiled loops take it, valid for these plants, or raise."""
        raise InvalidValueError(f"controller {self.name!r}", self.not_compiled)

    def estimator_for(self, start: CartPoleParameters) -> Estimator | None:
        """Return the estimator of M, l and the state, None if there is none.

        The plant at the start of the run is all that may be known of it.
        """
        return None

    @property
    def stateful(self) -> bool:
        """Whether a call depends on the calls before it.

        Only sampled mode, which calls once per control period and in order, supports that.
        """
        return False

    def without_estimator(self) -> Controller:
        """Return the controller that sees the true M and l where this one estimates them."""
        return self

    def about(self, home: float) -> Controller:
        """Return the controller that brings the cart to a place [m], or raise."""
        if home == 0.0:
            return self
        rule = "brings z to 0 alone, not to a target in [requirements]"
        raise InvalidValueError(f"controller {self.name!r}", rule, f"{home:g} m")

    def remarks(self, scenario: Scenario) -> list[str]:
        """Return remarks for readers of its runs on a cart-pole, one sentence each."""
        return []

    def rows_along(self, segment: Segment) -> tuple[Floats, Floats]:
        """Return the times at which gains along a segment have kinks, and rows between these."""
        raise InvalidValueError(f"controller {self.name!r}", self.not_compiled)

    def start(self) -> Controller:
        """Return the controller for one run, with its internal state reset if it has any."""
        return self

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance."""
        ...

    def assumed(self, values: Floats) -> Floats:
        """Return what the controller assumes of parameters that it is told, in rows or of one."""
        return values

    def nodes_within(self, spans: Mapping[str, tuple[float, float]]) -> dict[str, Floats]:
        """Return the values of true parameters at which its gains are not smooth, by name."""
        return {}

    def command(self, time: float, state: ArrayLike, assumed: Floats) -> float:
        """Return the force [N] at a state and an assumed (M, m, l, g), NaN where it has none."""
        z, phi, z_dot, phi_dot = np.asarray(state, dtype=np.float64).tolist()
        compiled = self.compiled_for(_range_of(assumed[None]))
        return float(compiled_force(*compiled, z, phi, z_dot, phi_dot, tuple(assumed.tolist())))

    def inputs_for(self, values: Floats) -> Floats:
        """Return the inputs of the controller for rows of told parameters, shape (N, numbers).

        Of the cart-pole the assumed (M, m, l, g), gains, three of the paper's controller, four of
        state feedback, and where it brings the cart [m]. Raises if a gain breaks its rule.
        """
        rows = np.ascontiguousarray(self.assumed(values))
        if rows.shape[1] != len(self.plant.parameters):
            rule = "is of the cart-pole; another plant takes lqr, or a controller of your own"
            raise InvalidValueError(f"controller {self.name!r}", rule)
        inputs: Floats = inputs_along(*self.compiled_for(_range_of(rows)), rows)
        return inputs

    def forces(self, states: Floats, inputs: Floats, times: Floats | None = None) -> Floats:
        """Return the force [N] at each of N states, shape (N, 4); NaN outside its domain.

        Inputs are those of `inputs_for`; only a Python controller uses the times [s]. Of several
        inputs, shape (N, k).
        """
        found = np.empty((len(states), len(self.plant.inputs)))
        rows = np.ascontiguousarray(states), np.ascontiguousarray(inputs)
        forces_along(self.kind, *rows, found)
        return found[:, 0] if found.shape[1] == 1 else found

    def saturation_ratio(self, states: Floats, inputs: Floats) -> Floats | None:
        """Return s / Phi at each of N states, for `forces`; None without a boundary layer."""
        return None


def _range_of(assumed: Floats) -> PlantRange:
    """Return the range of plants in rows of assumed (M, m, l, g), with m and g constant."""
    masses, lengths = (
        (float(column.min()), float(column.max())) for column in (assumed[:, 0], assumed[:, 2])
    )
    return PlantRange(masses, lengths, float(assumed[0, 1]), float(assumed[0, 3]))


# A controller along a segment of a run, as compiled loops call it at any time in it.

WINDOW, MOST_EVALUATIONS = 0.02, 20_000
"""Simulated time [s], and most calls of a controller in Python within it, where it is evaluated
continuously.

A step takes 12; the paper's controllers, whose force has kinks, need fewer than 1000. One
that is not a smooth function of the state needs more than any number.
"""


class Law(NamedTuple):
    """A controller along a segment."""

    kind: int
    # as of `CompiledController`, for those of the cart-pole
    table: Floats
    masses: Floats
    lengths: Floats
    home: float
    assumed: Floats  # what is assumed of the parameters, NaN for the true ones
    # of one that is affine: times at which its rows have a kink [s], and between these the rows as
    # polynomials of the share of the way, shapes (K,) and (K - 1, numbers, degree + 1)
    knots: Floats
    rows: Floats
    row: Floats  # work space
    address: int  # of one that is called


@jitable
def command(law, time, state, values, out):
    """Write the inputs of a controller at a time of the segment, NaN where it has none.

    values: The true parameters; overwritten by what the controller assumes of them.
    """
    for i in range(len(out)):
        out[i] = np.nan
    if law.kind == CALLED:
        call(law.address, time, state, out, values, out)
        return
    if law.kind == AFFINE:
        _row_at(law, time)
        force_from_inputs(AFFINE, state, law.row, out)
        return
    for i in range(len(values)):
        if not np.isnan(law.assumed[i]):
            values[i] = law.assumed[i]
    out[0] = compiled_force(
        law.kind, law.table, law.masses, law.lengths, law.home,
        state[0], state[1], state[2], state[3],
        (values[0], values[1], values[2], values[3]),
    )  # fmt: skip


@jitable
def _row_at(law, time):
    k = 0
    while k < len(law.rows) - 1 and time >= law.knots[k + 1]:
        k += 1
    share = (time - law.knots[k]) / (law.knots[k + 1] - law.knots[k])
    for i in range(len(law.row)):
        value = 0.0
        for j in range(law.rows.shape[2] - 1, -1, -1):
            value = value * share + law.rows[k, i, j]
        law.row[i] = value


class Laws:
    """A controller on a scenario, segment by segment."""

    def __init__(
        self, controller: Controller, scenario: Scenario, *, continuous: bool = True
    ) -> None:
        """Take a controller that is called continuously, or once for each step that it is held."""
        plant, self.controller, none = scenario.plant, controller, np.empty(0)
        count = len(plant.parameters)
        self.callback: Callback | None = None
        self._segment: Segment | None = None  # the one that the law of an affine one is along
        self._law = Law(AFFINE, np.empty((0, 0, 0)), none, none, 0.0, np.full(count, np.nan), none,
                        np.empty((0, 0, 0)), none, 0)  # fmt: skip
        if controller.interpreted or controller.stateful:
            own = controller.start()
            ask = _Counted(own) if continuous else _asked(own)
            sizes = len(plant.states), len(plant.inputs), count, len(plant.inputs)
            self.callback = Callback(ask, sizes)
            self._law = self._law._replace(kind=CALLED, address=self.callback.address)
        elif controller.kind != AFFINE:
            compiled = controller.compiled_for(scenario.plants)._asdict()
            assumed = controller.assumed(np.full(4, np.nan))
            self._law = self._law._replace(**compiled, assumed=assumed)

    def along(self, segment: Segment) -> Law:
        """Return it along a segment."""
        if self._law.kind != AFFINE:
            return self._law
        if segment is not self._segment:  # an integrator in Python asks for it at each stage
            knots, rows = self.controller.rows_along(segment)
            self._law = self._law._replace(knots=knots, rows=rows, row=np.empty(rows.shape[1]))
            self._segment = segment
        return self._law

    def watched(self) -> Any:
        """Return the block in which compiled code runs; it raises what the controller raises."""
        return nullcontext() if self.callback is None else self.callback.watched()


def _asked(own: Controller) -> Any:
    """Return a controller as a `Callback` calls it."""

    def ask(time: float, state: Floats, _: Floats, values: Floats, out: Floats) -> None:
        out[:] = own.command(time, state, own.assumed(values))

    return ask


class _Counted:
    """The same, which raises if it is called too often."""

    def __init__(self, own: Controller) -> None:
        self.ask, self.name = _asked(own), own.name
        self.count, self.until = 0, WINDOW

    def __call__(self, time: float, *rest: Any) -> None:
        if time >= self.until:
            self.count, self.until = 0, time + WINDOW
        self.count += 1
        if self.count > MOST_EVALUATIONS:
            rule = (
                "must give a force that is a smooth function of time and state where it is "
                "evaluated continuously, not one that is rounded (float32), switches, or remembers "
                f"earlier calls: at t = {time:g} s its run needs more than {MOST_EVALUATIONS} "
                f"evaluations for {WINDOW:g} s; only sampled mode runs it"
            )
            raise InvalidValueError(f"controller {self.name!r}", rule)
        self.ask(time, *rest)
