"""The table of tuned gains as a file, and the one that is shipped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.control.gain_table import COLUMNS, GainTable
from afl_mujoco.errors import AflMujocoError, FileError, InvalidValueError

ROW = [1.0, 0.5, 100.0, 3.5, 90.0, 2.1, 2.2]


def test_a_table_comes_back_from_its_file_bit_for_bit(tmp_path: Path) -> None:
    table = GainTable(np.array([ROW, [2.0, 0.1, 1 / 3, 0.1, 1e-7, 3.3, 4.4]]), {"seed": 7})
    table.save(tmp_path / "table.json")
    loaded = GainTable.load(tmp_path / "table.json")
    np.testing.assert_array_equal(loaded.rows, table.rows)
    assert loaded.provenance == {"seed": 7}
    assert loaded.gains(2.0, 0.1).slope == 0.1


def test_the_shipped_table_is_the_paper_s_grid_and_says_how_it_was_made() -> None:
    table = GainTable.shipped()
    assert len(table.rows) == 400
    assert sorted(set(table.column("cart_mass"))) == [k / 10 for k in range(1, 21)]
    assert sorted(set(table.column("half_length"))) == [k / 20 for k in range(1, 21)]
    assert {"settings", "box", "seed", "versions"} <= set(table.provenance)


def test_mujoco_confirms_the_objective_of_every_shipped_row() -> None:
    table = GainTable.shipped()
    np.testing.assert_allclose(  # samples of 1 ms: a kinked peak may lie between two
        table.column("objective_mujoco"), table.column("objective"), rtol=1e-4
    )


def test_the_retuned_controllers_have_the_gains_of_the_shipped_table() -> None:
    nominal = GainTable.shipped().gains(1.0, 0.5)
    assert CONTROLLERS["fixed-retuned"].gain_function.gains(0.3, 0.9) == nominal


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is not a gain table"),
        ("[" * 100_000, "is not a gain table"),
        ("{}", "is not a gain table: schema is missing"),
        (json.dumps({"schema": 2, "columns": COLUMNS}), "schema must be 1, got 2"),
        (json.dumps({"schema": 1, "provenance": {}, "columns": COLUMNS, "rows": []}), "7 columns"),
        (
            json.dumps({"schema": 1, "provenance": {}, "columns": COLUMNS, "rows": [[-1.0] * 7]}),
            "positive finite numbers",
        ),
    ],
    ids=["empty", "deep", "no schema", "other schema", "no rows", "negative"],
)
def test_a_file_that_is_no_table_is_refused_by_name(
    tmp_path: Path, content: str, message: str
) -> None:
    path = tmp_path / "table.json"
    path.write_text(content)
    with pytest.raises(FileError, match=message) as caught:
        GainTable.load(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_plant_or_column_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be read: no such file"):
        GainTable.load(tmp_path / "none.json")
    table = GainTable(np.array([ROW]), {})
    with pytest.raises(InvalidValueError, match=r"must be in the gain table, got M = 3 kg"):
        table.gains(3.0, 0.5)
    with pytest.raises(AflMujocoError, match="column"):
        table.column("mass")
