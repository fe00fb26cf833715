"""The cart-pole as a dm_control environment: `load`, the task, and the controller as an agent."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.graphics import choose_backend
from afl_mujoco.scenario.catalogue import with_ranges
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.mujoco_model import CartPoleModel
from afl_mujoco.simulation.sampled.runs import fine_enough, ticks_of
from afl_mujoco.simulation.trajectory import FALL_ANGLE, STATE_LIMIT
from afl_mujoco.values import require_finite, require_positive

choose_backend()
from afl_mujoco.simulation.mujoco_physics import Physics  # noqa: E402  (says if dm_control is missing)

from dm_control.rl import control  # noqa: E402  (it reads MUJOCO_GL when imported)  # isort: skip
from dm_control.utils.rewards import tolerance  # noqa: E402  # isort: skip
from dm_env import TimeStep, specs  # noqa: E402  # isort: skip

PHI_MARGIN = math.pi / 3
"""Lean [rad] at which the reward's upright term is 0.1: the start of the paper's runs."""

Z_MARGIN = 2.0
"""Distance [m] at which the reward's centred term is 0.1."""

FORCE_MARGIN = 100.0
"""Force [N] at which the reward's effort term is 0.1."""

_MARGINS = np.array([PHI_MARGIN, Z_MARGIN, FORCE_MARGIN])

OBSERVED, HIDDEN, PRIVILEGED = PARAMETERS = ("observed", "hidden", "privileged")
"""Whether the observation has M and l."""

DAMPING = ("damping.z", "damping.phi")
LIGHTER = ("armature.z", "armature.phi", "tip_mass_share", "pole_radius")
"""Imperfections that slow a joint the faster the larger, and the smaller, they are."""

SAMPLES = 2**31 - 1
"""Number of samples from which episodes are drawn."""

ENVIRONMENT_KEYS = ("flat_observation", "time_limit")
"""Keys that `load` accepts in ``environment_kwargs``; it sets the others itself."""


def reward(z: ArrayLike, phi: ArrayLike, force: ArrayLike) -> Any:
    """Return the reward of `Balance`, smooth and within (0, 1].

    With ``near(x, margin)``, which is 1 at 0 and 0.1 at the margin, from
    `dm_control.utils.rewards.tolerance` with its long tail, the reward is ``near(phi, PHI_MARGIN) *
    (1 + near(z, Z_MARGIN)) / 2 * (4 + near(force, FORCE_MARGIN)) / 5``. It is a product, as in the
    suite's cart-pole: balance counts most, a cart off centre at most halves it, effort costs at
    most a fifth. The long tails leave a slope to follow far from the goal. It is 1 only where
    the pole is upright at z = 0, without force.

    z, phi, force: Cart position [m], pole angle [rad], force on the cart [N]: numbers, or arrays of
        one shape.
    """
    away = np.array([phi, z, force]).T / _MARGINS  # in one call: it is slow for single numbers
    upright, centred, easy = tolerance(away, margin=1.0, sigmoid="long_tail").T
    return upright * (1.0 + centred) / 2.0 * (4.0 + easy) / 5.0


