"""A loop at its target, linearised by finite differences in MuJoCo, and its stability margins.

The margins are of the loop L broken where one input enters the plant, the other inputs closed, at
the frequencies where abs(L) = 1 or L is real. These are found between frequencies that surround
every pole and zero closely, from the states and never from polynomials, which overflow (those of
python-control do, at a delay of thirty periods); whole periods of delay turn L and add no states.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.features import without_dry_friction
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import SNAP
from afl_mujoco.simulation.judgement import require_start
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.values import require_positive

Array = NDArray[np.float64]

STEP = 1e-5
"""Step of the central differences [m, rad, m/s, rad/s, N]: their error falls with its square, the
rounding error grows with its inverse; here both are near 1e-10."""

COARSER = 10.0  # ratio of a second, longer step, with which the first is compared, to the first

AGREEMENT = 1e-5
"""Largest relative difference between the two results: the longer step's error is near 1e-7."""

REST = 1e-6  # largest acceleration at the target [m/s^2, rad/s^2]

KINK = 1e-3
"""Largest difference between a controller's slopes on either side of its target, relative to its
largest slope: central differences do not see a kink, whatever their step."""

NOTHING = 1e-9  # share of the largest slope that is the rounding of 0
NO_GAIN = 1e-9
"""Factors of the gain below it, and above its inverse, are rounding errors of 0 and infinity."""

GRID = 2000  # frequencies, even in their logarithm, at which a response is looked at
TURNS = 16  # frequencies for each turn that a delay adds up to Nyquist's
BESIDE = 10.0 ** np.linspace(-9.0, -0.5, 35)
"""How far others are from that of each pole and zero, as shares of it."""

BEYOND = 100.0
"""Factor by which these frequencies reach below the slowest and above the fastest pole."""

FIRST_PERIODS, MOST_PERIODS, PARTS = 6, 100, 24
"""Periods of delay through which poles are followed, since a crossover above a third of Nyquist's
frequency turns once within them; periods of a delay margin beyond which its part within a period is
not sought; and the parts of a period in which both are."""

LINEAR = (
    *("delay", "lag", "damping", "armature", "tip_mass_share", "pole_radius", "control_period"),
    *("differentiated", "velocity_filter"),
)
"""Imperfections that a linear loop can have."""


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """x' = A x + B u, u = -K x of coordinates, rates and lagging inputs, away from the target."""

    a: Array
    b: Array
    k: Array
    inputs: tuple[str, ...] = ("",)
    coordinates: int = 0
    held: tuple[float, ...] = (0.0,)  # the inputs at rest

    @property
    def stable(self) -> bool:
        """Whether all poles lie in the left half-plane; one on its edge, but for rounding, not."""
        poles = np.linalg.eigvals(self.a - self.b @ self.k)
        return bool(poles.real.max() < -NOTHING * np.abs(poles).max())

    @property
    def idle(self) -> NDArray[np.bool_]:
        """Which coordinates nothing depends on, among the states."""
        several = [np.abs(x).max(axis=0) > NOTHING * np.abs(x).max() for x in (self.a, self.k)]
        return np.asarray(~np.logical_or(*several) & (np.arange(len(self.a)) < self.coordinates))


def linear_part(imperfections: Imperfections) -> Imperfections:
    """Return imperfections without those that a linear loop cannot have."""
    return Imperfections(**{name: getattr(imperfections, name) for name in LINEAR})


