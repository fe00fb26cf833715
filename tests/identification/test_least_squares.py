import numpy as np
import pytest

from afl_mujoco.identification.least_squares import (
    Parameter,
    fit,
    fit_to_scatter,
    with_uncertainty_of,
)

T = np.linspace(0.0, 1.0, 9)


def parameter(name: str, start: float, low: float = -10.0, high: float = 10.0) -> Parameter:
    return Parameter(name=name, unit="1", title=name, start=start, low=low, high=high, scale=1.0)


def decays(rng: np.random.Generator, windows: int, rate: float = 2.0, noise: float = 0.01):
    amplitudes = rng.uniform(0.5, 1.5, (windows, 1))
    return amplitudes * np.exp(-rate * T) + noise * rng.normal(size=(windows, len(T)))


def fitted(data, parameters, groups=None):
    """The rates, whose sum acts, and the windows' own amplitudes, by plain least squares."""
    groups = np.arange(len(data)) if groups is None else groups

    def residuals(shared, starts):
        return (starts * np.exp(-shared.sum() * T) - data) / 0.01

    return fit(residuals, parameters, np.ones((len(data), 1)), groups, start_scale=np.ones(1))


def fitted_to_scatter(data, parameters, mask=None, known=0.0):
    def errors(shared, starts):
        return (starts * np.exp(-(shared.sum() + known) * T) - data)[:, None]

    mask = np.ones((len(data), 1, len(T))) if mask is None else mask
    own = np.ones((len(data), 1)), np.arange(len(data))
    return fit_to_scatter(errors, mask, parameters, *own, start_scale=np.ones(1))


def test_the_intervals_hold_the_truth_as_often_as_they_say() -> None:
    held = []
    for seed in range(120):
        data = decays(np.random.default_rng(seed), 24)
        found = fitted(data, [parameter("rate", 1.8)], np.repeat(np.arange(12), 2))
        held.append(abs(found.values[0] - 2.0) <= found.half_widths[0])
    assert 0.88 <= np.mean(held) <= 0.99


def test_a_few_wild_readings_and_masked_ones_do_not_move_the_estimate() -> None:
    data = decays(np.random.default_rng(1), 60)
    data[::7, 3] += 5.0
    found = fitted_to_scatter(data, [parameter("rate", 1.0)])
    assert found.by_name["rate"] == pytest.approx(2.0, abs=0.05)
    assert found.scatter == pytest.approx([0.01], rel=0.25)
    data = decays(np.random.default_rng(2), 40)
    mask = np.ones((40, 1, len(T)))
    mask[:, 0, 4:] = 0.0
    data[:, 4:] = 1e6
    found = fitted_to_scatter(data, [parameter("rate", 1.0)], mask)
    assert found.by_name["rate"] == pytest.approx(2.0, abs=4.0 * found.errors[0])


def test_what_was_taken_as_known_widens_the_interval() -> None:
    data = decays(np.random.default_rng(5), 40)
    first = fitted(data, [parameter("rate", 1.0)])
    second = fitted_to_scatter(data, [parameter("rest", 0.1)], known=first.values.sum())

    def errors(values, own):
        return (own * np.exp(-values.sum() * T) - data)[:, None]

    every = np.ones((40, 1, len(T)))
    whole = with_uncertainty_of(errors, every, second, first, start_scale=np.ones(1))
    expected = second.covariance[0, 0] + first.covariance[0, 0]
    assert whole.covariance[0, 0] == pytest.approx(expected, rel=1e-3)
