"""A scenario as a dm_control environment: `load`, the task, and the controller as an agent."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError, MissingPackageError, require_count, told
from afl_mujoco.graphics import choose_backend
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.catalogue import with_ranges
from afl_mujoco.scenario.files import as_scenario
from afl_mujoco.scenario.ranges import scheduled_columns
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import ticks_of
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.drawing import drawn_model
from afl_mujoco.simulation.judgement import require_start
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.sampled.episode import World
from afl_mujoco.simulation.sampled.runs import fine_enough
from afl_mujoco.simulation.trajectory import STATE_LIMIT, Layout, criterion_of, within_limits
from afl_mujoco.values import require_finite, require_positive, require_switch

choose_backend()  # dm_control reads MUJOCO_GL when imported

try:
    from dm_control.mujoco import Physics as DmPhysics
    from dm_control.mujoco import wrapper
    from dm_control.rl import control
    from dm_control.utils.rewards import tolerance
    from dm_env import TimeStep, specs
except ModuleNotFoundError as error:  # beyond Python 3.12 pip cannot install it with the rest
    rule = "must be installed: pip install --no-deps 'dm-control>=1.0.50,<1.1'"
    raise MissingPackageError(str(error.name), rule) from None


PHI_MARGIN = math.pi / 3
"""Lean [rad] at which the reward's upright term is 0.1: the start of the paper's runs."""

Z_MARGIN = 2.0  # distance [m] at which the reward's centred term is 0.1
FORCE_MARGIN = 100.0  # force [N] at which the reward's effort term is 0.1

_MARGINS = np.array([PHI_MARGIN, Z_MARGIN, FORCE_MARGIN])

DAMPING, LIGHTER = ("damping.",), ("armature.", "tip_mass_share", "pole_radius")
"""What slows a joint the faster the larger, and the smaller, it is: beginnings of imperfections."""

SAMPLES = 2**31 - 1  # number of samples from which episodes are drawn


class Physics(DmPhysics):  # type: ignore[misc]
    """A dm_control Physics whose plant follows a scenario, step by step, with its imperfections.

    Between steps model and data belong to the instant ``time()``, after its ideal impulses: a
    picture shows the current length. The instant is the whole number of timesteps nearest to
    ``data.time``, so `set_state` with MuJoCo's time in it moves along the schedule too; call
    `forward` after it. The state of the hardware, such as delayed commands, is not part of MuJoCo's
    state: `set_state` does not change it.

    timestep: Physics step [s]; the last ends at the scenario's duration, though ``time()`` counts
    whole ones.
    """

    def __init__(
        self, scenario: Scenario, *, timestep: float, integrator: str, hold: int = 1
    ) -> None:
        self._seen_at: tuple[int, bytes] | None = None
        self._model = drawn_model(scenario, timestep=timestep, integrator=integrator)
        self.world = World(self._model, timestep, hold)
        self.world.follow(scenario)
        data = wrapper.MjData(wrapper.MjModel(self._model.mj_model))
        self._model.drive(data.ptr)
        super().__init__(data)
        self.reset()

    @property
    def scenario(self) -> Scenario:
        """The scenario that it follows."""
        return self.world.scenario

    @property
    def instant(self) -> int:
        """Number of steps since t = 0."""
        return round(float(self.data.ptr.time) / self.world.timestep)

    def measured(self) -> Floats:
        """Return the state as measured at this control tick, shape (2 n,)."""
        now = (self.instant, self.world.state.tobytes())
        if now != self._seen_at:  # filters and differences must see each tick once
            self.world.measured(self.instant)
            self._seen_at = now
        return self.world.run.measured.copy()

    def diverged(self) -> bool:
        """Return whether the state exceeds `STATE_LIMIT` or is not finite."""
        return not within_limits(self.world.state)

    def begin(self) -> None:
        """Put the plant at t = 0 into its initial state, then apply the impulses there."""
        self.data.ptr.time = 0.0
        self._seen_at = None
        with self.check_invalid_state():
            self.world.begin()

    def reset(self, keyframe_id: int | None = None) -> None:
        """Return to the scenario's initial state, plant included."""
        super().reset(keyframe_id)
        self._model.set_imperfections(self.scenario.imperfections)
        self.begin()

    def forward(self) -> None:
        """Update everything in model and data to this instant and state."""
        with self.check_invalid_state():
            self.world.write_at(self.instant)

    def step(self, nstep: int = 1) -> None:
        """Advance under the commands in MjData, which then holds what the drives exert."""
        for name, force in zip(self.scenario.plant.inputs, self.data.ptr.ctrl, strict=True):
            if not abs(force) < STATE_LIMIT:
                unit = f" {self.scenario.plant.units[name]}".rstrip()
                rule = f"must be below {STATE_LIMIT:g}{unit}"
                raise InvalidValueError("control", rule, f"{force:g}{unit}")
        self.data.ptr.time = self.world.advance(self.instant, nstep) * self.world.timestep

    def copy(self, share_model: bool = False) -> NoReturn:
        """Raise: the state of the hardware is not part of MuJoCo's, and the model changes."""
        raise InvalidValueError("Physics", "cannot be copied: load the scenario again")

    __getstate__ = copy

    def _reload_from_model(self, model: Any) -> None:
        raise InvalidValueError("model", "cannot be replaced: it follows the scenario")


