import numpy as np
import pytest

from afl_mujoco.identification import least_squares
from afl_mujoco.identification.least_squares import Parameter, Problem, fit, fit_to_scatter

T = np.linspace(0.0, 1.0, 9)


def parameter(name: str, start: float, low: float = -10.0, high: float = 10.0) -> Parameter:
    return Parameter(name=name, unit="1", title=name, start=start, low=low, high=high, scale=1.0)


def decays(rng: np.random.Generator, windows: int, rate: float = 2.0, noise: float = 0.01):
    amplitudes = rng.uniform(0.5, 1.5, (windows, 1))
    return amplitudes * np.exp(-rate * T) + noise * rng.normal(size=(windows, len(T)))


def problem(data, mask=None, groups=None, known=0.0):
    """The rates, whose sum acts, and the windows' own amplitudes."""

    def errors(shared, starts):
        return (starts * np.exp(-(shared.sum() + known) * T) - data)[:, None]

    every = np.ones((len(data), 1, len(T))) if mask is None else mask
    groups = np.arange(len(data)) if groups is None else groups
    return Problem(errors, errors, every, groups, np.ones(1))


def fitted(data, parameters, groups=None):
    return fit(problem(data, None, groups), parameters, np.ones((len(data), 1)), np.array([0.01]))


def fitted_to_scatter(data, parameters, mask=None, known=0.0):
    return fit_to_scatter(problem(data, mask, known=known), parameters, np.ones((len(data), 1)))


def test_a_shared_rate_is_found_and_a_bound_is_met_exactly_and_has_no_interval() -> None:
    data = decays(np.random.default_rng(0), 60)
    found = fitted(data, [parameter("rate", 1.0)], np.repeat(np.arange(12), 5))
    assert found.by_name["rate"] == pytest.approx(2.0, abs=3.0 * found.errors[0])
    assert found.degrees == 11
    free = fitted(data, [parameter("rate", 1.0)])
    found = fitted(decays(np.random.default_rng(3), 30), [parameter("rate", 1.0, high=1.5)])
    assert found.values[0] == 1.5 and found.on_bound[0] and found.errors[0] == 0.0
    near = fitted(data, [parameter("rate", 1.0, high=free.values[0] + 1e-4)])
    assert not near.on_bound[0] and near.errors[0] > 0.0


def test_the_intervals_hold_the_truth_as_often_as_they_say() -> None:
    held = []
    for seed in range(120):
        data = decays(np.random.default_rng(seed), 24)
        one = fitted(data, [parameter("rate", 1.8)], np.repeat(np.arange(12), 2)).estimates["rate"]
        held.append(one.low <= 2.0 <= one.high)
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
    whole = least_squares.with_uncertainty_of(problem(data), second, first)
    expected = second.covariance[0, 0] + first.covariance[0, 0]
    assert whole.covariance[0, 0] == pytest.approx(expected, rel=1e-3)


def test_what_the_data_cannot_tell_apart_has_no_end_and_the_rest_its_interval() -> None:
    """Two rates of which the sum alone acts: zero, as of a pseudo-inverse, would say `known`."""
    two = problem(decays(np.random.default_rng(6), 40))
    three = [parameter("rate", 1.0), parameter("other", 0.5), parameter("wave", 0.1)]
    given = (np.ones((40, 1)), np.array([0.01]))
    found = fit(two, three[:2], *given)
    assert np.isinf(found.errors).all() and found.values.sum() == pytest.approx(2.0, abs=0.05)
    assert all(one.low == -np.inf and one.high == np.inf for one in found.estimates.values())

    def errors(shared, starts):
        return two.errors(shared[:2], starts) + 0.3 * shared[2] * np.sin(9.0 * T)

    def without(shared, own):
        return errors(np.array([0.0, *shared]), own)

    whole = fit(two._replace(errors=errors, smooth=errors), three, *given)
    assert np.isinf(whole.errors).tolist() == [True, True, False]
    one = fit(two._replace(errors=without, smooth=without), three[1:], *given)
    assert whole.errors[2] == pytest.approx(one.errors[1], rel=0.03)


def test_what_one_log_alone_tells_has_the_interval_of_its_windows() -> None:
    groups = np.repeat(np.arange(12), 5)
    wave = 0.3 * np.sin(9.0 * T) * (groups == 0)[:, None, None]
    many = problem(decays(np.random.default_rng(7), 60), groups=groups)

    def errors(shared, starts):
        return many.errors(shared[:1], starts) + shared[1] * wave

    both = [parameter("rate", 1.0), parameter("wave", 0.1)]
    one = many._replace(errors=errors, smooth=errors)
    found = fit(one, both, np.ones((60, 1)), np.array([0.01]))
    assert found.degrees == 59 and 1e-3 < found.errors[1] < 0.1 > abs(found.values[1])


def test_starts_that_are_far_off_are_found_too() -> None:
    """A whole Gauss-Newton step of such a start goes too far, however small that of the rate is."""

    def errors(shared, starts):
        return (np.arctan(starts) + (shared[0] - 1.0) * np.linspace(0.0, 1.0, 20))[:, None]

    far = Problem(errors, errors, np.ones((1, 1, 20)), np.zeros(1, np.int64), np.ones(1))
    found = fit(far, [parameter("rate", 1.5)], np.full((1, 1), 3.0), np.array([1e-3]))
    assert found.values == pytest.approx([1.0], abs=0.01)
    assert found.starts == pytest.approx(np.zeros((1, 1)), abs=0.2)


def test_a_log_of_a_single_window_has_the_scatter_of_all_logs() -> None:
    """Each window tells the rate by itself; its own residuals say nothing of its error."""
    times, noise = np.linspace(0.0, 1.0, 20), np.random.default_rng(3).normal(size=(40, 1, 20))

    def errors(shared, starts):
        return shared[0] * times + starts[:, None] - 2.0 * times - noise

    logs = np.r_[np.arange(20), np.arange(10), np.arange(10)]  # of one window up to three
    few = Problem(errors, errors, np.ones((40, 1, 20)), logs, np.ones(1))
    found = fit(few, [parameter("rate", 1.5)], np.zeros((40, 1)), np.ones(1))
    alone, spread = np.array(least_squares.by_cluster(few, found, "rate")).T
    expected = 1.0 / np.sqrt(np.sum((times - times.mean()) ** 2) * np.bincount(logs))
    np.testing.assert_allclose(spread, expected, rtol=0.35)
    assert np.std((alone - 2.0) / spread) == pytest.approx(1.0, abs=0.4)


def test_a_parameter_more_is_better_only_where_it_explains_more_than_noise() -> None:
    for extra, expected in ((0.0, False), (0.05, True)):
        noise = 0.01 * np.random.default_rng(5).normal(size=(20, 1, len(T)))

        def errors(shared, starts, extra=extra, noise=noise):
            return ((shared[0] - 2.0) * T + (shared[1] - extra) * T**2 + starts)[:, None] - noise

        more = Problem(errors, errors, np.ones((20, 1, len(T))), np.arange(20), np.ones(1))
        rate, bend = parameter("rate", 1.0), parameter("bend", 0.0)
        pairs = [rate, bend], [rate, bend.held(0.0)]
        fits = [fit_to_scatter(more, pair, np.zeros((20, 1))) for pair in pairs]
        assert least_squares.is_better(more, *fits) == expected
