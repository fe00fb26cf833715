"""A scenario survives its file; a file that breaks a rule is answered with file, key and value."""

from dataclasses import replace

import pytest

import afl_mujoco as afl
from afl_mujoco.scenario.belief import Assumed
from afl_mujoco.scenario.files import scenario_from_table, scenario_to_table
from tests.plants.plants import known

BY_HAND = """
duration = 12
schedule.half_length = 0.4
[schedule.cart_mass]
shape = "joined"
starts = [0, 4, 8]
pieces = [
  {shape = "staircase", times = [1], values = [0.5, 1]},
  {shape = "trapezoid", times = [0, 1, 2, 3], low = 1, high = 2}, {shape = "constant", value = 3},
]
[[disturbances]]
shape = "pulse"
force = -10
start = 10
duration = 0.1
[[disturbances]]
shape = "impulse"
momentum = 1
time = 5
[requirements]
completes = false
max.force = 150
settling_time = 4.5
recover_within = 1.5
bands.z = 0.1
"""


@pytest.mark.parametrize("belief", ["nominal", {"cart_mass": Assumed("true", 0.1), "gravity": 9.0}])
def test_a_scenario_survives_its_file(odd_scenario, belief, tmp_path):
    jumps = afl.piecewise_linear((-0.1, 1 / 3, 1 / 3, 0.7), (1e-3, 0.1 + 0.2, 1e3, 2.0))
    scenario = replace(
        odd_scenario.with_schedule(cart_mass=jumps), name='a "quoted" \\ n\u00e4me = [1]',
        belief=belief, initial_state=(-1e5, 6.28, 1e-300, 1 / 3),
    )  # fmt: skip
    afl.save_scenario(scenario, tmp_path / "s.toml")
    assert afl.load_scenario(tmp_path / "s.toml") == scenario


def test_every_shape_can_be_written_by_hand(tmp_path):
    (path := tmp_path / "by hand.toml").write_text(BY_HAND)
    scenario = afl.load_scenario(path)
    assert (scenario.name, scenario.duration) == ("by hand", 12.0)
    assert scenario.half_length.at(3.0) == 0.4
    assert scenario.cart_mass([0.5, 1, 4, 4.5, 5, 6.5, 8]).tolist() == [0.5, 1, 1, 1.5, 2, 1.5, 3]
    pulse = afl.ForcePulse(force=-10, start=10, duration=0.1)
    assert scenario.disturbances == (pulse, afl.Impulse(momentum=1, time=5))
    asked = {"settling_time": 4.5, "recover_within": 1.5, "bands": {"z": 0.1, "phi": 0.02}}
    asked = afl.Requirements(completes=False, max={"force": 150.0}, **asked)
    assert replace(scenario, requirements=asked) == scenario
    afl.save_scenario(scenario, again := tmp_path / "again.toml")
    assert afl.load_scenario(again) == scenario and "phi = 0.02" not in again.read_text()
    (tmp_path / "nominal.toml").write_text("[schedule]")  # what a file leaves out is nominal
    assert afl.load_scenario(tmp_path / "nominal.toml") == afl.SCENARIOS["nominal"]