def linearize(controller: Controller, scenario: Scenario) -> Loop:
    """Return the loop at rest, with passive physics and lags; `loop_margins` handles the rest."""
    require_start(scenario)
    plant, r = scenario.plant, linear_part(scenario.imperfections)
    model = SimulatedModel(plant, imperfections=r, edit=without_dry_friction)
    model.write(scenario.values_at(0.0))
    n = len(plant.coordinates)
    target = target_of(scenario)
    told = controller.inputs_for(scenario.told_values(np.zeros(1)))

    def dynamics(state: Array, inputs: Array) -> Array:
        return np.array([*state[n:], *model.accelerations(state, inputs)])

    def command(state: Array, time: float = 0.0) -> Array:
        return np.atleast_1d(controller.forces(state[None], told, np.array([time]))[0])

    thing = f"linearisation of {controller.name!r}"
    held = require_rest(thing, scenario, command(target), model)
    fine, coarse = (
        (
            _jacobian(lambda x: dynamics(x, held), target, step),
            _jacobian(lambda u: dynamics(target, u), held, step),
            -_jacobian(command, target, step),
        )
        for step in (STEP, COARSER * STEP)
    )
    gaps = [np.abs(x - y).max() / max(np.abs(x).max(), 1e-300)
            for x, y in zip(fine, coarse, strict=True)]  # fmt: skip
    a, b, k = fine
    if not np.isfinite(k).all():
        raise InvalidValueError(thing, "must have finite slopes", k.ravel().tolist())
    ahead, behind = _sides(command, target, STEP)
    bend = float(np.abs(ahead + behind - 2.0 * held[:, None]).max()) / STEP
    kink = bend / max(float(np.abs(k).max()), 1e-300)
    if not max(gaps) <= AGREEMENT:
        rule = f"must not depend on the step by more than {AGREEMENT:g}"
        raise InvalidValueError(thing, rule, f"{max(gaps):.1e}")
    if not kink <= KINK:
        rule = f"must be smooth: slopes on either side may differ by {KINK:g} of the largest"
        raise InvalidValueError(thing, rule, f"{kink:.1e}")
    if (flat := ~k.any(axis=1)).any():
        later = functools.partial(command, time=0.5 * scenario.duration)
        bands = np.tile([scenario.band(name) for name in plant.coordinates], 2)
        beyond = np.abs(_sides(later, target, bands) - later(target)[:, None]).max((0, 2))
        for name in np.array(plant.inputs)[flat & (beyond > 0.0)]:
            rule = f"must have a slope at the target at t = 0, where {name} does not answer to it"
            raise InvalidValueError(thing, f"{rule} (a dead zone, a rounding, or a soft start?)")
    lags = np.array([r.of_input("lag", name) for name in plant.inputs])
    late = np.eye(len(lags))[lags > 0.0]  # the inputs that follow what is commanded with a lag [s]
    rates = np.diag(1.0 / lags[lags > 0.0])
    a = np.block([[a, b @ late.T], [np.zeros((len(late), 2 * n)), -rates]])
    b = np.vstack([b * (lags == 0.0), rates @ late])
    k = np.hstack([k, np.zeros((len(k), len(late)))])
    return Loop(a, b, k, tuple(plant.inputs), n, tuple(held.tolist()))


def target_of(scenario: Scenario) -> Array:
    """Return the state at rest at the target of a scenario."""
    return np.array([*scenario.target, *np.zeros(len(scenario.target))])


def require_rest(thing: str, scenario: Scenario, inputs: Array, model: SimulatedModel) -> Array:
    """Return inputs, or raise unless they hold a model at rest at the target."""
    plant = scenario.plant
    rule = "must be about an equilibrium: its inputs must hold the plant at its target"
    for name, x, (low, high) in zip(plant.inputs, inputs, scenario.limits, strict=True):
        if not (low <= x <= high and math.isfinite(x)):
            within = f"{rule}, within {low:g} to {high:g}"
            raise InvalidValueError(thing, within, f"{name} = {x:g}")
    rates = model.accelerations(target_of(scenario), inputs)
    for name, x in zip(plant.coordinates, rates, strict=True):
        if not abs(x) <= REST:
            said = f"{name} accelerates by {x:g} {plant.units[name]}/s²"
            raise InvalidValueError(thing, rule, said)
    return inputs


def _jacobian(function: Callable[[Array], Array], point: Array, step: float) -> Array:
    ahead, behind = _sides(function, point, step)
    return np.asarray((ahead - behind) / (2.0 * step))


def _sides(function: Callable[[Array], Array], point: Array, step: Any) -> list[Array]:
    """Return a function a step ahead of a point and a step behind, shapes (outputs, inputs)."""
    offsets = step * np.eye(len(point))
    return [np.stack([function(point + x) for x in s * offsets], axis=-1) for s in (1.0, -1.0)]


# --- margins of a linear loop -------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """What a stable loop tolerates at one input, one change at a time."""

    gain_decrease: float  # factor of the loop gain, below 1
    gain_increase: float  # the same, above 1; infinite if no increase destabilises it
    phase: float  # least additional lag or lead at a crossover [deg]
    delay: float  # least additional delay [s]; infinite if none destabilises it
    # frequency of the crossover whose phase a delay uses up first [rad/s]; infinite without one
    crossover: float
    disk: float  # size of the largest disk of gain and phase at once, by the peak of (S - T)/2


