import shutil
from dataclasses import replace
from math import cos, sin
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.writer import PlantModel
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.judgement import remarks_on
from afl_mujoco.simulation.simulate import simulate_ode
from afl_mujoco.simulation.trajectory import signals_of
from afl_mujoco.studies.compare import report
from afl_mujoco.studies.margins import Request
from afl_mujoco.studies.shared.run import run_of
from tests.plants.plants import EXAMPLES, PENDULUM, known

QUADROTOR = known("quadrotor_load.py:plant")
HIT = afl.Impulse(momentum=1.0, time=1.0, coordinate="z")

RENAMED = """<mujoco><option integrator="RK4"><flag autoreset="disable"/></option><worldbody>
<body name="sled"><joint name="way" type="slide" axis="1 0 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  <body name="stick"><joint name="lean" axis="0 -1 0"/>
    <inertial pos="0 0 .5" mass=".05" diaginertia="1 1 1"/></body></body></worldbody>
<actuator><motor name="pull" joint="way" ctrlrange="-70 50"/></actuator></mujoco>"""


def write(p):
    across = p.stick_mass * p.reach * p.reach / 3.0
    sticks = {"mass": p.stick_mass, "ipos 2": p.reach, "inertia": (across, across, 0.01 * across)}
    return {"body sled mass": p.sled_mass, "option gravity 2": -p.weight,
            **{f"body stick {name}": value for name, value in sticks.items()}}  # fmt: skip


def terms(q, v, p):
    ml = p.stick_mass * p.reach
    coupling = -ml * cos(q[1])
    mass = ((p.sled_mass + p.stick_mass, coupling), (coupling, 4.0 / 3.0 * ml * p.reach))
    return mass, (ml * v[1] ** 2 * sin(q[1]), -ml * p.weight * sin(q[1])), ((1.0,), (0.0,))


SLED = afl.Plant(
    name="sled", model=RENAMED, coordinates=("way", "lean"), inputs=("pull",),
    parameters={"sled_mass": afl.Parameter(1.0, "kg", low=0.1, high=2.0),
        "stick_mass": afl.Parameter(0.05, "kg", low=0.01, high=1.0),
        "reach": afl.Parameter(0.5, "m", low=0.05, high=1.0),
        "weight": afl.Parameter(9.81, "m/s^2", low=1.0, high=20.0)}, write=write, terms=terms,
    upright=(0.0, 0.0), wraps=("lean",), ends_at={"lean": 0.5 * np.pi - 1e-3},
    signals={"top": lambda q, v, p: 2.0 * p.reach * cos(q[1])},
)  # fmt: skip


def steady(time, state, belief):
    return 5.6 * state[0] - 92.0 * state[1] + 10.9 * state[2] - 26.0 * state[3]


OWN = afl.Scenario(
    name="own",
    schedule={"cart_mass": afl.staircase([1.0], [1.0, 1.6]),
              "half_length": afl.trapezoid([0.5, 1.0, 1.5, 2.0], 0.4, 0.7)},
    disturbances=(afl.ForcePulse(force=-5.0, start=1.2003, duration=0.1),
        afl.Impulse(momentum=0.3, time=2.0004)),
    imperfections=afl.Imperfections(control_period=0.004, delay=0.0033, lag=0.002, slew_rate=4e3,
        input_limit=50.0, noise={"z": 1e-4, "phi": 5e-4, "z_dot": 1e-3, "phi_dot": 5e-3},
        encoder_step={"phi": 1e-3}, damping={"z": 1.0}, end_stops={"z": 3.0}, seed=3),
    initial_state={"phi": 0.2}, duration=3.0,
)  # fmt: skip
"""A cart-pole whose M and l change, with most imperfections at once."""


