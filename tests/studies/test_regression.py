"""The physics regression notices what moved, is missing or left over; an update mends it."""

import dataclasses
import json
import math

import pytest

import afl_mujoco as afl
from afl_mujoco import cli
from afl_mujoco.errors import FileError
from afl_mujoco.files import as_plain
from afl_mujoco.studies.verify import regression
from afl_mujoco.studies.verify.cases import REPORTED
from tests.messages import line
from tests.studies.test_validate import SHORT

H = regression.SETTINGS.timestep
METRICS = {
    "objective": 2.5, "force_squared": 67.5, "overshoot_z": 0.0, "saturated_share": 0.25,
    "settling_2pc_z": 6.112, "settling_5pc_z": None, "end_time": 20.0,
}  # fmt: skip
ROWS = ((0.0, 0.0, -1.0, 0.0, 0.0, 59.0), (0.5, 1.9, 0.1, 5.4, 3.0, -2.4))


def recording(rows=ROWS, outcome="completed", **metrics) -> regression.Recording:
    return regression.Recording({"timestep": H}, outcome, {**METRICS, **metrics}, rows)


def made(scenario="step-step", run=None, **versions) -> regression.Baseline:
    runs = {"ode": recording(), "mujoco sampled": run or recording()}
    return regression.Baseline(scenario, "fixed", {"mujoco": "3.17.0", **versions}, runs)


def text(made_up: regression.Baseline) -> str:
    return json.dumps(as_plain(made_up))


def by_name(*baselines: regression.Baseline) -> dict[str, regression.Baseline]:
    return {b.file_name: b for b in baselines}


@pytest.fixture
def baselines(tmp_path):
    regression.update_baselines(tmp_path, {}, by_name(made(), made("nominal")))
    return tmp_path


def updated(folder, fresh) -> list[str]:
    return regression.update_baselines(folder, regression.load_baselines(folder), fresh)


def shifted(column: int, by: float) -> regression.Recording:
    last = [*ROWS[1]]
    last[column] += by
    return recording(rows=(ROWS[0], tuple(last)))


@pytest.mark.parametrize(("run", "said"), [
    # a metric may move by a millionth, by round-off where it is zero, by one sample of time
    (recording(objective=2.5 * (1 + 5e-7)), ""), (recording(overshoot_z=5e-10), ""),
    (recording(objective=2.5 * (1 + 2e-6)), "objective 2.5 -> 2.500005 (limit 2.50e-06)"),
    (recording(force_squared=67.5 * (1 - 2e-6)), "force_squared"),
    (recording(overshoot_z=2e-9), "overshoot_z"), (recording(settling_2pc_z=6.112 - H), ""),
    (recording(settling_2pc_z=6.112 + 2 * H), "settling_2pc_z"),
    (recording(saturated_share=0.25 + H / 20.0), ""),
    (recording(saturated_share=0.25 + 2 * H / 20.0), "saturated_share"),
    # what comes or goes has moved
    (recording(settling_5pc_z=7.0), "settling_5pc_z"), (recording(outcome="fell"), "outcome"),
    (recording(settling_2pc_z=None), "settling_2pc_z 6.112 -> none"),
    (recording(new_metric=1.0), "new_metric missing -> 1"),
    (recording(rows=ROWS[:1]), "phi at 2 -> 1 instants"),
    # the trajectory may move by round-off only
    (shifted(2, 5e-9), ""), (shifted(2, 2e-8), "phi at 1 instants, first at t = 0.5 s,"),
    (shifted(5, 5e-7), ""), (shifted(5, 2e-6), "force at 1 instants, first at t = 0.5 s,"),
])  # fmt: skip
def test_what_moves_by_more_than_its_limit_is_named(run, said) -> None:
    found = "".join(regression.changes(made(), made(run=run)))
    assert said in found and bool(said) == bool(found)


def test_an_update_says_what_moved_and_leaves_what_did_not(baselines) -> None:
    untouched = (baselines / "step-step.fixed.json").read_bytes()
    elsewhere = made(python="3.12.1")  # another host, the same numbers but for the last digits
    fresh = by_name(elsewhere, made("trapezoid-step", run=recording(objective=2.6)))
    assert updated(baselines, fresh) == [
        "missing   trapezoid-step.fixed.json has no baseline",
        "orphaned  nominal.fixed.json has no run",
    ]
    assert (baselines / "step-step.fixed.json").read_bytes() == untouched
    fresh |= by_name(made(run=recording(settling_2pc_z=None)))
    (told,) = updated(baselines, fresh)
    said = "moved     step-step / fixed / mujoco sampled: settling_2pc_z 6.112 -> none"
    assert told.startswith(said)
    assert updated(baselines, fresh) == []


