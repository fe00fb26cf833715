"""Features of a hardware sample that may separate failures from survivors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp

from afl_mujoco.scenario.imperfections import DECLARATIONS, DRAWS
from afl_mujoco.scenario.ranges import HARDWARE
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario
from afl_mujoco.scenario.scenario import Scenario


def _label(name: str) -> tuple[str, float]:
    """Return what an imperfection is called, with its unit, and the factor to that unit."""
    declared = DECLARATIONS[name]
    if declared.drawn is not None and declared.drawn.label:
        return declared.drawn.label, declared.drawn.scale
    for one in declared.swept:
        if one.fields == {name: 1.0}:
            return f"{one.title} [{one.unit}]", one.scale
    return f"{name} [{declared.unit}]", 1.0


def _imperfections(names: Iterable[str]) -> dict[str, Callable[[Scenario], float]]:
    """Return functions that read imperfections, by their label, in its unit."""

    def reader(name: str, scale: float) -> Callable[[Scenario], float]:
        return lambda scenario: scale * scenario.hardware(name)

    return {label: reader(name, scale) for name in names for label, scale in (_label(name),)}


FEATURES: Mapping[str, Callable[[Scenario], float]] = {
    "start angle |φ₀| [deg]": lambda s: math.degrees(abs(s.initial_state[1])),
    "start position |z₀| [m]": lambda s: abs(s.initial_state[0]),
    "start velocity z′₀ [m/s]": lambda s: s.initial_state[2],
    "start rate away from upright [rad/s]": lambda s: (
        abs(s.initial_state[3]) * (1.0 if s.initial_state[1] * s.initial_state[3] >= 0.0 else -1.0)
    ),
    "cart mass at the start [kg]": lambda s: s.cart_mass.at(0.0),
    "least cart mass [kg]": lambda s: min(s.cart_mass.values),
    "half-length at the start [m]": lambda s: s.half_length.at(0.0),
    "least half-length [m]": lambda s: min(s.half_length.values),
    "rail damping / least cart mass [1/s]": lambda s: (
        s.imperfections.rail_damping / min(s.cart_mass.values)
    ),
    "delay + lag [ms]": lambda s: 1e3 * (s.imperfections.delay + s.imperfections.actuator_lag),
    **_imperfections(DRAWS),
}
"""Features of a scenario by their label, which gives the unit."""

FEWEST = 5
"""Smallest number of failures, and of survivors, with which a controller counts in the ranking."""


def features_of(space: SampleSpace, samples: int, seed: int) -> dict[str, NDArray[np.float64]]:
    """Return every feature that varies over the samples of a campaign, each of shape (samples,).

    Of features that put the samples in the same order only the last is kept, as where M is the
    same in every sample: it is the simplest.
    """
    scenarios = [sample_scenario(space, i, seed) for i in range(samples)]
    known = {**FEATURES, **_imperfections(name for name in HARDWARE if name in space.varied)}
    found = {
        label: np.array([feature(scenario) for scenario in scenarios])
        for label, feature in known.items()
    }
    varying = {label: values for label, values in found.items() if np.ptp(values) > 0.0}
    last = {np.argsort(values, kind="stable").tobytes(): label for label, values in varying.items()}
    return {label: varying[label] for label in varying if label in last.values()}


def most_separating(
    features: Mapping[str, NDArray[np.float64]], failed: Sequence[NDArray[np.bool_]], count: int
) -> list[str]:
    """Return the features that differ most between failures and survivors, in that order.

    They are ranked by the largest gap between the two distribution functions (the statistic of
    Kolmogorov and Smirnov), the largest over the controllers.

    Parameters
    ----------
    failed
        For each controller, whether it did not pass each sample, shape (samples,).
    """
    ranked = [bad for bad in failed if FEWEST <= int(bad.sum()) <= len(bad) - FEWEST]

    def gap(name: str) -> float:
        x = features[name]
        return max((float(ks_2samp(x[bad], x[~bad]).statistic) for bad in ranked), default=0.0)

    return sorted(features, key=lambda name: -gap(name))[:count]
