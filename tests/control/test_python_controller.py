"""A controller of one's own: loaded by name, run, and answered in one line when it misbehaves."""

import json
import math
import os
import pickle
import signal
import threading
import time as clock
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from decimal import Decimal
from functools import lru_cache, partial, wraps

import numpy as np
import pytest
from numba import njit

import afl_mujoco as afl
from afl_mujoco.cli.main import main
from afl_mujoco.control import controller as controllers
from afl_mujoco.control.own import ControllerError, PythonController
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.cartpole import FALL_ANGLE
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.simulation.ode_fixed_step import Holds
from tests import program
from tests.feedback import force_of
from tests.messages import line
from tests.plants.plants import known

ASSUMED = np.array([1.0, 0.05, 0.5, 9.81])
STATE = np.array([0.1, -0.2, 0.3, 0.4])


def paper(time, state, belief):
    return afl.control_force(state, belief, afl.FIXED_GAINS)


def controller_of(function, **settings):
    return PythonController(name="mine", function=function, **settings)


def limited(function, seconds):
    return controller_of(function, call_limit=seconds, first_call_limit=seconds)


SIMULATORS = {
    "ode": afl.simulate_ode, "exact": lambda *of: afl.simulate_mujoco(*of, "exact"),
    "continuous": lambda *of: afl.simulate_mujoco(*of, "continuous"),
    "sampled": lambda *of: afl.simulate_mujoco(*of, "sampled", control_period=0.004),
    "RK4": lambda *of: afl.simulate_ode_rk4(*of),
    "held": lambda *of: afl.simulate_ode_held(*of, control_period=0.004),
    "only the schedule held": lambda *of: afl.simulate_ode_held(*of, holds=Holds(schedule=True)),
}  # fmt: skip


def test_a_controller_gets_time_a_state_of_its_own_and_assumed_parameters():
    seen = []

    def vandal(time, state, belief):
        seen.append((time, state.tolist(), belief))
        state[:] = 0.0
        return 7.5

    own, mine = controller_of(vandal), STATE.copy()
    assert own.command(1.25, mine, ASSUMED) == 7.5
    assert force_of(own, mine, afl.CartPoleParameters()) == 7.5  # at the start
    assert seen == [(t, STATE.tolist(), afl.CartPoleParameters()) for t in (1.25, 0.0)]
    np.testing.assert_array_equal(mine, STATE)
    astray = controller_of(lambda time, state, belief: belief.mass)
    with pytest.raises(ControllerError, match=r"has no attribute 'mass'; belief has cart_mass, "):
        astray.command(0.0, np.zeros(4), ASSUMED)


class Tensor:
    """What a library of gradients returns: neither NumPy nor `float` takes it undetached."""

    shape = ()

    def __init__(self, graph=True):
        self.graph = graph

    def detach(self):
        return Tensor(graph=False)

    def __array__(self, dtype=None, copy=None):
        raise TypeError("unsupported type BFloat16")

    def __float__(self):
        assert not self.graph
        return 3.0


class Mute(Exception):
    def __str__(self):
        raise RuntimeError("no")

    __repr__ = __str__


async def asleep():
    return 3.0


@pytest.mark.parametrize("value", [
    3, np.float32(3.0), np.array([[3.0]]).view(np.matrix), [[3]], [Decimal(3)], Tensor(),
], ids=lambda x: type(x).__name__)  # fmt: skip
def test_one_number_in_any_shape_is_a_force(value):
    assert controller_of(lambda *_: value).command(0.0, STATE, ASSUMED) == 3.0


@pytest.mark.parametrize(("value", "said"), [
    (None, "None"), ("3", "'3'"), (True, "True"), ([[1.0], [2.0, 3.0]], "[[1.0], [2.0, 3.0]]"),
    (np.zeros((1, 2)), "an array of shape (1, 2) of float64"), (Mute(), "<Mute without a text>"),
    (np.ma.masked_invalid([np.nan]), "an array of shape (1,) of float64"),
    (asleep(), "<coroutine object asleep>"),
], ids=lambda x: type(x).__name__)  # fmt: skip
def test_what_is_no_number_is_answered_in_one_line(value, said):
    expected = line(f"controller 'mine' must return one number at t = 0.5 s, got {said}")
    with pytest.raises(ControllerError, match=expected):
        controller_of(lambda *_: value).command(0.5, STATE, ASSUMED)