class Balance(control.Task):  # type: ignore[misc]
    """Balance the pole and bring the cart to z = 0; an episode ends when the pole falls.

    The observation is ``position`` (z, phi) [m, rad], ``velocity`` (z_dot, phi_dot) [m/s, rad/s],
    as the sensors measure them, and (M, l) [kg, m], each at the instant of the observation, after
    any jump there. The action is the commanded force [N], clipped to the limit and held until the
    next. The discount is 0 if the pole has fallen, 1 mrad short of a right angle, or the state
    diverges.

    Parameters
    ----------
    force_limit
        Largest force [N], below 1e6.
    initial_noise
        Half-width of the uniform perturbation of phi(0) [rad].
    random
        Seed or `numpy.random.RandomState` of that perturbation, and of the scenarios drawn.
    parameters
        ``"observed"``: the observation has ``parameters``, the (M, l) that a controller assumes;
        ``"privileged"``: it has ``privileged``, the true (M, l), for a critic or a teacher;
        ``"hidden"``: it has neither.
    space
        The space from which the scenario of every episode is drawn; None for always the same.
    """

    def __init__(
        self,
        *,
        force_limit: float = 1000.0,
        initial_noise: float = 0.0,
        random: int | np.random.RandomState | None = None,
        parameters: str = OBSERVED,
        space: SampleSpace | None = None,
    ) -> None:
        self._limit = require_positive("force_limit", force_limit)
        if self._limit >= STATE_LIMIT:
            raise InvalidValueError("force_limit", f"must be below {STATE_LIMIT:g} N", self._limit)
        self._noise = require_finite("initial_noise", initial_noise)
        if self._noise < 0.0:
            raise InvalidValueError("initial_noise", "must not be negative", initial_noise)
        if parameters not in PARAMETERS:
            raise UnknownNameError.among("parameters", parameters, PARAMETERS)
        self._random = _random_state(random)
        self._parameters, self._space = parameters, space

    @property
    def random(self) -> np.random.RandomState:
        """The source of the initial perturbations and of the scenarios drawn."""
        return self._random

    @property
    def space(self) -> SampleSpace | None:
        """The space from which scenarios are drawn; None if they are not."""
        return self._space

    def initialize_episode(self, physics: Physics) -> None:
        """Put the plant into the scenario's initial state, drawn and perturbed if so configured.

        The scenario drawn is sample i of the space with seed 0 (`sample_scenario`), i at random.
        """
        scenario, start = self.draw(physics.scenario)
        if self._space is not None:
            physics.follow(scenario)
        physics.begin(start)

    def draw(self, scenario: Scenario) -> tuple[Scenario, tuple[float, float, float, float]]:
        """Return the scenario of an episode, and where it starts.

        Parameters
        ----------
        scenario
            The scenario if none is drawn.
        """
        if self._space is not None:
            scenario = sample_scenario(self._space, int(self._random.randint(SAMPLES)), 0)
        z, phi, z_dot, phi_dot = scenario.initial_state
        if self._noise > 0.0:
            phi += self._random.uniform(-self._noise, self._noise)
        return scenario, (z, phi, z_dot, phi_dot)

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """Return the bounds of the force [N]."""
        return specs.BoundedArray((1,), np.float64, -self._limit, self._limit, name="force [N]")

    def before_step(self, action: ArrayLike, physics: Physics) -> None:
        """Hold the clipped action over the next physics steps; refuse one that is not finite."""
        values = np.asarray(action, dtype=np.float64)
        if values.shape != (1,):
            raise InvalidValueError("action", "must have shape (1,)", values.shape)
        force = require_finite("action", values[0])
        physics.data.ptr.ctrl[0] = min(max(force, -self._limit), self._limit)

    def get_observation(self, physics: Physics) -> OrderedDict[str, NDArray[np.float64]]:
        """Return position, velocity and, if so configured, parameters at this instant."""
        measured = physics.measured()
        observation = OrderedDict(position=measured[:2], velocity=measured[2:])
        if self._parameters == OBSERVED:
            observation["parameters"] = physics.told_parameters()
        elif self._parameters == PRIVILEGED:
            observation["privileged"] = physics.parameters()
        return observation

    def get_reward(self, physics: Physics) -> float:
        """Return `reward` after the step, 0 if the state has diverged."""
        if physics.diverged():
            return 0.0
        z, phi = physics.data.ptr.qpos
        return float(reward(z, phi, physics.data.ptr.ctrl[0]))

    def get_termination(self, physics: Physics) -> float | None:
        """Return discount 0 if the pole has fallen or the state has diverged."""
        fallen = abs(physics.data.ptr.qpos[1]) >= FALL_ANGLE
        return 0.0 if fallen or physics.diverged() else None


def _random_state(random: Any) -> np.random.RandomState:
    """Return the random state that dm_control's suite would make of its argument `random`."""
    if isinstance(random, np.random.RandomState):
        return random
    try:
        return np.random.RandomState(random)
    except (TypeError, ValueError):
        rule = "must be a seed from 0 to 2**32 - 1, a numpy.random.RandomState or None"
        raise InvalidValueError("random", rule, repr(random)) from None


