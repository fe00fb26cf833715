import json
import shutil
from dataclasses import replace

import pytest

from afl_mujoco.identification.prediction import CHOOSE, FIT
from afl_mujoco.report.blocks import to_markdown
from afl_mujoco.studies.hardware import Result, protocol, report
from tests.study_results import RESULTS


@pytest.mark.slow
def test_the_command_judges_recordings_in_a_folder(tmp_path, command_line) -> None:
    (tmp_path / "logs").mkdir()
    for path in sorted(CHOOSE.glob("*.csv"))[:3]:
        shutil.copy(path, tmp_path / "logs")
    code, output, _ = command_line(*"hardware --logs logs --draws 0 --out out --workers 2".split())
    said = " ".join(output.split())
    data = json.loads((tmp_path / "out" / "hardware.json").read_text())
    gravity, coupling = data["terms"]["gravity"], data["terms"]["coupling"]
    assert gravity["expected"] == pytest.approx(0.75 * 9.81 / 0.1975)
    assert gravity["value"] == pytest.approx(gravity["expected"], rel=0.015)
    assert gravity["low"] < gravity["value"] < gravity["high"]
    assert coupling["expected"] == 1.0 and coupling["value"] == pytest.approx(1.0, abs=0.03)
    by_horizon = {one["horizon"]: one for one in data["held_out"]}
    assert list(by_horizon) == [0.1, 0.2, 0.5, 1.0]
    assert by_horizon[0.5]["explained_phi"] > 0.95 and by_horizon[0.5]["explained_z"] > 0.9
    assert by_horizon[0.1]["rms_phi"] < by_horizon[0.5]["rms_phi"]
    assert data["nominal"][1]["rms_phi"] > 3.0 * by_horizon[0.2]["rms_phi"]  # it knows less
    held = {one["id"]: one["value"] for one in data["statements"]}
    assert set(held) == {one["id"] for one in protocol()["statements"]}
    assert code == (0 if "PASS" in said else 1) and "on 3 recordings" in said
    assert data["fitted"] == []


def test_a_model_of_another_pole_does_not_hold(tmp_path, command_line) -> None:
    # the estimates with a drive that is far too weak
    (tmp_path / "logs").mkdir()
    shutil.copy(min(CHOOSE.glob("*.csv")), tmp_path / "logs")
    data = json.loads((FIT.parent / "estimates.json").read_text())
    for one in data["drive"]["estimates"]:
        if one["name"] == "gain":
            one["value"] *= 0.2
    (tmp_path / "wrong.json").write_text(json.dumps(data))
    asked = "hardware --logs logs --estimates wrong.json --draws 0 --out out --no-page".split()
    code, output, _ = command_line(*asked)
    assert code == 1 and "rig-0.5-z" in output.splitlines()[-1] and "FAIL" in output
    data["drive"]["correlations"] = [[1.0]]  # it would stand for all of them
    (tmp_path / "wrong.json").write_text(json.dumps(data))
    code, _, said = command_line(*asked)
    assert code == 2 and "drive correlations must have 7 rows of 7" in said


def judged(**values: float | None) -> Result:
    result = RESULTS["hardware"]()
    known = {one.id: one for one in result.statements}
    made = [replace(known[f"rig-0.5-{name}"], value=x, suspected="the drive")
            for name, x in values.items()]  # fmt: skip
    return replace(result, statements=tuple(made), fitted=("two",))


def test_a_statement_that_does_not_hold_is_a_failure_with_its_reason() -> None:
    shown = report(judged(z=0.49, phi=0.99))
    assert not shown.passed
    assert shown.headline == "1 of 2 statements hold on 20 recordings · not: rig-0.5-z"
    text = to_markdown(shown.blocks)
    assert "the drive" in text and "✗ fails" in text
    assert "No proof, if they are the same recordings: two have names" in text
    assert report(judged(phi=0.99)).passed
    # what recordings cannot tell neither fails nor holds
    found = report(judged(z=None, phi=0.99))
    said = "1 of 2 statements hold on 20 recordings · not decided: rig-0.5-z"
    assert found.passed and found.headline.startswith(said)
    both = report(judged(z=None, phi=0.1))
    assert not both.passed and "not: rig-0.5-phi · not decided" in both.headline
    assert not report(judged(z=None)).passed  # it would validate a model by nothing