def loop_margins(
    loop: Loop, control_period: float | None = None, imperfections: Imperfections = IDEAL
) -> list[Margins] | None:
    """Return the margins of a loop at each of its inputs, or None if it is not stable.

    Without a control period [s] the controller is continuous. With one, the delay of the hold
    itself, half a period, is no longer part of the margin; of the imperfections count then the
    delays of the inputs, on top of which the margin comes, and how velocities are measured.
    """
    period, r = control_period, imperfections
    measured = period is not None and (r.differentiated or r.velocity_filter)
    if not measured:  # sensors that difference positions need them
        kept = ~loop.idle
        loop = replace(loop, a=loop.a[kept][:, kept], b=loop.b[kept], k=loop.k[:, kept])
    if period is None:
        if not loop.stable:
            return None
        return [_margins(Broken(*x)) for x in _broken(loop.a, loop.b, loop.k)]
    require_positive("control_period", period)
    if not stable_as_held(loop, period, r):
        return None
    found = []
    for i, name in enumerate(loop.inputs):
        whole = math.floor(r.of_input("delay", name) / period + SNAP)
        late = _held(loop, period, r, i, -whole * period)
        one = _margins(Broken(*_broken(*late)[i], period, whole))
        found.append(replace(one, delay=_exact_delay(loop, period, r, i, one.delay)))
    return found


def _held(
    loop: Loop, period: float, r: Imperfections, place: int = 0, extra: float = 0.0
) -> tuple[Array, Array, Array]:
    """Return a loop from sample to sample, one of its inputs delayed by some more [s]."""
    delays = [r.of_input("delay", name) for name in loop.inputs]
    delays[place] += extra
    a, b = held_plant(loop, period, delays)
    k = np.hstack([loop.k, np.zeros((len(loop.k), len(a) - len(loop.a)))])
    if r.differentiated or r.velocity_filter:
        return _without_places(*_measured_loop(a, b, k, period, r, loop.coordinates), loop)
    return a, b, k


def _without_places(a: Array, b: Array, k: Array, loop: Loop) -> tuple[Array, Array, Array]:
    """Return a measured loop with steps in place of idle coordinates, whose places are no matter.

    Else each has a pole at 1, of which rounding says whether it is stable.
    """
    idle = np.flatnonzero(loop.idle)
    if not idle.size:
        return a, b, k
    before = len(a) - 2 * loop.coordinates + idle
    to, back = np.eye(len(a)), np.eye(len(a))
    to[idle, before], back[idle, before] = -1.0, 1.0
    kept = ~np.isin(np.arange(len(a)), before)
    return (to @ a @ back)[kept][:, kept], (to @ b)[kept], (k @ back)[:, kept]


def stable_as_held(loop: Loop, period: float, r: Imperfections) -> bool:
    """Return whether a loop is stable with its inputs held for a period [s], and late."""
    return _radius(loop, period, r) < 1.0 - NOTHING


def _radius(loop: Loop, period: float, r: Imperfections, *more: Any) -> float:
    """Return the largest magnitude of a pole of a held loop."""
    a, b, k = _held(loop, period, r, *more)
    return float(np.abs(np.linalg.eigvals(a - b @ k)).max())


def _exact_delay(loop: Loop, period: float, r: Imperfections, place: int, about: float) -> float:
    """Return the delay at which a held loop loses its stability, at most near that of its phase.

    A delay of whole periods shifts the phase by its length times the frequency; within a period a
    held input that comes late is another plant, and not one whose phase is shifted. And where the
    gain is above 1 at the frequency of Nyquist, a delay may cost the stability there, which is no
    crossover: poles are followed through the first periods, and through that of the phase.
    """
    from scipy.optimize import brentq

    def beyond(extra: float) -> float:
        return _radius(loop, period, r, place, extra) - (1.0 - NOTHING)

    whole = math.floor(about / period) if math.isfinite(about) else FIRST_PERIODS
    periods = [*range(min(whole + 1, FIRST_PERIODS))]
    if FIRST_PERIODS <= whole <= MOST_PERIODS:
        periods = [*range(whole + 1)] if beyond(whole * period) >= 0.0 else [*periods, whole]
    for first in periods:
        for low, high in itertools.pairwise(period * (first + np.linspace(0.0, 1.0, PARTS + 1))):
            if beyond(high) >= 0.0:
                return float(brentq(beyond, low, high, xtol=1e-12 * period, rtol=1e-12))
    return about


