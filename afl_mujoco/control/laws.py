"""A controller along a segment of a run, as compiled loops call it at any time in it."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import Callback, call, jitable
from afl_mujoco.control.controller import (
    AFFINE,
    CALLED,
    Controller,
    compiled_force,
    force_from_inputs,
)
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.scenario import Scenario, Segment

Floats = NDArray[np.float64]

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
        law.kind, law.table, law.masses, law.lengths, state[0], state[1], state[2], state[3],
        (values[0], values[1], values[2], values[3]),
    )  # fmt: skip


@jitable
def _row_at(law, time):
    """Write the row of an affine controller at a time."""
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
        self._law = Law(AFFINE, np.empty((0, 0, 0)), none, none, np.full(count, np.nan), none,
                        np.empty((0, 0, 0)), none, 0)  # fmt: skip
        if controller.interpreted or controller.stateful:
            own = controller.start()
            ask = _Counted(own) if continuous else _asked(own)
            sizes = len(plant.states), len(plant.inputs), count, len(plant.inputs)
            self.callback = Callback(ask, sizes)
            self._law = self._law._replace(kind=CALLED, address=self.callback.address)
        elif controller.kind != AFFINE:
            compiled = controller.compiled_for(scenario.plants)._asdict()
            assumed = np.array(controller.assumed_parameters(*[np.nan] * 4))
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
        out[:] = own.command(time, state, own.assumed_values(values))

    return ask


class _Counted:
    """The same, which raises if it is called too often."""

    def __init__(self, own: Controller) -> None:
        self.ask, self.name = _asked(own), own.name
        self.count, self.until = 0, WINDOW

    def __call__(self, time: float, *rest: Any) -> None:
        """Write the inputs."""
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
