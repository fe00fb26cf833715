"""The estimator of M, l and the state, and controllers that use it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from afl_mujoco.compiled import kernel
from afl_mujoco.control.controller import Controller, Estimator
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS, CartPoleParameters, PlantRange
from afl_mujoco.scenario.scenario import Scenario

STATES = 6  # length of the estimator's state


@kernel
def accelerations(phi, phi_dot, force, plant):
    """Return (z'', phi'') [m/s^2, rad/s^2] under a force on the cart [N], Eq. (E1)."""
    cart_mass, pole_mass, half_length, gravity = plant
    sin, cos = np.sin(phi), np.cos(phi)
    inertia = (cart_mass + pole_mass) - 0.75 * pole_mass * cos * cos
    centripetal = pole_mass * half_length * phi_dot * phi_dot * sin
    cart = (force - centripetal + 0.75 * pole_mass * gravity * sin * cos) / inertia
    return cart, 0.75 / half_length * (gravity * sin + cart * cos)


@kernel
def moved(z, phi, z_dot, phi_dot, force, plant, dt):
    """Return (z, phi, z_dot, phi_dot) after `dt` under a held force: one step of RK4, Eq. (E2)."""
    half = 0.5 * dt
    z1, p1 = accelerations(phi, phi_dot, force, plant)
    z2, p2 = accelerations(phi + half * phi_dot, phi_dot + half * p1, force, plant)
    z3, p3 = accelerations(phi + half * (phi_dot + half * p1), phi_dot + half * p2, force, plant)
    z4, p4 = accelerations(phi + dt * (phi_dot + half * p2), phi_dot + dt * p3, force, plant)
    return (
        z + dt * (z_dot + dt / 6.0 * (z1 + z2 + z3)),
        phi + dt * (phi_dot + dt / 6.0 * (p1 + p2 + p3)),
        z_dot + dt / 6.0 * (z1 + 2.0 * (z2 + z3) + z4),
        phi_dot + dt / 6.0 * (p1 + 2.0 * (p2 + p3) + p4),
    )


@kernel
def linearise(phi, phi_dot, force, plant, cart_row, pole_row):
    """Write the derivatives of z'' and phi'' with respect to the states, Eq. (E3)."""
    cart_mass, pole_mass, half_length, gravity = plant
    sin, cos = np.sin(phi), np.cos(phi)
    cart, pole = accelerations(phi, phi_dot, force, plant)
    inertia = (cart_mass + pole_mass) - 0.75 * pole_mass * cos * cos
    lever = pole_mass * half_length * phi_dot
    weight = 0.75 * pole_mass * gravity * (cos * cos - sin * sin)
    cart_row[0] = cart_row[2] = pole_row[0] = 0.0
    cart_row[1] = (weight - lever * phi_dot * cos - 1.5 * pole_mass * sin * cos * cart) / inertia
    cart_row[3] = -2.0 * lever * sin / inertia
    cart_row[4] = -cart_mass * cart / inertia
    cart_row[5] = -lever * phi_dot * sin / inertia
    coupling = 0.75 / half_length * cos
    for i in range(1, STATES):
        pole_row[i] = coupling * cart_row[i]
    pole_row[1] += 0.75 / half_length * (gravity * cos - cart * sin)
    pole_row[5] -= pole
    return coupling, cart, pole


@kernel
def fill_transition(cart_row, pole_row, dt, transition):
    """Write the transition matrix I + A dt + (A dt)^2 / 2 of the six states, Eq. (E4)."""
    half = 0.5 * dt * dt
    cart_by_phi, cart_by_rate = cart_row[1], cart_row[3]
    pole_by_phi, pole_by_rate = pole_row[1], pole_row[3]
    transition[:] = 0.0
    for j in range(STATES):
        transition[j, j] = 1.0
    for j in range(STATES):
        transition[0, j] += half * cart_row[j]
        transition[1, j] += half * pole_row[j]
        transition[2, j] += dt * cart_row[j] + half * cart_by_rate * pole_row[j]
        transition[3, j] += dt * pole_row[j] + half * pole_by_rate * pole_row[j]
    transition[0, 2] += dt
    transition[1, 3] += dt
    transition[2, 3] += half * cart_by_phi
    transition[3, 3] += half * pole_by_phi


FILTER = np.dtype(
    [("excitation", np.float64, (2,)), ("nis", np.float64)]
    + [(n, np.float64, (STATES, STATES)) for n in ("covariance", "transition", "product")]
    + [(n, np.float64, (STATES,)) for n in ("state", "cart_row", "pole_row", "gain", "row")]
)
"""State (z, phi, z', phi', ln M, ln l) and covariance; moving means of z'' and l phi'' [m/s^2]; the
normalised innovation squared (NIS) of the last update; work space."""

LARGEST_TURN = 0.5
"""The filter restarts, with its present M and l, if the pole would turn more than this in a period
[rad]: such a state was not measured, and it allows no further prediction."""


def new_filter() -> Any:
    """Return a filter for `start`."""
    return np.zeros(1, FILTER)[0]


@kernel
def estimate(filter_):
    """Return the estimates of M [kg] and l [m]."""
    return np.exp(filter_.state[4]), np.exp(filter_.state[5])


@kernel
def filtered_state(filter_):
    """Return the filtered (z, phi, z_dot, phi_dot)."""
    x = filter_.state
    return x[0], x[1], x[2], x[3]


@kernel
def start(filter_, settings, z, phi):
    """Begin with the first measurement and return the initial estimates of M [kg] and l [m]."""
    filter_.nis = 0.0
    filter_.state[:] = 0.0
    filter_.covariance[:] = 0.0
    filter_.excitation[:] = 0.0
    filter_.state[0], filter_.state[1] = z, phi
    filter_.covariance[0, 0] = settings.position_variance
    filter_.covariance[1, 1] = settings.angle_variance
    filter_.covariance[2, 2] = settings.speed_variance
    filter_.covariance[3, 3] = settings.rate_variance
    for i in range(2):
        filter_.state[4 + i] = settings.ln_start[i]
        filter_.covariance[4 + i, 4 + i] = settings.ln_variance[i]
    return estimate(filter_)


@kernel
def update(filter_, settings, z, phi, force, dt):
    """Process one control period and return the estimates of M [kg] and l [m].

    z [m] and phi [rad] are measured at its end; the force [N] is its mean over the period.
    """
    _predict(filter_, settings, force, dt)
    if not abs(filter_.state[3]) * dt < LARGEST_TURN:
        mass, length = filter_.state[4], filter_.state[5]
        start(filter_, settings, z, phi)
        filter_.state[4], filter_.state[5] = mass, length
        return estimate(filter_)
    learns = (_learns(filter_, settings, 0), _learns(filter_, settings, 1))
    nis = _correct(filter_, 0, z, settings.position_variance, learns)
    nis += _correct(filter_, 1, phi, settings.angle_variance, learns)
    filter_.nis = nis
    for i in range(2):
        j = 4 + i
        if _excited(filter_, settings, i):
            filter_.covariance[j, j] = max(filter_.covariance[j, j], settings.least_variance[i])
        within = max(filter_.state[j], settings.ln_lowest[i])
        filter_.state[j] = min(within, settings.ln_highest[i])
    return estimate(filter_)


@kernel
def _excited(filter_, settings, i):
    return abs(filter_.excitation[i]) > settings.least_excitation[i]


@kernel
def _learns(filter_, settings, i):
    """Return whether M (0) or l (1) may change: it is excited, or not yet known."""
    variance = filter_.covariance[4 + i, 4 + i]
    return _excited(filter_, settings, i) or variance > settings.least_variance[i]


@kernel
def _predict(filter_, settings, force, dt):
    """Propagate state, covariance and excitations over a period, Eqs. (E2)-(E5)."""
    x, covariance = filter_.state, filter_.covariance
    plant = (np.exp(x[4]), settings.pole_mass, np.exp(x[5]), settings.gravity)
    after = moved(x[0], x[1], x[2], x[3], force, plant, dt)
    phi = 0.5 * (x[1] + after[1])
    phi_dot = 0.5 * (x[3] + after[3])
    cart_row, pole_row = filter_.cart_row, filter_.pole_row
    coupling, cart, pole = linearise(phi, phi_dot, force, plant, cart_row, pole_row)
    transition, product = filter_.transition, filter_.product
    fill_transition(cart_row, pole_row, dt, transition)
    noise = 0.5 * dt * settings.acceleration_intensity
    _add_noise(covariance, noise, coupling)
    for i in range(STATES):
        for j in range(STATES):
            sum_ = 0.0
            for k in range(STATES):
                sum_ += transition[i, k] * covariance[k, j]
            product[i, j] = sum_
    for i in range(STATES):
        for j in range(i, STATES):
            sum_ = 0.0
            for k in range(STATES):
                sum_ += product[i, k] * transition[j, k]
            covariance[i, j] = covariance[j, i] = sum_
    _add_noise(covariance, noise, coupling)
    x[0], x[1], x[2], x[3] = after
    share = dt / (dt + settings.excitation_memory)
    excitation = filter_.excitation
    excitation[0] += share * (cart - excitation[0])
    excitation[1] += share * (plant[2] * pole - excitation[1])


@kernel
def _add_noise(covariance, noise, coupling):
    """Add half the covariance of an unknown acceleration of the cart in a period, Eq. (E5)."""
    covariance[2, 2] += noise
    covariance[2, 3] += noise * coupling
    covariance[3, 2] = covariance[2, 3]
    covariance[3, 3] += noise * coupling * coupling * (1.0 + covariance[5, 5])


@kernel
def _correct(filter_, which, measured, variance, learns):
    """Correct by one coordinate in Joseph's form; return its squared innovation over its variance.

    Eqs. (E6)-(E8).
    """
    x, covariance, gain, row = filter_.state, filter_.covariance, filter_.gain, filter_.row
    innovation = measured - x[which]
    expected = covariance[which, which] + variance
    for i in range(STATES):
        row[i] = covariance[which, i]
        gain[i] = row[i] / expected if i < 4 or learns[i - 4] else 0.0
        x[i] += gain[i] * innovation
    for i in range(STATES):
        for j in range(i, STATES):
            left = covariance[i, j] - gain[i] * row[j]
            crossed = row[i] - gain[i] * row[which]
            covariance[i, j] = left - crossed * gain[j] + gain[i] * variance * gain[j]
            covariance[j, i] = covariance[i, j]
    return innovation * innovation / expected


SETTINGS = np.dtype(
    [(name, np.float64) for name in (
        "position_variance", "angle_variance", "acceleration_intensity", "speed_variance",
        "rate_variance", "excitation_memory", "pole_mass", "gravity",
    )]
    + [(name, np.float64, (2,)) for name in (  # of M, then of l
        "least_variance", "least_excitation", "ln_start", "ln_variance", "ln_lowest", "ln_highest",
    )]
    + [("force_sensed", np.int64)]
)  # fmt: skip
"""The settings as the compiled estimator takes them, SI units."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorSettings:
    """What the estimator assumes of the hardware, and how accurate each assumption is.

    Positive numbers, which are not checked: a controller by its name has these.
    """

    # standard deviation of the measured z [m] and phi [rad]; for an encoder that only rounds, its
    # step over the square root of 12. The defaults are for steps of 0.35 mm and 3600 counts per
    # turn
    position_noise: float = 1e-4
    angle_noise: float = 5e-4
    # intensity of the white acceleration of the cart that the model does not know, from forces that
    # are not measured [m/s^2/sqrt(Hz)]. A larger value makes the estimate of M more robust against
    # friction, and more biased at rest: the controller reacts to the noise that passes the filter
    acceleration_noise: float = 0.01
    # least relative standard deviation of M and l while the motion is excited [1]: it keeps the
    # filter able to follow a change of M or l
    cart_mass_accuracy: float = 0.1
    half_length_accuracy: float = 0.1
    # excitation: an estimate of M or l that has reached that accuracy is frozen while the moving
    # mean of z'' or of l phi'' is smaller than this [m/s^2]: what moves a settled cart-pole is the
    # noise of its own sensors, from which nothing is learned
    least_cart_acceleration: float = 0.05
    least_pole_acceleration: float = 0.03
    excitation_memory: float = 0.3  # time constant of that moving mean [s]
    # M and l assumed before the first measurement [kg, m]. A light cart makes the first force
    # gentle: an estimate that is too light costs milliseconds, one that is too heavy can cost the
    # run
    initial_cart_mass: float = 0.1
    initial_half_length: float = 0.5
    # standard deviation of the logarithms of M and l before the first measurement [1]
    cart_mass_spread: float = 1.5
    half_length_spread: float = 1.0
    # standard deviation of the velocities, which are assumed to be zero then [m/s, rad/s]
    speed_spread: float = 1.0
    rate_spread: float = 1.0
    # whether the drive reports the force that it exerts, as a drive that measures its current does.
    # Otherwise the estimator gets the command, cut off at the force limit, which ignores a delay, a
    # slew rate or a lag of the drive
    force_sensed: bool = False

    def on(self, start: CartPoleParameters) -> tuple[Any, PlantRange]:
        """Return the settings for the compiled estimator, and the plants that it may assume."""
        masses = _around(start.cart_mass, (*CART_MASSES, self.initial_cart_mass))
        lengths = _around(start.half_length, (*HALF_LENGTHS, self.initial_half_length))
        assumed = PlantRange(masses, lengths, start.pole_mass, start.gravity)
        (found,) = np.zeros(1, SETTINGS)
        found["position_variance"] = self.position_noise**2
        found["angle_variance"] = self.angle_noise**2
        found["acceleration_intensity"] = self.acceleration_noise**2
        found["least_variance"] = self.cart_mass_accuracy**2, self.half_length_accuracy**2
        found["least_excitation"] = self.least_cart_acceleration, self.least_pole_acceleration
        found["ln_start"] = np.log((self.initial_cart_mass, self.initial_half_length))
        found["ln_variance"] = self.cart_mass_spread**2, self.half_length_spread**2
        found["ln_lowest"], found["ln_highest"] = np.log([masses, lengths]).T
        found["speed_variance"], found["rate_variance"] = self.speed_spread**2, self.rate_spread**2
        found["excitation_memory"] = self.excitation_memory
        found["force_sensed"] = self.force_sensed
        found["pole_mass"], found["gravity"] = start.pole_mass, start.gravity
        return found, assumed


