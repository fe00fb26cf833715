"""Tables 1 and 2: the printed rows bound what the RMSE over all rows can be."""

from __future__ import annotations

import numpy as np
import pytest

from afl_mujoco.control.gain_function import GainFunction
from afl_mujoco.studies import paper_tables
from afl_mujoco.studies.paper_tables import Fit, published_fits, published_rows


def test_the_rows_are_met_exactly_by_a_table_made_of_the_functions(monkeypatch) -> None:
    rows, function = published_rows(), GainFunction.published()
    for k, (mass, length) in enumerate(rows[:, [4, 5]]):
        gains = function.gains(mass, length)
        rows[k, :3] = gains.switching, gains.slope, gains.boundary_layer
    monkeypatch.setattr(paper_tables, "published_rows", lambda: rows)
    fits = {(fit.labels, fit.gain): fit for fit in published_fits()}
    assert max(fits["table2", gain].rmse for gain in paper_tables.PUBLISHED_RMSE) < 1e-12
    assert fits["table1", "switching"].rmse > 1.0


def test_the_bound_is_that_of_forty_rows_among_four_hundred() -> None:
    for fit in published_fits():
        assert fit.least == pytest.approx(fit.rmse * np.sqrt(0.1))


@pytest.mark.parametrize(("least", "possible"), [(0.15, True), (0.15504, True), (0.1551, False)])
def test_a_published_rmse_below_the_bound_is_impossible(least: float, possible: bool) -> None:
    fit = Fit(gain="slope", labels="table2", rmse=0.5, least=least, published=0.155)
    assert fit.possible is possible


def test_table_1s_header_contradicts_table_2() -> None:
    found = {(fit.labels, fit.gain): fit.possible for fit in published_fits()}
    assert not found["table1", "switching"]
    assert all(found["table2", gain] for gain in paper_tables.PUBLISHED_RMSE)
