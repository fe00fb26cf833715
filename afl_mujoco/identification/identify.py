"""A cart-pole identified from its logs, in two steps: the pole alone, then the whole in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.identification import pole, rig
from afl_mujoco.identification.description import Description
from afl_mujoco.identification.least_squares import (
    Estimate,
    Fit,
    Parameter,
    Residuals,
    by_cluster,
    fit_to_scatter,
    fitted_starts,
    half_widths,
    with_uncertainty_of,
)
from afl_mujoco.identification.log import LEAST, Log, Windows, cut
from afl_mujoco.identification.prediction import explained

Array = NDArray[np.float64]
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

EARLY = 0.1  # share of a row by which a force may act before its command, as a clock may be off
ALIKE = 0.9  # correlation above which two estimates are hard to tell apart

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

    @property
    def is_sound(self) -> bool:
        """Whether there is a correlation for each pair, and the scatter is positive."""
        count = len(self.estimates)
        square = len(self.correlations) == count == max(map(len, self.correlations), default=0)
        return square and self.scatter_phi > 0.0 and (self.scatter_z is None or self.scatter_z > 0)

    @property
    def alike(self) -> list[tuple[str, str, float]]:
        """The pairs that are hard to tell apart, with their correlations."""
        names, found = [one.name for one in self.estimates], np.array(self.correlations)
        return [
            (names[i], names[j], float(found[i, j]))
            for i in range(len(names))
            for j in range(i)
            if abs(found[i, j]) >= ALIKE
        ]


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
    require_radians(logs, description)
    windows = windows_of(logs)
    progress(0, 4)
    drive = None
    try:
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
    driven = pole.Drive(windows=w, gravity=description.nominal.gravity)
    names = [one.name for one in parameters]

    def errors(shared: Array, starts: Array) -> Array:
        v = dict(zip(names, shared.tolist(), strict=True))
        read = pole.readings(v, driven.angles(v, starts), w.turns)
        return (w.valid * (read - w.phi))[:, None]

    guess, far = np.array([one.start for one in parameters]), 1e3  # every reading has full weight
    starts = fitted_starts(
        lambda own: errors(guess, own)[:, 0] / far, w.starts[:, [1, 3]], pole.START_SCALE
    )
    found = fit_to_scatter(
        errors, w.valid[:, None], parameters, starts, w.log, start_scale=pole.START_SCALE
    )
    _require_one_rig(errors, w.valid[:, None], found, "gravity_term", w, pole.START_SCALE)
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


def _require_one_rig(
    errors: Residuals, mask: Array, found: Fit, name: str, windows: Windows, start_scale: Array
) -> None:
    """Raise if logs differ in a parameter, each by itself with the others as found."""
    one = found.estimates[name]
    values, sizes = by_cluster(errors, mask, found, name, windows.log, start_scale=start_scale)
    names = [windows.logs[number].name for number in np.unique(windows.log)]
    by_log = list(zip(values.tolist(), sizes.tolist(), names, strict=True))
    sure = [x for x in by_log if x[1] < 0.5 * DIFFERENT * abs(x[0])]
    if not sure:
        return
    (low, low_error, first), (high, high_error, last) = min(sure), max(sure)
    if high - low > max(DIFFERENT * abs(one.value), SURELY * np.hypot(low_error, high_error)):
        got = f"{one.title} {low:.4g} {one.unit} in {first} and {high:.4g} {one.unit} in {last}"
        raise InvalidValueError("logs", "must be of one cart-pole", got)


def _require_cause(found: Fit, description: Description) -> None:
    delay, high = found.estimates["delay"].value, found.estimates["delay"].high
    if high < 0.0 and delay < -EARLY * description.period:
        raise InvalidValueError(
            description.command.column,
            "must be in the row from which on it acts",
            f"a force that acts {-1e3 * delay:.3g} ms before its row: shift the column by "
            f"{-delay / description.period:.2g} rows and more",
        )


def _shows(fit: Fit, name: str) -> bool:
    """Return whether an estimate is off its bound, and its interval lies above zero."""
    one = fit.estimates[name]
    return one.low > 0.0 and not one.on_bound


class _Drive(NamedTuple):
    """Cart and drive, identified behind a known pole."""

    windows: Windows
    description: Description
    pole: Fit
    starts: Array  # of the windows, shape (B, 4)
    workers: int

    def identify(self, progress: Progress) -> Fit:
        """Fit few windows, then all; with a lag only if it is significant."""
        known = _without_dry_friction(self.pole.by_name, self.windows)
        parameters = rig.parameters_of(self.description)
        some = max(1, min(COARSE, self.windows.count // ENOUGH))
        without = {one.name: one.low for one in parameters if one.name == "lag"}
        free = [
            replace(one, low=-one.high) if one.name == "delay" else one
            for one in parameters
            if one.name not in without
        ]
        found = self._fit(self.windows, some, {**known, **without}, free)
        _require_cause(found, self.description)
        progress(2, 4)
        guess = {**found.by_name, "lag": 0.05 * self.description.period}
        lagging = [replace(one, start=guess[one.name]) for one in parameters]
        other = self._fit(self.windows, some, known, lagging)
        progress(3, 4)
        if not _shows(other, "lag") or not _shows(final := self._finished(known, other, {}), "lag"):
            final = self._finished(known, found, without)
        if not _shows(final, "gain"):
            raise InvalidValueError(
                self.description.command.column,
                "must drive the cart: check its sign, and that each command is in its own row",
                f"{final.by_name['gain']:.4g} m/s^2 per unit of command, zero within its error",
            )
        return final

    def _fit(
        self, windows: Windows, every: int, known: Mapping[str, float], free: Sequence[Parameter]
    ) -> Fit:
        """Fit some parameters to every n-th window, with n = `every`.

        Dry friction is exact, and the model that softens it gives the derivatives.
        """
        w, names = windows.some(every), [one.name for one in free]
        soft = rig.Rig(windows=w, description=self.description, workers=self.workers)
        return fit_to_scatter(
            _errors(replace(soft, exact=True), names, known), _mask(w), free, self.starts[::every],
            w.log, start_scale=rig.START_SCALE, smooth=_errors(soft, names, known),
        )  # fmt: skip

    def _finished(self, known: Mapping[str, float], guess: Fit, bound: Mapping[str, float]) -> Fit:
        """Fit all windows from a first guess; parameters on a bound stay there."""
        bound = {**bound, **{n: one.value for n, one in guess.estimates.items() if one.on_bound}}
        start = {**bound, **guess.by_name}
        parameters = [
            replace(one, start=start[one.name]) for one in rig.parameters_of(self.description)
        ]
        free = [one for one in parameters if one.name not in bound]
        fine = replace(self.windows, step=self.windows.step / FINER)
        final = self._fit(fine, 1, {**known, **bound}, free)
        soft = rig.Rig(windows=fine, description=self.description, workers=self.workers)
        names, mask = [one.name for one in free], _mask(fine)
        errors = _errors(soft, names, {**known, **bound})
        _require_one_rig(errors, mask, final, "gain", fine, rig.START_SCALE)
        names += [one.name for one in self.pole.parameters]
        final = with_uncertainty_of(
            _errors(replace(soft, exact=True), names, bound), mask, final, self.pole,
            start_scale=rig.START_SCALE, smooth=_errors(soft, names, bound),
        )  # fmt: skip
        return _with_bound(final, parameters, bound)


def _without_dry_friction(found: Mapping[str, float], windows: Windows) -> dict[str, float]:
    """Return the pole's parameters with viscous friction of equal dissipation for the dry one.

    Dry friction is small beside gravity, and without it MuJoCo has no constraint to solve.
    """
    known = windows.valid[:, 1:] * windows.valid[:, :-1] > 0.0
    turned = np.diff(windows.phi + 2.0 * np.pi * windows.turns, axis=1)
    rates = np.abs(turned / np.diff(windows.time, axis=1))[known]
    share = float(rates.mean() / np.mean(rates**2))
    return {**found, "damping": found["damping"] + share * found["friction"], "friction": 0.0}


def _errors(model: rig.Rig, names: Sequence[str], known: Mapping[str, float]) -> Residuals:
    measured = np.stack([model.windows.z, model.windows.phi], axis=1)

    def errors(shared: Array, own: Array) -> Array:
        values = {**known, **dict(zip(names, shared.tolist(), strict=True))}
        return model.readings(values, own) - measured

    return errors


def _mask(windows: Windows) -> Array:
    """Return 1 where a reading of position or angle is valid, else 0, shape (B, 2, n)."""
    return np.stack([windows.there, windows.valid], axis=1)


def _with_bound(fit: Fit, parameters: Sequence[Parameter], bound: Mapping[str, float]) -> Fit:
    """Return a fit with the parameters that were held on a bound put back in their places."""
    names = [one.name for one in parameters]
    free = [i for i, name in enumerate(names) if name not in bound]
    values, on_bound = np.array([bound.get(n, 0.0) for n in names]), np.ones(len(names), bool)
    covariance = np.zeros((len(names), len(names)))
    values[free], on_bound[free] = fit.values, fit.on_bound
    covariance[np.ix_(free, free)] = fit.covariance
    return replace(
        fit, parameters=parameters, values=values, covariance=covariance, on_bound=on_bound
    )


def _step(fit: Fit, windows: Windows) -> Step:
    return Step(
        estimates=tuple(fit.estimates.values()),
        correlations=tuple(tuple(row) for row in fit.correlations.tolist()),
        scatter_phi=float(fit.scatter[-1]),
        scatter_z=float(fit.scatter[0]) if len(fit.scatter) > 1 else None,
        windows=windows.count,
    )


_PHYSICAL = {
    "half_length": ("l of a uniform rod that falls alike", "m", {"gravity_term"}),
    "cart_mass": ("M, with the inertia of the drive", "kg", {"mass_ratio"}),
    "force": ("force of one of the command", "N", {"mass_ratio", "gain"}),
    "rail_damping": ("rail damping, with the back-EMF", "N s/m", {"mass_ratio", "decay"}),
    "rail_friction": ("dry friction of the rail", "N", {"mass_ratio", "dry_deceleration"}),
    "hinge_damping": ("hinge damping", "N m s/rad", {"gravity_term", "damping"}),
    "hinge_friction": ("dry friction of the hinge", "N m", {"gravity_term", "friction"}),
}
"""Title and unit of each quantity of `rig.physical`, and the parameters it is computed from."""


def _physical(steps: Sequence[Fit], description: Description) -> tuple[Estimate, ...]:
    """Return masses, forces and frictions with intervals, by linear propagation of errors."""
    values = {name: value for step in steps for name, value in step.by_name.items()}
    base = rig.physical(values, description)
    variance = dict.fromkeys(base, 0.0)
    for step in steps:  # the two steps are assumed to be independent
        slopes = np.zeros((len(base), len(step.values)))
        for i, one in enumerate(step.parameters):
            delta = 1e-6 * one.scale
            ahead = rig.physical({**values, one.name: values[one.name] + delta}, description)
            slopes[:, i] = [(ahead[name] - base[name]) / delta for name in base]
        spread = np.einsum("ki,ij,kj->k", slopes, step.covariance, slopes)
        variance = {name: variance[name] + float(x) for name, x in zip(base, spread, strict=True)}
    halves = half_widths(np.sqrt([*variance.values()]), min(step.degrees for step in steps))
    bound = {x.name for step in steps for x in step.estimates.values() if x.on_bound}
    return tuple(
        Estimate(
            name=name, title=title, unit=unit, value=base[name], low=base[name] - half,
            high=base[name] + half, on_bound=bool(bound & made_of),
        )
        for (name, (title, unit, made_of)), half in zip(
            _PHYSICAL.items(), halves.tolist(), strict=True
        )
    )  # fmt: skip


def require_radians(logs: Sequence[Log], description: Description) -> None:
    """Raise if gravity shows that the angle has another unit than the description says.

    The second derivative of the angle is compared with the sine of the angle, taken in radians and
    in degrees: if the readings swing far, only one of the two fits.
    """
    fits = {x: _share_explained(logs, x) for x in (1.0, np.pi / 180.0, 180.0 / np.pi)}
    best = max(fits, key=lambda factor: fits[factor])
    if best != 1.0 and fits[best] > fits[1.0] + 0.2:
        rule = f"must be {'deg' if best < 1.0 else 'rad'!r} according to gravity, which then "
        rule += f"explains {fits[best]:.0%} of the curvature instead of {fits[1.0]:.0%}"
        raise InvalidValueError(
            f"unit of {description.phi.column}", rule, repr(description.phi.unit)
        )


def _share_explained(logs: Sequence[Log], factor: float) -> float:
    left, curvature = [], []
    for log in logs:
        angle, t = np.unwrap(factor * log.phi), log.time
        inner = np.flatnonzero(log.valid[:-2] & log.valid[1:-1] & log.valid[2:]) + 1
        h = 0.5 * (t[inner + 1] - t[inner - 1])
        bent = [(x[inner + 1] - 2.0 * x[inner] + x[inner - 1]) / h**2 for x in (angle, log.z)]
        curvature.append(bent[0])
        left.append(np.stack([np.sin(angle[inner]), bent[1] * np.cos(angle[inner])], axis=1))
    y, x = np.concatenate(curvature), np.concatenate(left)
    return explained(y - x @ np.linalg.lstsq(x, y, rcond=None)[0], y)