MORE = 1.25  # factor by which an estimate may go beyond the usual plants at either end

CHANGED = 2.0
"""Factor by which an estimate may go beyond the plant at the start of a run: a load as heavy as the
cart, a pole drawn out to twice its length."""


def _around(start: float, usual: tuple[float, ...]) -> tuple[float, float]:
    """Return the range in which an estimate of M or l is kept.

    The box of the paper, widened by a quarter at either end, and half to twice the value at the
    start of a run: the plant as it is set up is known, what it becomes is not.
    """
    return min(start / CHANGED, min(usual) / MORE), max(start * CHANGED, max(usual) * MORE)


GRID = 11  # number of values of M, and of l, for which gains are checked before a run


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatedController(Controller):
    """A controller with the estimator of its M, l and state; only sampled mode supports it."""

    name: str  # name for reports and files
    controller: Controller  # the compiled controller that uses the estimates
    # settings of the estimator
    settings: EstimatorSettings = field(default_factory=EstimatorSettings)
    estimates: ClassVar[bool] = True
    not_compiled: ClassVar[str] = 'uses the estimator; only mode "sampled" supports it'

    def estimator_for(self, start: CartPoleParameters) -> Estimator:
        """Return controller and settings as compiled loops take them."""
        settings, assumed = self.settings.on(start)
        self.controller.inputs_for(assumed.grid(GRID))  # raises if a gain is not positive
        return Estimator(self.controller.compiled_for(assumed), settings)

    def remarks(self, scenario: Scenario) -> list[str]:
        """Return those of the controller inside, and where the plant leaves what is estimated."""
        _, assumed = self.settings.on(scenario.parameters_at(0.0))
        plants = scenario.plants
        return self.controller.remarks(scenario) + [
            f"{symbol} goes to {value:g} {unit}, beyond the {least:g} to {largest:g} {unit} that "
            "the estimator may assume"
            for symbol, unit, (least, largest), ends in (
                ("M", "kg", assumed.cart_mass, plants.cart_mass),
                ("l", "m", assumed.half_length, plants.half_length),
            )
            for value in sorted({*ends})
            if not least <= value <= largest
        ]

    def about(self, home: float) -> EstimatedController:
        """Return the same with the controller inside about a place [m]."""
        return replace(self, controller=self.controller.about(home))

    def without_estimator(self) -> Controller:
        """Return the controller inside, which sees the true M and l."""
        return self.controller

    def inputs_for(self, values: Floats) -> Floats:
        """Return the inputs that the controller would have if M and l were known."""
        return self.controller.inputs_for(values)

    def describe(self) -> dict[str, Any]:
        """Return controller and estimator as plain data, for provenance."""
        return {
            "name": self.name,
            "controller": self.controller.describe(),
            "estimator": asdict(self.settings),
            "belief": "estimated",
        }