def reward(z: ArrayLike, phi: ArrayLike, force: ArrayLike) -> Any:
    """Return the reward of `Balance` on the cart-pole, smooth and within (0, 1].

    It is a product, as in the suite's cart-pole: balance counts most, a cart off centre at most
    halves it, effort costs at most a fifth; long tails leave a slope to follow far from the goal.
    """
    away = np.array([phi, z, force]).T / _MARGINS  # in one call: it is slow for single numbers
    upright, centred, easy = tolerance(away, margin=1.0, sigmoid="long_tail").T
    return upright * (1.0 + centred) / 2.0 * (4.0 + easy) / 5.0


def nearness(away: ArrayLike, bands: ArrayLike) -> Any:
    """Return the reward of `Balance` on any other plant: the mean of ``1 / (1 + (x / band)^2)``."""
    return (1.0 / (1.0 + (np.asarray(away) / bands) ** 2)).mean(axis=-1)


def numbers_of(thing: str, given: ArrayLike, shape: tuple[int, ...] | None = None) -> Floats:
    """Return an action as an array of floats, of a shape if one is given, or raise."""
    try:
        found = np.asarray(given)
        if found.dtype.kind not in "biuf":
            raise TypeError
        found = found.astype(np.float64)
    except (TypeError, ValueError):
        raise InvalidValueError(thing, "must be numbers", told(given, repr)) from None
    if shape is not None and found.shape != shape:
        raise InvalidValueError(thing, f"must have shape {shape}", found.shape)
    return found


class Reward:
    """What an instant of a scenario is worth, and where an episode ends, for one state or many."""

    def __init__(self, scenario: Scenario) -> None:
        self._layout, self._is_cart_pole = Layout.of(scenario), scenario.is_cart_pole
        self._bands = np.array([scenario.band(name) for name in scenario.plant.coordinates])
        self._ends = criterion_of(scenario).ends

    def of(self, states: Floats, inputs: Floats) -> Any:
        """Return the reward of finite states under inputs, shapes (N, 2 n) and (N, k)."""
        away = self._layout.away(states)[:, : len(self._bands)]
        if self._is_cart_pole:
            return reward(away[:, 0], away[:, 1], inputs[:, 0])
        return nearness(away, self._bands)

    def ended(self, states: Floats, peaks: Floats) -> NDArray[np.bool_]:
        """Return whether a coordinate is as far from its target as ends a run.

        Or was, of which `peaks` tells of the last control period, shape (N, n).
        """
        away = np.abs(states[:, : len(self._ends)] - self._layout.target)
        if (away > math.pi).any():  # the shorter way, where one comes round
            away = np.abs(self._layout.away(states)[:, : len(self._ends)])
        return np.asarray((np.maximum(away, peaks) >= self._ends).any(axis=1))


