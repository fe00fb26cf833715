"""Intervals and the paired test against numbers worked out elsewhere."""

from __future__ import annotations

import pytest
from scipy.stats import beta

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.studies.monte_carlo.rates import Pairing, Rate, pair


@pytest.mark.parametrize(
    ("count", "of", "low", "high"),
    [
        (0, 10, 0.0, 0.3085),  # 1 - 0.025^(1/10), the closed form
        (10, 10, 0.6915, 1.0),
        (4, 20, 0.0573, 0.4366),  # the tables of Clopper and Pearson (1934)
        (81, 263, 0.2527, 0.3676),  # Newcombe (1998), table I
    ],
)
def test_the_interval_is_that_of_clopper_and_pearson(count, of, low, high) -> None:
    assert Rate(count, of).interval == pytest.approx((low, high), abs=5e-5)


def test_the_interval_is_of_the_quantiles_of_two_beta_distributions() -> None:
    expected = (beta.ppf(0.025, 899, 102), beta.ppf(0.975, 900, 101))
    assert Rate(899, 1000).interval == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("count", "of"), [(0, 0), (2, 1), (-1, 3)])
def test_a_rate_of_nothing_is_refused(count: int, of: int) -> None:
    with pytest.raises(InvalidValueError, match=r"^rate must be a share of at least one"):
        Rate(count, of)


def test_pairs_are_counted_by_who_survived() -> None:
    first = [True, True, True, False, False, True]
    second = [True, False, False, True, False, True]
    found = pair(first, second)
    assert found == Pairing(both=2, only_first=2, only_second=1, neither=1)


def test_the_paired_test_uses_the_samples_on_which_the_two_differ() -> None:
    # 1 of 6 discordant: 2 * (1 + 6) / 2^6, whatever the others
    assert Pairing(both=500, only_first=1, only_second=5, neither=90).p_value == pytest.approx(
        14 / 64
    )
    assert Pairing(both=3, only_first=0, only_second=0, neither=1).p_value == 1.0
