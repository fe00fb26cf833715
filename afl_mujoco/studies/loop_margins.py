"""A loop at upright, linearised by finite differences in MuJoCo, and its stability margins.

The margins are of the loop broken where the force enters the plant, and come from python-control.
Added here are the choice of the worst of several crossovers and the sampled loop, which is
transformed into a continuous loop with the same margins.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.belief import TRUTH, Belief
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.sampling import SNAP
from afl_mujoco.values import require_positive

if TYPE_CHECKING:
    from control import StateSpace

Array = NDArray[np.float64]

STEP = 1e-5
"""Step of the central differences [m, rad, m/s, rad/s, N]: their error falls with its square, the
rounding error grows with its inverse; here both are near 1e-10."""

COARSER = 10.0  # ratio of a second, longer step, with which the first is compared, to the first

AGREEMENT = 1e-5
"""Largest relative difference between the two results: the longer step's error is near 1e-7."""

REST = 1e-9  # largest force at upright [N]

KINK = 1e-3
"""Largest difference between a controller's slopes on either side of upright, relative to its
largest slope: central differences do not see a kink, whatever their step."""

COARSE, FINE = 80, 40
"""Numbers of frequencies at which the disk margin is sought: overall, then near the minimum."""

BEYOND = 100.0
"""Factor by which these frequencies reach below the slowest and above the fastest pole."""

PERIOD = 1e-3  # default control period [s]

LINEAR = (
    "delay", "lag", "damping.z", "damping.phi", "armature.z", "armature.phi", "tip_mass_share",
    "pole_radius", "control_period", "differentiated", "velocity_filter",
)  # fmt: skip
"""Imperfections that a linear loop can have."""

_UPRIGHT = np.zeros(4)


class NotSmoothError(InvalidValueError):
    """Raised for a controller whose force has no slope at upright."""


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """The loop ``x' = A x + B F``, ``F = -K x`` of the state x = (z, phi, z_dot, phi_dot).

    Shapes are (4, 4), (4,) and (4,), each with one more if the actuator lags.
    """

    a: Array
    b: Array
    k: Array
    disagreement: float = 0.0  # largest relative difference from those with a longer step

    @property
    def stable(self) -> bool:
        """Whether all poles lie in the left half-plane."""
        return bool(np.linalg.eigvals(self.a - np.outer(self.b, self.k)).real.max() < 0.0)


def linear_part(imperfections: Imperfections) -> Imperfections:
    """Return imperfections without those that a linear loop cannot have."""
    return Imperfections().changed({path: imperfections.at(path) for path in LINEAR})


def linearize(
    controller: Controller,
    plant: CartPoleParameters,
    imperfections: Imperfections = IDEAL,
    belief: Belief = TRUTH,
) -> Loop:
    """Return the loop of a controller, as it is deployed, and MuJoCo's cart-pole at upright.

    Of the imperfections passive physics count, and the actuator's lag, whose state follows those of
    the plant. `loop_margins` handles delay, hold and velocities. The nominal values of the belief
    must be known.
    """
    from afl_mujoco.simulation.mujoco_model import CartPoleModel

    r = linear_part(imperfections)
    model = CartPoleModel(plant, imperfections=r)
    assumed = replace(plant, **{name: belief.told(name, x) for name, x in asdict(plant).items()})

    def dynamics(state: Array, force: float) -> Array:
        return np.array([*state[2:], *model.accelerations(state, force)])

    def force(state: Array) -> Array:
        return np.array([controller.force(state, assumed)])

    thing = f"linearisation of {controller.name!r} at M = {plant.cart_mass:g} kg"
    thing += f", l = {plant.half_length:g} m"
    (at_rest,) = force(_UPRIGHT)
    if not abs(at_rest) <= REST:
        rule = "must be about an equilibrium: no force at upright"
        raise InvalidValueError(thing, rule, f"{at_rest:g} N")
    fine, coarse = (
        (
            _jacobian(lambda x: dynamics(x, 0.0), _UPRIGHT, step),
            _jacobian(lambda u: dynamics(_UPRIGHT, u[0]), np.zeros(1), step),
            -_jacobian(force, _UPRIGHT, step),
        )
        for step in (STEP, COARSER * STEP)
    )
    disagreement = max(
        float(np.abs(one - other).max() / max(np.abs(one).max(), 1e-300))
        for one, other in zip(fine, coarse, strict=True)
    )
    a, b, k = fine
    if not np.isfinite(k).all():
        raise InvalidValueError(thing, "must have finite slopes", k.ravel().tolist())
    ahead, behind = _sides(force, _UPRIGHT, STEP)
    bend = float(np.abs(ahead + behind - 2.0 * at_rest).max()) / STEP
    kink = bend / max(float(np.abs(k).max()), 1e-300)
    if not disagreement <= AGREEMENT:
        rule = f"must not depend on the step by more than {AGREEMENT:g}"
        raise NotSmoothError(thing, rule, f"{disagreement:.1e}")
    if not kink <= KINK:
        rule = f"must be smooth: slopes on either side may differ by {KINK:g} of the largest"
        raise NotSmoothError(thing, rule, f"{kink:.1e}")
    loop = Loop(a, b[:, 0], k[0], disagreement)
    return loop if r.lag == 0.0 else _lagging(loop, r.lag)