@pytest.mark.parametrize("raised", [ZeroDivisionError("x"), SystemExit("x"), StopIteration()])
def test_whatever_a_controller_raises_is_answered_in_one_line(raised):
    def raising(time, state, belief):
        raise raised

    said = type(raised).__name__
    text = f": {raised}" if str(raised) else ""
    expected = line(f"controller 'mine' raised {said} at t = 2 s{text}")
    with pytest.raises(ControllerError, match=expected):
        controller_of(raising).command(2.0, STATE, ASSUMED)
    with pytest.raises(InvalidValueError, match=f"cannot be started: {said}{text}"):
        controller_of(type("Mine", (), {"__init__": lambda _: raising(0, 0, 0), "__call__": paper}))
    assert math.isnan(controller_of(raising).command(0.0, (0.0, 1.6, 0.0, 0.0), ASSUMED))


def forever(time, state, belief):
    while True:
        try:
            clock.sleep(0.001)
        except Exception:  # a controller that swallows whatever it can
            pass


def stubborn(time, state, belief):
    try:
        clock.sleep(10.0)
    except:  # noqa: E722 (as controllers are written)
        return 1.0


@pytest.mark.parametrize("function", [forever, stubborn])
def test_a_controller_that_does_not_return_or_answers_late_is_stopped(function):
    start, said = clock.perf_counter(), "must answer within 0.05 s (--call-limit), but did not at"
    with pytest.raises(ControllerError, match=line("controller 'mine' ", said, ...)):
        limited(function, 0.05).command(0.0, STATE, ASSUMED)
    assert clock.perf_counter() - start < 5.0


class SlowAtFirst:
    """Takes long for its first call, as a function that is compiled then, or a network loaded."""

    seconds = 0.15

    def __call__(self, time, state, belief):
        clock.sleep(self.seconds)
        self.seconds = 0.0
        return -60.0 * state[1]


@pytest.mark.parametrize("simulate", SIMULATORS.values(), ids=list(SIMULATORS))
def test_a_first_call_may_take_longer_than_the_others(smooth_scenario, simulate):
    short, forgetful = replace(smooth_scenario, duration=0.02), type("Mine", (SlowAtFirst,), {})
    stateless = type("Mine", (SlowAtFirst,), {"stateless": True})
    stateful = (forgetful, forgetful()) if simulate is SIMULATORS["sampled"] else ()
    for given in (stateless(), *stateful):  # of a run, if it remembers
        own = controller_of(given, call_limit=0.1)
        for _ in range(2):
            assert simulate(short, own).outcome.kind == "completed"


def test_a_first_call_that_hangs_is_not_awaited_again():
    own = PythonController(name="hanging", function=forever, call_limit=0.05, first_call_limit=0.2)
    said = "must answer its first call within 0.2 s (--call-limit), but did not at t = 0 s"
    with pytest.raises(ControllerError, match=line(f"controller 'hanging' {said}")):
        own.command(0.0, STATE, ASSUMED)
    with pytest.raises(ControllerError, match=r"must answer within 0\.05 s"):
        pickle.loads(pickle.dumps(own)).command(0.0, STATE, ASSUMED)


def test_every_command_that_runs_controllers_has_a_limit_and_so_has_a_comparison(
    smooth_scenario, capsys
):
    commands = "simulate compare thresholds montecarlo attraction margins validate render view"
    for command in commands.split():
        assert main([command, "nominal", "--call-limit", "0"]) == 2
        said = "afl-mujoco: call_limit must be positive, got 0.0"
        assert capsys.readouterr().err.splitlines() == [said]

    def slow(time, state, belief):
        return clock.sleep(0.15 if time > 0.0 else 0.0) or 0.0

    short = replace(smooth_scenario, duration=0.005)
    (row,) = afl.compare(short, slow, control_period=0.004, call_limit=0.05).rows
    said = "must answer within 0.05 s (--call-limit), but did not at t = 0.004 s"
    assert row.ending == f"failed: {said}"