def load(
    scenario: str | Path | Scenario = "nominal",
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    force_limit: float = 1000.0,
    initial_noise: float = 0.0,
    random: int | np.random.RandomState | None = None,
    parameters: str = OBSERVED,
    randomize: bool = False,
    environment_kwargs: Mapping[str, Any] | None = None,
) -> control.Environment:
    """Return a scenario as a dm_control environment, as `dm_control.suite.load` does.

    Parameters
    ----------
    scenario
        A name of the catalogue, a TOML file or a `Scenario`, with its imperfections.
    timestep
        Physics step [s], as in `simulate_mujoco`; the plant changes at each step.
    control_period
        How long an action is held [s], a multiple of `timestep` (default: that of the scenario's
        imperfections, else one step).
    integrator
        MuJoCo's integrator, as in `simulate_mujoco`.
    force_limit, initial_noise, random, parameters
        As in `Balance`.
    randomize
        Whether to draw each episode's scenario from the scenario's ``[ranges]``; one without them
        gets a random start and random laboratory hardware, as in `with_ranges`.
    environment_kwargs
        ``flat_observation`` or ``time_limit`` [s], which is the scenario's duration by default;
        beyond the duration the plant keeps its last parameters.

    Returns
    -------
    dm_control.rl.control.Environment
        The environment, its task a `Balance`.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule.
    """
    scenario = as_scenario(scenario)
    space = SampleSpace(with_ranges(scenario, start=True)) if randomize else None
    asked = ticks_of(scenario, timestep, control_period)
    ticks = fine_enough(asked, _decay_rate(scenario, space, integrator))
    task = Balance(
        force_limit=force_limit,
        initial_noise=initial_noise,
        random=random,
        parameters=parameters,
        space=space,
    )
    leans = (scenario.initial_state[1], scenario.initial_state[1])
    leans = leans if space is None else space.varied.get("phi", leans)
    if (initial_noise > 0.0 or randomize) and max(map(abs, leans)) + initial_noise >= FALL_ANGLE:
        raise InvalidValueError(
            "initial_noise", "must not let the pole start fallen", initial_noise
        )
    # Half a step early, so that round-off in the division by the period cannot add a period.
    settings = {
        "time_limit": scenario.duration - 0.5 * ticks.timestep,
        **(environment_kwargs or {}),
    }
    for key in settings:
        if key not in ENVIRONMENT_KEYS:
            raise UnknownNameError.among("environment_kwargs", key, ENVIRONMENT_KEYS)
    if settings["time_limit"] != math.inf:
        require_positive("time_limit", settings["time_limit"])
    physics = Physics(scenario, timestep=ticks.timestep, integrator=integrator, hold=ticks.hold)
    return control.Environment(physics, task, n_sub_steps=ticks.hold, legacy_step=False, **settings)


def _decay_rate(scenario: Scenario, space: SampleSpace | None, integrator: str) -> float:
    """Return the fastest `CartPoleModel.decay_rate` of the scenarios of any episode [1/s]."""
    hardware, plants = scenario.imperfections, scenario.plants
    if space is not None:
        passive = {n: space.varied[n] for n in (*DAMPING, *LIGHTER) if n in space.varied}
        ends: dict[str, Any] = {n: bounds[n in DAMPING] for n, bounds in passive.items()}
        hardware = hardware.changed(ends)
        masses, lengths = space.bounds("cart_mass"), space.bounds("half_length")
        plants = plants._replace(cart_mass=masses, half_length=lengths)
    parameters = scenario.parameters_at(0.0)
    model = CartPoleModel(parameters, integrator=integrator, imperfections=hardware)
    return model.decay_rate(plants)


def controller_policy(
    controller: Controller, scenario: Scenario, *, control_period: float | None = None
) -> Callable[[TimeStep], NDArray[np.float64]]:
    """Return the agent that runs a control law on the observation.

    With it an environment reproduces `simulate_mujoco` in sampled mode, bit for bit.

    control_period: Control period of the environment [s], for a Python controller, which gets the
        time: the observation does not have it.
    """
    if controller.interpreted and control_period is None:
        raise InvalidValueError("control_period", f"must be given for {controller.name!r}")
    period, tick, own = control_period or 0.0, 0, controller.start()

    def policy(time_step: TimeStep) -> NDArray[np.float64]:
        nonlocal tick, own
        tick = 0 if time_step.first() else tick + 1
        if time_step.first():
            own = controller.start()
        seen = time_step.observation
        for name in ("position", "velocity", "parameters"):
            if name not in seen:
                raise InvalidValueError("observation", f"must hold {name!r}", ", ".join(seen))
        cart_mass, half_length = seen["parameters"].tolist()
        pole_mass, gravity = scenario.told_constants
        truth = CartPoleParameters(
            cart_mass=cart_mass, pole_mass=pole_mass, half_length=half_length, gravity=gravity
        )
        state = np.concatenate([seen["position"], seen["velocity"]])
        return np.array([own.force(state, truth, tick * period)])

    return policy