@pytest.mark.parametrize(("text", "message"), [
    ("imperfections.drag = 1", "imperfections.drag is not a known key; known keys: control_p"),
    ("imperfections.encoder_step.z = 1e-13",
     "imperfections.encoder_step.z must be 0 or at least 1e-12, got 1e-13"),
    ("imperfections.delay = -0.1", "imperfections.delay must not be negative, got -0.1"),
    ("imperfections.differentiated = 1",
     "imperfections.differentiated must be true or false, got 1"),
    ("imperfections.seed = 1.5", "imperfections.seed must be a whole number, got 1.5"),
    ("imperfections.end_stops.z = 0.5\ninitial_state = [-0.6, 0, 0, 0]",
     "initial_state z must lie within end_stops.z, 0.5 m, got"),
    ("ranges.phj = [0, 1]", "ranges.phj is not a known key; known keys: z, phi, "),
    ("ranges.phi = [-2, 2]", "ranges.phi must lie between -1.57 and 1.57 rad, where a run end"),
    ("ranges.phi = {}", "ranges.phi must have a least and a largest value"),
    ("ranges.phi = 3.0", "ranges.phi must be a range: its least and its largest value, got 3"),
    ("ranges.phi = [0.3, -0.3]", "ranges.phi must not decrease, got 0.3 to -0.3"),
    ("requirements.max.z = -1", "requirements.max.z must be positive, got -1"),
    ("requirements.max.phi = 15",
     "requirements.max.phi must be at most 1.57 rad, where a run ends (15 degrees is"),
    ("requirements.max_force = 1",
     "requirements.max_force is not a known key; it is now max = { force"),
    ("[requirements]\nends_at = {}\nmax.phi = 90",
     "requirements.max.phi must be at most 3.142 rad, as it is mea"),
    ("requirements.ends_at.phi = 57", "requirements.ends_at.phi must be at most 3.142 rad, as it"),
    ("requirements.min.phi = -3.2", "requirements.min.phi must lie in -3.142 to 3.142, as it "),
    ("requirements.max.y = 1",
     "requirements.max name must be one of z, phi, z_dot, phi_dot, force_comm"),
    ("requirements.settling_time = 21",
     "requirements.settling_time must be at most 20 s, the duration, got 21"),
    ("requirements.recover_within = 1",
     "requirements.recover_within needs a disturbance to recover from"),
    ("", "must have at least one key: it is empty or all comments"),
    ("half_length = 1", "half_length is not a known key; it is now [schedule] half_length"),
    ("delay = 1", "delay is not a known key; known keys: name, plant, duration, "),
    ("[replay]\ncontroller = 1", "replay.controller must be text, got 1"),
    ("schedule.pole_mass = -0.1", "schedule.pole_mass must be positive, got -0.1"),
    ("initial_state = [0, -60, 0, 0]",
     "initial_state phi must lie in -2 pi to 2 pi rad (-60 degrees is -1.0472 rad), got -60"),
    ("duration = 12\nimperfections.delay = 12",
     "imperfections.delay must be shorter than the duration, 12 s, got 12 s"),
    ("plant = { name = 'x' }", 'plant must be "FILE.py:NAME", got '),
    ("[schedule.cart_mass]\nshape = 'spline'",
     "schedule.cart_mass.shape must be one of constant, staircase, "),
    ("[schedule.cart_mass]\ntimes = [1]", "schedule.cart_mass must have a shape, one of "),
    ("duration = 1e-300", "duration must be positive, got 0.0"),
    ("schedule.cart_mass = {shape = 'staircase', times = [1], values = [1, 2], high = 3}",
     "schedule.cart_mass.high is not a known key; known keys: times, values"),
    ("[schedule.cart_mass]\nshape = 'joined'\nstarts = [0]\npieces = [{shape = 'staircase', "
     "times = [1]}]", "schedule.cart_mass.pieces[0].values is missing"),
    ("disturbances = [{shape = 'impulse', momentum = 1, time = 21.0}]",
     "disturbances[0] must end within the duration 20.0 s, got 21.0"),
    ("name = ", "is not valid TOML: "),
    ("[disturbances]\nshape = 'pulse'",
     "disturbances must be a list of tables, each of which begins with [[disturbances]], "),
    ("[imperfections]\ndifferentiated = True",
     "is not valid TOML: Invalid value (at line 2, column 18): values are written true, "),
    ('name = "a\\u0000b"', "name must be printable, not empty, not only dots and without '/'"),
    ('name = ".."', "name must be printable, not empty, not only dots and without '/', got '..'"),
    ("belief = 3", "belief must be a table by name, 'true' or 'nominal', got 3"),
    ("belief = 'nominl'", "belief.cart_mass value must be one of true, nominal, a number"),
    ("belief.mass = 1.0", "belief.key must be one of cart_mass, pole_mass, half_length, grav"),
    ("belief.cart_mass = -1.0", "belief.cart_mass value must be positive, got -1.0"),
    ("belief.cart_mass = { error = -1 }", "belief.cart_mass error must be above -1, got -1.0"),
    ("belief.cart_mass = { eror = 1 }", "belief.cart_mass eror is not a known key"),
], ids=lambda value: value[:36].replace("\n", " ") if "must" not in value else "")  # fmt: skip
def test_the_message_names_file_key_and_value(text, message, tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(afl.AflMujocoError) as caught:
        afl.load_scenario(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: {message}") or said.startswith(f"{path} {message}")
    assert "\n" not in said


@pytest.mark.parametrize("run", [
    afl.simulate_mujoco, afl.simulate_ode, afl.simulate_ode_rk4, afl.simulate_ode_held,
    lambda scenario, controller: afl.run_all(controller, scenario)[0],
])  # fmt: skip
def test_every_simulator_takes_the_path_of_a_file_or_a_name(tmp_path, run):
    scenario = afl.Scenario(name="mine", duration=0.02)
    afl.save_scenario(scenario, path := tmp_path / "mine.toml")
    of_path, of_text, of_object = (run(x, "lqr").metrics for x in (path, str(path), scenario))
    assert of_path == of_text == of_object
    with pytest.raises(afl.AflMujocoError, match="did you mean nominal"):
        run("nominall", "lqr")


def test_a_result_keeps_values_that_its_plant_allows_and_knots_before_the_start() -> None:
    own = {"friction": afl.Parameter(0.02, low=0.0, high=0.1)}
    plant = replace(known("double_pendulum.py:plant"), parameters=own, write=lambda p: {},
                    terms=None, accelerations=None, signals={})  # fmt: skip
    zero = afl.Scenario(name="own", plant=plant, schedule={"friction": 0.0})
    again = scenario_from_table(scenario_to_table(zero))
    assert scenario_to_table(again) == scenario_to_table(zero)
    past = afl.SCENARIOS["nominal"].with_schedule(cart_mass=afl.staircase([-1.0], [2.0, 1.0]))
    runs = [afl.simulate_mujoco(replace(x, duration=0.1), "lqr")
            for x in (past, afl.SCENARIOS["nominal"])]  # fmt: skip
    assert runs[0].state.tobytes() == runs[1].state.tobytes()