def test_an_alarm_of_the_program_s_own_goes_on_and_a_first_call_leaves_us_where_we_were(tmp_path):
    here = os.getcwd()
    controller = controller_of(lambda *_: float(os.chdir(tmp_path) is None))
    assert controller.command(0.0, STATE, ASSUMED) == 1.0 and os.getcwd() == here
    before = signal.signal(signal.SIGALRM, own := lambda *_: None)
    try:
        signal.setitimer(signal.ITIMER_REAL, 20.0)
        assert controller_of(lambda *_: 1.0).command(0.0, np.zeros(4), ASSUMED) == 1.0
        assert 0.0 < signal.getitimer(signal.ITIMER_REAL)[0] <= 20.0
        assert signal.getsignal(signal.SIGALRM) is own
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_a_controller_that_is_slow_in_another_thread_is_reported_afterwards():
    slow = limited(lambda *_: clock.sleep(0.05) or 1.0, 0.01)
    with ThreadPoolExecutor() as other, pytest.raises(ControllerError, match=r"within 0\.01 s"):
        other.submit(slow.command, 0.0, STATE, ASSUMED).result()


@pytest.mark.parametrize("simulate", SIMULATORS.values(), ids=list(SIMULATORS))
def test_the_paper_s_controller_in_python_is_the_compiled_one(odd_scenario, simulate):
    compiled, own = afl.CONTROLLERS["fixed"], controller_of(paper)
    run, reference = (simulate(odd_scenario, controller) for controller in (own, compiled))
    assert run.outcome == reference.outcome
    np.testing.assert_allclose(run.state, reference.state, atol=1e-10)
    np.testing.assert_allclose(run.force, reference.force, rtol=1e-8, atol=1e-8)
    assert metrics(odd_scenario, own, run)["saturated_share"] is None


@pytest.mark.parametrize("simulate", SIMULATORS.values(), ids=list(SIMULATORS))
def test_a_controller_gets_the_time(smooth_scenario, simulate):
    run = simulate(smooth_scenario, controller_of(lambda time, state, belief: 3.0 * time))
    period = run.provenance["settings"].get("control_period")
    seen_at = run.time if period is None else period * np.floor(run.time / period + 1e-9)
    np.testing.assert_allclose(run.force[:-1], 3.0 * seen_at[:-1], atol=1e-9)
    if simulate is SIMULATORS["RK4"]:  # within a step too, as no scheme of a lower order would
        reference = afl.simulate_ode(smooth_scenario, controller_of(lambda t, x, b: 3.0 * t))
        np.testing.assert_allclose(run.state[:200], reference.state[:200], atol=1e-9)


@pytest.mark.parametrize("simulate", SIMULATORS.values(), ids=list(SIMULATORS))
def test_a_controller_without_a_force_ends_the_run_as_diverged(smooth_scenario, simulate):
    run = simulate(smooth_scenario, controller_of(lambda time, *_: math.nan if time > 0.3 else 0.0))
    assert run.outcome.kind == "diverged"
    assert run.outcome.time == pytest.approx(0.3, abs=0.02) and np.isfinite(run.state).all()


def test_a_run_without_a_force_within_a_step_has_one_for_every_state(smooth_scenario):
    own = controller_of(lambda time, *_: math.nan if time > 0.302 else 0.25)
    run = afl.simulate_ode_rk4(smooth_scenario, own, timestep=4e-3)
    assert run.outcome.kind == "diverged" and len(run.force) == len(run.state) == len(run.time)
    np.testing.assert_array_equal(run.force, 0.25)


@pytest.mark.parametrize("simulate", SIMULATORS.values(), ids=list(SIMULATORS))
def test_a_pole_at_the_angle_of_a_fall_has_fallen(smooth_scenario, simulate):
    scenario = replace(smooth_scenario, initial_state=(0.0, -FALL_ANGLE, 0.0, 0.0))
    for controller in (controller_of(lambda *_: 0.0), afl.CONTROLLERS["lqr"]):
        run = simulate(scenario, controller)
        assert str(run.outcome) == "fell at t = 0 s"
        assert (run.time.tolist(), run.state.tolist()) == ([0.0], [[*scenario.initial_state]])
        if simulate is SIMULATORS["held"]:  # no period began
            assert run.force.tolist() == [0.0]


