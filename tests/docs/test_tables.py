from dataclasses import fields

from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.studies.shared.contract import studies
from docs.tables import cells_as_table, tables
from tests.docs.test_content import CONTENT
from tests.planted_faults import load_faults


def test_every_imperfection_result_and_fault_has_a_row_and_a_cell_may_hold_a_bar() -> None:
    found = tables()
    assert all(f"| `{one.name}` |" in found["imperfections"] for one in fields(Imperfections))
    assert all(f"`{study.stem}.json`" in found["result files"] for study in studies().values())
    rows = CONTENT.table("faults")
    assert "not run" not in rows, "run: make faults"
    assert [f.name for f in load_faults() if f"| {f.name} |" not in rows.replace("\\|", "|")] == []
    assert cells_as_table(("a",), [("|x|",)]) == "| a |\n| --- |\n| \\|x\\| |\n"
