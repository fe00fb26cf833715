"""The map of a scenario: each point is a run of the scenario from there, judged as any other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.report.old import Table
from afl_mujoco.errors import AflMujocoError
from afl_mujoco.scenario.disturbances import ForcePulse
from afl_mujoco.scenario.files import save_scenario
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.requirements import Requirements
from afl_mujoco.simulation.attraction.grid import FALLEN, SETTLED, UNDECIDED
from afl_mujoco.simulation.judgement import judge
from afl_mujoco.studies.attraction.deployed import WORDS
from afl_mujoco.studies.attraction.figures import GOOD_COLOUR, draw_starts
from afl_mujoco.studies.attraction.sections import sections
from afl_mujoco.studies.attraction.study import STUDY, Attraction, check, run

RIG = afl.Scenario(
    name="rig",
    cart_mass=afl.staircase([1.0], [8.0, 10.0]),
    half_length=afl.constant(1.5),
    pole_mass=0.2,
    duration=5.0,
    initial_state=(0.1, 0.2, 0.0, 0.0),
    disturbances=(ForcePulse(force=20.0, start=2.0, duration=0.1),),
    imperfections=Imperfections(control_period=0.01, delay=0.004, force_limit=150.0),
    requirements=Requirements(max_position=1.0),
)
PLAIN = replace(RIG, requirements=Requirements(), duration=12.0)
SMALL = {"grid": 5, "max_angle": 0.8, "max_rate": 2.0}


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    save_scenario(RIG, tmp_path / "rig.toml")
    save_scenario(PLAIN, tmp_path / "plain.toml")
    return {name: str(tmp_path / f"{name}.toml") for name in ("rig", "plain")}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rig", "plain"])
def test_every_point_is_a_run_from_there(name: str, files) -> None:
    settings = Attraction(scenario=files[name], controllers=("lqr", "adaptive"), **SMALL)
    scenario = {"rig": RIG, "plain": PLAIN}[name]
    result = run(settings, workers=2)
    assert [one.controller for one in result.starts] == ["lqr", "adaptive"]
    assert result.maps == ()
    seen = set()
    for found in result.starts:
        for row, rate in enumerate(found.rates.tolist()):
            for column, angle in enumerate(found.angles.tolist()):
                started = replace(scenario, initial_state=(0.1, angle, 0.0, rate))
                alone = afl.simulate_mujoco(started, afl.CONTROLLERS[found.controller], "sampled")
                if alone.outcome.kind != "completed":
                    expected = FALLEN
                elif name == "rig":
                    met = all(one.met for one in judge(started, alone))
                    expected = SETTLED if met else UNDECIDED
                else:
                    last = np.abs(alone.state[alone.time >= 11.0])
                    still = last[:, 0].max() <= 0.05 and last[:, 1].max() <= 0.02
                    expected = SETTLED if still else UNDECIDED
                assert found.outcome[row, column] == expected
                seen.add(expected)
        assert sum(found.shares.values()) == pytest.approx(1.0)
        assert next(iter(found.shares.values())) == np.mean(found.outcome == SETTLED)
        (itself,) = afl.compare(scenario, found.controller).runs
        met = itself.outcome == "completed" and not itself.missed
        if name == "rig":
            assert found.own_outcome == (SETTLED if met else UNDECIDED)
    assert len(seen) >= 2
    assert len(draw_starts(result.starts).axes) == 2
    (section,) = sections(result)
    word = "meets all requirements" if name == "rig" else "settles"
    assert word in section.blocks[0].text


def test_one_thread_and_two_give_the_same_map(files) -> None:
    settings = Attraction(scenario=files["rig"], controllers=("lqr",), **SMALL)
    one, two = (run(settings, workers=n).starts[0].outcome for n in (1, 2))
    np.testing.assert_array_equal(one, two)


def test_a_python_controller_can_be_mapped_on_a_scenario(files, monkeypatch, tmp_path) -> None:
    (tmp_path / "mapped_law.py").write_text("def law(t, x, b):\n    return -200.0 * x[1]\n")
    monkeypatch.chdir(tmp_path)
    settings = Attraction(scenario=files["rig"], controllers=("mapped_law:law",), **SMALL)
    check(settings)
    assert run(settings).starts[0].shares["falls"] > 0.5
    with pytest.raises(AflMujocoError, match="give a scenario to map its starts"):
        check(Attraction(controllers=("mapped_law:law",)))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"half_length": 1.0}, "half_length is that of scenario 'rig': leave it out, got 1.0"),
        ({"planes": ("plants",)}, "planes is that of scenario 'rig': leave it out"),
        ({"max_angle": 1.6}, "max_angle must be below 1.5698 rad, where a pole has fallen"),
        ({"grid": 1}, "grid must be at least 2, got 1"),
        ({"controllers": ("lqr", "lqr")}, "controller names must differ, got 'lqr' twice"),
    ],
    ids=str,
)
def test_what_cannot_be_mapped_is_refused(files, settings, message: str) -> None:
    with pytest.raises(AflMujocoError) as raised:
        check(Attraction(scenario=files["rig"], **settings))
    assert str(raised.value).startswith(message)


def test_the_record_survives_its_file(files, tmp_path) -> None:
    from afl_mujoco.studies.record import Record, load_record, save_record

    result = run(Attraction(scenario=files["rig"], controllers=("lqr",), **SMALL))
    save_record(Record(study=STUDY, result=result, command="x"), tmp_path, figures=False)
    again = load_record(STUDY, tmp_path).result
    np.testing.assert_array_equal(again.starts[0].outcome, result.starts[0].outcome)
    assert again.starts[0].shares == result.starts[0].shares


def test_the_cross_is_judged_for_itself_between_points_that_end_otherwise(files) -> None:
    settings = Attraction(
        scenario=files["rig"], controllers=("lqr", "fixed"), grid=2, max_angle=1.5, max_rate=4.0
    )
    result = run(settings)
    lqr = result.starts[0]
    assert (lqr.outcome != SETTLED).all() and lqr.own_outcome == SETTLED
    cross = draw_starts(result.starts).axes[0].lines[0]
    assert cross.get_markerfacecolor() == GOOD_COLOUR
    (table,) = (b for b in sections(result)[0].blocks if isinstance(b, Table))
    assert [row[-1].text for row in table.rows] == [
        WORDS[True][one.own_outcome] for one in result.starts
    ]


def test_a_controller_that_fails_from_some_starts_fails_there_only(
    files, monkeypatch, tmp_path
) -> None:
    law = "def law(t, x, b):\n    if abs(x[1]) > 0.6: raise RuntimeError('far')\n    return 0.0\n"
    (tmp_path / "fragile_law.py").write_text(law)
    monkeypatch.chdir(tmp_path)
    settings = Attraction(scenario=files["rig"], controllers=("fragile_law:law",), **SMALL)
    found = run(settings).starts[0]
    assert (found.outcome[:, [0, -1]] == 3).all()
    assert found.shares["controller fails"] >= 0.4
    assert len(draw_starts([found]).legends[0].get_texts()) >= 1


def test_where_nothing_is_asked_for_a_fall_is_a_fall(tmp_path) -> None:
    careless = replace(PLAIN, requirements=Requirements(completes=False), duration=3.0)
    save_scenario(careless, tmp_path / "careless.toml")
    found = run(
        Attraction(scenario=str(tmp_path / "careless.toml"), controllers=("lqr",), grid=3,
                   max_angle=1.5, max_rate=4.0)
    ).starts[0]  # fmt: skip
    assert found.outcome[2, 2] == FALLEN
    assert found.outcome[1, 1] != FALLEN
