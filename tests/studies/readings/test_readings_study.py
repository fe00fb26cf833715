"""The study as a whole, with the smallest effort."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import afl_mujoco as afl
from afl_mujoco.scenario.files import load_scenario
from afl_mujoco.studies.paper_readings import CASES
from afl_mujoco.studies.readings import study
from afl_mujoco.studies.readings.search import GOALS
from afl_mujoco.studies.readings.study import QUICK

TINY = replace(
    QUICK, restarts=1, generations=2, population=4, draws=20, descents=0, samples=50, base=4,
    slopes=8, steps=3,
)  # fmt: skip


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "QUICK", TINY)


@pytest.mark.slow
def test_each_case_of_each_named_reading_is_a_scenario_file(command_line, tmp_path: Path) -> None:
    options = ("--quick", "--no-page", "--workers", "1")
    code, output, errors = command_line("readings", *options, "--out", "out")
    assert (code, errors) == (0, "")
    assert "Table 3: " in output
    assert output.count(".toml") == 1 and "afl-mujoco validate out/nearest-" in output
    assert f"{len(list((tmp_path / 'out').glob('*.toml')))} scenario files in out" in output
    folder = tmp_path / "out"
    found = json.loads((folder / "readings.json").read_text())
    names = [one["name"] for one in found["readings"]]
    assert names == [f"{kind}-{goal}" for kind in ("nearest", "round") for goal in GOALS]
    files = {path.name for path in folder.glob("*.toml")}
    assert files == {f"{name}-{case}.toml" for name in names for case in CASES}
    first = found["readings"][0]
    for case, (fixed, adaptive) in zip(CASES, first["objectives"], strict=True):
        scenario = load_scenario(folder / f"{first['name']}-{case}.toml")
        assert scenario.duration == first["values"]["horizon"]
        assert scenario.name == f"{first['name']}-{case}"
        assert fixed > 0.0 and adaptive > 0.0
    run = afl.simulate_ode(scenario, afl.CONTROLLERS["fixed"], sample_period=0.01)
    assert run.outcome.kind == "completed"


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_workers() -> None:
    configuration = study.Readings(quick=True)
    assert study.run(configuration) == study.run(configuration, workers=2)


def test_a_negative_seed_is_refused(command_line) -> None:
    assert command_line("readings", "--seed", "-1")[0::2] == (
        2,
        "afl-mujoco: seed must be at least 0, got -1\n",
    )
