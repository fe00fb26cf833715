"""A run with imperfections: without any it is ideal sampled mode, and each acts where it should."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.errors import ControllerDomainError, InvalidValueError
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.simulation.sampled.runs import simulate_sampled
from tests.engine import jump as jump_of
from tests.feedback import force_of
from tests.messages import line
from tests.plants.plants import cart

ARRAYS = ("time", "state", "force", "command", "cart_mass", "half_length")
REAL = Imperfections(
    control_period=0.002, input_limit=40.0, slew_rate=5000.0, lag=0.003, delay=0.0025,
    encoder_step={"z": 1e-4, "phi": 1e-3}, noise={"z": 1e-4, "phi": 1e-3}, differentiated=True,
    velocity_filter=0.004, damping={"z": 0.1, "phi": 1e-4}, dry_friction={"z": 0.3},
    armature={"phi": 1e-4}, end_stops={"z": 2.0}, tip_mass_share=0.1, parameter_delay=0.02, seed=7,
)  # fmt: skip


def same(one, other):
    bits = ([getattr(run, name).tobytes() for name in ARRAYS] for run in (one, other))
    return str(one.outcome) == str(other.outcome) and next(bits) == next(bits)


def in_python(function):
    return PythonController(name="mine", function=function, call_limit=60.0)  # one compiles


def plain_loop(scenario, controller, hold, integrator):
    """States and forces of the ideal loop, written with nothing but MuJoCo's own functions."""
    model = afl.CartPoleModel(scenario.parameters_at(0.0), timestep=1e-3, integrator=integrator)
    m, d = model.mj_model, model.mj_data
    count = round(scenario.duration / 1e-3)
    d.qpos[:], d.qvel[:] = scenario.initial_state[:2], scenario.initial_state[2:]
    rows, force = np.empty((count + 1, 5)), 0.0
    for k in range(count + 1):
        start, end = k * 1e-3, (k + 1) * 1e-3
        if k < count:
            model.set_parameters(scenario.parameters_at(0.5 * (start + end)))
        state = [*d.qpos, *d.qvel]
        if k < count and k % hold == 0:
            force = force_of(controller, state, scenario.parameters_at(round(start, 9)))
        rows[k] = *state, force
        if k < count:
            hits = [d for d in scenario.disturbances if not isinstance(d, afl.ForcePulse)]
            d.ctrl[0], d.qfrc_applied[0] = force, mean_push(scenario, k)
            for hit in (one for one in hits if int(1e3 * one.time) == k):  # never at the start
                m.opt.timestep = hit.time - start
                mujoco.mj_step(m, d)
                model.set_parameters(scenario.parameters_at(hit.time))
                d.qvel[:] += jump_of(model, (*d.qpos, *d.qvel), hit.momentum)
                model.set_parameters(scenario.parameters_at(0.5 * (start + end)))
                m.opt.timestep = end - hit.time
            d.ctrl[0], d.qfrc_applied[0] = force, mean_push(scenario, k)
            mujoco.mj_step(m, d)
            m.opt.timestep = 1e-3
    return rows


def mean_push(scenario, k):
    pulses = [one for one in scenario.disturbances if isinstance(one, afl.ForcePulse)]
    spans = [(x.force, round(1e4 * x.start) / 10, round(1e4 * x.end) / 10) for x in pulses]
    return sum(force * max(min(end, k + 1) - max(start, k), 0.0) for force, start, end in spans)


@pytest.mark.parametrize(("name", "hold", "integrator"), [
    ("adaptive", 1, "RK4"), ("adaptive", 7, "RK4"), ("fixed-nominal", 5, "Euler"),
    ("lqr", 7, "implicit"),
])  # fmt: skip
def test_ideal_the_loop_is_a_plain_loop_of_mj_step(odd_scenario, name, hold, integrator):
    controller = afl.CONTROLLERS[name]
    settings = {"integrator": integrator, "control_period": hold * 1e-3}
    run = afl.simulate_mujoco(odd_scenario, controller, "sampled", **settings)
    rows = plain_loop(odd_scenario, controller, hold, integrator)
    np.testing.assert_allclose(run.state, rows[:, :4], rtol=0, atol=1e-12)
    np.testing.assert_allclose(run.force, rows[:, 4], rtol=1e-11)
    assert (run.command == run.force).all()


