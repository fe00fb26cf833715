"""Margins over a grid of plants against those of one plant, and small motions in MuJoCo."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco import CONTROLLERS
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.report.blocks import Matrix
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.studies import margins
from afl_mujoco.studies.loop_margins import delay_margin, linearize, loop_margins
from afl_mujoco.studies.margins import (
    METRICS,
    REACH,
    Deployment,
    Options,
    Request,
    Result,
    SmallMotions,
    measure,
    motion_decays,
    prepare,
    report,
    run,
)
from tests import study_results

LQR, ADAPTIVE = CONTROLLERS["lqr"], CONTROLLERS["adaptive"]
GRID = {"cart_masses": (0.1, 1.0), "half_lengths": (0.05, 0.5)}


def plant(cart_mass: float, half_length: float, **others: float) -> afl.CartPoleParameters:
    return afl.CartPoleParameters(cart_mass=cart_mass, half_length=half_length, **others)


@pytest.fixture(scope="module")
def survey() -> Result:
    return run(Request([CONTROLLERS[name] for name in ("fixed", "fixed-nominal")], **GRID))


def test_a_survey_holds_the_margins_of_each_plant_and_where_the_worst_stands(survey) -> None:
    loop = linearize(CONTROLLERS["fixed"], NOMINAL)
    for sampled, period in ((False, None), (True, 1e-3)):
        expected = loop_margins(loop, period)
        for metric in METRICS:
            values = survey.values("fixed", metric, sampled=sampled)
            assert values.shape == (2, 2)
            assert values[1, 1] == getattr(expected, metric)
    worst = survey.worst("fixed-nominal", "delay")
    assert (worst.cart_mass, worst.half_length) == (0.1, 0.05)
    assert worst.value == survey.values("fixed-nominal", "delay").min()
    for metric in ("gain_decrease", "crossover"):
        values = survey.values("fixed", metric)
        assert survey.worst("fixed", metric).value == values.max() > values.min()


def test_a_loop_that_the_hold_makes_unstable_is_left_out(survey: Result) -> None:
    # a controller that assumes 1 kg and 0.5 m commands ten times too much force
    assert np.isnan(survey.values("fixed-nominal", "delay", sampled=True)[0, 0])
    assert not np.isnan(survey.values("fixed-nominal", "delay")[0, 0])
    worst = survey.worst("fixed-nominal", "delay", sampled=True)
    assert (worst.cart_mass, worst.half_length) != (0.1, 0.05)
    loop = survey.loop("fixed-nominal", sampled=True)
    assert loop["stable"] == ((False, True), (True, True))
    assert loop["delay"][0][0] is None and survey.unstable("fixed-nominal", sampled=True) == 1
    assert "fixed-nominal unstable on 1 of 4 plants" in report(survey).headline


@pytest.mark.slow
def test_two_workers_find_the_same_margins(survey: Result) -> None:
    controllers = [CONTROLLERS[name] for name in survey.margins]
    assert run(Request(controllers, **GRID), workers=2) == survey


def test_the_command_writes_and_prints_the_margins(tmp_path, command_line) -> None:
    grid = ["--cart-masses", "1", "--half-lengths", "0.5"]
    few = ["--controllers", "lqr", *grid, "--no-measure", "--workers", "1", "--out", "out"]
    code, output, errors = command_line("margins", *few)
    assert (code, errors) == (0, "")
    content = json.loads((tmp_path / "out" / "margins.json").read_text())
    assert content["command"] == (
        "afl-mujoco margins --controllers lqr --cart-masses 1.0 --half-lengths 0.5 --no-measure"
    )
    delay = content["margins"]["lqr"]["continuous"]["delay"][0][0]
    assert f"{1e3 * delay:.2f}" in output and "Delay [ms]" in output


def test_a_scenario_gives_its_plants_its_period_and_what_is_linear(tmp_path) -> None:
    own = afl.Scenario(
        name="own",
        schedule={
            "pole_mass": 0.2,
            "cart_mass": afl.staircase([1.0], [8.0, 10.0]),
            "half_length": afl.constant(1.5),
        },
        imperfections=Imperfections(control_period=0.01, delay=0.004, noise={"phi": 1e-3}),
    )
    afl.save_scenario(own, tmp_path / "own.toml")
    asked = Options(scenario=str(tmp_path / "own.toml"), controllers=("lqr",), measure=False)
    request = prepare(asked)
    assert request.cart_masses == (8.0, 8.5, 9.0, 9.5, 10.0)
    assert request.half_lengths == (1.5,)
    assert (request.deployed.period, request.nominal.pole_mass) == (0.01, 0.2)
    assert request.deployed.imperfections == Imperfections(control_period=0.01, delay=0.004)
    assert prepare(replace(asked, control_period=0.002)).deployed.period == 0.002
    assert prepare(replace(asked, pole_mass=0.3)).nominal.pole_mass == 0.3
    found = run(request._replace(cart_masses=(8.0,)))
    assert (found.scenario, found.left_out) == ("own", ("noise.phi",))
    said = report(found).blocks[0]
    assert "count: delay = 0.004; that a linear loop cannot have: noise.phi" in said


def test_a_delay_of_the_hardware_is_in_the_margins_of_the_held_force_alone() -> None:
    plain, late = (
        run(Request([LQR], (1.0,), (0.5,), Deployment(0.01, Imperfections(delay=delay))))
        for delay in (0.0, 0.01)
    )
    one, other = (found.values("lqr", "delay", sampled=True)[0, 0] for found in (plain, late))
    assert other == pytest.approx(one - 0.01, rel=1e-9)
    assert late.imperfections == "delay = 0.01"
    continuous = [found.values("lqr", "delay")[0, 0] for found in (plain, late)]
    assert continuous[0] == continuous[1]


# Small motions in MuJoCo


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adaptive", "lqr", "partial-linearization"])
def test_margin_and_measurement_agree(name: str) -> None:
    found = measure((CONTROLLERS[name], plant(0.5, 0.2), Deployment(), True))
    assert found.agrees
    assert abs(found.difference) < 0.01  # far within REACH


@pytest.mark.slow
def test_a_wrong_margin_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    true = delay_margin(LQR, plant(1.0, 0.5))
    monkeypatch.setattr(margins, "delay_margin", lambda *plant: true * (1.0 + 2.0 * REACH))
    found = measure((LQR, plant(1.0, 0.5), Deployment(), True))
    assert not found.agrees
    assert found.difference == pytest.approx(1.0 / (1.0 + 2.0 * REACH) - 1.0, abs=0.01)


@pytest.mark.slow
def test_a_limit_cycle_is_no_decay() -> None:
    margin = delay_margin(ADAPTIVE, plant(2.0, 0.05))
    assert motion_decays(ADAPTIVE, plant(2.0, 0.05), 0.98 * margin)
    for factor in (1.02, 1.3, 1.6, 1.9):  # it falls no more than it decays
        assert not motion_decays(ADAPTIVE, plant(2.0, 0.05), factor * margin)


class Remembering:
    def __init__(self, bias: float = 0.0) -> None:
        self.calls, self.bias = 0, bias
        self.gains = linearize(LQR, NOMINAL).k.tolist()

    def __call__(self, time, state, belief) -> float:
        self.calls += 1
        force = sum(k * x for k, x in zip(self.gains, state.tolist(), strict=True))
        return self.bias * (self.calls > 100) - force


def biased(time, state, belief) -> float:
    return 1.0 + float(state[1])


def kinked(time, state, belief) -> float:
    return 50.0 * max(float(state[1]), 0.0)


def test_a_controller_with_a_memory_is_measured_where_the_linear_margins_are() -> None:
    mine = PythonController(name="mine", function=Remembering)
    period = 0.01
    expected = loop_margins(linearize(LQR, NOMINAL), period)
    found = measure((mine, NOMINAL, Deployment(period), False))
    assert found.decays
    for name in ("gain_decrease", "gain_increase", "delay"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=0.02), name


def test_what_cannot_be_judged_takes_no_other_s_answer_away() -> None:
    own = [
        PythonController(name=name, function=function)
        for name, function in (("memory", Remembering), ("biased", biased), ("kinked", kinked))
    ]
    alone = run(Request([LQR], **GRID))
    found = run(Request([own[0], own[1], LQR, own[2]], **GRID).require())
    assert found.margins == alone.margins
    assert found.not_linear["memory"] == "has a memory, which a linearisation leaves out"
    assert "no force at upright, got 1 N" in found.not_linear["biased"]
    assert "must be smooth" in found.not_linear["kinked"]
    with pytest.raises(InvalidValueError, match="no force at upright, got 1 N"):
        Request(own[1:2], **GRID).require()
    late = PythonController(name="late", function=partial(Remembering, 1.0))
    refused = measure((replace(late, stateful=True), NOMINAL, Deployment(), False))
    assert "no force at upright, got 1 N" in str(refused)


# What is shown

MADE_UP = study_results.margins()


def matrices(result: Result) -> list[list[list[str]]]:
    found = [block for block in report(result).blocks if isinstance(block, Matrix)]
    return [[[cell.marked for cell in row] for row in matrix.cells] for matrix in found]


def test_the_table_has_the_worst_of_the_stable_plants() -> None:
    worst, measured = matrices(MADE_UP)
    assert worst[0][:3] == ["adaptive", "continuous", "0"]
    assert worst[1] == ["adaptive", "held", "✗ 1", "0.60", "16.6", "0.4", "0.40", "12.00",
                        "0.1 kg, 0.05 m"]  # fmt: skip
    assert matrices(study_results.margins(gain_increase=None))[0][1][4] == "∞"
    assert measured == [["0.1 kg, 0.05 m", "12.0 (+0.5 %)"], ["0.1 kg, 0.2 m", "✗ 30.0 (–)"]]


def test_what_is_measured_by_small_motions_has_its_worst_plant_and_its_reason() -> None:
    def motion(name: str, decays: bool = True, **found: float | None) -> SmallMotions:
        return SmallMotions(
            controller=name, cart_mass=2.0, half_length=0.05, decays=decays, **found
        )

    result = replace(
        MADE_UP,
        margins={},
        measured=(),
        not_linear={"mine": "has a memory", "wild": "must be smooth", "biased": "pushes"},
        small_motions=(
            motion("mine", gain_decrease=0.25, gain_increase=8.0, delay=0.0),
            replace(motion("mine", gain_decrease=0.5, delay=0.02), cart_mass=0.1),
            motion("wild", decays=False),
            replace(motion("wild"), cart_mass=0.1),
        ),
    )
    (rows,) = matrices(result)
    assert rows == [
        ["mine", "measured", "0 of 2", "0.50", "8.0", "–", "–", "< 0.1", ""],
        ["wild", "measured", "✗ 1 of 2", "< 0.01", "> 100", "–", "–", "> 1000", ""],
        ["biased", "measured", *["–"] * 6, ""],
    ]
