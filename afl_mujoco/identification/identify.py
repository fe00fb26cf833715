"""A cart-pole identified from its logs, in two steps: the pole alone, then the whole in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.identification import pole, rig
from afl_mujoco.identification.description import UNITS, Description
from afl_mujoco.identification.least_squares import (
    Array,
    Errors,
    Estimate,
    Fit,
    Parameter,
    Problem,
    by_cluster,
    explained,
    fit_to_scatter,
    fitted_starts,
    intervals,
    is_better,
    with_uncertainty_of,
)
from afl_mujoco.identification.log import LEAST, Log, Windows, cut, stride_of

Progress = Callable[[int, int], None]

WINDOW = 0.5  # length of fitted windows [s]: three time constants of a pole of 0.4 m

LEAST_SHARE = 0.5
"""Share of the duration of the logs from which the rest may be judged: below it, what is lost may
not be lost at random."""

COARSE = 4  # the first guess of the drive uses one window in this many
ENOUGH = 60  # number of windows that a first guess needs

FINER = 2
"""Factor by which the last fit of the drive has finer steps: a force that changes within a step
acts as its mean."""

DIFFERENT, SURELY = 0.1, 6.0
"""Relative difference between two logs, and the same in standard errors, from which they are of
different cart-poles."""

NOISY = 2.0
"""Compliance from which one shows, in squares of the time between rows over pi. With one of 1 what
is fastest in a position cancels, so that its noise drives the pole least: any noise pulls the
estimate to there, however little of a compliance there is."""

FORGOTTEN = 5.0  # lags after which a drive has forgotten a command to 0.7 %

EARLY = 0.1  # share of a row by which a force may act before its command, as a clock may be off

TOLD, MORE = 0.5, 0.2
"""Share of the angle's curvature that has to be explained to tell a unit of it, of what gravity
leaves of it for one of the position; and how much more than by the unit of the description."""
NEAR = 0.5  # how near a unit must be to be named, in powers of ten

LEFT = 0.5  # share of the angle's movement within windows that no fit may leave

UNITS_RIGHT = (0.2, 5.0)
"""Range of coupling and gravity term, relative to their expected values, if the units are right."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One of the two steps of the identification."""

    estimates: tuple[Estimate, ...]  # the estimates of its parameters
    # correlations of the estimates, in their order; 0 with one that lies on a bound
    correlations: tuple[tuple[float, ...], ...]
    # robust scatter of the residuals [rad, m]; None for a signal that was not fitted
    scatter_phi: float
    scatter_z: float | None
    windows: int  # number of windows fitted

    def __post_init__(self) -> None:
        """Raise where an edited file has not one correlation for each pair of estimates."""
        count = len(self.estimates)
        if {len(self.correlations), *map(len, self.correlations)} != {count}:
            rule = f"must have {count} rows of {count}, one for each estimate"
            raise InvalidValueError("correlations", rule)


@dataclass(frozen=True, slots=True, kw_only=True)
class Identified:
    """A cart-pole as identified from its logs."""

    description: Description  # description of its logs
    logs: tuple[str, ...]  # names of the logs
    seconds: float  # total duration of the logs [s]
    period: float  # period of their rows [s], the device's own
    pole: Step  # the two steps; no drive if the command is constant
    drive: Step | None
    # physical quantities for a pole of the given mass; empty without a drive
    physical: tuple[Estimate, ...]
    dropped: int = 0  # number of stretches between lost rows that are in no window
    share: float = 1.0  # share of their duration that lies in a window [1]

    @property
    def steps(self) -> list[Step]:
        """The steps that there are."""
        return [step for step in (self.pole, self.drive) if step is not None]

    @property
    def values(self) -> dict[str, float]:
        """Every estimate of the two steps by name."""
        return {one.name: one.value for step in self.steps for one in step.estimates}

    def scatter(self) -> tuple[float, float]:
        """Return the scatter of position and angle about the whole model, or raise without it."""
        if self.drive is None or self.drive.scatter_z is None:
            rule = "must include cart and drive: the command of every log is constant"
            raise InvalidValueError("estimates", rule)
        return self.drive.scatter_z, self.drive.scatter_phi

    def find(self, name: str) -> Estimate:
        """Return an estimate by name."""
        found = [*(one for step in self.steps for one in step.estimates), *self.physical]
        return next(one for one in found if one.name == name)


