"""What the wrappers of an environment do to observations and actions, without the environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.simulation.gym_env.registration import require_gymnasium

require_gymnasium()
import gymnasium  # noqa: E402  (an optional package; its absence raised an error in one line)
from gymnasium import wrappers  # noqa: E402

Change = Callable[[Any], Any]

_OUTSIDE = (
    *(gymnasium.RewardWrapper, wrappers.NormalizeReward, wrappers.RecordEpisodeStatistics),
    *(wrappers.OrderEnforcing, wrappers.PassiveEnvChecker, wrappers.TimeLimit),
    *(wrappers.Autoreset, wrappers.RecordVideo, wrappers.HumanRendering),
    wrappers.RenderCollection,
)
"""Wrappers that change neither what a policy sees nor what it does."""

_OUTSIDE_NAMES = frozenset({"Monitor"})
"""The same, of Stable-Baselines3, which need not be installed."""


def changes_of(environment: gymnasium.Env) -> tuple[Change, Change]:
    """Return what wrappers make of the innermost environment's observation, and of an action."""
    seen: list[Change] = []
    done: list[Change] = []
    layer = environment
    while isinstance(layer, gymnasium.Wrapper):
        if isinstance(layer, gymnasium.ObservationWrapper):
            seen.insert(0, _observation(layer))
        elif isinstance(layer, gymnasium.ActionWrapper):
            _require_its_own(layer, gymnasium.ActionWrapper)
            done.append(layer.action)
        elif not (isinstance(layer, _OUTSIDE) or type(layer).__name__ in _OUTSIDE_NAMES):
            rule = "must change observations or actions one by one (ObservationWrapper, "
            raise InvalidValueError(_named(layer), f"{rule}ActionWrapper), or rewards alone")
        layer = layer.env
    return _in_turn(seen), _in_turn(done)


def _observation(layer: gymnasium.ObservationWrapper) -> Change:
    """Return what a wrapper makes of an observation; statistics as they are now."""
    if isinstance(layer, wrappers.AddRenderObservation):
        raise InvalidValueError(_named(layer), "must not need a picture of the environment")
    _require_its_own(layer, gymnasium.ObservationWrapper)
    if not isinstance(layer, wrappers.NormalizeObservation):
        return layer.observation  # type: ignore[no-any-return]
    if layer.update_running_mean:
        rule = "must be frozen: set update_running_mean = False"
        raise InvalidValueError(_named(layer), rule)
    mean, spread = layer.obs_rms.mean.copy(), np.sqrt(layer.obs_rms.var + layer.epsilon)
    return lambda seen: np.float32((seen - mean) / spread)


def _require_its_own(layer: gymnasium.Wrapper, base: type) -> None:
    """Raise if a wrapper does more at a step or a reset than its kind: it has memory."""
    if type(layer).step is not base.step or type(layer).reset is not base.reset:  # type: ignore[attr-defined]
        rule = "must depend on the present observation or action alone"
        raise InvalidValueError(_named(layer), rule, "a step or reset of its own")


def _named(layer: gymnasium.Wrapper) -> str:
    """Return the name of a wrapper for messages."""
    return f"wrapper {type(layer).__name__} of the environment"


def _in_turn(changes: list[Change]) -> Change:
    """Return the function that applies changes one after the other."""

    def change(value: Any) -> Any:
        for one in changes:
            value = one(value)
        return value

    return change
