"""A scenario survives its file; a file that breaks a rule is answered with file, key and value."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import afl_mujoco as afl
from afl_mujoco.scenario.belief import Assumed

POSITIVE = st.floats(1e-3, 1e3)
NUMBER = st.floats(-1e5, 1e5)  # disturbances may not be larger
TIME = st.floats(0, 9)
PULSES = st.builds(afl.ForcePulse, force=NUMBER, start=TIME, duration=st.floats(1e-3, 1))
HITS = st.builds(afl.Impulse, momentum=NUMBER, time=TIME)
NOT_NEGATIVE = st.floats(0, 1e3)
IMPERFECTIONS = st.builds(
    afl.Imperfections, control_period=st.none() | POSITIVE, delay=st.floats(0, 9),
    noise=st.fixed_dictionaries({"phi": NOT_NEGATIVE}), differentiated=st.booleans(),
    end_stops=st.just({}) | st.fixed_dictionaries({"z": st.floats(1.1e5, 1e6)}),
    tip_mass_share=st.floats(0, 0.999), seed=st.integers(0, 2**63 - 1),
)  # fmt: skip
ASSUMED = st.builds(
    Assumed, value=st.sampled_from(("true", "nominal")) | POSITIVE, error=st.floats(-0.999, 1e3)
)
BELIEFS = st.just("nominal") | st.fixed_dictionaries({"cart_mass": ASSUMED, "gravity": ASSUMED})
NAMES = st.text(min_size=1, max_size=12).filter(lambda s: s.isprintable() and "/" not in s)


@st.composite
def scenarios(draw):
    def schedule():
        ms = draw(st.lists(st.integers(-1000, 12_000), min_size=1, max_size=4, unique=True))
        times = [t / 1000 for t in sorted(ms)]
        knots = [t for t in times for _ in range(draw(st.integers(1, 2)))]
        return afl.piecewise_linear(knots, draw(st.tuples(*[POSITIVE] * len(knots))))

    return afl.Scenario(
        name=draw(NAMES),
        schedule={"cart_mass": schedule(), "half_length": schedule(), "pole_mass": draw(POSITIVE),
                  "gravity": draw(POSITIVE)},
        disturbances=draw(st.lists(st.one_of(PULSES, HITS), max_size=3)),
        initial_state=draw(st.tuples(NUMBER, st.floats(-6.28, 6.28), NUMBER, NUMBER)),
        duration=draw(st.floats(10, 1e3)), imperfections=draw(IMPERFECTIONS), belief=draw(BELIEFS),
    )  # fmt: skip


def test_any_scenario_survives_its_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("round trip") / "s.toml"

    @settings(derandomize=True, max_examples=60, deadline=None)
    @given(scenario=scenarios())
    def survives(scenario):
        afl.save_scenario(scenario, path)
        assert afl.load_scenario(path) == scenario

    survives()


def test_every_shape_can_be_written_by_hand(tmp_path):
    path = tmp_path / "by hand.toml"
    path.write_text(
        """
        duration = 12
        [schedule]
        half_length = 0.4
        [schedule.cart_mass]
        shape = "joined"
        starts = [0, 4, 8]
        pieces = [
          {shape = "staircase", times = [1], values = [0.5, 1]},
          {shape = "trapezoid", times = [0, 1, 2, 3], low = 1, high = 2},
          {shape = "constant", value = 3},
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
        """
    )
    scenario = afl.load_scenario(path)
    assert (scenario.name, scenario.duration) == ("by hand", 12.0)
    assert scenario.half_length.at(3.0) == 0.4
    assert scenario.cart_mass([0.5, 1, 4, 4.5, 5, 6.5, 8]).tolist() == [0.5, 1, 1, 1.5, 2, 1.5, 3]
    assert scenario.disturbances == (
        afl.ForcePulse(force=-10, start=10, duration=0.1),
        afl.Impulse(momentum=1, time=5),
    )


def test_what_a_file_leaves_out_is_nominal(tmp_path):
    (tmp_path / "nominal.toml").write_text("[schedule]")
    assert afl.load_scenario(tmp_path / "nominal.toml") == afl.SCENARIOS["nominal"]


TABLE = "[schedule.cart_mass]\nshape = "
HIT = "[[disturbances]]\nshape = "


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must have at least one key: it is empty or all comments"),
        ("half_length = 1", "half_length is not a known key; it is now [schedule] half_length"),
        ("delay = 1", "delay is not a known key; known keys: name, plant, duration, "),
        ("[imperfections]\nnoise_phi = 1e-3",
         "imperfections.noise_phi is not a known key; it is now noise = { phi = ... }"),
        ("[replay]\ncontroller = 1", "replay.controller must be text, got 1"),
        ("schedule.pole_mass = -0.1", "schedule.pole_mass must be positive, got -0.1"),
        ("initial_state = [0, -60, 0, 0]",
         "initial_state phi must lie in -2 pi to 2 pi rad (-60 degrees is -1.0472 rad), got -60"),
        ("duration = 12\nimperfections.delay = 12",
         "imperfections.delay must be shorter than the duration, 12 s, got 12 s"),
        ("initial_state = [0, 0]", "initial_state must hold four numbers, got 2"),
        ("plant = { name = 'x' }", 'plant must be "FILE.py:NAME", got '),
        (TABLE + "'spline'", "schedule.cart_mass.shape must be one of constant, staircase, "),
        (TABLE + "'staircase'\ntimes = [1]\nvalues = [1, 2]\nhigh = 3",
         "schedule.cart_mass.high is not a known key; known keys: times, values"),
        (TABLE + "'joined'\nstarts = [0]\npieces = [{shape = 'staircase', times = [1]}]",
         "schedule.cart_mass.pieces[0].values is missing"),
        (HIT + "'kick'", "disturbances[0].shape must be one of pulse, impulse, got 'kick'"),
        (HIT + "'impulse'\nmomentum = 1\ntime = 21.0",
         "disturbance must end within the duration 20.0 s, got 21.0"),
        ("name = ", "is not valid TOML: "),
        ("[disturbances]\nshape = 'pulse'",
         "disturbances must be a list of tables, each of which begins with [[disturbances]], "),
        ("[imperfections]\ndifferentiated = True",
         "is not valid TOML: Invalid value (at line 2, column 18): values are written true, "),
        ('name = "a\\u0000b"', "name must be printable, not empty and without '/'"),
    ],
    ids=lambda value: value[:36].replace("\n", " ").strip() if "must" not in value else "",
)  # fmt: skip
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