def test_a_controller_is_found_by_module_and_function_in_the_working_directory(module):
    text = "class Set:\n    @staticmethod\n    def push(t, x, b): return -2.0 * x[1]\n"
    module("module_of_mine", text)
    own = afl.find_controller("module_of_mine:Set.push")
    assert own.name == "module_of_mine.Set.push"
    assert force_of(own, (0.0, 0.25, 0.0, 0.0), afl.CartPoleParameters()) == -0.5
    described = json.loads(json.dumps(own.describe()))
    assert (described["function"], len(described["source"])) == ("module_of_mine.Set.push", 32)


def test_what_outlives_a_run_is_remarked_on(smooth_scenario, module):
    module("counts", "N = 0\ndef f(t, x, b):\n    global N\n    N += 1\n    return float(N)\n")
    (remarks,) = afl.compare(replace(smooth_scenario, duration=0.01), "counts:f").remarks.values()
    said = "it writes 'N', which outlives the call: make it a class: a run depends on those before"
    assert any(one.startswith(said) for one in remarks)


@pytest.mark.parametrize(("spec", "text", "said"), [
    ("no_such_module:f", "x = 1", "must be in a module that is installed or in "),
    ("m:needs", "import nowhere_at_all", "needs a module: No module named 'nowhere_at_all'"),
    ("m:syntax", "def f(:", "cannot be imported: SyntaxError: "),
    ("m:leaves", "raise GeneratorExit('k')", "cannot be imported: GeneratorExit: k"),
    ("m:lacks", "x = 1", "which has no 'lacks'"),
    ("m:number", "number = 1", "must be callable, got 1"),
    ("m:made", "def made(): return 3.0", "must be callable, got 3.0"),
    ("m:Needy", "class Needy:\n def __init__(self, gain): pass", "cannot be started: TypeError"),
    ("m:two", "def two(t, x): return 0.0", "must take (time, state, belief): "),
    *((spec, "x = 1", "must be module:attribute, or FILE.py:NAME below this folder")
      for spec in ("m:", "m:x-estimated", "../m.py:f")),
])  # fmt: skip
def test_what_cannot_be_loaded_is_answered_in_one_line(spec, text, said, module):
    module("m", text)
    with pytest.raises(InvalidValueError, match=line(f"controller {spec!r} ", ..., said, ...)):
        afl.find_controller(spec)


def pd(state):
    return np.dot(state, 1.05 * np.array([3.3, -64.0, 6.5, -29.0], state.dtype))


ROUGH = {
    "in_float32": lambda time, state, belief: np.float32(pd(state.astype(np.float32))),
    "switching": lambda time, state, belief: math.copysign(10.0, pd(state)),
}


@pytest.mark.parametrize("mode", ["ode", "exact"])
@pytest.mark.parametrize("kind", ROUGH)
def test_a_force_that_is_not_smooth_is_refused_in_continuous_time(kind, mode, monkeypatch):
    most = controllers.MOST_EVALUATIONS
    if kind != "in_float32":  # of one kind all are awaited
        most //= 10
        monkeypatch.setattr(controllers, "MOST_EVALUATIONS", most)
    scenario = afl.Scenario(name="lean", initial_state=(0.0, -0.3, 0.0, 0.0), duration=1.0)
    said = "controller 'mine' must give a force that is a smooth function of time"
    said = line(said, ..., f"more than {most} evaluations for 0.02 s", ...)
    with pytest.raises(InvalidValueError, match=said):
        SIMULATORS[mode](scenario, controller_of(ROUGH[kind]))