def identify(
    logs: Sequence[Log],
    description: Description,
    *,
    workers: int = 1,
    progress: Progress = lambda done, total: None,
) -> Identified:
    """Identify a cart-pole from its logs."""
    require_units(logs, description)
    windows = windows_of(logs)
    progress(0, 4)
    drive = None
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # guesses may be far off
            first, starts = identify_pole(windows, description)
            progress(1, 4)
            if any(np.ptp(log.command) > 0.0 for log in logs):
                drive = _Drive(windows, description, first, starts, workers).identify(progress)
    except np.linalg.LinAlgError:
        rule = "do not determine a cart-pole: check units, signs and nominal values"
        raise InvalidValueError("logs", rule) from None
    progress(4, 4)
    return Identified(
        description=description,
        logs=tuple(log.name for log in logs),
        seconds=sum(log.duration for log in logs),
        period=float(np.median([log.period for log in logs])),
        pole=_step(first, windows),
        drive=None if drive is None else _step(drive, windows),
        physical=() if drive is None else _physical([first, drive], description),
        dropped=windows.dropped,
        share=windows.share,
    )


def windows_of(logs: Sequence[Log]) -> Windows:
    """Return the windows to which a model is fitted, or raise if they hold too little."""
    windows = cut(logs, WINDOW, WINDOW)
    if windows.share < LEAST_SHARE:
        lost = sum(log.missing for log in logs) / sum(log.slots[-1] + 1 for log in logs)
        known = np.mean(np.concatenate([log.valid for log in logs]))
        raise InvalidValueError(
            "logs",
            f"must have {100 * LEAST_SHARE:.0f} % of their duration in windows of {LEAST} rows or "
            "more, without a lost row and with a known angle at the start",
            f"{100 * windows.share:.0f} % ({100 * lost:.2g} % of the rows are lost, and "
            f"{100 * (1 - known):.2g} % of the angles are not valid)",
        )
    return windows


def identify_pole(windows: Windows, description: Description) -> tuple[Fit, Array]:
    """Identify the pole and the sensors alone; return the states at the first rows too, (B, 4)."""
    w, parameters = windows, pole.parameters_of(description)
    driven = pole.Drive(w, description.nominal.gravity)
    names = [one.name for one in parameters]

    def errors(shared: Array, starts: Array) -> Array:
        v = dict(zip(names, shared.tolist(), strict=True))
        return (driven.readings(v, starts) - w.phi)[:, None]

    problem = Problem(errors, errors, w.valid[:, None], w.log, pole.START_SCALE)
    guess, far = np.array([one.start for one in parameters]), np.array([1e3])  # full weight for all
    starts = fitted_starts(
        lambda own: problem.residuals(guess, own, far), w.starts[:, [1, 3]], pole.START_SCALE
    )
    found = fit_to_scatter(problem, parameters, starts)
    _require_a_pole(found, w, description)
    _require_determined(found)
    if not _compliant(found, w):
        at = zip(parameters, found.values.tolist(), strict=True)
        without = [one.held(0.0) if one.name == "compliance" else one._replace(start=x)
                   for one, x in at]  # fmt: skip
        found = fit_to_scatter(problem, without, found.starts)
    _require_one_rig(problem, found, "gravity_term", w)
    w2, k = found.by_name["gravity_term"], found.by_name["coupling"]
    expected = parameters[0].start
    ratios = {"gravity term w2": w2 / expected, "coupling k": k}
    least, most = UNITS_RIGHT
    if off := [title for title, ratio in ratios.items() if not least < ratio < most]:
        raise InvalidValueError(
            " and ".join(off),
            "must be near the expected value for a pole; check the units and signs of "
            f"{description.phi.column} and {description.z.column}, and the pole's length",
            f"w2 = {w2:.4g} 1/s² instead of {expected:.4g}, k = {k:.4g} instead of 1",
        )
    whole = w.starts.copy()
    whole[:, [1, 3]] = found.starts
    return found, whole


def _compliant(found: Fit, windows: Windows) -> bool:
    """Return whether a compliance shows beyond what noise of the position does to it."""
    one = found.estimates["compliance"]
    spacing = max(log.period * stride_of(log.period) for log in windows.logs)
    return one.high < 0.0 or one.low > NOISY * (spacing / np.pi) ** 2


