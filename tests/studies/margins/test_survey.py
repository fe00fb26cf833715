"""Margins over a grid of plants against those of one plant at a time."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco import CONTROLLERS
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.studies.linearization import linearize
from afl_mujoco.studies.loop_margins import loop_margins
from afl_mujoco.studies.margins.measured_delay import Deployment
from afl_mujoco.studies.margins.result import METRICS, Result
from afl_mujoco.studies.margins.small_motions import measure
from afl_mujoco.studies.margins.study import MarginsConfiguration
from afl_mujoco.studies.margins.survey import described, request_of, survey_margins

GRID = {"cart_masses": (0.1, 1.0), "half_lengths": (0.05, 0.5)}


@pytest.fixture(scope="module")
def survey() -> Result:
    controllers = [CONTROLLERS[name] for name in ("fixed", "fixed-nominal")]
    return survey_margins(controllers, **GRID)


def test_a_survey_holds_the_margins_of_each_plant(survey: Result) -> None:
    loop = linearize(CONTROLLERS["fixed"], NOMINAL)
    for sampled, period in ((False, None), (True, 1e-3)):
        expected = loop_margins(loop, period)
        for metric in METRICS:
            values = survey.values("fixed", metric, sampled=sampled)
            assert values.shape == (2, 2)
            assert values[1, 1] == getattr(expected, metric)


def test_the_worst_margin_says_where_it_stands(survey: Result) -> None:
    worst = survey.worst("fixed-nominal", "delay")
    assert (worst.cart_mass, worst.half_length) == (0.1, 0.05)
    assert worst.value == survey.values("fixed-nominal", "delay").min()
    largest = survey.worst("fixed", "gain_decrease")
    assert largest.value == survey.values("fixed", "gain_decrease").max()
    fastest, crossovers = survey.worst("fixed", "crossover"), survey.values("fixed", "crossover")
    assert fastest.value == crossovers.max() > crossovers.min()


def test_a_loop_that_the_hold_makes_unstable_is_left_out(survey: Result) -> None:
    # a controller that assumes 1 kg and 0.5 m commands ten times too much force
    assert np.isnan(survey.values("fixed-nominal", "delay", sampled=True)[0, 0])
    assert not np.isnan(survey.values("fixed-nominal", "delay")[0, 0])
    worst = survey.worst("fixed-nominal", "delay", sampled=True)
    assert (worst.cart_mass, worst.half_length) != (0.1, 0.05)
    grid = survey.grid("fixed-nominal", sampled=True)
    assert grid.stable == ((False, True), (True, True))
    assert grid.delay[0][0] is None and grid.unstable == 1


@pytest.mark.slow
def test_two_workers_find_the_same_margins(survey: Result) -> None:
    controllers = [CONTROLLERS[name] for name in survey.margins]
    assert survey_margins(controllers, **GRID, workers=2) == survey


def test_a_survey_names_what_it_does_not_hold(survey: Result) -> None:
    with pytest.raises(UnknownNameError, match=r"^controller must be one of fixed, fixed-nominal"):
        survey.values("lqr", "delay")
    with pytest.raises(UnknownNameError, match=r"^margin must be one of gain_decrease, "):
        survey.values("fixed", "delays")
    with pytest.raises(InvalidValueError, match="controllers must hold at least one, each once"):
        survey_margins([])
    with pytest.raises(InvalidValueError, match="cart_masses must hold at least one, each once"):
        request_of(MarginsConfiguration(cart_masses=()))


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
    assert f"{1e3 * delay:.2f}" in output
    assert "Delay [ms]" in output


def test_a_delay_of_the_hardware_is_in_the_margins_of_the_held_force_alone() -> None:
    lqr = afl.CONTROLLERS["lqr"]
    plain, late = (
        survey_margins([lqr], [1.0], [0.5], 0.01, imperfections=Imperfections(delay=delay))
        for delay in (0.0, 0.01)
    )
    one, other = (found.values("lqr", "delay", sampled=True)[0, 0] for found in (plain, late))
    assert other == pytest.approx(one - 0.01, rel=1e-9)
    assert late.imperfections == "delay = 0.01"
    continuous = [found.values("lqr", "delay")[0, 0] for found in (plain, late)]
    assert continuous[0] == continuous[1]


def test_a_scenario_gives_its_plants_its_period_and_what_is_linear(tmp_path) -> None:
    own = afl.Scenario(
        name="own",
        pole_mass=0.2,
        cart_mass=afl.staircase([1.0], [8.0, 10.0]),
        half_length=afl.constant(1.5),
        imperfections=Imperfections(control_period=0.01, delay=0.004, noise_phi=1e-3),
    )
    afl.save_scenario(own, tmp_path / "own.toml")
    asked = MarginsConfiguration(scenario=str(tmp_path / "own.toml"), controllers=("lqr",))
    request = request_of(asked)
    assert request.cart_masses == (8.0, 8.5, 9.0, 9.5, 10.0)
    assert request.half_lengths == (1.5,)
    assert (request.control_period, request.pole_mass) == (0.01, 0.2)
    assert request.imperfections == Imperfections(control_period=0.01, delay=0.004)
    assert described(asked) == {"scenario": "own", "left_out": ("noise_phi",)}
    assert request_of(replace(asked, control_period=0.002)).control_period == 0.002
    assert request_of(replace(asked, pole_mass=0.3)).pole_mass == 0.3


class Remembering:
    """An LQR that counts its calls."""

    def __init__(self, bias: float = 0.0) -> None:
        self.calls, self.bias = 0, bias
        loop = linearize(CONTROLLERS["lqr"], NOMINAL)
        self.gains = loop.k.tolist()

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
    expected = loop_margins(linearize(CONTROLLERS["lqr"], NOMINAL), period)
    found = measure((mine, NOMINAL, Deployment(period)))
    assert found.decays
    for name in ("gain_decrease", "gain_increase", "delay"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=0.02), name


def test_what_cannot_be_judged_takes_no_other_s_answer_away() -> None:
    own = [
        PythonController(name=name, function=function)
        for name, function in (("memory", Remembering), ("biased", biased), ("kinked", kinked))
    ]
    lqr = CONTROLLERS["lqr"]
    alone = survey_margins([lqr], **GRID)
    found = survey_margins([own[0], own[1], lqr, own[2]], **GRID)
    assert found.margins == alone.margins
    assert found.not_linear["memory"] == "has a memory, which a linearisation leaves out"
    assert "no force at upright, got 1 N" in found.not_linear["biased"]
    assert "must be smooth" in found.not_linear["kinked"]
    with pytest.raises(InvalidValueError, match="no force at upright, got 1 N"):
        survey_margins(own[1:2], **GRID)
    late = PythonController(name="late", function=partial(Remembering, 1.0))
    refused = measure((replace(late, stateful=True), NOMINAL, Deployment()))
    assert "no force at upright, got 1 N" in str(refused)
