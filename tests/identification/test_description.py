from dataclasses import replace

import pytest
import tomli_w

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.identification.description import load_description, to_table
from afl_mujoco.identification.prediction import DESCRIPTION
from tests.messages import line

GOOD = """
name = "mine"
period = 0.01
[phi]
unit = "deg"
resolution = 0.1
[nominal]
pole_mass = 0.1
half_length = 0.25
cart_mass = 0.5
force = 5.0
"""


def test_units_signs_and_defaults_are_read_and_what_is_written_reads_back(tmp_path) -> None:
    (tmp_path / "rig.toml").write_text(GOOD)
    one = load_description(tmp_path / "rig.toml")
    assert one.columns == {"time": "time", "phi": "phi", "z": "z", "command": "command"}
    assert one.angle_count == pytest.approx(0.0017453, rel=1e-4)
    assert one.nominal.gravity_term == pytest.approx(29.43)
    one = replace(load_description(DESCRIPTION), limits={"pole-0.2": 5.0})
    (tmp_path / "again.toml").write_text(tomli_w.dumps(to_table(one)))
    assert load_description(tmp_path / "again.toml") == one


@pytest.mark.parametrize(("before", "after", "message"), [
    ("period = 0.01", "period = 0.0", "period must be positive, got 0"),
    ('unit = "deg"', 'unit = "dge"', "phi.unit must be one of rad, deg, turn, got 'dge'; did"),
    ("resolution = 0.1", "resolution = -1.0", "resolution must not be negative, got -1"),
    ("resolution = 0.1", "resolutoin = 0.1", "resolutoin is not a known key"),
    ("resolution = 0.1", "dead_zone = [2.0, 1.0]", "dead_zone must increase, got [2.0, 1.0]"),
    ("resolution = 0.1", "sign = 2", "sign must be 1 or -1, got 2"),
    ("resolution = 0.1", 'column = "z"', "column must be for one signal alone, got 'z'"),
    ("pole_mass = 0.1", "pole_mass = nan", "pole_mass"),
    ("pole_mass = 0.1", "", "nominal.pole_mass is missing"),
    ("[nominal]", "[limits]\ngravity = 0\n[nominal]", "limits.gravity must be positive, got 0"),
    ("[nominal]", "[nominal", "is not valid TOML"),
    ("[nominal]", f"x = {5000 * '1'}\n[nominal]", "a whole number of so many digits"),
])  # fmt: skip
def test_what_breaks_a_rule_is_named(tmp_path, before: str, after: str, message: str) -> None:
    (tmp_path / "rig.toml").write_text(GOOD.replace(before, after))
    with pytest.raises(AflMujocoError, match=line(..., "rig.toml", ..., message, ...)):
        load_description(tmp_path / "rig.toml")
