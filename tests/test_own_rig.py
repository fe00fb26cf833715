"""A rig with three controllers of one's own goes as an integration written from scratch.

It shares no code with the package. The equations are Lagrange's for a cart with a uniform rod, with
viscous friction on rail and hinge; the drive cuts the command off, delays it and lags it; the
sensors are encoders, of which the controllers get differences. Between the instants at which
anything changes SciPy's DOP853 integrates cart, pole and drive together.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.studies.shared.robustness import Settings
from afl_mujoco.studies.thresholds import Request
from afl_mujoco.studies.thresholds import run as find_thresholds

CART, POLE, HALF, GRAVITY = 3.2, 0.31, 0.42, 9.81
RAIL_DAMPING, HINGE_DAMPING = 4.0, 2e-3
PERIOD, DELAY, LAG, LIMIT = 0.005, 0.0073, 0.011, 60.0
STEPS = STEP_Z, STEP_PHI = 1e-4, 1e-3
START, DURATION = 0.15, 3.2
PUSH, BEGIN, LASTS = 20.0, 1.6, 0.1034


@dataclass(frozen=True, kw_only=True)
class Motion:
    time: np.ndarray
    state: np.ndarray
    force: np.ndarray
    command: np.ndarray
    fell: bool

    def rest(self, begin: float, end: float) -> float | None:
        """How long after `begin` z or phi last leaves 5 cm and 0.02 rad before `end`."""
        outside = (np.abs(self.state[:, 0]) > 0.05) | (np.abs(self.state[:, 1]) > 0.02)
        last = self.time[outside & (self.time >= begin) & (self.time <= end)]
        return None if len(last) and last[-1] > end - 0.01 else float(max([begin, *last])) - begin


def move(law, delay: float = DELAY, limit: float = LIMIT) -> Motion:
    sent = [(-1.0, 0.0)]  # when a command arrives at the drive, and it
    seen, x = None, np.array([0.0, START, 0.0, 0.0, 0.0])
    times, states, commands = [], [], []
    for tick in range(math.ceil(DURATION / PERIOD - 1e-9)):
        now, end = tick * PERIOD, min((tick + 1) * PERIOD, DURATION)
        position = np.round(x[:2] / STEPS) * STEPS
        rates = np.zeros(2) if seen is None else (position - seen) / PERIOD
        seen = position
        commands.append(law(now, np.concatenate([position, rates])))
        sent.append((now + delay, float(np.clip(commands[-1], -limit, limit))))
        cuts = sorted({t for t, _ in sent} | {BEGIN, BEGIN + LASTS} | {now, end})
        for first, last in pairwise(t for t in cuts if now <= t <= end):
            middle = 0.5 * (first + last)
            wanted = next(f for t, f in reversed(sent) if t <= middle)
            pushed = PUSH if BEGIN <= middle < BEGIN + LASTS else 0.0
            part = solve_ivp(
                _slopes, (first, last), x, method="DOP853", rtol=1e-9, atol=1e-11,
                args=(wanted, pushed), t_eval=np.linspace(first, last, 7),
            )  # fmt: skip
            times.append(part.t)
            states.append(part.y.T)
            x = part.y[:, -1]
        if fell := abs(x[1]) > 1.5:
            break
    state, time = np.concatenate(states), np.concatenate(times)
    made = {"state": state[:, :4], "force": state[:, 4], "command": np.array(commands)}
    return Motion(time=time, fell=fell, **made)


def _slopes(t: float, x: np.ndarray, wanted: float, pushed: float) -> list[float]:
    """Lagrange's equations solved for the accelerations, and the lag of the drive."""
    _, phi, v, w, force = x
    ml, sin, cos = POLE * HALF, math.sin(phi), math.cos(phi)
    mass = np.array([[CART + POLE, -ml * cos], [-ml * cos, 4.0 / 3.0 * ml * HALF]])
    cart = force + pushed - RAIL_DAMPING * v - ml * w * w * sin
    pole = ml * GRAVITY * sin - HINGE_DAMPING * w
    return [v, w, *np.linalg.solve(mass, [cart, pole]), (wanted - force) / LAG]


SCENARIO = afl.Scenario(
    name="own-rig", duration=DURATION, initial_state=(0.0, START, 0.0, 0.0),
    schedule={"cart_mass": CART, "half_length": HALF, "pole_mass": POLE},
    disturbances=(afl.ForcePulse(force=PUSH, start=BEGIN, duration=LASTS),),
    imperfections=afl.Imperfections(
        control_period=PERIOD, delay=DELAY, lag=LAG, input_limit=LIMIT,
        encoder_step={"z": STEP_Z, "phi": STEP_PHI}, differentiated=True,
        damping={"z": RAIL_DAMPING, "phi": HINGE_DAMPING},
    ),
    requirements=afl.Requirements(max={"force": 60.0, "force_command": 200.0},
                                  settling_time=1.5, recover_within=1.4),
)  # fmt: skip
GAINS = {
    "gentle": (9.0, -95.0, 17.0, -21.0), "firm": (14.0, -140.0, 24.0, -28.0),
    "greedy": (14.0, -420.0, 24.0, -42.0),
}  # fmt: skip


def law_of(name):
    gains = np.array(GAINS[name])

    def law(time, state, belief=None):
        return float(gains @ state)

    law.__name__ = name
    return law


@pytest.mark.parametrize("name", GAINS)
def test_states_forces_and_times_are_those_of_the_integration_from_scratch(name: str) -> None:
    """Encoders amplify round-off, a count at a time, so that the runs agree to a few counts."""
    mine, law = move(law_of(name)), law_of(name)
    run = afl.simulate_mujoco(SCENARIO, law)
    assert not mine.fell and run.outcome.kind == "completed"
    for column, most in ((0, 8.0 * STEP_Z), (1, 3.0 * STEP_PHI)):
        there = np.interp(run.time, mine.time, mine.state[:, column])
        assert np.abs(run.state[:, column] - there).max() <= most < 0.02 * np.ptp(there)
    most = [np.abs(x).max() for x in (mine.command, mine.force)]
    expected = [*most, float(np.trapezoid(mine.force**2, mine.time))]
    found = [run.metrics[name] for name in ("max_command", "max_force", "force_squared")]
    assert found == pytest.approx(expected, rel=0.02)
    limited = np.mean(np.abs(mine.command) >= LIMIT)
    assert run.metrics["limited_share"] == pytest.approx(limited, abs=0.01)
    assert (limited > 0.0) == (name == "greedy")
    (row,) = afl.compare(SCENARIO, law, draws=1).rows
    judged = {one.requirement: one.value for one in row.requirements}
    spans = {"settling_time": (0.0, BEGIN), "recover_within": (BEGIN + LASTS, DURATION)}
    for key, span in spans.items():
        expected = mine.rest(*span)
        assert judged[key] == (expected and pytest.approx(expected, abs=0.03))


@pytest.mark.slow
def test_thresholds_of_delay_and_limit_are_those_of_the_integration_from_scratch() -> None:
    free = replace(SCENARIO, requirements=afl.Requirements())
    own = PythonController(name="firm", function=law_of("firm"))
    settings = Settings(seeds=1, scan=5, tolerance=0.06)
    found = find_thresholds(Request([own], (free,), settings, ("delay", "input_limit")))
    for name, field, worse in (("delay", "delay", 1.1), ("input_limit", "limit", 1.0 / 1.1)):
        level = found.sweep(name, "firm").survives.fails_at
        falls = [move(law_of("firm"), **{field: x}).fell
                 for x in (level / worse, level * worse)]  # fmt: skip
        assert falls == [False, True], name