@pytest.mark.parametrize("changes", [
    {"initial_state": (0, -1.6, 0, 0)}, {"initial_state": (0, 1.569, 0, 10.0)},
    {"schedule": {"cart_mass": 20.0, "half_length": 0.05, "pole_mass": 3.0}},
    *({"schedule": dict.fromkeys(("cart_mass", "half_length"), afl.piecewise_linear(*ramp))}
      for ramp in (((0.0, 0.8), (0.6, 1.1)), ((-0.3, 1.4), (0.6, 1.1)))),
], ids=["starts fallen", "no force", "falls", "ramp to the end", "ramp beyond both"])  # fmt: skip
def test_also_where_the_run_ends_early_or_never_stops_changing(odd_scenario, adaptive, changes):
    schedule = odd_scenario.schedule | changes.get("schedule", {})
    scenario = replace(odd_scenario, **changes | {"schedule": schedule})
    run = afl.simulate_mujoco(scenario, adaptive, "sampled")
    try:
        rows = plain_loop(scenario, adaptive, 1, "RK4")
    except ControllerDomainError:  # where the pole has fallen
        assert run.outcome.kind == "fell"
        return
    count = len(run.time)
    np.testing.assert_allclose(run.state, rows[:count, :4], rtol=0, atol=1e-11)
    assert (run.outcome.kind == "completed") == (count == len(rows))


def test_assumed_parameters_can_be_late_and_wrong():
    schedule = {
        "cart_mass": afl.staircase((0.05,), (1.0, 2.0)),
        "half_length": afl.piecewise_linear((0.0, 0.1), (0.4, 0.5)),
    }
    wrong = {"cart_mass": {"error": 0.1}, "half_length": {"error": -0.2}}
    late = Imperfections(parameter_delay=0.03)
    what = {"schedule": schedule, "imperfections": late, "belief": wrong, "duration": 0.2}
    seen = []
    mine = in_python(lambda time, state, belief: seen.append(belief) or 0.0)
    afl.simulate_mujoco(afl.Scenario(name="late", **what), mine, "sampled")
    masses, lengths = zip(*((b.cart_mass, b.half_length) for b in seen), strict=True)
    assert masses == pytest.approx([1.1] * 80 + [2.2] * 120)  # the jump at 0.05 + 0.03 s
    expected = 0.8 * (0.4 + np.clip(0.001 * np.arange(200) - 0.03, 0.0, 0.1))
    np.testing.assert_allclose(lengths, expected, rtol=1e-9)
    assert {(b.pole_mass, b.gravity) for b in seen} == {(0.05, 9.81)}


@pytest.mark.parametrize("late", [10, 20, 40, 70], ids=lambda ticks: f"{ticks} ms")
def test_a_late_jump_arrives_on_its_tick_however_the_times_round(late):
    jumps = (10, 20, 40, 50, 70, 140, 170, 200)  # [ms]; minus the delay, some round to just before
    seen = []
    mine = in_python(lambda time, state, belief: seen.append(belief.cart_mass) or 0.0)
    mass = afl.staircase([1e-3 * k for k in jumps], [1.0 + k for k in range(len(jumps) + 1)])
    hardware = Imperfections(parameter_delay=1e-3 * late)
    known = {"schedule": {"cart_mass": mass}, "imperfections": hardware}
    afl.simulate_mujoco(afl.Scenario(name="late", duration=0.3, **known), mine, "sampled")
    assert (np.flatnonzero(np.diff(seen)) + 1 - late).tolist() == list(jumps)


def test_the_scenario_s_control_period_is_the_simulator_s(odd_scenario, adaptive):
    held = replace(odd_scenario, imperfections=Imperfections(control_period=0.005))
    run = afl.simulate_mujoco(held, adaptive, "sampled")
    by_hand = afl.simulate_mujoco(odd_scenario, adaptive, "sampled", control_period=0.005)
    assert (run.state == by_hand.state).all()
    assert run.provenance["settings"]["control_period"] == 0.005
    assert same(afl.simulate_mujoco(held, adaptive, "sampled", control_period=0.005), run)
    said = line("control_period must be that of scenario 'odd', 0.005 s, got 0.002")
    with pytest.raises(InvalidValueError, match=said):
        afl.simulate_mujoco(held, adaptive, "sampled", control_period=0.002)
    half = replace(odd_scenario, imperfections=Imperfections(control_period=0.0005))
    assert afl.simulate_mujoco(half, adaptive).provenance["settings"]["timestep"] == 0.0005
    with pytest.raises(InvalidValueError, match=r"^timestep 0\.001 s must divide control_period"):
        afl.simulate_mujoco(half, adaptive, timestep=1e-3)


def test_a_real_run_is_replayed_by_its_file_and_forgets_others(odd_scenario, adaptive, tmp_path):
    scenario = replace(odd_scenario, imperfections=REAL)
    afl.save_scenario(scenario, file := tmp_path / "failure.toml")
    other = replace(scenario, imperfections=replace(REAL, seed=8))
    run, again, replayed, drawn = (
        afl.simulate_mujoco(one, adaptive, "sampled", integrator="Euler")
        for one in (scenario, scenario, afl.find_scenario(str(file)), other)
    )
    assert same(run, again) and same(run, replayed) and not same(run, drawn)
    p = scenario.parameters_at(0.0)
    fresh, used = (afl.CartPoleModel(p, imperfections=REAL) for _ in range(2))
    data = used.mj_data
    data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = 1.0, 2.0, 1e4
    data.qfrc_applied[:], data.ctrl[:], data.time = 3.0, 4.0, 5.0
    data.xfrc_applied[:] = 6.0
    assert same(*(simulate_sampled(scenario, adaptive, model=one) for one in (used, fresh)))


