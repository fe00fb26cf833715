"""The cost of gains, the search on one plant, and the units of a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import CART_MASSES, HALF_LENGTHS
from afl_mujoco.studies.gain_tuning.gain_cost import GAIN_BOX, gain_cost, paper_scales
from afl_mujoco.studies.gain_tuning.gain_table import (
    pair_searches,
    search_pair,
    table_provenance,
)
from afl_mujoco.studies.gain_tuning.settings import GeneticSettings

SMALL = GeneticSettings(population_size=120, generations=40)


def test_the_fixed_gains_on_the_nominal_plant_cost_three() -> None:
    cost = gain_cost(1.0, 0.5)(np.array([[109.9651, 1.2849, 100.0004]]))
    assert cost[0] == pytest.approx(3.0, rel=1e-12)


def test_the_scales_are_those_that_the_readable_path_gives() -> None:
    scales = paper_scales()
    measured = scales.iae_z, scales.iae_phi, scales.max_force
    assert measured == pytest.approx((20.9094, 1.52891, 96.1118), rel=1e-4)


def test_a_search_finds_what_a_bounded_scalar_search_finds_on_the_edge_of_the_box() -> None:
    unit = pair_searches((1.0,), (0.5,), SMALL, seed=0)[0]
    _, _, switching, slope, layer, found = search_pair(unit)
    cost = gain_cost(1.0, 0.5)
    best = minimize_scalar(
        lambda x: float(cost(np.array([[100.0, x, 90.0]]))[0]), bounds=(1.0, 5.0), method="bounded"
    )
    assert (switching, layer) == pytest.approx((100.0, 90.0), abs=1e-6)
    assert slope == pytest.approx(best.x, abs=1e-2)  # the bottom is flat: cost within 1e-6
    assert found == pytest.approx(best.fun, rel=1e-6)


def test_the_shipped_optima_are_not_beaten_along_the_slope() -> None:
    table = GainTable.shipped()
    slopes = np.linspace(GAIN_BOX.lower[1], GAIN_BOX.upper[1], 401)
    for row in table.rows[::37]:
        gains = np.stack([np.full(401, row[2]), slopes, np.full(401, row[4])], axis=1)
        assert gain_cost(row[0], row[1])(gains).min() > row[5] * (1.0 - 1e-6)


def test_an_interrupted_unit_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    whole = search_pair(pair_searches((1.0,), (0.5,), SMALL, seed=3)[0])
    unit = pair_searches((1.0,), (0.5,), SMALL, seed=3, checkpoints=tmp_path)[0]

    class Stop(Exception):
        pass

    calls = []

    def interrupted(cost):
        def call(gains):
            calls.append(len(gains))
            if len(calls) == 17:
                raise Stop
            return cost(gains)

        return call

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "afl_mujoco.studies.gain_tuning.gain_table.gain_cost",
            lambda *p: interrupted(gain_cost(*p)),
        )
        with pytest.raises(Stop):
            search_pair(unit)
    assert search_pair(unit) == whole


def test_units_are_seeded_by_their_place_and_a_grid_is_not_empty() -> None:
    units = pair_searches(CART_MASSES, HALF_LENGTHS, SMALL, seed=5)
    assert len({unit.seed for unit in units}) == len(units) == 400
    with pytest.raises(
        InvalidValueError, match="half-length of the grid must have at least one value"
    ):
        pair_searches((1.0,), (), SMALL, seed=0)
    assert table_provenance(units)["seed"] == 5