class Balance(control.Task):  # type: ignore[misc]
    """Bring the coordinates to their targets, of the cart-pole by default upright and z = 0.

    The observation is ``position`` and ``velocity``, of the cart-pole (z, phi) [m, rad] and (z_dot,
    phi_dot) [m/s, rad/s], as the sensors measure them, and ``parameters``, of the cart-pole (M, l)
    [kg, m], of another plant all, each at the instant of the observation, after any jump there. The
    action is the command of each input (of the cart-pole the force [N]), clipped to the limits and
    held until the next.
    The reward is `reward` on the cart-pole, else `nearness`. The discount is 0 if a coordinate is
    as far from its target as ends a run (the pole has fallen, 1 mrad short of a right angle), or
    the state diverges.

    Parameters
    ----------
    force_limit
        Largest force [N], below 1e6; an input whose limits in the MJCF or by its drive are closer
        has those.
    random
        Seed or `numpy.random.RandomState` of the scenarios drawn.
    space
        The space from which the scenario of every episode is drawn; None for always the same.
    """

    def __init__(
        self,
        *,
        force_limit: float = 1000.0,
        random: int | np.random.RandomState | None = None,
        space: SampleSpace | None = None,
    ) -> None:
        self._limit = require_positive("force_limit", force_limit)
        if self._limit >= STATE_LIMIT:
            raise InvalidValueError("force_limit", f"must be below {STATE_LIMIT:g} N", self._limit)
        if not isinstance(random, np.random.RandomState):
            seed = None if random is None else require_count("random", random, 0, 2**32 - 1)
            random = np.random.RandomState(seed)
        self.random: np.random.RandomState = random
        self.space = space

    def initialize_episode(self, physics: Physics) -> None:
        """Put the plant into the initial state of the scenario, drawn if so configured."""
        scenario = self.draw(physics.scenario)
        if self.space is not None:
            physics.world.follow(scenario)
        self._reward = Reward(scenario)
        physics.begin()

    def draw(self, scenario: Scenario) -> Scenario:
        """Return the scenario of an episode, the given one if none is drawn.

        The one drawn is sample i of the space with seed 0 (`sample_scenario`), i at random.
        """
        if self.space is None:
            return scenario
        return sample_scenario(self.space, int(self.random.randint(SAMPLES)), 0)

    def bounds(self, scenario: Scenario) -> Floats:
        """Return least and largest inputs, shape (2, k), the same in every episode, or raise."""
        widest = scenario if self.space is None else self.space.corners[1]
        found: Floats = np.clip(widest.limits, -self._limit, self._limit).T
        if (found[0] >= found[1]).any():
            raise InvalidValueError("force_limit", "must leave each input a range", self._limit)
        return found

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """Return the bounds of the inputs [N, N m]."""
        plant = physics.scenario.plant
        low, high = self.bounds(physics.scenario)
        units = [f" [{plant.units[name]}]" if plant.units[name] else "" for name in plant.inputs]
        words = ", ".join(map("".join, zip(plant.inputs, units, strict=True)))
        return specs.BoundedArray((len(low),), np.float64, low, high, name=words)

    def before_step(self, action: ArrayLike, physics: Physics) -> None:
        """Hold the clipped action over the next physics steps; refuse one that is not finite."""
        control = physics.data.ptr.ctrl
        values = numbers_of("action", action, control.shape)
        for i, (low, high) in enumerate(physics.scenario.plant.limits.tolist()):
            force = require_finite("action", values[i])
            control[i] = min(max(force, -self._limit, low), self._limit, high)

    def get_observation(self, physics: Physics) -> OrderedDict[str, Floats]:
        """Return position, velocity and parameters at this instant."""
        position, velocity = np.split(physics.measured(), 2)
        told = physics.world.told(physics.instant)
        return OrderedDict(position=position, velocity=velocity, parameters=told)

    def get_reward(self, physics: Physics) -> float:
        """Return the reward after the step, 0 if the state has diverged."""
        if physics.diverged():
            return 0.0
        return float(self._reward.of(physics.world.state[None], physics.data.ptr.ctrl[None])[0])

    def get_termination(self, physics: Physics) -> float | None:
        """Return discount 0 if a run ends here, of the cart-pole fallen, or has diverged."""
        world = physics.world
        ended = self._reward.ended(world.state[None], world.run.peak[None])[0]
        return 0.0 if ended or physics.diverged() else None


