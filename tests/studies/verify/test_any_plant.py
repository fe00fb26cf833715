"""The checks of a plant that is not the cart-pole, and that they can fail."""

from dataclasses import replace
from math import sin
from pathlib import Path

import pytest

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Plant
from afl_mujoco.studies.shared.arrays import packed, unpacked
from afl_mujoco.studies.validate import Options, Request, Result, prepare, report, run
from afl_mujoco.studies.verify.any_plant import judge
from afl_mujoco.studies.verify.cases import REPORTED, Settings
from tests.plants.plants import EXAMPLES, OWN, known

LQR = afl.CONTROLLERS["lqr"]
PENDULA, QUADROTOR, DOUBLE = (known(f"{name}.py:plant") for name in OWN)
STARTS = {
    "quadrotor-load": {
        "initial_state": {"x": -0.3, "cable": 0.2},
        "schedule": {"load": afl.staircase((1.0,), (0.02, 0.3)),
                     "length": afl.piecewise_linear((0.2, 1.2), (0.5, 0.7))},
        "disturbances": (afl.ForcePulse(force=1.0, start=0.4, duration=0.1, coordinate="x"),
                         afl.Impulse(momentum=0.05, time=0.7, coordinate="cable")),
        "requirements": afl.Requirements(target={"z": 0.5}),
    },
    "cart-double-pendulum": {"initial_state": {"cart": 0.1, "lower": 0.03}},
    "double-pendulum": {"initial_state": {"shoulder": 3.3, "elbow": 0.1}},
}  # fmt: skip


def scenario_of(plant: Plant, **changes) -> afl.Scenario:
    given = STARTS.get(plant.name, {})
    return afl.Scenario(name="short", plant=plant, **{"duration": 1.3, **given, **changes})


def validated(plant: Plant, **changes) -> Result:
    return run(Request([scenario_of(plant, **changes)], [LQR], Settings()))


def failed(result: Result) -> set[str]:
    return {check.id for check in result.failed_checks}


@pytest.mark.parametrize("plant", [QUADROTOR, PENDULA, DOUBLE], ids=lambda plant: plant.name)
def test_every_check_holds_on_the_examples(plant: Plant) -> None:
    result = validated(plant)
    assert result.failed_checks == [] and result.model_verified
    ids = ["A1e", "A1t", "A1x", "A1c", "A3n", "A4f", "A6f", "B4f", "A5s", "A10r", "B1r"]
    assert [check.id for check in result.checks] == ids
    assert [one.simulator for one in result.runs] == list(REPORTED)
    (growth,) = result.growths
    assert growth.difference is not None and growth.amplification is not None
    assert growth.difference < 1e-6 and growth.amplification > 1.0
    said = report(result)
    assert said.headline == "CODES AGREE 11/11" and said.passed
    anchors = [getattr(block, "anchor", "") for block in said.blocks]
    assert "checks" in anchors and "claims" not in anchors
    assert unpacked(Result, *packed(result)).checks == result.checks


def test_the_order_of_the_hold_is_not_judged_where_a_coordinate_comes_round() -> None:
    """The feedback jumps as the shoulder passes half a turn from upright."""
    start = {"shoulder": 0.05, "shoulder_dot": -10.0}
    result = validated(DOUBLE, duration=0.3, initial_state=start)
    assert result.passed and "B4f" not in {check.id for check in result.checks}


def test_codes_agree_on_what_turns_fast_and_differ_by_a_hair_in_its_bias() -> None:
    """Round-off is a share of what a state reaches."""
    start = {"shoulder": 0.05, "shoulder_dot": 1000.0}
    wrong = with_terms(DOUBLE, lambda q, v, p, m, h, b: (m, (h[0] * (1 + 1e-7), h[1]), b))
    for plant, fails in ((DOUBLE, set()), (wrong, {"A5s", "B1r"})):
        scenario = scenario_of(plant, duration=0.3, initial_state=start)
        checks = judge((scenario, LQR, Settings())).checks
        assert {"A5s", "B1r"} <= {one.id for one in checks}
        assert {one.id for one in checks if not one.passed} == fails


def test_a_run_that_reaches_the_range_of_a_joint_is_not_compared() -> None:
    text = DOUBLE.model.read_text().replace('"shoulder" axis', '"shoulder" range="3.29 9" axis')
    with pytest.raises(InvalidValueError, match="shoulder reaches its range"):
        validated(replace(DOUBLE, model=text))


def with_terms(plant: Plant, change) -> Plant:
    return replace(plant, terms=lambda q, v, p: change(q, v, p, *plant.terms(q, v, p)))


@pytest.mark.slow
def test_a_wrong_sign_is_found_in_each_comparison_and_a_hair_at_random_points() -> None:
    def turned(q, v, p, m, h, b):
        pull = p.load * p.length * v[3] ** 2 * sin(q[3])
        return m, (h[0] + 2 * pull, *h[1:]), b

    result = validated(with_terms(QUADROTOR, turned))
    assert failed(result) == {"A1e", "A1x", "A1c", "A5s", "B1r"}
    assert not report(result).passed and "CODES DIFFER" in report(result).headline
    (row,) = (check for check in result.checks if check.id == "A1e")
    assert "bias, x" in row.reason  # what `check` says of it

    def heavier(q, v, p, m, h, b):
        return m, (*h[:3], h[3] + 1e-9 * sin(q[3])), b

    result = validated(with_terms(QUADROTOR, heavier))
    assert {"A1e", "A1x"} <= failed(result) and "A1t" not in failed(result)


