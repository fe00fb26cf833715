import json
import re
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from afl_mujoco.identification.description import to_table
from afl_mujoco.identification.log import write_log
from afl_mujoco.scenario.files import load_scenario
from tests.synthetic_logs import Truth, swing

TRUTH = Truth()
IDENTIFY = ("identify", "logs", "--description", "rig.toml", "--out", "out", "--workers", "1")


@pytest.fixture
def rig(tmp_path):
    (tmp_path / "logs").mkdir()
    write_log(tmp_path / "logs" / "one.csv", swing(TRUTH, 4, 1.6))
    (tmp_path / "rig.toml").write_text(tomli_w.dumps(to_table(TRUTH.description)))
    return tmp_path


@pytest.mark.slow
def test_the_command_writes_estimates_a_scenario_and_a_figure(rig, command_line) -> None:
    code, output, _ = command_line(*IDENTIFY)
    assert code == 0 and output.splitlines()[-1].startswith("made up: w2 = ")
    assert "too narrow: too few logs" in " ".join(output.split())
    data = json.loads((rig / "out" / "identify.json").read_text())
    found = {one["name"]: one for one in data["identified"]["drive"]["estimates"]}
    assert found["gain"]["value"] == pytest.approx(TRUTH.expected["gain"], rel=0.05)
    scenario = load_scenario(rig / "out" / "identified.toml")
    assert scenario.imperfections.delay == found["delay"]["value"]
    assert (rig / "out" / "identify-log.png").is_file()


def identify_logs(folder, command_line, columns: dict) -> str:
    for name, c in columns.items():
        write_log(folder / "logs" / f"{name}.csv", c)
    code, output, errors = command_line(*IDENTIFY)
    assert code == 2, output
    return errors


def test_logs_of_two_poles_and_a_command_after_its_force_are_named(rig, command_line) -> None:
    other = replace(TRUTH, half_length=0.24)
    errors = identify_logs(rig, command_line, {"other": swing(other, 7, 1.6)})
    said = r"logs must be of one cart-pole, got gravity term w2 3\d.* in other and 3\d.* in one"
    assert re.search(said, errors)
    (rig / "logs" / "other.csv").unlink()
    columns = {}
    for name in ("one", "two"):
        log = swing(TRUTH, len(name) + ord(name[0]), 2.0)
        columns[name] = log | {"command": np.concatenate([[0.0], log["command"][:-1]])}
    errors = identify_logs(rig, command_line, columns)
    said = r"command must be in the row from which on it acts, got a force that acts ([\d.]+)"
    assert (said := re.search(said, errors)), errors
    assert float(said[1]) == pytest.approx(1e3 * (0.02 - TRUTH.delay), abs=1.0)