@pytest.mark.parametrize("imperfections", [IDEAL, REAL], ids=["ideal", "real"])
def test_a_python_controller_gives_the_compiled_one_s_bits(odd_scenario, controller, imperfections):
    scenario = replace(odd_scenario, imperfections=imperfections)
    compiled = afl.simulate_mujoco(scenario, controller, "sampled")
    mine = in_python(lambda time, state, belief: force_of(controller, state, belief))
    assert same(afl.simulate_mujoco(scenario, mine, "sampled"), compiled)
    assert compiled.outcome.kind == "completed"


SETTINGS = {"integrator": "Euler", "control_period": 0.002}
EULER = afl.Deployed(**SETTINGS)


@pytest.fixture
def scenarios(rng):
    scenarios = []
    for i in range(12):
        mass, length = rng.uniform(0.2, 1.5), rng.uniform(0.1, 0.8)
        imperfections = afl.Imperfections(
            noise={"z": rng.uniform(0, 1e-3), "phi": rng.uniform(0, 1e-2)},
            dry_friction={"z": rng.choice([0.0, 0.4])}, damping={"z": rng.choice([0.0, 0.3])},
            end_stops=[{}, {"z": 1.5}][i % 2], delay=rng.uniform(0.0, 0.02),
            tip_mass_share=rng.uniform(0.0, 0.3), seed=i,
        )  # fmt: skip
        scenarios.append(afl.Scenario(
            name=f"drawn-{i}", duration=[1.0, 1.5][i % 2],
            schedule={"cart_mass": afl.staircase((0.3,), (mass, 1.3 * mass)),
                      "half_length": afl.piecewise_linear((0.1, 0.5), (length, 1.2 * length))},
            initial_state=(0.0, rng.uniform(-1.3, 1.3), 0.0, rng.normal()),
            imperfections=imperfections if i % 3 else afl.Imperfections(),
        ))  # fmt: skip
    return scenarios


def test_threads_and_repetitions_change_no_bit_and_one_error_is_raised(scenarios, adaptive):
    one = afl.run_all(adaptive, scenarios, EULER)
    for threads in (1, 2, 3):
        assert afl.run_all(adaptive, scenarios, EULER, threads=threads) == one
    assert 0 < sum(run.outcome == "fell" for run in one) < len(one) == 12
    with pytest.raises(InvalidValueError, match=r"^threads must be at least 1, got 0$"):
        afl.run_all(adaptive, scenarios, threads=0)
    with pytest.raises(InvalidValueError, match=r"^timestep must be positive, got 0.0$"):
        afl.run_all(adaptive, scenarios, afl.Deployed(timestep=0.0), threads=2)
    (failed,) = afl.run_all("adaptive", afl.Scenario(name="tiny", schedule={"half_length": 0.001}))
    assert failed.failure == "controller failed" and "at M = 1 kg, l = 0.001" in failed.message


def test_figures_and_outcome_are_those_of_the_run_of_the_file(scenarios, adaptive, tmp_path):
    many = afl.run_all(adaptive, scenarios, EULER, threads=2)
    for row, scenario in zip(many, scenarios, strict=True):
        afl.save_scenario(scenario, file := tmp_path / "s.toml")
        run = afl.simulate_mujoco(afl.find_scenario(str(file)), adaptive, "sampled", **SETTINGS)
        assert row.ending == str(run.outcome)
        found, theirs = row.metrics, metrics(scenario, adaptive, run)
        peaks = np.abs(run.state[:, :2]).max(axis=0).tolist()
        assert [found[x] for x in ("peak_z", "peak_phi")] == peaks
        assert found["max_force"] == theirs["max_force"]
        assert found["iae_z"] == (theirs["iae_z"] and pytest.approx(theirs["iae_z"], rel=1e-12))


def test_an_end_stop_is_judged_from_0_where_the_target_is_not_there() -> None:
    plant = replace(cart(), upright=(2.0,))
    rail = afl.Imperfections(end_stops={"x": 2.1})
    start = {"initial_state": {"x": 2.0, "x_dot": 1.0}, "imperfections": rail, "duration": 0.5}
    (row,) = afl.run_all(lambda *_: 0.0, afl.Scenario(name="s", plant=plant, **start))
    assert row.failure == "end_stops" and row.time == pytest.approx(0.1, abs=2e-3)
