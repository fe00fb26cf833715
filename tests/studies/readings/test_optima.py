"""Table 1 under every scale: a table that is optimal is found to be, ours is under D4."""

from __future__ import annotations

import numpy as np
import pytest

from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.studies.readings import optima
from afl_mujoco.studies.readings.optima import judge_optima


def test_our_own_optima_are_optimal_under_the_scales_they_were_found_with(monkeypatch) -> None:
    rows, table = optima.published_rows(), GainTable.shipped()
    for k, (mass, length) in enumerate(rows[:, [4, 5]]):
        gains = table.gains(mass, length)
        rows[k, :3] = gains.switching, gains.slope, gains.boundary_layer
    monkeypatch.setattr(optima, "published_rows", lambda: rows)
    found = judge_optima(("table2", 20.0, 16, 5))
    assert found.as_decided == 40
    assert found.best == 40 and found.median_excess < 1e-3


def test_a_column_made_of_the_terms_is_met(monkeypatch) -> None:
    rows = optima.published_rows()
    terms = optima._terms(rows[:, [0, 1, 2]], rows[:, [4, 5]], 20.0)
    rows[:, 3] = terms @ [0.3, 0.2, 0.01]
    monkeypatch.setattr(optima, "published_rows", lambda: rows)
    assert judge_optima(("table2", 20.0, 8, 3)).column_error == pytest.approx(0.0, abs=1e-9)


def test_the_papers_table_is_not_optimal() -> None:
    found = judge_optima(("table2", 20.0, 16, 9))
    assert found.as_decided == 0 and found.best < 40
    assert found.column_error == pytest.approx(0.384, abs=2e-3)
    assert np.isfinite(found.scales).all()
