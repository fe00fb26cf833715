"""The searches: round readings are round and sound, a descent ends where no change helps."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest

from afl_mujoco.studies.cube_search import Budget
from afl_mujoco.studies.paper_readings import (
    HORIZON,
    HORIZONS,
    SCALE_PHI,
    SCALE_Z,
    SCHEDULES,
    Array,
    random_readings,
    terms_of,
)
from afl_mujoco.studies.readings import search
from afl_mujoco.studies.readings.search import (
    GOALS,
    ROUND_HORIZONS,
    descend,
    nearest,
    round_count,
    rounded,
    sound,
    tidied,
)


@pytest.mark.parametrize("goal", GOALS)
def test_round_readings_are_round_and_sound(goal: str) -> None:
    found = rounded(random_readings(500, 0), GOALS[goal])
    assert sound(found).all()
    assert set(found[:, HORIZON]) <= set(ROUND_HORIZONS)
    for (symbol, _), (times, levels) in SCHEDULES.items():
        np.testing.assert_allclose(found[:, times] % 0.5, 0.0, atol=1e-12)
        share = found[:, levels] / (0.1 if symbol == "M" else 0.05)
        np.testing.assert_allclose(share, np.round(share), atol=1e-9)
    if not GOALS[goal].scales:
        assert not found[:, [SCALE_Z, SCALE_PHI]].any()


def test_a_reading_that_is_round_stays_as_it_is() -> None:
    once = rounded(random_readings(50, 1), GOALS["values"])
    np.testing.assert_allclose(rounded(once, GOALS["values"]), once, atol=1e-12)


def test_tidied_numbers_are_near_and_on_the_grid_of_time() -> None:
    one = random_readings(1, 2)[0]
    found = tidied(one)
    assert np.abs(found - one).max() < 5.1e-3
    for times, _ in SCHEDULES.values():
        np.testing.assert_allclose(found[times] / 2e-3, np.round(found[times] / 2e-3), atol=1e-9)


def test_a_search_is_the_same_again_and_finds_better_than_its_start() -> None:
    unit = ("improvements-d4", 1, 0, Budget(generations=3, population=8))
    first = nearest(unit)
    assert nearest(unit) == first
    values, error, tried = first
    assert tried == 25
    one = np.array([values])
    assert error == pytest.approx(search.improvement_error(terms_of(one).objectives(one))[0])
    assert HORIZONS[0] <= one[0, HORIZON] <= HORIZONS[1]
    assert not one[0, [SCALE_Z, SCALE_PHI]].any()
    assert nearest(("improvements-d4", 2, 0, unit[3])) != first


def test_a_descent_ends_where_no_change_of_one_unknown_helps(monkeypatch) -> None:
    goal = GOALS["improvements-d4"]
    wanted = rounded(random_readings(1, 7), goal)[0]

    def distance(_: object, readings: Array) -> list[float]:
        return np.abs(readings - wanted).sum(axis=1).tolist()

    monkeypatch.setattr(search, "_costs", distance)
    values, error, tried = descend(
        ("improvements-d4", rounded(random_readings(1, 8), goal)[0].tolist())
    )
    assert values == pytest.approx(wanted.tolist()) and error == pytest.approx(0.0, abs=1e-9)
    assert tried > 500


def test_the_number_of_round_readings() -> None:
    levels = 20 ** (2 * (3 + 2))
    times = sum((comb(n, 2) * comb(n, 4)) ** 2 for n in (19, 29, 39, 59))
    assert round_count() == 4 * levels * times