def _broken(a: Array, b: Array, k: Array) -> list[tuple[Array, Array, Array]]:
    """Return the loop as each of its inputs sees it, the others closed."""
    return [(a - np.delete(b, i, 1) @ np.delete(k, i, 0), b[:, [i]], k[[i]]) for i in range(len(k))]


def held_plant(loop: Loop, period: float, delays: Sequence[float]) -> tuple[Array, Array]:
    """Return A and B from sample to sample; delayed inputs follow the states, latest first."""
    order, count = loop.b.shape
    late = []
    for delay in delays:
        whole = math.floor(delay / period + SNAP)
        rest = max(round(delay - whole * period, 15), 0.0)  # alike in every period
        rest = rest if rest > SNAP * period else 0.0
        late.append((whole, rest, whole + (rest > 0.0)))
    size = order + sum(pending for *_, pending in late)
    system, drive = np.zeros((size, size)), np.zeros((size, count))
    system[:order, :order] = _sampled(loop, period)[0]
    first = order
    for i, (whole, rest, pending) in enumerate(late):
        a, b = _sampled(loop, period - rest)  # of the input that comes last
        if rest:
            system[:order, first + pending - 1] = a @ _sampled(loop, rest)[1][:, i]
        if whole:
            system[:order, first + whole - 1] += b[:, i]
        else:
            drive[:order, i] = b[:, i]
        if pending:
            drive[first, i] = 1.0
        for j in range(1, pending):
            system[first + j, first + j - 1] = 1.0
        first += pending
    return system, drive


def _measured_loop(
    a: Array, b: Array, k: Array, period: float, r: Imperfections, n: int
) -> tuple[Array, Array, Array]:
    """Add what the sensors of n velocities remember: positions, and filtered velocities, before."""
    order = len(a)
    rows = np.eye(order + 2 * n)
    positions, velocities = rows[:n], rows[n : 2 * n]
    before, filtered = rows[order : order + n], rows[order + n :]
    if r.differentiated:
        velocities = (positions - before) / period
    kept = math.exp(-period / r.velocity_filter) if r.velocity_filter else 0.0
    seen = kept * filtered + (1.0 - kept) * velocities
    system = np.zeros((order + 2 * n, order + 2 * n))
    system[:order, :order], system[order : order + n], system[order + n :] = a, positions, seen
    gains = np.hstack([k, np.zeros((len(k), 2 * n))])
    gains[:, n : 2 * n] = 0.0
    return system, np.vstack([b, np.zeros((2 * n, b.shape[1]))]), gains + k[:, n : 2 * n] @ seen


def _sampled(loop: Loop, length: float) -> tuple[Array, Array]:
    """Return A and B of the plant over a length of time [s], its inputs held."""
    both = np.hstack([loop.a, loop.b])
    a, b = np.split(_grown(both.tobytes(), len(both), round(length, 15)), [len(both)], axis=1)
    return a, b


@functools.lru_cache(maxsize=1024)
def _grown(both: bytes, order: int, length: float) -> Array:
    """Return A and B over a length of time [s], of those of rates."""
    from scipy.linalg import expm  # what cont2discrete calls; scipy.signal takes long to import

    rates = np.frombuffer(both).reshape(order, -1)
    grown = np.zeros((rates.shape[1], rates.shape[1]))
    grown[:order] = rates
    return np.asarray(expm(length * grown)[:order])