@pytest.mark.slow
def test_what_a_controller_s_arithmetic_warns_of_is_one_line(module, tmp_path):
    text = "import numpy as np\n\ndef force(t, x, p): return np.exp(np.float64(1e4)) and 0.0\n"
    module("overflowing", text)
    (tmp_path / "short.toml").write_text("duration = 0.1\n[ranges]\nphi = [0.0, 0.1]\n")
    warning = "afl-mujoco: warning: overflow encountered in exp (overflowing.py, line 3)"
    few = ["--samples", "41", "--no-worst-case", "--no-page", "--workers", "2"]
    for command in (["simulate", "short.toml", "--controller"], ["montecarlo", "short.toml", *few]):
        option = [] if command[0] == "simulate" else ["--controllers"]
        said = program.run(*command, *option, "overflowing:force", "--out", "out", cwd=tmp_path)
        assert set(said.stderr.splitlines()) == {warning}


class Integrating:
    count = 0

    def __call__(self, time, state, belief):
        self.count += 1
        return float(self.count)


class Resettable(Integrating):
    def reset(self):
        self.count = 0


def counting_in(kept, time, state, belief):
    kept[0] += 1.0
    return kept[0]


STATEFUL = {
    "bound list": partial(counting_in, [0.0]), "bound array": partial(counting_in, np.zeros(1)),
    "class": Integrating, "factory": lambda: Integrating(), "instance with reset()": Resettable(),
    "method": Integrating().__call__, "partial": partial(Integrating().__call__),
}  # fmt: skip


@pytest.mark.parametrize("given", STATEFUL.values(), ids=list(STATEFUL))
def test_memory_is_fresh_in_every_run(smooth_scenario, given):
    scenario = replace(smooth_scenario, duration=0.02)
    for _ in range(2):
        run = afl.simulate_mujoco(scenario, given, "sampled", control_period=0.005)
        assert run.force.tolist() == [*[1.0] * 5, *[2.0] * 5, *[3.0] * 5, *[4.0] * 6]
    assert afl.run_all(given, [scenario]) * 2 == afl.run_all(given, [scenario] * 2)
    held = afl.simulate_ode_held(scenario, given, control_period=0.005)
    assert held.force.tolist() == run.force.tolist()


@pytest.mark.parametrize("simulator", sorted(SIMULATORS.keys() - {"sampled", "held"}))
def test_memory_is_refused_where_it_is_undefined(smooth_scenario, simulator):
    for given in STATEFUL.values():
        with pytest.raises(InvalidValueError, match=r"^controller 'mine' is stateful, which "):
            SIMULATORS[simulator](smooth_scenario, controller_of(given))


@pytest.mark.parametrize("given", [lambda x: x, lambda x: x.__call__, partial])
def test_an_instance_that_was_used_before_is_reset_in_each_run(smooth_scenario, given):
    used = Resettable()
    used.count = 40
    scenario = replace(smooth_scenario, duration=0.01)
    run = afl.simulate_mujoco(scenario, given(used), "sampled", control_period=0.005)
    assert run.force.tolist()[::5] == [1.0, 2.0, 2.0] and used.count == 40


class Locked(Integrating):
    def __init__(self):
        super().__init__()
        self.lock = threading.Lock()


@pytest.mark.parametrize("given", [
    Locked(), partial(Locked().__call__), partial(lambda kept, time, state, belief: 0.0, Locked()),
], ids=["instance", "partial of a method", "its argument"])  # fmt: skip
def test_what_cannot_be_copied_is_refused_and_not_shared(given):
    said = "controller 'mine' must be copied for each run, but cannot be: TypeErr"
    end = "give its class, or set stateless = True on it if it remembers nothing"
    with pytest.raises(InvalidValueError, match=line(said, ..., end)):
        controller_of(given)
    assert controller_of(Locked).start().command(0.0, STATE, ASSUMED) == 1.0


class Policy:
    """Remembers nothing that changes an answer, and says so; a lock, which nothing copies."""

    stateless = True

    def __init__(self):
        self.lock = threading.Lock()

    def __call__(self, time, state, belief):
        return 3.0 * state[1] + time

    def act(self, time, state, belief):
        return self(time, state, belief)


def summing(time, state, belief):
    total = 0.0

    def add(x):
        nonlocal total
        total += x

    add(state[1])
    return total