def _require_a_pole(found: Fit, windows: Windows, description: Description) -> None:
    """Raise if the fit leaves as much of the angle's movement as it explains, or lacks its zero."""
    d = description
    turned = np.where(windows.valid > 0.0, windows.phi + 2.0 * np.pi * windows.turns, np.nan)
    moved = np.nansum((turned - np.nanmean(turned, axis=1, keepdims=True)) ** 2)
    left = float(found.scatter[0] * np.sqrt(np.sum(found.residuals**2) / moved))
    if not left < LEFT:
        raise InvalidValueError(
            "logs",
            f"must move as a pole on a cart does: check units and signs of {d.phi.column} and "
            f"{d.z.column}, the zero of {d.phi.column}, and the pole's length",
            f"a fit that leaves {min(left, 1.0):.0%} of the angle's movement",
        )
    zero = found.estimates["angle_offset"]
    if zero.on_bound:
        rule = "must be the reading of the upright pole, within half a radian"
        got = f"one that is {abs(zero.value):.2g} rad or more off, as gravity tells"
        raise InvalidValueError(f"zero of {d.phi.column}", rule, got)


def _require_determined(found: Fit) -> None:
    """Raise if the logs hold nothing by which some parameters could be told."""
    pairs = zip(found.parameters, found.errors, strict=True)
    if unknown := [one.title for one, error in pairs if not np.isfinite(error)]:
        raise InvalidValueError("logs", f"must move enough to tell {' and '.join(unknown)}")


def _require_one_rig(problem: Problem, found: Fit, name: str, windows: Windows) -> None:
    """Raise if logs differ in a parameter, each by itself with the others as found."""
    one, alone = found.estimates[name], by_cluster(problem, found, name)
    names = [windows.logs[number].name for number in np.unique(windows.log)]
    by_log = [(*pair, name) for pair, name in zip(alone, names, strict=True)]
    sure = [x for x in by_log if x[1] < 0.5 * DIFFERENT * abs(x[0])]
    if not sure:
        return
    (low, low_error, first), (high, high_error, last) = min(sure), max(sure)
    if high - low > max(DIFFERENT * abs(one.value), SURELY * np.hypot(low_error, high_error)):
        got = f"{one.title} {low:.4g} {one.unit} in {first} and {high:.4g} {one.unit} in {last}"
        raise InvalidValueError("logs", "must be of one cart-pole", got)


def _lags(fit: Fit) -> bool:
    """Return whether a lag shows beside the delay that is fitted with it.

    The delay takes up its first moment, so that its square acts: the interval of this is tested,
    not that of the lag, which is too narrow near zero.
    """
    one = fit.estimates["lag"]
    return one.value > 2.0 * (one.high - one.value) and not one.on_bound