def _lagging(loop: Loop, lag: float) -> Loop:
    """Return a loop whose force follows what is commanded with a first-order lag [s]."""
    last = np.append(np.zeros(len(loop.b)), 1.0 / lag)
    a = np.block([[loop.a, loop.b[:, None]], [-last]])
    a[-1, :-1] = 0.0
    return Loop(a, last, np.append(loop.k, 0.0), loop.disagreement)


def _jacobian(function: Callable[[Array], Array], point: Array, step: float) -> Array:
    """Return the derivative of a function by central differences, shape (outputs, inputs)."""
    ahead, behind = _sides(function, point, step)
    return np.asarray((ahead - behind) / (2.0 * step))


def _sides(function: Callable[[Array], Array], point: Array, step: float) -> list[Array]:
    """Return a function a step ahead of a point and a step behind, shapes (outputs, inputs)."""
    offsets = step * np.eye(len(point))
    return [np.stack([function(point + x) for x in s * offsets], axis=-1) for s in (1.0, -1.0)]


# --- margins of a linear loop -------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """What a stable loop tolerates before it becomes unstable, one change at a time.

    The plant is unstable, so too little gain destabilises the loop as well as too much.
    """

    gain_decrease: float  # factor of the loop gain, below 1
    gain_increase: float  # the same, above 1; infinite if no increase destabilises it
    phase: float  # least additional lag or lead at a crossover [deg]
    delay: float  # least additional delay [s]; infinite if there is no crossover
    crossover: float  # frequency at which that delay destabilises it [rad/s]
    disk: float  # size of the largest disk of gain and phase at once, by the peak of (S - T)/2
    disk_gain: float  # factor of gain, up and down, that the disk contains
    disk_phase: float  # lag and lead that the disk contains [deg]


def loop_margins(
    loop: Loop, control_period: float | None = None, imperfections: Imperfections = IDEAL
) -> Margins | None:
    """Return the margins of a loop, or None if it is not stable.

    Without a control period [s] the controller is continuous. With one, the delay of the hold
    itself, half a period, is no longer part of the margin, and a loop whose delay is a whole number
    of periods is stable exactly up to the margin; of the imperfections count then the transport
    delay, besides which the delay margin is additional, and how the velocities are measured.
    """
    import control

    if control_period is None:
        if not loop.stable:
            return None
        return _margins(control.ss(loop.a, loop.b[:, None], loop.k[None], 0.0), None)
    period = require_positive("control_period", control_period)
    a, b = held_plant(loop, period, imperfections.delay)
    k = np.concatenate([loop.k, np.zeros(len(a) - len(loop.k))])
    if imperfections.differentiated or imperfections.velocity_filter:
        a, b, k = _measured_loop(a, b, k, period, imperfections)
    if not np.abs(np.linalg.eigvals(a - np.outer(b, k))).max() < 1.0:
        return None
    return _margins(_bilinear(a, b, k, period), period)


def delay_margin(
    controller: Controller,
    plant: CartPoleParameters,
    period: float = PERIOD,
    imperfections: Imperfections = IDEAL,
    belief: Belief = TRUTH,
) -> float | None:
    """Return the delay margin [s] of a linearised loop with a held force; None if it has none."""
    loop = linearize(controller, plant, imperfections, belief)
    margins = loop_margins(loop, period, imperfections)
    return None if margins is None or not math.isfinite(margins.delay) else margins.delay


def held_plant(loop: Loop, period: float, delay: float = 0.0) -> tuple[Array, Array]:
    """Return A and B of the plant from sample to sample, its force held in between.

    With a delay [s] from when a force is commanded to when it acts, the pending forces follow the
    states, the latest first.
    """
    whole = math.floor(delay / period + SNAP)
    late = max(delay - whole * period, 0.0)
    late = late if late > SNAP * period else 0.0
    a, b = _sampled(loop, period - late)  # of the force that comes last
    if delay < SNAP * period:
        return a, b
    order, waiting = len(a), whole + (1 if late else 0)
    system, drive = np.zeros((order + waiting, order + waiting)), np.zeros(order + waiting)
    system[:order, :order] = a
    if late:
        before, by_before = _sampled(loop, late)
        system[:order, :order] = a @ before
        system[:order, order + waiting - 1] = a @ by_before
    if whole:
        system[:order, order + whole - 1] += b
    else:
        drive[:order] = b
    drive[order] = 1.0
    for i in range(1, waiting):
        system[order + i, order + i - 1] = 1.0
    return system, drive


def _measured_loop(
    a: Array, b: Array, k: Array, period: float, r: Imperfections
) -> tuple[Array, Array, Array]:
    """Return A, B and K of a sampled loop whose controller gets its velocities by measurement.

    Four states are added, what the sensors remember: the positions and the filtered velocities of
    the sample before.
    """
    order = len(a)
    rows = np.eye(order + 4)
    positions, velocities, before, filtered = rows[:2], rows[2:4], rows[order:-2], rows[-2:]
    if r.differentiated:
        velocities = (positions - before) / period
    kept = math.exp(-period / r.velocity_filter) if r.velocity_filter else 0.0
    seen = kept * filtered + (1.0 - kept) * velocities
    system = np.zeros((order + 4, order + 4))
    system[:order, :order], system[order:-2], system[-2:] = a, positions, seen
    gains = np.append(k, np.zeros(4))
    gains[2:4] = 0.0
    return system, np.append(b, np.zeros(4)), gains + k[2:4] @ seen


def _sampled(loop: Loop, length: float) -> tuple[Array, Array]:
    """Return A and B of the plant over a length of time [s], its force held."""
    import control

    order = len(loop.a)
    plant = control.ss(loop.a, loop.b[:, None], np.eye(order), np.zeros((order, 1)))
    sampled = control.sample_system(plant, length, method="zoh")
    return np.asarray(sampled.A), np.asarray(sampled.B)[:, 0]


def _bilinear(a: Array, b: Array, k: Array, period: float) -> StateSpace:
    """Return a sampled loop as a function of w, where ``z = (1 + w T/2) / (1 - w T/2)``.

    The unit circle becomes the imaginary axis, so gain, phase and disk margins are those of a
    continuous loop, at frequencies ``(2/T) tan(omega T/2)``.
    """
    import control

    half = 0.5 * period
    inverse = np.linalg.inv(np.eye(len(a)) + a)
    a_w = inverse @ (a - np.eye(len(a))) / half
    b_w = inverse @ b / half
    direct = -half * (k @ b_w)
    return control.ss(a_w, (b_w - half * (a_w @ b_w))[:, None], k[None], direct)


def _margins(system: StateSpace, period: float | None) -> Margins:
    """Return the margins of a stable loop; of a sampled one as a function of w with its period."""
    import control

    gains, phases, _, _, crossovers, _ = control.stability_margins(system, returnall=True)
    if period is not None:
        at_nyquist = float(system.D[0, 0])  # w is infinite there: no crossover, but L is real
        gains = np.append(gains, -1.0 / at_nyquist) if at_nyquist < 0.0 else gains
        crossovers = 2.0 / period * np.arctan(0.5 * period * crossovers)
    delays = np.radians(np.mod(phases, 360.0)) / crossovers
    worst = int(np.argmin(delays)) if len(delays) else None
    with warnings.catch_warnings():  # python-control 0.10 does what NumPy 2.5 deprecates
        warnings.filterwarnings("ignore", "Setting the shape", DeprecationWarning)
        disk, disk_gain, disk_phase = _disk(system)
    return Margins(
        gain_decrease=float(np.max(gains[gains < 1.0], initial=0.0)),
        gain_increase=float(np.min(gains[gains > 1.0], initial=np.inf)),
        phase=float(np.min(np.abs(phases), initial=np.inf)),
        delay=np.inf if worst is None else float(delays[worst]),
        crossover=np.inf if worst is None else float(crossovers[worst]),
        disk=disk,
        disk_gain=disk_gain,
        disk_phase=disk_phase,
    )


def _disk(system: StateSpace) -> tuple[float, float, float]:
    """Return disk margin, its gain as a factor and its phase [deg]."""
    import control

    closed = np.abs(control.poles(control.feedback(system)))
    omega = np.geomspace(closed.min() / BEYOND, closed.max() * BEYOND, COARSE)
    least = int(np.argmin(control.disk_margins(system, omega, returnall=True)[0]))
    near = omega[max(least - 1, 0)], omega[min(least + 1, COARSE - 1)]
    alpha, gain, phase = control.disk_margins(system, np.geomspace(*near, FINE))
    return float(alpha), float(control.db2mag(gain)), float(phase)
