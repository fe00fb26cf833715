"""Margins over a grid of plants against those of one plant."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import afl_mujoco as afl
from afl_mujoco import CONTROLLERS
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.studies import margins
from afl_mujoco.studies.shared.loop_margins import linearize, loop_margins
from tests.plants.plants import cart

LQR = CONTROLLERS["lqr"]
AT_REST = afl.Scenario(name="at rest")
METRICS = ("gain_decrease", "gain_increase", "phase", "delay", "crossover", "disk")


def test_a_survey_holds_the_margins_of_each_plant_but_where_the_hold_is_unstable() -> None:
    grid = {"cart_mass": (0.1, 1.0), "half_length": (0.05, 0.5)}
    both = [CONTROLLERS[name] for name in ("fixed", "fixed-nominal")]
    survey = margins.run(margins.Request(AT_REST, both, grid))
    loop = linearize(CONTROLLERS["fixed"], AT_REST)
    for kind, period in ((margins.CONTINUOUS, None), (margins.HELD, 1e-3)):
        (expected,) = loop_margins(loop, period)
        rows = survey.of("fixed", kind)
        assert len(rows) == 4
        for metric in METRICS:
            assert margins.value_of(rows[-1], metric) == getattr(expected, metric)
    worst = survey.worst("fixed-nominal", margins.CONTINUOUS, "delay")
    assert worst.parameters == {"cart_mass": 0.1, "half_length": 0.05}
    assert worst.delay == min(row.delay for row in survey.of("fixed-nominal", margins.CONTINUOUS))
    for metric in ("gain_decrease", "crossover"):
        values = [getattr(row, metric) for row in survey.of("fixed", margins.CONTINUOUS)]
        worst = survey.worst("fixed", margins.CONTINUOUS, metric)
        assert getattr(worst, metric) == max(values) > min(values)
    # a controller that assumes 1 kg and 0.5 m commands ten times too much force
    held, free = (survey.of("fixed-nominal", kind) for kind in (margins.HELD, margins.CONTINUOUS))
    assert [row.stable for row in held] == [False, True, True, True]
    assert held[0].delay is None and free[0].delay is not None
    worst = survey.worst("fixed-nominal", margins.HELD, "delay")
    assert worst.parameters != {"cart_mass": 0.1, "half_length": 0.05}
    assert "fixed-nominal unstable on 1 of 4 plants" in margins.report(survey).headline
    shown = margins._delays(survey)[1]["fixed-nominal"]
    assert shown[0] == (0, "unstable") and all(grade > 0 for grade, _ in shown[1:])


def test_the_command_writes_and_prints_the_margins(tmp_path, command_line) -> None:
    few = ["--controllers", "lqr", "--quick", "--workers", "1", "--out", "out"]
    code, output, errors = command_line("margins", "nominal", *few)
    assert (code, errors) == (0, "")
    content = json.loads((tmp_path / "out" / "margins.json").read_text())
    assert content["command"] == f"afl-mujoco margins nominal {' '.join(few[:3])}"
    row = content["rows"][0]
    assert (row["loop"], row["input"], row["parameters"]) == ("continuous", "force", {})
    assert f"{1e3 * row['delay']:.2f}" in output and "Delay [ms]" in output


def test_a_scenario_gives_its_plants_its_period_and_what_is_linear(tmp_path) -> None:
    step = afl.staircase([1.0], [8.0, 10.0])
    own = afl.Scenario(
        name="own", schedule={"pole_mass": 0.2, "cart_mass": step, "half_length": 1.5},
        imperfections=afl.Imperfections(control_period=0.01, delay=0.004, noise={"phi": 1e-3}),
        ranges={"pole_mass": (0.1, 0.3), "z": (-0.1, 0.1)},
    )  # fmt: skip
    afl.save_scenario(own, tmp_path / "own.toml")
    asked = margins.Options(scenario=str(tmp_path / "own.toml"), controllers=("lqr",))
    request = margins.prepare(asked)
    assert request.axes["cart_mass"] == (8.0, 8.5, 9.0, 9.5, 10.0)
    assert request.axes["pole_mass"] == pytest.approx((0.1, 0.15, 0.2, 0.25, 0.3))
    assert [*request.axes] == ["cart_mass", "pole_mass"] and request.period == 0.01
    assert tuple(request.at((8.0, 0.1)).nominal.values()) == (8.0, 0.1, 1.5, 9.81)
    assert margins.prepare(replace(asked, control_period=0.002)).period == 0.002
    assert len(margins.prepare(replace(asked, levels=3)).plants) == 9
    with pytest.raises(InvalidValueError, match=r"at most 10000 plants of cart_mass, pole_mass"):
        margins.prepare(replace(asked, levels=101))
    found = margins.run(request._replace(axes={"cart_mass": (8.0,)}))
    assert (found.scenario, found.left_out) == ("own", ("noise.phi",))
    said = margins.report(found).blocks[0]
    assert "count: delay = 0.004; delay in held loops only; that a linear" in said
    assert "loop cannot have: noise.phi" in said


def test_dry_friction_of_the_mjcf_is_left_out_and_said() -> None:
    plant = cart(joint=' frictionloss="1"')
    law = {"plant": plant, "function": lambda t, x, b: -100.0 * x[0] - 4.0 * x[1]}
    still = afl.Scenario(name="still", plant=plant, duration=1.0)
    found = margins.run(margins.Request(still, [PythonController(name="pd", **law)], {}))
    assert found.left_out == ("frictionloss of x",)
    assert found.rows[0].phase == pytest.approx(22.6, abs=0.1)  # of (4 s + 100) / s^2


def test_a_delay_of_the_hardware_is_in_the_margins_of_the_held_force_alone() -> None:
    hardware = [afl.Imperfections(delay=delay) for delay in (0.0, 0.01)]
    scenarios = [replace(AT_REST, imperfections=one) for one in hardware]
    plain, late = (margins.run(margins.Request(one, [LQR], {}, 0.01)) for one in scenarios)
    one, other = (found.of("lqr", margins.HELD)[0].delay for found in (plain, late))
    assert other == pytest.approx(one - 0.01, rel=1e-9) and late.imperfections == "delay = 0.01"
    continuous = [found.of("lqr", margins.CONTINUOUS) for found in (plain, late)]
    assert continuous[0] == continuous[1]
    told = replace(AT_REST, belief={"cart_mass": 2.0})
    found = margins.run(margins.Request(told, [LQR], {}, 0.01))
    assert found.imperfections == "belief.cart_mass = 2.0"


def test_what_cannot_be_judged_takes_no_other_s_answer_away() -> None:
    functions = {
        "memory": type("Mine", (), {"__call__": lambda self, time, state, belief: 0.0}),
        "biased": lambda time, state, belief: 1.0 + state[1],
        "kinked": lambda time, state, belief: 50.0 * max(state[1], 0.0),
    }  # fmt: skip
    own = [PythonController(name=name, function=one) for name, one in functions.items()]
    found = margins.run(margins.Request(AT_REST, [own[0], own[1], LQR, own[2]], {}).require())
    assert found.rows == margins.run(margins.Request(AT_REST, [LQR], {})).rows
    assert "must not have a memory, which a linearisation" in found.not_linear["memory"]
    rule = "must hold the plant at its target, got z accelerates by"
    assert rule in found.not_linear["biased"] and "must be smooth" in found.not_linear["kinked"]
    with pytest.raises(InvalidValueError, match=rule):
        margins.Request(AT_REST, own[1:2], {}).require()
    # nor is a drive too weak to hold the plant at its target
    scenario = afl.load_scenario(Path(__file__).parents[2] / "examples" / "quadrotor_load.toml")
    weak = replace(scenario, imperfections=afl.Imperfections(input_limit=2.0))
    with pytest.raises(InvalidValueError, match=r"within -2 to 2, got left = 5.0"):
        margins.Request(weak, [LQR], {}).require()