class _Drive(NamedTuple):
    """Cart and drive, identified behind a known pole."""

    windows: Windows
    description: Description
    pole: Fit
    starts: Array  # of the windows, shape (B, 4)
    workers: int

    def identify(self, progress: Progress) -> Fit:
        """Fit few windows, then all; with a lag only if it is significant."""
        d, parameters = self.description, self._parameters
        known = _without_dry_friction(self.pole.by_name, self.windows)
        every = max(1, min(COARSE, self.windows.count // ENOUGH))
        problem = self._problem(self.windows.where(slice(None, None, every)), parameters, known)
        without = [
            one.held(one.low) if one.name == "lag"
            else one._replace(low=-one.high) if one.name == "delay" else one
            for one in parameters
        ]  # fmt: skip
        found = fit_to_scatter(problem, without, self.starts[::every])
        delay = found.estimates["delay"]
        if delay.high < 0.0 and delay.value < -EARLY * d.period:
            raise InvalidValueError(
                d.command.column,
                "must be in the row from which on it acts",
                f"a force that acts {-1e3 * delay.value:.3g} ms before its row: shift the column "
                f"by {-delay.value / d.period:.2g} rows and more",
            )
        progress(2, 4)
        # half of it may be lag: beside a whole delay a lag shows by its square alone
        half = max(0.5 * delay.value, 0.05 * d.period)
        guess = {**found.by_name, "delay": half, "lag": half}
        lagging = [one._replace(start=guess[one.name]) for one in parameters]
        other = fit_to_scatter(problem, lagging, self.starts[::every])
        progress(3, 4)
        lags = _lags(other) and is_better(problem, other, found)
        final = self._finished(known, other if lags else found)
        if lags and not _lags(final):
            final = self._finished(known, found)
        _require_determined(final)
        gain = final.estimates["gain"]
        if gain.on_bound or not gain.low > 0.0:
            raise InvalidValueError(
                d.command.column,
                "must drive the cart: check its sign, and that each command is in its own row",
                f"{gain.value:.4g} m/s^2 per unit of command, zero within its error",
            )
        return final

    @property
    def _parameters(self) -> list[Parameter]:
        return rig.parameters_of(self.description, self.windows)

    def _problem(
        self, windows: Windows, parameters: Sequence[Parameter], known: Mapping[str, float]
    ) -> Problem:
        """Return the problem of some parameters.

        Dry friction is exact, and the model that softens it gives the derivatives.
        """
        w, names = windows, [one.name for one in parameters]
        measured, mask = np.stack([w.z, w.phi], axis=1), np.stack([w.there, w.valid], axis=1)

        def errors_of(model: rig.Rig) -> Errors:
            def errors(shared: Array, own: Array) -> Array:
                values = {**known, **dict(zip(names, shared.tolist(), strict=True))}
                return model.readings(values, own) - measured

            return errors

        rigs = (rig.Rig(w, self.description, self.workers, exact=x) for x in (True, False))
        exact, soft = map(errors_of, rigs)
        return Problem(exact, soft, mask, w.log, rig.START_SCALE)

    def _settled(self, guess: Fit) -> NDArray[np.bool_]:
        """Return the windows that no command before its log acts on behind a lag, shape (B,).

        That command is not known, and as long as it acts a lag looks like a delay.
        """
        lag, kept = guess.by_name["lag"], np.ones(self.windows.count, np.bool_)
        settled = self.windows.time[:, 0] >= guess.by_name["delay"] + FORGOTTEN * lag
        return settled if lag > 0.0 and settled.mean() >= LEAST_SHARE else kept

    def _finished(self, known: Mapping[str, float], guess: Fit) -> Fit:
        """Fit all windows from a first guess; parameters on a bound stay there."""
        found = guess.estimates.values()
        parameters = [
            one.held(x.value) if x.on_bound else one._replace(start=x.value)
            for one, x in zip(self._parameters, found, strict=True)
        ]  # fmt: skip
        kept = self._settled(guess)
        fine = replace(self.windows.where(kept), step=self.windows.step / FINER)
        problem = self._problem(fine, parameters, known)
        final = fit_to_scatter(problem, parameters, self.starts[kept])
        _require_one_rig(problem._replace(errors=problem.smooth), final, "gain", fine)
        every = self._problem(fine, [*parameters, *self.pole.parameters], {})
        return with_uncertainty_of(every, final, self.pole)


def _without_dry_friction(found: Mapping[str, float], windows: Windows) -> dict[str, float]:
    """Return the pole's parameters with viscous friction of equal dissipation for the dry one.

    Dry friction is small beside gravity, and without it MuJoCo has no constraint to solve.
    """
    known = windows.valid[:, 1:] * windows.valid[:, :-1] > 0.0
    turned = np.diff(windows.phi + 2.0 * np.pi * windows.turns, axis=1)
    rates = np.abs(turned / np.diff(windows.time, axis=1))[known]
    share = float(rates.mean() / np.mean(rates**2))
    return {**found, "damping": found["damping"] + share * found["friction"], "friction": 0.0}


def _step(fit: Fit, windows: Windows) -> Step:
    return Step(
        estimates=tuple(fit.estimates.values()),
        correlations=tuple(tuple(row) for row in fit.correlations.tolist()),
        scatter_phi=float(fit.scatter[-1]),
        scatter_z=float(fit.scatter[0]) if len(fit.scatter) > 1 else None,
        windows=windows.count,
    )


_PHYSICAL = {
    "half_length": ("m", "l of a uniform rod that falls alike"),
    "cart_mass": ("kg", "M, with the inertia of the drive"),
    "force": ("N", "force of one of the command"),
    "rail_damping": ("N s/m", "rail damping, with the back-EMF"),
    "rail_friction": ("N", "dry friction of the rail"),
    "hinge_damping": ("N m s/rad", "hinge damping"),
    "hinge_friction": ("N m", "dry friction of the hinge"),
}
"""Unit and title of each quantity of `rig.physical`."""


def _physical(steps: Sequence[Fit], description: Description) -> tuple[Estimate, ...]:
    """Return masses, forces and frictions with intervals, by linear propagation of errors.

    One that depends on an estimate on its bound has no interval either.
    """
    values = {name: value for step in steps for name, value in step.by_name.items()}
    base = rig.physical(values, description)
    variance, on_bound = np.zeros(len(base)), np.zeros(len(base), bool)
    for step in steps:  # the two steps are assumed to be independent
        slopes = np.zeros((len(base), len(step.values)))
        for i, one in enumerate(step.parameters):
            delta = 1e-6 * one.scale
            ahead = rig.physical({**values, one.name: values[one.name] + delta}, description)
            slopes[:, i] = [(ahead[name] - base[name]) / delta for name in base]
        variance += np.einsum("ki,ij,kj->k", slopes, step.covariance, slopes)
        on_bound |= (slopes[:, step.on_bound] != 0.0).any(axis=1)
    named = [(name, *told) for name, told in _PHYSICAL.items()]
    known, degrees = np.array([*base.values()]), min(step.degrees for step in steps)
    return tuple(intervals(named, known, np.sqrt(variance), on_bound, degrees).values())


def require_units(logs: Sequence[Log], description: Description) -> None:
    """Raise if angle or position have another unit than the description says, as gravity tells.

    The second derivative of the angle is compared with the sine of the angle and the acceleration
    of the cart: if the readings swing far, only one unit of each fits.
    """
    d = description
    own = UNITS["phi"][d.phi.unit]
    fits = {unit: _curvature(logs, si / own) for unit, si in UNITS["phi"].items()}
    best, here = max(fits, key=lambda unit: fits[unit].share), fits[d.phi.unit]
    most = fits[best].share
    if most > TOLD and most > here.share + MORE:
        rule = f"must be {best!r} according to gravity, which then explains {most:.0%} of the "
        rule += f"curvature instead of {here.share:.0%}"
        raise InvalidValueError(f"unit of {d.phi.column}", rule, repr(d.phi.unit))
    if here.share > TOLD and here.share > 1.0 - TOLD * (1.0 - here.by_gravity):
        coupling = abs(here.coupling) * d.nominal.gravity * UNITS["z"][d.z.unit]
        far = {unit: abs(np.log10(coupling / si)) for unit, si in UNITS["z"].items()}
        nearest = min(far, key=lambda unit: far[unit])
        if nearest != d.z.unit and far[nearest] < NEAR:
            rule = f"must be {nearest!r}, as the cart moves the pole"
            raise InvalidValueError(f"unit of {d.z.column}", rule, repr(d.z.unit))


class _Curvature(NamedTuple):
    share: float  # explained by gravity and the cart, and by gravity alone
    by_gravity: float
    coupling: float  # by the cart's acceleration, relative to that by gravity


def _curvature(logs: Sequence[Log], factor: float) -> _Curvature:
    """Explain the curvature of the angle, readings times a factor, where no row is lost."""
    left, curvature = [np.empty((0, 2))], [np.empty(0)]
    for log in logs:
        n, known = stride_of(log.period), log.valid
        at = np.flatnonzero(log.slots[2 * n :] - log.slots[: -2 * n] == 2 * n) + n
        at = at[known[at - n] & known[at] & known[at + n]]
        angle, h = np.unwrap(factor * log.phi), n * log.period
        bent = [(x[at + n] - 2.0 * x[at] + x[at - n]) / h**2 for x in (angle, log.z)]
        curvature.append(bent[0])
        left.append(np.stack([np.sin(angle[at]), bent[1] * np.cos(angle[at])], axis=1))
    y, x = np.concatenate(curvature), np.concatenate(left)
    if not y.any():
        return _Curvature(0.0, 0.0, 1.0)
    gravity, cart = np.linalg.lstsq(x, y, rcond=None)[0]
    alone = np.linalg.lstsq(x[:, :1], y, rcond=None)[0]
    shares = explained(y - x @ [gravity, cart], y), explained(y - x[:, :1] @ alone, y)
    return _Curvature(*shares, float(cart / gravity) if gravity else np.inf)