@pytest.mark.parametrize(("content", "reason"), [
    ("<<<<<<< HEAD", "Invalid JSON"),
    (text(made()).replace('"schema": 1', '"schema": 2'), "schema must be 1, got 2"),
    (text(made("other")), "its file must be named other.fixed.json"),
    (text(made()).replace("2.5", "NaN"), "objective must be a finite number, got nan"),
], ids=["conflict", "schema", "name", "nan"])  # fmt: skip
def test_a_file_that_is_no_baseline_is_named_with_the_reason(baselines, content, reason) -> None:
    (baselines / "step-step.fixed.json").write_text(content)
    said = line(f"{baselines}/step-step.fixed.json is not a baseline: ", ..., reason, ...)
    with pytest.raises(FileError, match=said):
        regression.load_baselines(baselines)


@pytest.fixture(scope="module")
def fresh() -> dict[str, regression.Baseline]:
    return regression.record_all([SHORT], [afl.CONTROLLERS["adaptive"]])


def test_a_recording_has_every_reported_run_every_half_second(fresh) -> None:
    assert list(fresh) == ["short.adaptive.json"]
    recorded = fresh["short.adaptive.json"]
    assert tuple(recorded.runs) == REPORTED
    run = afl.simulate_mujoco(SHORT, afl.CONTROLLERS["adaptive"], "continuous")
    kept = recorded.runs["mujoco continuous"]
    instants = [(t, int(abs(run.time - t).argmin())) for t in (0.0, 0.5, 1.0)]
    expected = [[t, *run.state[i], run.force[i]] for t, i in instants]
    assert [list(row) for row in kept.trajectory] == expected
    assert kept.metrics["objective"] is not None and kept.settings["timestep"] == H
    assert recorded.versions.keys() >= {"python", "afl_mujoco", "mujoco", "numpy", "scipy", "numba"}


def test_a_plant_a_hair_off_is_noticed_and_a_fall_is_recorded_up_to_its_end(fresh) -> None:
    mass = {"pole_mass": SHORT.pole_mass * (1 + 1e-5)}
    heavier = dataclasses.replace(SHORT, schedule={**SHORT.schedule, **mass})
    moved = regression.record_all([heavier], [afl.CONTROLLERS["adaptive"]])
    found = regression.changes(fresh["short.adaptive.json"], moved["short.adaptive.json"])
    assert {line.split(": ")[0].rpartition(" / ")[2] for line in found} == set(REPORTED)
    hit = dataclasses.replace(SHORT, disturbances=(afl.Impulse(momentum=60.0, time=0.7),))
    fallen = regression.record_all([hit], [afl.CONTROLLERS["fixed"]])["short.fixed.json"]
    kept = fallen.runs["mujoco exact"]
    assert kept.outcome == "fell" and [row[0] for row in kept.trajectory] == [0.0, 0.5]
    assert all(math.isfinite(x) for row in kept.trajectory for x in row if x is not None)
    assert kept.metrics["objective"] is None


def test_the_command_passes_what_it_recorded_and_fails_on_a_change(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("afl_mujoco.scenario.catalogue.SCENARIOS", {"short": SHORT})
    monkeypatch.setattr(regression, "REGRESSED", ("adaptive",))
    command = ["regression", "--baselines", str(tmp_path / "b"), "--workers", "1"]
    assert cli.main([*command, "--update"]) == 0
    path = tmp_path / "b" / "short.adaptive.json"
    assert capsys.readouterr().out == f"missing   {path.name} has no baseline\n"
    before = path.read_bytes()
    assert cli.main(command) == 0
    assert capsys.readouterr().out == "PASS: 4 runs match their baselines\n"

    content = json.loads(before)
    content["runs"]["ode"]["metrics"]["max_force"] *= 1 + 2e-6
    path.write_text(json.dumps(content))
    assert cli.main(command) == 1
    output = capsys.readouterr().out.splitlines()
    assert output[0].startswith("moved     short / adaptive / ode: max_force ")
    assert output[-1] == "FAIL: 1 baselines; make baselines accepts intended changes"
    assert cli.main([*command, "--update"]) == 0 and path.read_bytes() == before
