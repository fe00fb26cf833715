"""Least squares for parameters that all windows share and an initial state of each window.

A start acts on its own window alone, so that starts are eliminated window by window, exactly:
SciPy's trust region on the whole sparse problem solves iteratively what is solved here directly.
The covariance is that of the jackknife by logs: readings of one log are not independent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

Array = NDArray[np.float64]
Errors = Callable[[Array, Array], Array]
"""``errors(shared, starts)``: of predicted readings, shapes (p,) and (B, L) to (B, C, n)."""

ROBUST = 3.0  # beyond so many scatters residuals count by size, not by square
LEAST_SCATTER = 1e-12  # least scatter of residuals: those of a simulation may be zero
SETTLED = 0.05  # relative change of the scatter below which it has converged
ROUNDS, EVALUATIONS = 6, 8  # most rounds to find the scatter, and most steps in each
FEW_CLUSTERS = 8  # fewer logs, and windows count as independent, for want of better
STEP = 1e-4  # step of a finite difference, relative to the scale of its variable
FIRST_DAMPING, LARGEST_DAMPING = 1e-4, 1e6  # of Levenberg and Marquardt's method
LEAST_CURVATURE = 1e-10  # of parameters scaled to 1, below which a direction is not determined
ON_BOUND = 1e-6  # distance from a bound within which a value is on it, relative to its scale
TOLERANCE = 1e-4  # relative decrease of the cost below which the fit has converged

CONFIDENCE = 0.95
SURE = 0.999  # that a parameter is needed at all


class Parameter(NamedTuple):
    """A parameter to be estimated; one whose bounds are equal is held there."""

    name: str  # name and unit in files and tables
    unit: str
    title: str  # name in words
    start: float  # first guess and bounds
    low: float
    high: float
    scale: float  # scale of its changes

    def held(self, value: float) -> Parameter:
        """Return the parameter held at a value."""
        return self._replace(start=value, low=value, high=value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """An estimate with its interval."""

    name: str  # name, title and unit of the parameter
    title: str
    unit: str
    value: float  # the estimate, and its interval of 95 %
    low: float
    high: float
    # whether the estimate lies on a bound of its parameter, so that there is no interval
    on_bound: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """The result of a least-squares fit."""

    parameters: Sequence[Parameter]  # parameters that were estimated
    values: Array  # estimates, shape (p,)
    # covariance of the estimates, shape (p, p); zero for one on a bound, infinite variances of what
    # the data do not determine
    covariance: Array
    on_bound: NDArray[np.bool_]  # which estimates lie on a bound, shape (p,)
    degrees: int  # degrees of freedom of the covariance
    starts: Array  # initial states of the windows, shape (B, L)
    residuals: Array  # residuals in units of their scatter, shape (B, R)
    scatter: Array  # robust scatter of each signal, shape (C,)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The estimates with their intervals by name."""
        named = [one[:3] for one in self.parameters]
        return intervals(named, self.values, self.errors, self.on_bound, self.degrees)

    @property
    def by_name(self) -> dict[str, float]:
        """The estimates by name."""
        return {name: one.value for name, one in self.estimates.items()}

    @property
    def errors(self) -> Array:
        """Standard errors, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlations(self) -> Array:
        """Correlations of the estimates, shape (p, p); zero with one that lies on a bound."""
        errors = np.where(self.errors > 0.0, self.errors, np.inf)
        return np.asarray(self.covariance / np.outer(errors, errors) + np.diag(errors == np.inf))


def intervals(
    named: Sequence[tuple[str, str, str]], values: Array, errors: Array, on_bound: Any, degrees: int
) -> dict[str, Estimate]:
    """Return estimates by name, from names, units and titles, with intervals of `CONFIDENCE`."""
    halves = errors * float(student.ppf(0.5 + 0.5 * CONFIDENCE, degrees))
    columns = values.tolist(), halves.tolist(), on_bound.tolist()
    return {
        name: Estimate(
            name=name, title=title, unit=unit, value=value, low=value - half, high=value + half,
            on_bound=bound,
        )
        for (name, unit, title), value, half, bound in zip(named, *columns, strict=True)
    }  # fmt: skip


class Problem(NamedTuple):
    """What is fitted: readings of windows, each with a start of its own."""

    errors: Errors
    smooth: Errors  # the errors that give the derivatives
    mask: Array  # 1 where a reading is valid, 0 elsewhere, shape (B, C, n)
    clusters: NDArray[np.int64]  # the index of the log of each window, shape (B,)
    start_scale: Array  # scale of the changes of a start, shape (L,)

    def residuals(
        self, shared: Array, starts: Array, scatter: Array, errors: Errors | None = None
    ) -> Array:
        """Return the errors in units of their scatter, shape (B, R)."""
        off = (errors or self.errors)(shared, starts)
        return (self.mask * off / scatter[:, None]).reshape(len(self.mask), -1)

    def scatter(self, errors: Array) -> Array:
        """Return the scatter of each signal from the median of its absolute values, shape (C,)."""
        sizes = [np.abs(errors[:, i][self.mask[:, i] > 0.0]) for i in range(self.mask.shape[1])]
        return np.maximum([1.4826 * np.median(one) for one in sizes], LEAST_SCATTER)

    def reduced(
        self, values: Array, starts: Array, scales: Array, scatter: Array, rest: Array
    ) -> _Reduced:
        """Return the problem about a point, for weights that make it robust."""
        return _reduced(*self.derivatives(values, starts, scales, scatter), rest, _weights(rest))

    def derivatives(
        self, values: Array, starts: Array, scales: Array, scatter: Array
    ) -> tuple[Array, Array]:
        """Return the finite-difference derivatives in the shared parameters and in the starts."""
        near = partial(self.residuals, scatter=scatter, errors=self.smooth)
        base = near(values, starts)
        by_shared = _slopes(lambda x: near(x, starts), values, base, STEP * scales)
        return by_shared, _slopes(lambda x: near(values, x), starts, base, STEP * self.start_scale)


def fit_to_scatter(problem: Problem, parameters: Sequence[Parameter], starts: Array) -> Fit:
    """Estimate parameters and the unknown scatter of the signals, alternately."""
    now, scatter = parameters, np.full(problem.mask.shape[1], np.inf)
    for _ in range(ROUNDS):
        rest = problem.errors(np.array([one.start for one in now]), starts)
        before, scatter = scatter, problem.scatter(rest)
        found = fit(problem, now, starts, scatter)
        starts = found.starts
        now = [one._replace(start=x) for one, x in zip(now, found.values.tolist(), strict=True)]
        if (np.abs(scatter / before - 1.0) <= SETTLED).all():
            break
    final = found.residuals.reshape(problem.mask.shape) * scatter[:, None]
    return replace(found, parameters=parameters, scatter=problem.scatter(final))


def fit(problem: Problem, parameters: Sequence[Parameter], starts: Array, scatter: Array) -> Fit:
    """Estimate parameters by the Levenberg-Marquardt method, from a first guess of the starts."""
    scales = np.array([one.scale for one in parameters])
    low, high = (np.array([getattr(one, end) for one in parameters]) for end in ("low", "high"))
    values = np.clip([one.start for one in parameters], low, high)
    rest = problem.residuals(values, starts, scatter)
    cost, damping = _cost(rest), FIRST_DAMPING
    for _ in range(EVALUATIONS):
        system = problem.reduced(values, starts, scales, scatter, rest)
        down, up = system.gradient > 0.0, system.gradient < 0.0
        stuck = ((values <= low) & down) | ((values >= high) & up)
        before = cost
        while cost == before and damping < LARGEST_DAMPING:
            ahead = np.clip(values + system.step(damping, ~stuck), low, high)
            own = system.own_step(ahead - values, low < high)
            ahead_starts = starts + own / max(1.0, damping)  # they may be far off, too
            tried = problem.residuals(ahead, ahead_starts, scatter)
            if (now := _cost(tried)) < cost:
                values, starts, rest, cost = ahead, ahead_starts, tried, now
                damping = max(0.1 * damping, FIRST_DAMPING**2)
            else:
                damping *= 10.0
        if before - cost <= TOLERANCE * before:
            break
    on_bound = np.minimum(values - low, high - values) <= ON_BOUND * scales
    slopes = problem.derivatives(values, starts, scales, scatter)
    covariance, degrees = _covariance(*slopes, rest, problem.clusters, ~on_bound)
    return Fit(
        parameters=parameters, values=values, covariance=covariance, on_bound=on_bound,
        degrees=degrees, starts=starts, residuals=rest, scatter=scatter,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Reduced:
    """The linear least-squares problem about a point, with the starts of the windows eliminated."""

    # weighted derivatives with respect to the shared parameters, projected off those with respect
    # to the starts, and weighted residuals, shapes (B, R, p) and (B, R)
    slopes: Array
    rest: Array
    # weighted derivatives before the projection, and the QR decomposition of those with respect to
    # the starts
    shared: Array
    q: Array
    r: Array

    @property
    def matrix(self) -> Array:
        """Gauss-Newton matrix, shape (p, p)."""
        return np.asarray(np.einsum("bri,brj->ij", self.slopes, self.slopes))

    @property
    def gradient(self) -> Array:
        """Gradient of half the cost, shape (p,)."""
        return np.asarray(np.einsum("bri,br->i", self.slopes, self.rest))

    def step(self, damping: float, free: NDArray[np.bool_]) -> Array:
        """Return the step of the shared parameters, zero unless free, shape (p,)."""
        matrix = self.matrix[np.ix_(free, free)]
        if not np.isfinite(matrix).all():
            raise np.linalg.LinAlgError("the residuals overflow")
        found = np.zeros(len(free))
        damped = matrix + damping * np.diag(np.diag(matrix))
        found[free] = -np.linalg.lstsq(damped, self.gradient[free], rcond=None)[0]
        return found

    def own_step(self, step: Array, free: NDArray[np.bool_]) -> Array:
        """Return the step of the starts for one of the free shared parameters, shape (B, L)."""
        rest = self.rest + self.shared.compress(free, axis=2) @ step.compress(free)
        right = np.swapaxes(self.q, 1, 2) @ rest[..., None]
        return np.asarray(-np.linalg.solve(self.r, right)[..., 0])


def _reduced(shared: Array, own: Array, rest: Array, weights: Array) -> _Reduced:
    root = np.sqrt(weights)
    shared, own = root[..., None] * shared, root[..., None] * own
    q, r = np.linalg.qr(own)
    slopes = shared - q @ (np.swapaxes(q, 1, 2) @ shared)
    return _Reduced(slopes=slopes, rest=root * rest, shared=shared, q=q, r=r)


def with_uncertainty_of(problem: Problem, fit: Fit, known: Fit) -> Fit:
    """Return a fit whose covariance includes that of the parameters taken as known.

    The problem is of the parameters of the fit followed by those that are known.
    """
    p = len(fit.values)
    scales = np.array([one.scale for one in (*fit.parameters, *known.parameters)])
    values = np.concatenate([fit.values, known.values])
    rest = problem.residuals(values, fit.starts, fit.scatter)
    matrix = problem.reduced(values, fit.starts, scales, fit.scatter, rest).matrix
    free = np.flatnonzero(~fit.on_bound)
    shift = np.zeros((p, len(known.values)))
    shift[free] = -_inverse(matrix[np.ix_(free, free)])[0] @ matrix[free, p:]
    return replace(fit, covariance=fit.covariance + shift @ known.covariance @ shift.T)


def is_better(problem: Problem, fit: Fit, other: Fit) -> bool:
    """Return whether a fit of one parameter more than another explains more than noise would.

    By the likelihood ratio at the scatter of the other, at `SURE`: readings are not independent.
    """
    one, two = (_cost(problem.residuals(x.values, x.starts, other.scatter)) for x in (other, fit))
    free = fit.values.size + fit.starts.size
    degrees = max(1, int(np.count_nonzero(problem.mask)) - free)
    beyond = float(student.ppf(0.5 + 0.5 * SURE, degrees)) ** 2
    return bool(one - two > beyond * two / degrees)


def by_cluster(problem: Problem, fit: Fit, name: str) -> list[tuple[float, float]]:
    """Return an estimate from each cluster alone, and its standard error, to first order.

    The other parameters stay as fitted to all. Windows count as independent, and their scatter, in
    units of what each tells, is that of all clusters: a cluster may have a single one.
    """
    at = [one.name for one in fit.parameters].index(name)
    scales = np.array([one.scale for one in fit.parameters])
    rest = problem.residuals(fit.values, fit.starts, fit.scatter)
    system = problem.reduced(fit.values, fit.starts, scales, fit.scatter, rest)
    slopes, clusters = system.slopes[:, :, at], problem.clusters
    told, scores = np.sum(slopes**2, axis=1), np.sum(slopes * system.rest, axis=1)
    groups, which = np.unique(clusters, return_inverse=True)
    curvature = np.bincount(which, told)
    steps = -np.bincount(which, scores) / curvature
    left = (scores + steps[which] * told) ** 2 / np.maximum(told, np.finfo(float).tiny)
    degrees = len(clusters) - len(groups)
    errors = np.sqrt(left.sum() / degrees / curvature) if degrees else np.full(len(groups), np.inf)
    return [*zip((fit.values[at] + steps).tolist(), errors.tolist(), strict=True)]


def fitted_starts(
    residuals: Callable[[Array], Array], starts: Array, start_scale: Array, *, rounds: int = 6
) -> Array:
    """Return the starts, shape (B, L), that minimise the residuals of the windows, (B, R)."""
    for _ in range(rounds):
        rest = residuals(starts)
        slopes = _slopes(residuals, starts, rest, STEP * start_scale)
        system = _reduced(np.empty((*rest.shape, 0)), slopes, rest, _weights(rest))
        starts = starts + system.own_step(np.empty(0), np.empty(0, bool))
    return starts


def _slopes(function: Callable[[Array], Array], point: Array, base: Array, steps: Array) -> Array:
    """Return the derivatives of residuals by the last axis of a point, shape (B, R, len(steps))."""
    slopes = np.empty((*base.shape, len(steps)))
    for i, step in enumerate(steps):
        ahead = point.copy()
        ahead[..., i] += step
        slopes[..., i] = (function(ahead) - base) / step
    return slopes


def _weights(rest: Array) -> Array:
    return np.asarray(1.0 / np.sqrt(1.0 + (rest / ROBUST) ** 2))


def _cost(rest: Array) -> float:
    """Return the sum of the squares of small residuals and the absolute values of large ones."""
    with np.errstate(over="ignore", invalid="ignore"):
        cost = float(np.sum(2.0 * ROBUST**2 * (np.sqrt(1.0 + (rest / ROBUST) ** 2) - 1.0)))
    return cost if np.isfinite(cost) else np.inf


def _covariance(
    shared: Array, own: Array, rest: Array, clusters: NDArray[np.int64], free: NDArray[np.bool_]
) -> tuple[Array, int]:
    """Return the covariance of the shared parameters, and its degrees of freedom.

    The jackknife, to first order: how the estimates move as each log is left out. With few logs, or
    with one that alone tells a parameter, the windows are left out instead. Times the readings by
    those that the starts leave.
    """
    weights = _weights(rest)
    curvature = weights**3  # the derivative of a residual's influence, ``weights * rest``
    system = _reduced(shared[..., free], own, rest, curvature)
    told = np.einsum("bri,brj->bij", system.slopes, system.slopes)
    undone = system.slopes / np.sqrt(curvature)[..., None]
    scores = np.einsum("bri,br->bi", undone, weights * rest)
    moved, endless = _left_out(told, scores, clusters)
    if len(moved) < FEW_CLUSTERS or endless.any():
        moved, endless = _left_out(told, scores, np.arange(len(rest)))
    degrees = max(1, len(moved) - 1)
    known = np.count_nonzero(np.abs(own).sum(axis=2))  # masked readings depend on nothing
    factor = degrees / len(moved) * known / max(1, known - own.shape[0] * own.shape[2])
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = factor * moved.T @ moved + np.diag(endless)
    return covariance, degrees


def _left_out(told: Array, scores: Array, groups: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return how the estimates move without each group, and the variances that have no end."""
    whole, moved, endless = told.sum(axis=0), [], np.zeros(told.shape[1])
    for group in np.unique(groups):
        mine = groups == group
        bread, unknown = _inverse(whole - told[mine].sum(axis=0))
        moved.append(bread @ scores[mine].sum(axis=0))
        endless = np.maximum(endless, unknown)
    return np.array(moved), endless


def _inverse(matrix: Array) -> tuple[Array, Array]:
    """Return the inverse of a Gauss-Newton matrix, and the variances that have no end.

    What only changes together without a change of the residuals is not determined: zero in the
    inverse, as in the pseudo-inverse, would say that it is known exactly.
    """
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    flat = values < LEAST_CURVATURE
    kept = vectors[:, ~flat] / scale[:, None]
    moved = np.abs(vectors[:, flat]).max(axis=1, initial=0.0) > np.sqrt(LEAST_CURVATURE)
    return kept / values[~flat] @ kept.T, np.where(moved, np.inf, 0.0)


def explained(errors: Array, readings: Array) -> float:
    """Return the share of variance that a prediction explains."""
    total = float(np.sum((readings - readings.mean()) ** 2))
    return 1.0 - float(np.sum(errors**2)) / total if total > 0.0 else 0.0