def load(
    scenario: str | Path | Scenario = "nominal",
    *,
    timestep: float | None = None,
    control_period: float | None = None,
    integrator: str = "RK4",
    force_limit: float = 1000.0,
    random: int | np.random.RandomState | None = None,
    randomize: bool = False,
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
    force_limit, random
        As in `Balance`.
    randomize
        Whether to draw each episode's scenario from the scenario's ``[ranges]``; one without them
        gets a random start and random laboratory hardware, as in `with_ranges`, if its plant is
        the cart-pole.

    Returns
    -------
    dm_control.rl.control.Environment
        The environment, its task a `Balance`.

    Raises
    ------
    UnknownNameError
        If there is no scenario or integrator of that name.
    InvalidValueError
        If a period or the force limit is not positive, or the step does not divide the control
        period.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> environment = afl.load("step-step", control_period=0.02)
    >>> environment.action_spec().shape
    (1,)
    """
    scenario = as_scenario(scenario)
    drawn = require_switch("randomize", randomize)
    space = SampleSpace(with_ranges(scenario, start=True)) if drawn else None
    for corner in space.corners if space else ():
        require_start(corner)
    asked = ticks_of(scenario, timestep, control_period)
    ticks = fine_enough(asked, _fastest_rate(scenario, space, integrator))
    task = Balance(force_limit=force_limit, random=random, space=space)
    physics = Physics(scenario, timestep=ticks.timestep, integrator=integrator, hold=ticks.hold)
    # Half a step early, so that round-off in the division by the period cannot add a period.
    early = (physics.world.last - 0.5) * ticks.timestep
    settings = {"time_limit": early, "n_sub_steps": ticks.hold, "legacy_step": False}
    return control.Environment(physics, task, **settings)


def _fastest_rate(scenario: Scenario, space: SampleSpace | None, integrator: str) -> float:
    """Return the fastest `SimulatedModel.fastest_rate` of the scenarios of any episode [1/s]."""
    hardware, spans = scenario.imperfections, scenario.spans
    if space is not None:
        drawn = {x: ends for x, ends in space.varied.items() if x.startswith((*DAMPING, *LIGHTER))}
        hardware = hardware.changed({x: ends[x.startswith(DAMPING)] for x, ends in drawn.items()})
        spans = {name: space.bounds(name) for name in spans}
    model = SimulatedModel(scenario.plant, integrator=integrator, imperfections=hardware)
    return model.fastest_rate(scenario, spans)


def controller_policy(
    controller: Controller, scenario: Scenario, *, control_period: float | None = None
) -> Callable[[TimeStep], Floats]:
    """Return the agent that reproduces sampled mode by the observation, bit for bit."""
    if controller.interpreted and control_period is None:
        raise InvalidValueError("control_period", f"must be given for {controller.name!r}")
    controller = bound(controller, scenario)
    period, tick, own = control_period or 0.0, 0, controller.start()
    told = scenario.told_values(np.zeros(1))
    columns = scheduled_columns(scenario.plant)

    def policy(time_step: TimeStep) -> Floats:
        nonlocal tick, own
        tick = 0 if time_step.first() else tick + 1
        if time_step.first():
            own = controller.start()
        seen = time_step.observation
        told[0, columns] = seen["parameters"]
        state = np.concatenate([seen["position"], seen["velocity"]])
        return np.atleast_1d(own.command(tick * period, state, own.assumed(told[0])))

    return policy