def test_a_plant_of_other_names_runs_bit_for_bit_as_the_cart_pole() -> None:
    names, r = dict(zip(CART_POLE.states, SLED.states, strict=True)), OWN.imperfections
    tables = {name: {names[key]: x for key, x in getattr(r, name).items()}
              for name in ("noise", "encoder_step", "damping", "end_stops")}  # fmt: skip
    schedule = dict(zip(SLED.parameters, OWN.schedule.values(), strict=True))
    renamed = replace(OWN, plant=SLED, schedule=schedule, imperfections=replace(r, **tables))
    one, other = (afl.simulate_mujoco(x, steady) for x in (OWN, renamed))
    assert one.outcome == other.outcome and one.outcome.kind == "completed"
    for name in ("state", "input", "command"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    for old, new in {"iae_z": "iae_way", "peak_phi": "peak_lean", "max_force": "max_pull"}.items():
        assert one.metrics[old] == other.metrics[new]


def test_an_lqr_goes_the_shorter_way_where_an_angle_wraps() -> None:
    at = afl.Scenario(name="s", plant=PENDULUM, duration=3.0, initial_state=(-3.0, 0.0))
    one = afl.simulate_mujoco(at, "lqr")
    other = afl.simulate_mujoco(replace(at, initial_state=(2.0 * np.pi - 3.0, 0.0)), "lqr")
    np.testing.assert_allclose(one.state[:, 0] + 2.0 * np.pi, other.state[:, 0], atol=1e-9)
    assert abs(other.state[-1, 0] - np.pi) < 0.01


def test_requirements_go_by_the_plants_names_and_measure_from_the_target() -> None:
    asked = afl.Requirements(
        target={"way": 0.5}, max={"way": 0.7, "pull": 75.0, "top": 1.1}, min={"top": 0.9},
        settling_time=5.0, bands={"way": 0.1},
    )  # fmt: skip
    what = {"requirements": asked, "initial_state": {"lean": 0.1}}
    scenario = afl.Scenario(name="to", plant=SLED, duration=8.0, **what)
    (row,) = afl.compare(scenario, "lqr").rows
    found = {one.requirement: one for one in row.requirements}
    assert [*found] == "completes max.way max.pull max.top min.top settling_time".split()
    assert row.failure == "" and row.settled
    assert found["min.top"].value == pytest.approx(np.cos(0.1), abs=0.05)
    missed = replace(scenario, requirements=replace(asked, min={"top": 0.99999}))
    assert afl.compare(missed, "lqr").rows[0].failure == "min.top"


def test_without_an_end_a_pole_swings_round_and_is_measured_modulo_a_turn() -> None:
    free = afl.Requirements(ends_at={}, settling_time=3.0)
    start = {"phi": 2 * np.pi - 0.05}
    turned = afl.Scenario(name="own", requirements=free, initial_state=start, duration=5.0)
    run = afl.simulate_mujoco(turned, lambda t, x, b: steady(t, x - [0, 2 * np.pi, 0, 0], b))
    assert run.outcome.kind == "completed" and run.metrics["peak_phi"] < 0.1
    hanging = replace(turned, initial_state=(0.0, 3.0, 0.0, 0.0))
    swung = afl.simulate_mujoco(hanging, lambda time, state, belief: 0.0)
    assert swung.outcome.kind == "completed" and swung.state[:, 1].max() > 3.2


@pytest.mark.parametrize(("changes", "message"), [
    ({"initial_state": {"phi": 0.1}}, "initial_state name must be one of way, lean, way_dot"),
    ({"schedule": {"cart_mass": 1.0}}, "schedule name must be one of sled_mass, stick_mass"),
    ({"imperfections": afl.Imperfections(noise={"phi": 1.0})},
     "imperfections.noise name must be one of way"),
    ({"requirements": afl.Requirements(max={"force": 1.0})},
     "requirements.max name must be one of way"),
    ({"disturbances": (HIT,)}, r"disturbances\[0\]\.coordinate must be one of way, lean"),
])  # fmt: skip
def test_a_name_of_another_plant_is_refused_with_those_of_this(changes, message) -> None:
    with pytest.raises(AflMujocoError, match=f"^{message}"):
        afl.Scenario(**{"name": "own", "plant": SLED, **changes})


def test_a_controller_fits_its_plant_and_returns_all_of_its_inputs() -> None:
    scenario = afl.Scenario(name="own", plant=SLED)
    with pytest.raises(AflMujocoError, match=r"^controller 'adaptive' is of the cart-pole; plant"):
        afl.compare(scenario, "adaptive")
    bare = replace(SLED, upright=None)
    with pytest.raises(AflMujocoError, match=r"^controller 'lqr' needs a plant that says where"):
        afl.simulate_mujoco(afl.Scenario(name="own", plant=bare), "lqr")
    scenario = afl.Scenario(name="own", plant=QUADROTOR, duration=0.1)
    with pytest.raises(AflMujocoError, match=r"must return 2 numbers \(left, right\) at t = 0 s"):
        afl.simulate_mujoco(scenario, lambda time, state, belief: 0.0)
    run = afl.simulate_mujoco(scenario, lambda time, state, belief: (5.0, belief.mass * 5.0))
    assert run.input[0].tolist() == [5.0, 5.0]


def test_a_saved_run_knows_the_names_of_its_plant_and_a_scenario_finds_it_from_any_folder(
    tmp_path: Path, monkeypatch
) -> None:
    scenario = afl.Scenario(name="own", plant=QUADROTOR, duration=0.1)
    run = afl.simulate_mujoco(scenario, "lqr")
    run.save(tmp_path / "run.npz")
    again = afl.Trajectory.load(tmp_path / "run.npz")
    assert again.layout == run.layout and again.metrics == run.metrics
    assert list(again.parameters) == list(QUADROTOR.parameters)
    with pytest.raises(AttributeError, match="no parameter cart_mass; parameters: mass, inertia"):
        _ = again.cart_mass
    for kind in ("py", "xml"):
        shutil.copy(EXAMPLES / f"quadrotor_load.{kind}", tmp_path)
    (tmp_path / "own.toml").write_text('plant = "quadrotor_load.py:plant"\nduration = 1.0\n')
    monkeypatch.chdir(tmp_path)
    scenario = afl.load_scenario("own.toml")
    (tmp_path / "out" / "deep").mkdir(parents=True)
    afl.save_scenario(scenario, "out/deep/saved.toml")
    assert 'plant = "../../quadrotor_load.py:plant"' in Path("out/deep/saved.toml").read_text()
    monkeypatch.chdir(tmp_path / "out")
    assert afl.load_scenario("deep/saved.toml").plant.name == scenario.plant.name


def test_a_load_joins_at_rest_and_leaves_with_the_velocity_that_it_has() -> None:
    scenario = afl.Scenario(
        name="caught", plant=QUADROTOR, duration=0.5,
        schedule={"load": afl.staircase([0.2, 0.4], [0.02, 0.4, 0.02])},
        initial_state={"x_dot": 1.0, "cable": 0.3, "cable_dot": 0.5, "pitch_dot": 0.2},
    )  # fmt: skip
    run, ode = (f(scenario, lambda *_: (0.0, 0.0)) for f in (afl.simulate_mujoco, simulate_ode))
    assert np.abs(run.state - ode.state).max() < 1e-11
    # nothing pushes sideways: the momentum along x of frame and load stays while the load is on
    x_dot, swing = run.state[:, 4], run.parameters["length"] * run.state[:, 7]
    load = run.parameters["load"]
    momentum = (1.0 + load) * x_dot + load * swing * np.cos(run.state[:, 3])
    np.testing.assert_allclose(momentum[run.time < 0.4 - 1e-9], momentum[0], rtol=1e-9)
    falls = int(np.searchsorted(run.time, 0.4 - 1e-9))
    assert np.abs(run.state[falls] - run.state[falls - 1])[4:].max() < 0.1


TURNING = afl.Plant(
    name="turning", coordinates=("a", "x"),
    model="""<mujoco><option gravity="0 0 0"/><worldbody>
      <body name="arm"><joint name="a" axis="0 0 1"/>
        <inertial pos="0.5 0 0" mass="1" diaginertia=".01 .01 .01"/></body>
      <body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
        <inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody></mujoco>""",
    parameters={"l": afl.Parameter(0.5, "m"), "m": afl.Parameter(1.0, "kg", jump="momenta"),
                "cart": afl.Parameter(2.0, "kg", jump="momenta")},
    write=lambda p: {"body arm ipos 0": p.l, "body arm mass": p.m, "body cart mass": p.cart},
    terms=lambda q, v, p: (((0.01 + p.m * p.l**2, 0), (0, p.cart)), (0, 0), ((), ())),
)  # fmt: skip
"""A load at the end of an arm, and a cart that has nothing to do with it."""


def kept(length: float) -> float:
    return (0.01 + length**2) / (0.01 + 2.0 * length**2)


STEPS = (afl.staircase([1.0], [1.0, 2.0]), afl.staircase([1.0], [2.0, 1.0]))
JOINS = {  # the schedule, and what the arm keeps
    "another mass falls": ({"m": STEPS[0], "cart": STEPS[1]}, kept(0.5)),
    "a length jumps, at rates that stay": (
        {"m": STEPS[0], "l": afl.staircase([1.0], [0.5, 1.5])}, kept(1.5)),
    "a length jumps later in the step": (
        {"m": afl.staircase([0.9991], [1.0, 2.0]), "l": afl.staircase([0.9993], [0.5, 1.5])},
        kept(0.5)),
    "in the first half of a step": ({"m": afl.staircase([4e-4], [1.0, 2.0])}, kept(0.5)),
    "a length ramps": (
        {"m": STEPS[0], "l": afl.piecewise_linear([0.0, 2.0], [0.5, 2.5])}, kept(1.5)),
}  # fmt: skip


@pytest.mark.parametrize(("schedule", "share"), JOINS.values(), ids=JOINS)
def test_what_joins_at_rest_does_not_change_what_else_jumps_or_ramps(schedule, share) -> None:
    scenario = afl.Scenario(
        name="joins", plant=TURNING, schedule=schedule, duration=1.5,
        initial_state={"a_dot": 1.0, "x_dot": 1.0},
    )  # fmt: skip
    modes = ("sampled", "exact", "continuous")
    runs = [afl.simulate_mujoco(scenario, lambda *_: (), mode=mode) for mode in modes]
    for run in (*runs, afl.simulate_ode(scenario, lambda *_: ())):
        assert run.state[-1, 2:] == pytest.approx([share, 1.0], rel=1e-12)


def nothing(time, state, belief):
    return ()


def test_a_plant_needs_neither_parameters_nor_inputs() -> None:
    xml = """<mujoco><worldbody><body><joint name="angle" axis="0 1 0"/>
        <inertial pos="0 0 -0.3" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody></mujoco>"""
    plant = afl.Plant(
        name="free", model=xml, coordinates=("angle",),
        accelerations=lambda q, v, u, p: (-0.6 * 9.81 * sin(q[0]) / 0.28,),
    )  # fmt: skip
    scenario = afl.Scenario(name="free", plant=plant, duration=0.5, initial_state={"angle": 0.3})
    expected = afl.simulate_ode(scenario, nothing).state[-1]
    for mode, away in (("exact", 1e-9), ("continuous", 1e-9), ("sampled", 1e-2)):
        run = afl.simulate_mujoco(scenario, nothing, mode=mode)
        np.testing.assert_allclose(run.state[-1], expected, atol=away)
        assert dict(run.parameters) == {}
    assert afl.load(scenario).reset().observation is not None
    found = afl.compare(scenario, [nothing])
    assert found.rows[0].outcome == "completed" and report(found).passed
    with pytest.raises(InvalidValueError, match="plant 'free' must have an input at which a loop"):
        Request(scenario, [afl.CONTROLLERS["lqr"]], {}).require()


@pytest.mark.parametrize(("target", "least", "most"), [(0.0, 1.0, 0.5), (-5.0, 0.5, -4.0)])
def test_a_least_value_beyond_the_largest_about_the_target_is_refused(target, least, most) -> None:
    asked = afl.Requirements(target={"z": target}, min={"z": least}, max={"z": most - target})
    rule = f"min.z must be at most {most:g}, the largest that requirements.max.z allows"
    with pytest.raises(InvalidValueError, match=rule):
        afl.Scenario(name="own", plant=QUADROTOR, requirements=asked)
    met = replace(asked, min={"z": most - 0.1})
    assert afl.Scenario(name="own", plant=QUADROTOR, requirements=met).about("z") == target


@pytest.mark.parametrize(("changes", "said"), [
    ({"signals": {"x": len}}, "signal 'x' must not be the name of the state too"),
    ({"signals": {"left_command": len}}, "signal 'left_command' must not be the name of the comm"),
    ({"signals": {"command": len}}, "signal 'command' must not be the name of the command in tab"),
    ({"coordinates": ("time", "z", "pitch", "cable")}, "state 'time' must not be the name of the "),
    ({"wraps": ("x",)}, "wraps must be hinges, which come round, got 'x'"),
])  # fmt: skip
def test_a_name_that_stands_for_something_else_too_is_refused(changes, said) -> None:
    with pytest.raises(InvalidValueError, match=said):
        PlantModel(replace(QUADROTOR, **changes))


@pytest.mark.parametrize("signal", [
    lambda q, v, p: p.load * q[0] + cos(q[2]),  # of numbers alone
    lambda q, v, p: 3.0, lambda q, v, p: q[0] - np.mean(q[0]),  # of arrays, something else
])  # fmt: skip
def test_signals_of_a_run_are_those_of_its_instants(signal) -> None:
    plant = replace(QUADROTOR, signals={"own": signal})
    states = np.random.default_rng(0).normal(size=(40, 8))
    values = np.tile(plant.nominal, (40, 1))
    found = signals_of(plant, states, values)["own"]
    pairs = zip(states, values, strict=True)
    expected = [signal(x[:4], x[4:], plant.named(row)) for x, row in pairs]
    np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_a_joint_that_reaches_its_range_is_remarked_on_and_at_its_end_stop() -> None:
    ranged = RENAMED.replace('axis="1 0 0"', 'axis="1 0 0" range="-.3 .3"')
    ends = afl.Requirements(ends_at={})
    free = afl.Scenario(name="rail", plant=SLED, duration=2.0, initial_state={"lean": -0.5},
                        requirements=ends)  # fmt: skip
    lqr = bound(afl.CONTROLLERS["lqr"], free)
    for scenario in (free, replace(free, plant=replace(SLED, model=ranged))):
        run = afl.simulate_mujoco(scenario, lqr, mode="sampled")
        found = [one for one in remarks_on(run, scenario, lqr) if "range" in one]
        assert len(found) == (scenario is not free)
    first = run.time[np.argmax(np.abs(run.state[:, 0]) >= 0.3)]
    said = f"way reaches its range in the MJCF, -0.3 to 0.3 m, first at {first}"
    assert found[0].startswith(said)
    wide = replace(scenario, imperfections=afl.Imperfections(end_stops={"way": 0.5}))
    row = run_of(wide, lqr, run)
    (stop,) = (one for one in row.requirements if one.requirement == "end_stops")
    assert (stop.limit, stop.met, row.failure, row.time) == (0.3, False, "end_stops", first)


def test_the_share_at_a_limit_is_that_of_each_simulator() -> None:
    shares = []
    for tilt in (0.02, -0.5):
        tilted = afl.Scenario(name="s", plant=SLED, duration=1.0, initial_state={"lean": tilt})
        runs = [simulate_ode(tilted, "lqr")]
        modes = ("exact", "continuous", "sampled")
        runs += [afl.simulate_mujoco(tilted, "lqr", mode) for mode in modes]
        shares.append([run.metrics["limited_share"] for run in runs])
        asked = np.mean((runs[1].command <= -70.0) | (runs[1].command >= 50.0))
        assert shares[-1] == pytest.approx([asked] * 4, abs=5e-3)
    assert shares[0] == [0.0] * 4 and min(shares[1]) > 0.02
