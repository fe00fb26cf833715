"""Least squares for parameters that all windows share and an initial state of each window.

A start acts on its own window alone, so that starts are eliminated window by window, exactly:
SciPy's trust region on the whole sparse problem solves iteratively what is solved here directly.
The covariance is that of clustered observations: readings of one log are not independent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

Array = NDArray[np.float64]
Residuals = Callable[[Array, Array], Array]
"""``residuals(shared, starts)``: shapes (p,) and (B, L) to (B, R), in units of their scatter."""

ROBUST = 3.0  # beyond so many scatters residuals count by size, not by square
LEAST_SCATTER = 1e-12  # least scatter of residuals: those of a simulation may be zero
SETTLED = 0.05  # relative change of the scatter below which it has converged
ROUNDS = 6  # largest number of rounds to find the scatter
FEW_CLUSTERS = 8  # fewer logs, and windows count as independent, for want of better
STEP = 1e-4  # step of a finite difference, relative to the scale of its variable
FIRST_DAMPING, LARGEST_DAMPING = 1e-4, 1e6  # of Levenberg and Marquardt's method
TOLERANCE = 1e-4  # relative decrease of the cost below which the fit has converged

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter to be estimated."""

    name: str  # name and unit in files and tables
    unit: str
    title: str  # name in words
    start: float  # first guess and bounds
    low: float
    high: float
    scale: float  # scale of its changes


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
    covariance: Array  # covariance of the estimates, shape (p, p); zero for an estimate on a bound
    on_bound: NDArray[np.bool_]  # which estimates lie on a bound, shape (p,)
    degrees: int  # degrees of freedom of the covariance
    starts: Array  # initial states of the windows, shape (B, L)
    residuals: Array  # residuals in units of their scatter, shape (B, R)
    scatter: Array  # robust scatter of each signal, shape (C,)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The estimates with their intervals by name."""
        columns = self.values.tolist(), self.half_widths.tolist(), self.on_bound.tolist()
        return {
            one.name: Estimate(
                name=one.name, title=one.title, unit=one.unit, value=value,
                low=value - half, high=value + half, on_bound=on_bound,
            )
            for one, value, half, on_bound in zip(self.parameters, *columns, strict=True)
        }  # fmt: skip

    @property
    def by_name(self) -> dict[str, float]:
        """The estimates by name."""
        return {name: one.value for name, one in self.estimates.items()}

    @property
    def errors(self) -> Array:
        """Standard errors, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def half_widths(self) -> Array:
        """Half-widths of the intervals of `CONFIDENCE`, shape (p,)."""
        return half_widths(self.errors, self.degrees)

    @property
    def correlations(self) -> Array:
        """Correlations of the estimates, shape (p, p); zero with one that lies on a bound."""
        errors = np.where(self.errors > 0.0, self.errors, np.inf)
        return np.asarray(self.covariance / np.outer(errors, errors) + np.diag(errors == np.inf))


def half_widths(errors: Array, degrees: int) -> Array:
    """Return the half-widths of the intervals of `CONFIDENCE` for standard errors, shape (p,)."""
    return np.asarray(errors * float(student.ppf(0.5 + 0.5 * CONFIDENCE, degrees)))


def fit_to_scatter(
    errors: Residuals,
    mask: Array,
    parameters: Sequence[Parameter],
    starts: Array,
    clusters: NDArray[np.int64],
    *,
    start_scale: Array,
    smooth: Residuals | None = None,
) -> Fit:
    """Estimate parameters and the unknown scatter of the signals, alternately.

    mask: 1 where a reading is valid, 0 elsewhere, shape (B, C, n).
    """
    now, scatter = list(parameters), np.full(mask.shape[1], np.inf)
    for _ in range(ROUNDS):
        rest = errors(np.array([one.start for one in now]), starts)
        before, scatter = scatter, _scatter(rest, mask)
        found = fit(
            _in_scatters(errors, mask, scatter), now, starts, clusters, start_scale=start_scale,
            evaluations=8, smooth=_in_scatters(smooth or errors, mask, scatter),
        )  # fmt: skip
        starts = found.starts
        now = [
            replace(one, start=float(value)) for one, value in zip(now, found.values, strict=True)
        ]
        if (np.abs(scatter / before - 1.0) <= SETTLED).all():
            break
    final = found.residuals.reshape(mask.shape) * scatter[:, None]
    return replace(found, parameters=parameters, scatter=_scatter(final, mask))


def _in_scatters(errors: Residuals, mask: Array, scatter: Array) -> Residuals:
    """Return errors, shape (B, C, n), as residuals in units of their scatter, shape (B, R)."""
    return lambda *at: (mask * errors(*at) / scatter[:, None]).reshape(len(mask), -1)


def _scatter(rest: Array, mask: Array) -> Array:
    """Return the scatter of each signal from the median of its absolute values, shape (C,)."""
    sizes = [np.abs(rest[:, i][mask[:, i] > 0.0]) for i in range(mask.shape[1])]
    return np.array([max(1.4826 * float(np.median(one)), LEAST_SCATTER) for one in sizes])


def fit(
    residuals: Residuals,
    parameters: Sequence[Parameter],
    starts: Array,
    clusters: NDArray[np.int64],
    *,
    start_scale: Array,
    evaluations: int = 20,
    smooth: Residuals | None = None,
) -> Fit:
    """Estimate parameters by the Levenberg-Marquardt method, from a first guess of the starts.

    The clusters are the index of the log of each window, shape (B,).
    """
    near = smooth or residuals
    scales = np.array([one.scale for one in parameters])
    steps, own_steps = STEP * scales, STEP * start_scale
    low, high = (np.array([getattr(one, end) for one in parameters]) for end in ("low", "high"))
    values = np.clip([one.start for one in parameters], low, high)
    rest = residuals(values, starts)
    cost, damping = _cost(rest), FIRST_DAMPING
    for _ in range(evaluations):
        slopes = derivatives(near, values, starts, steps, own_steps)
        system = _reduced(*slopes, rest, _weights(rest))
        stuck = ((values <= low) & (system.gradient > 0.0)) | (
            (values >= high) & (system.gradient < 0.0)
        )
        before = cost
        while cost == before and damping < LARGEST_DAMPING:
            ahead = np.clip(values + system.step(damping, ~stuck), low, high)
            ahead_starts = starts + system.own_step(ahead - values)
            tried = residuals(ahead, ahead_starts)
            if (now := _cost(tried)) < cost:
                values, starts, rest, cost = ahead, ahead_starts, tried, now
                damping = max(0.1 * damping, FIRST_DAMPING**2)
            else:
                damping *= 10.0
        if before - cost <= TOLERANCE * before:
            break
    on_bound = np.minimum(values - low, high - values) <= 1e-3 * scales
    covariance, degrees = _covariance(
        *derivatives(near, values, starts, steps, own_steps), rest, clusters, ~on_bound
    )
    return Fit(
        parameters=parameters, values=values, covariance=covariance, on_bound=on_bound,
        degrees=degrees, starts=starts, residuals=rest, scatter=np.ones(1),
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
        found = np.zeros(len(free))
        damped = matrix + damping * np.diag(np.diag(matrix))
        found[free] = -np.linalg.lstsq(damped, self.gradient[free], rcond=None)[0]
        return found

    def own_step(self, step: Array) -> Array:
        """Return the step of the starts for a step of the shared parameters, shape (B, L)."""
        rest = self.rest + self.shared @ step
        right = np.swapaxes(self.q, 1, 2) @ rest[..., None]
        return np.asarray(-np.linalg.solve(self.r, right)[..., 0])


def _reduced(shared: Array, own: Array, rest: Array, weights: Array) -> _Reduced:
    root = np.sqrt(weights)
    shared, own = root[..., None] * shared, root[..., None] * own
    q, r = np.linalg.qr(own)
    slopes = shared - q @ (np.swapaxes(q, 1, 2) @ shared)
    return _Reduced(slopes=slopes, rest=root * rest, shared=shared, q=q, r=r)


def with_uncertainty_of(
    errors: Residuals,
    mask: Array,
    fit: Fit,
    known: Fit,
    *,
    start_scale: Array,
    smooth: Residuals | None = None,
) -> Fit:
    """Return a fit whose covariance includes that of the parameters taken as known.

    errors, smooth: Of the parameters of the fit followed by those that are known, and the starts.
    """
    p = len(fit.values)
    scales = np.array([one.scale for one in (*fit.parameters, *known.parameters)])
    values = np.concatenate([fit.values, known.values])
    near = _in_scatters(smooth or errors, mask, fit.scatter)
    rest = _in_scatters(errors, mask, fit.scatter)(values, fit.starts)
    slopes = derivatives(near, values, fit.starts, STEP * scales, STEP * start_scale)
    matrix = _reduced(*slopes, rest, _weights(rest)).matrix
    free = np.flatnonzero(~fit.on_bound)
    shift = np.zeros((p, len(known.values)))
    shift[free] = -np.linalg.pinv(matrix[np.ix_(free, free)]) @ matrix[free, p:]
    return replace(fit, covariance=fit.covariance + shift @ known.covariance @ shift.T)


def by_cluster(
    errors: Residuals,
    mask: Array,
    fit: Fit,
    name: str,
    clusters: NDArray[np.int64],
    *,
    start_scale: Array,
) -> tuple[Array, Array]:
    """Return an estimate from each cluster alone, and its standard error, to first order.

    The other parameters stay as fitted to all; the windows of a cluster count as independent.
    """
    at = [one.name for one in fit.parameters].index(name)

    def of_one(shared: Array, own: Array) -> Array:
        values = fit.values.copy()
        values[at] = shared[0]
        return errors(values, own)

    value, scaled = fit.values[at : at + 1], _in_scatters(of_one, mask, fit.scatter)
    rest = scaled(value, fit.starts)
    steps = np.array([STEP * fit.parameters[at].scale])
    slopes = derivatives(scaled, value, fit.starts, steps, STEP * start_scale)
    system = _reduced(*slopes, rest, _weights(rest))
    slope = system.slopes[..., 0]
    values, sizes = [], []
    for cluster in np.unique(clusters):
        mine = clusters == cluster
        curvature = float(np.sum(slope[mine] ** 2))
        step = -float(np.sum(slope[mine] * system.rest[mine])) / curvature
        scores = np.sum(slope[mine] * (system.rest[mine] + step * slope[mine]), axis=1)
        spread = np.sqrt(np.sum(scores**2) * len(scores) / max(1, len(scores) - 1))
        values.append(float(value[0]) + step)
        sizes.append(float(spread) / curvature)
    return np.array(values), np.array(sizes)


def fitted_starts(
    residuals: Callable[[Array], Array], starts: Array, start_scale: Array, *, rounds: int = 6
) -> Array:
    """Return the starts, shape (B, L), that minimise the residuals of the windows, (B, R)."""
    for _ in range(rounds):
        rest = residuals(starts)
        slopes = _slopes(residuals, starts, rest, STEP * start_scale)
        system = _reduced(np.empty((*rest.shape, 0)), slopes, rest, _weights(rest))
        starts = starts + system.own_step(np.empty(0))
    return starts


def derivatives(
    residuals: Residuals, shared: Array, starts: Array, steps: Array, own_steps: Array
) -> tuple[Array, Array]:
    """Return the finite-difference derivatives in the shared parameters and in the starts."""
    base = residuals(shared, starts)
    by_shared = _slopes(lambda x: residuals(x, starts), shared, base, steps)
    return by_shared, _slopes(lambda x: residuals(shared, x), starts, base, own_steps)


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

    The sandwich estimator of Huber and White for clustered observations: the bread is the inverse
    of the curvature, the meat the scatter of the contributions of the clusters to the gradient,
    corrected for few clusters and for the number of estimated parameters.
    """
    weights = _weights(rest)
    curvature = weights**3  # the derivative of a residual's influence, ``weights * rest``
    system = _reduced(shared[..., free], own, rest, curvature)
    bread = np.linalg.pinv(system.matrix, hermitian=True)
    undone = system.slopes / np.sqrt(curvature)[..., None]
    scores = np.einsum("bri,br->bi", undone, weights * rest)
    groups = np.unique(clusters)
    if len(groups) >= FEW_CLUSTERS:
        scores = np.array([scores[clusters == group].sum(axis=0) for group in groups])
    degrees = max(1, len(scores) - 1)
    known = np.count_nonzero(np.abs(own).sum(axis=2))  # masked readings depend on nothing
    left = max(1, known - int(free.sum()) - own.shape[0] * own.shape[2])
    spread = bread @ scores.T  # squared last, lest round-off makes a variance negative
    factor = (len(scores) / degrees) * (max(1, known - 1) / left)
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = spread @ spread.T * factor
    return covariance, degrees
