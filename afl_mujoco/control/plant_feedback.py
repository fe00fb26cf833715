"""Linear feedback of the state of any plant, about where it should be: the LQR by Bryson's rule."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import ArrayLike

from afl_mujoco.control.controller import AFFINE, Controller, force_from_inputs
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.scenario.scenario import Segment

NODES = 16
"""Gains are computed at so many values within the bounds of a parameter that ramps, and
interpolated between them."""

MOST_KNOWN = 4096  # designs that are kept for the runs of one plant to share
HOLDS = 1e-6  # share of the forces at rest that inputs may leave over


class Rest(NamedTuple):
    """A plant at rest: ``M v' + h(q, v) = B u`` and its slopes there."""

    mass: Floats  # M, shape (n, n)
    bias: Floats  # h, shape (n,)
    inputs: Floats  # B, shape (n, k)
    stiffness: Floats  # dh/dq - d(B u)/dq at the holding input, shape (n, n)
    damping: Floats  # dh/dv, shape (n, n)


def holding_input(bias: Floats, inputs: Floats, limits: Floats) -> tuple[Floats, Floats]:
    """Return the inputs that hold a plant at rest, ``B u = h``, and the forces they leave over.

    They are the smallest; where these are not within `limits`, shape (k, 2), some that are, if
    there are any, and a quarter of the range away from them, if there are such.
    """
    held = np.asarray(np.linalg.lstsq(inputs, bias, rcond=None)[0], dtype=np.float64)
    low, high = limits.T
    if np.any((held < low) | (held > high)) and len(held) > 1:
        from scipy.optimize import lsq_linear  # a third of a second to import

        quarter = np.where(np.isfinite(high - low), 0.25 * (high - low), 0.0)
        for spare in (quarter, 0.0):
            bounds = low + spare, high - spare
            within = lsq_linear(inputs, bias, bounds, method="bvls", tol=1e-14).x
            if np.abs(bias - inputs @ within).max() <= HOLDS * max(1.0, np.abs(bias).max()):
                return within, bias - inputs @ within
    return held, bias - inputs @ held


def linear_model(rest: Rest) -> tuple[Floats, Floats]:
    """Return A and B of ``x' = A x + B u`` about rest, shapes (2n, 2n) and (2n, k)."""
    n = len(rest.bias)
    a, b = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, rest.inputs.shape[1]))
    a[:n, n:] = np.eye(n)
    a[n:, :n] = -np.linalg.solve(rest.mass, rest.stiffness)
    a[n:, n:] = -np.linalg.solve(rest.mass, rest.damping)
    b[n:] = np.linalg.solve(rest.mass, rest.inputs)
    return a, b