def test_without_equations_and_with_requirements_codes_are_compared_by_themselves() -> None:
    result = validated(replace(PENDULA, terms=None), duration=0.3)
    ids = ["A1t", "A1c", "A3n", "A4f", "A6f", "B4f", "A10r"]
    assert [check.id for check in result.checks] == ids and result.failed_checks == []
    assert [one.simulator for one in result.runs] == list(REPORTED[1:])
    assert report(result).headline == "CODES AGREE 7/7; model not verified: no equations"
    assert not unpacked(Result, *packed(result)).model_verified
    limits = afl.Requirements(max={"load_height": 0.1}, target={"z": 0.5})
    late = afl.Imperfections(delay=0.01)
    asked = {"requirements": limits, "imperfections": late, "schedule": {}, "disturbances": ()}
    result = validated(QUADROTOR, duration=0.5, **asked)
    assert result.failed_checks == [] and not result.passed
    assert result.rows[0].failure == "max.load_height"
    assert "1 of 1 runs fail: lqr on short" in report(result).headline


def test_the_order_of_a_loop_that_is_fast_is_seen_at_shorter_periods() -> None:
    """Of 1500 rad/s, which a period of 0.25 ms does not follow: the codes agree nevertheless."""
    fast = Plant(
        name="fast", coordinates=("x",), inputs=("f",),
        model='<mujoco><worldbody><body><joint name="x" type="slide"/><geom size=".1" mass="1"/>'
        '</body></worldbody><actuator><motor name="f" joint="x"/></actuator></mujoco>',
    )  # fmt: skip
    follow = {"plant": fast, "function": lambda t, x, b: -2.25e6 * x[0] - 1800.0 * x[1]}
    stiff = PythonController(name="stiff", **follow)
    scenario = scenario_of(fast, initial_state={"x": 1e-3}, duration=0.2)
    (check,) = [one for one in judge((scenario, stiff, Settings())).checks if one.id == "B4f"]
    assert check.passed and check.value > 0.0
    spring = replace(fast, model=fast.model.replace('"slide"', '"slide" stiffness="2e4"'))
    idle = PythonController(name="idle", plant=spring, function=lambda t, x, b: 0.0)
    scenario = scenario_of(spring, initial_state={"x": 0.05}, duration=1.0)
    assert "B4f" not in {one.id for one in judge((scenario, idle, Settings())).checks}


def test_a_run_that_ends_where_it_starts_is_one_that_fails() -> None:
    mute = PythonController(name="mute", plant=DOUBLE, function=lambda t, x, b: (float("nan"), 0.0))
    result = run(Request([scenario_of(DOUBLE)], [mute], Settings(full=True)))
    assert result.failed_checks == [] and result.rows[0].failure == "diverged"


def test_what_cannot_be_compared_is_refused_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(f'plant = "{EXAMPLES}/cart_double_pendulum.py:plant"\n')
    own = str(tmp_path / "own.toml")
    with pytest.raises(InvalidValueError, match=r"^timestep must be positive, got -1\.0"):
        prepare(Options(scenarios=(own,), timestep=-1.0))
    assert [one.name for one in prepare(Options(scenarios=(own,))).controllers] == ["lqr"]
    with pytest.raises(InvalidValueError, match="of one plant in a comparison, got cart-pole, ca"):
        prepare(Options(scenarios=("nominal", own), controllers=("lqr",)))
    with pytest.raises(InvalidValueError, match="is of the cart-pole; plant 'cart-double-pen"):
        prepare(Options(scenarios=(own,), controllers=("adaptive",)))


@pytest.mark.slow
def test_the_command_writes_a_report_and_a_page(tmp_path, command_line):
    text = f'plant = "{EXAMPLES}/double_pendulum.py:plant"\nduration = 1.0\n'
    (tmp_path / "own.toml").write_text(text + "initial_state = {shoulder = 3.3}\n")
    code, output, errors = command_line("validate", "own.toml", "--out", "out")
    assert (code, errors) == (0, "") and "PASS: CODES AGREE 11/11" in output
    assert {"report.html", "report.json"} <= {x.name for x in (tmp_path / "out").iterdir()}


@pytest.mark.slow
def test_a_full_verification_says_what_a_run_s_difference_consists_of(tmp_path: Path) -> None:
    load = {"load": afl.staircase((0.5015,), (0.02, 0.3))}
    push = afl.ForcePulse(force=1.0, start=0.2, duration=0.1037, coordinate="x")
    scenario = scenario_of(QUADROTOR, duration=1.0, schedule=load, disturbances=(push,))
    found = run(Request([scenario], [LQR], Settings(full=True)))
    (budget,) = found.error_budgets
    at = budget.at_worst
    parts = (at.model_form, at.integrator, at.control_hold, at.schedule_sampling)
    assert sum(parts) + at.disturbance_timing + at.residual == pytest.approx(at.total)
    assert budget.residual_share < 0.05 < budget.control_hold / budget.total
    assert min(budget.schedule_sampling, budget.disturbance_timing) > 1e-6 > budget.model_form
    assert at.unit == scenario.plant.units[at.state]
    assert "not explained" in str(report(found).blocks)
    ((time, states),) = found.curves.values()
    assert states.shape == (len(time), 8) and (time[0], time[-1]) == (0.0, 1.0)
    acting = scenario_of(QUADROTOR, duration=1.0, disturbances=())
    assert not run(Request([acting], [LQR], Settings(full=True))).error_budgets