class Broken(NamedTuple):
    """A loop broken at one input, of rates or from sample to sample, and whole periods late."""

    a: Array
    b: Array
    k: Array
    period: float | None = None  # [s]
    whole: int = 0

    def response(self, omega: Array) -> NDArray[np.complex128]:
        """Return L at frequencies [rad/s]."""
        p = 1j * omega if self.period is None else np.exp(1j * omega * self.period)
        found, each = np.empty(len(p), dtype=np.complex128), max(1, 4_000_000 // self.a.size)
        for i in range(0, len(p), each):  # as many matrices at a time as fit the memory
            matrices = p[i : i + each, None, None] * np.eye(len(self.a)) - self.a
            try:
                states = np.linalg.solve(matrices, self.b)
            except np.linalg.LinAlgError:  # at a pole: beside it
                beside = 1e-15 * np.abs(matrices).max() * np.eye(len(self.a))
                states = np.linalg.solve(matrices + beside, self.b)
            found[i : i + each] = (self.k @ states)[:, 0, 0]
        return np.asarray(found / p**self.whole)

    def frequencies(self) -> Array:
        """Return frequencies between which a response has one crossing at most, ascending."""
        from scipy.linalg import eigvals

        order = len(self.a)
        edge = np.block([[self.a, self.b], [self.k, np.zeros((1, 1))]])
        zeros = eigvals(edge, np.diag([1.0] * order + [0.0]))
        closed = self.a - self.b @ self.k
        known = np.concatenate([zeros, np.linalg.eigvals(self.a), np.linalg.eigvals(closed)])
        known = known[np.isfinite(known) & (np.abs(known) > NOTHING)]
        highest = np.inf
        if self.period is not None:
            known, highest = np.log(known.astype(complex)) / self.period, np.pi / self.period
        sizes = np.abs(known)[np.abs(known) > NOTHING]
        least, most = sizes.min() / BEYOND, min(sizes.max() * BEYOND, highest)
        places = np.abs(known.imag)[:, None] * (1.0 + np.concatenate([-1.3 * BESIDE, BESIDE]))
        found = [places.ravel(), np.geomspace(least, most * (1.0 - NOTHING), GRID)]
        if self.period is not None:
            found.append(np.linspace(0.0, most, TURNS * (self.whole + order) + 2)[1:-1])
        omega = np.unique(np.concatenate(found))
        omega = omega[(omega > 0.0) & (omega < highest)]
        return np.unique(np.concatenate([omega, 0.5 * (omega[1:] + omega[:-1])]))

    def ends(self) -> Array:
        """Return the frequencies at which L is real anyway, where it has a value."""
        ends = np.array([0.0] if self.period is None else [0.0, np.pi / self.period])
        p = ends if self.period is None else np.array([1.0, -1.0])
        near = np.abs(np.linalg.eigvals(self.a)[:, None] - p).min(axis=0)
        return np.asarray(ends[near > NOTHING])


def _margins(loop: Broken) -> Margins:
    from scipy.optimize import brentq, minimize_scalar

    def crossings(of: Callable[[Any], Any]) -> Array:
        signs = np.sign(of(response))
        pairs = np.flatnonzero(signs[1:] * signs[:-1] <= 0.0)
        at = functools.partial(_at, loop, of)
        found = [brentq(at, omega[i], omega[i + 1], xtol=1e-300, rtol=1e-14) for i in pairs]
        return np.unique(found)

    with np.errstate(all="ignore"):
        omega, ends = loop.frequencies(), loop.ends()
        response = loop.response(omega)
        crossovers = crossings(lambda x: np.log(np.abs(x)))
        crossed = loop.response(np.concatenate([ends, crossings(np.imag)]))
        real = crossed.real[np.abs(crossed.imag) <= NO_GAIN * np.abs(crossed)]  # not through a pole
        gains = -1.0 / real[real < 0.0]
        gains = gains[(gains > NO_GAIN) & (gains < 1.0 / NO_GAIN)]
        phases = np.angle(-loop.response(crossovers))
        delays = np.mod(phases, 2.0 * np.pi) / crossovers
        worst = int(np.argmin(delays)) if len(delays) else None
        sizes = _disk(response)
        least = int(np.argmin(sizes))
        near = omega[max(least - 1, 0)], omega[min(least + 1, len(omega) - 1)]
        at = functools.partial(_at, loop, _disk)
        disks = [sizes[least], *_disk(loop.response(ends)), minimize_scalar(at, bounds=near).fun]
    return Margins(
        gain_decrease=float(np.max(gains[gains < 1.0], initial=0.0)),
        gain_increase=float(np.min(gains[gains > 1.0], initial=np.inf)),
        phase=float(np.degrees(np.min(np.abs(phases), initial=np.inf))),
        delay=np.inf if worst is None else float(delays[worst]),
        crossover=np.inf if worst is None else float(crossovers[worst]),
        disk=float(min(disks)),
    )


def _at(loop: Broken, of: Callable[[Any], Any], omega: float) -> float:
    return float(of(loop.response(np.array([omega])))[0])


def _disk(response: NDArray[np.complex128]) -> Array:
    """Return the inverse of the size of (S - T)/2, of L = -1 + d the size of d."""
    return np.asarray(2.0 * np.abs(1.0 + response) / np.abs(1.0 - response))