RestOf = Callable[[Floats], Rest]  # the plant at rest at its target with some parameters


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearFeedback(Controller):
    """An LQR of any plant, about its target, with gains for the parameters that it is told.

    States are weighted by the inverse squares of `largest`, inputs by those of `most`.
    """

    name: str
    plant: Plant
    rest: RestOf
    target: tuple[float, ...]  # of the coordinates
    largest: tuple[float, ...]  # of the states
    most: tuple[float, ...]  # of the inputs; 0 for that of holding the plant
    grids: Mapping[int, tuple[float, float]]  # first node and spacing of parameters with ramps
    known: dict[bytes, Floats]  # designs by parameters, shared by runs
    rows: dict[bytes, Floats] = field(default_factory=dict, repr=False)  # of `command`

    @property
    def kind(self) -> int:
        """Feedback that is affine in the state."""
        return AFFINE

    def gains(self, values: Floats) -> tuple[Floats, Floats]:
        """Return the holding input (k,) and the gains (k, 2n) for some parameters."""
        from scipy.linalg import solve_continuous_are  # a third of a second to import

        rest = self.rest(values)
        thing = f"controller {self.name!r}"
        if not self.plant.inputs:
            raise InvalidValueError(thing, "must have an input, but the plant has none")
        held, left = holding_input(rest.bias, rest.inputs, self.plant.limits)
        worst = int(np.abs(left).argmax())
        if abs(left[worst]) > HOLDS * max(1.0, float(np.abs(rest.bias).max())):
            name = self.plant.coordinates[worst]
            rule = f"must be able to hold the plant at its target, but no input holds {name} there"
            unit = "N" if self.plant.units[name] == "m" else "N m"
            raise InvalidValueError(thing, rule, f"{left[worst]:.4g} {unit} that is left over")
        a, b = linear_model(rest)
        weights = np.array([x if x else max(float(np.abs(held).max()), 1.0) for x in self.most])
        states = np.diag([x**-2 for x in self.largest])
        try:
            cost = solve_continuous_are(a, b, states, np.diag(weights**-2))
        except (LinAlgError, ValueError) as error:
            rule = f"must be able to stabilise the plant at its target: {error}"
            raise InvalidValueError(thing, rule) from None
        return held, np.asarray(weights[:, None] ** 2 * (b.T @ cost))

    def _at(self, values: Floats) -> Floats:
        """Return holding inputs and gains at some parameters, those of the nodes interpolated."""
        corners = [(1.0, values.copy())]
        for i, (first, spacing) in self.grids.items():
            place = (values[i] - first) / spacing
            share, low = place - np.floor(place), first + spacing * np.floor(place)
            several = []
            for weight, corner in corners:
                for part, at in ((1.0 - share, low), (share, low + spacing)):
                    if part > 0.0:
                        other = corner.copy()
                        other[i] = at
                        several.append((weight * part, other))
            corners = several
        parts = [weight * _once(self._designed, corner, self.known) for weight, corner in corners]
        return np.asarray(np.sum(parts, axis=0))

    def _designed(self, values: Floats) -> Floats:
        held, gains = self.gains(values)
        return np.concatenate([held, gains.ravel()])

    def nodes_within(self, spans: Mapping[str, tuple[float, float]]) -> dict[str, Floats]:
        """Return the values of parameters at which the gains are not smooth, by name."""
        found = {}
        for i, (first, spacing) in self.grids.items():
            low, high = spans[name := list(spans)[i]]
            places = np.arange(np.ceil((low - first) / spacing), (high - first) / spacing + 1.0)
            found[name] = first + spacing * places
        return found

    def rows_along(self, segment: Segment) -> tuple[Floats, Floats]:
        """Return the rows along a segment: between nodes, polynomials of the share of the way."""
        names = list(self.plant.parameters)
        ends = np.sort([segment.values_at(segment.start), segment.values_at(segment.end)], axis=0)
        nodes = self.nodes_within(dict(zip(names, zip(*ends.tolist(), strict=True), strict=True)))
        times = np.array([segment.start, *segment.passes(names, nodes), segment.end])
        degree = sum(segment.lines[i][1] != 0.0 for i in self.grids)
        shares = np.linspace(0.0, 1.0, degree + 1)
        powers, rows = np.vander(shares, increasing=True), []
        for start, end in itertools.pairwise(times.tolist()):
            table = [self._row(segment.values_at(start + x * (end - start))) for x in shares]
            rows.append(np.linalg.solve(powers, np.array(table)).T)
        return times, np.array(rows)

    def inputs_for(self, values: Floats) -> Floats:
        """Return holding inputs, gains, target and turns for rows of parameters."""
        distinct, which = np.unique(values, axis=0, return_inverse=True)
        return np.array([self._row(row) for row in distinct])[which.reshape(-1)]

    def _row(self, values: Floats) -> Floats:
        turns = [2.0 * math.pi * (name in self.plant.wraps) for name in self.plant.coordinates]
        none = np.zeros(len(turns))
        return np.concatenate([self._at(values), self.target, none, turns, none])

    def command(self, time: float, state: ArrayLike, assumed: Floats) -> Any:
        """Return the inputs at a state and assumed parameters, shape (k,)."""
        row = _once(self._row, np.asarray(assumed), self.rows)
        found = np.empty(len(self.plant.inputs))
        force_from_inputs(AFFINE, np.array(state, dtype=np.float64), row, found)
        return found

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance."""
        return {
            "name": self.name,
            "formula": "u = u0(p) - K(p) (x - target), wraps the shorter way",
            "gains": {
                "method": "LQR by Bryson's rule",
                "largest_state": list(self.largest),
                "largest_input": list(self.most),
            },
            "belief": "true",
        }


def _once(make: Callable[[Floats], Floats], values: Floats, known: dict[bytes, Floats]) -> Floats:
    """Return what is made of some parameters, from what is known of them or computed now."""
    if (found := known.get(key := values.tobytes())) is None:
        found = make(values)
        if len(known) >= MOST_KNOWN:
            known.clear()
        known[key] = found
    return found


def largest_of(limits: Mapping[str, float], bands: Mapping[str, float]) -> tuple[float, ...]:
    """Return the largest states by Bryson's rule: as required, else ten bands, and as fast."""
    found = {name: limits.get(name, 10.0 * band) for name, band in bands.items()}
    rates = [limits.get(f"{name}_dot", 5.0 * x) for name, x in found.items()]
    return (*found.values(), *rates)