STATELESS = {
    "function": lambda time, state, belief: 3.0 * state[1] + time,
    "partial": partial(lambda gain, time, state, belief: gain * state[1] + time, 3.0),
    "instance that says so": Policy(), "its method": Policy().act,
    "partial of it": partial(Policy()),
    "partial of constants": partial(
        lambda p, k, f, time, state, belief: k[0] * state[1] + time,
        type("OfFrozen", (afl.CartPoleParameters,), {})(), (3.0, None), max),
    "a variable that ends with the call": summing,
}  # fmt: skip


@pytest.mark.parametrize("given", STATELESS.values(), ids=list(STATELESS))
def test_what_remembers_nothing_runs_everywhere_and_is_used_as_it_is(smooth_scenario, given):
    own = controller_of(given)
    assert not own.stateful
    assert own.start().function is given or isinstance(given, partial)
    for mode in ("ode", "sampled") if isinstance(given, partial) else SIMULATORS:
        assert SIMULATORS[mode](smooth_scenario, given).outcome.kind == "fell"


def test_a_function_of_another_kind_remembers_nothing():
    class Library:
        push, pull = classmethod(lambda cls, time, state, belief: 1.0), staticmethod(paper)

    kinds = (lru_cache(paper), njit(lambda time, state, belief: 2.0 * state[0]), max, partial(max))
    given = (Library.push, Library().push, Library.pull, *kinds)
    assert [controller_of(one).stateful for one in given] == [False] * len(given)


COUNT = 0


def counting(time, state, belief):
    def more():
        global COUNT
        COUNT += 1

    more()
    return float(COUNT)


def enclosing():
    last = 0.0

    def force(time, state, belief):
        nonlocal last
        last = 0.9 * last + state[1]
        return last

    return force


@pytest.mark.parametrize(("given", "name"), [
    (counting, "COUNT"), (enclosing(), "last"),
    (partial(wraps(kept := lru_cache(counting))(lambda *of, kept=kept: kept(*of))), "COUNT"),
    (type("Mine", (), {"push": staticmethod(counting)}).push, "COUNT"),
], ids=["nested", "nonlocal", "decorated twice, in a partial", "of a class"])  # fmt: skip
def test_a_function_that_writes_what_outlives_it_is_refused(smooth_scenario, given, name):
    end = f"(it writes {name!r}, which outlives the call: make it a class)"
    said = line("controller 'mine' is stateful, which ", ..., end)
    with pytest.raises(InvalidValueError, match=said):
        afl.simulate_ode(smooth_scenario, controller_of(given))


REMEMBERING = """
import threading
class Mine:
    n = 0
    def __call__(self, time, state, belief):
        self.n += 1
        return self.n
class Policy:
    stateless = True
    lock = threading.Lock()
    def act(self, time, state, belief):
        return 2.0
act, method = Policy().act, Mine().__call__
"""


@pytest.mark.parametrize("name", ["Mine", "method", "act"])
def test_what_is_loaded_by_name_is_as_new_in_a_worker(module, name):
    module("loaded_mine", REMEMBERING)
    own, answer = afl.find_controller(f"loaded_mine:{name}"), 2.0 if name == "act" else 1.0
    for one in (own, own, twin := pickle.loads(pickle.dumps(own)), twin):
        assert one.start().command(0.0, STATE, ASSUMED) == answer
        assert one.stateful == (name != "act")
    assert name != "Mine" or twin.describe()["function"] == "loaded_mine.Mine"


def test_a_function_that_numba_has_compiled_is_a_controller_of_any_plant():
    compiled = njit(lambda time, x, belief: belief.cart_mass * (3.3 * x[0] - 64.0 * x[1]))
    scenario = replace(afl.SCENARIOS["step-step"], duration=0.3)
    run, reference = (afl.simulate_mujoco(scenario, x) for x in (compiled, compiled.py_func))
    np.testing.assert_allclose(run.state, reference.state, rtol=1e-12, atol=1e-12)
    hover = njit(lambda time, state, belief: (belief.gravity, 5.0))
    flight = afl.Scenario(name="s", plant=known("quadrotor_load.py:plant"), duration=0.01)
    assert afl.simulate_mujoco(flight, hover).input[0].tolist() == [9.81, 5.0]
