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


@dataclass(frozen=True, kw_only=True)
class Rig:
    cart: float = 3.2
    pole: float = 0.31
    half: float = 0.42
    gravity: float = 9.81
    rail_damping: float = 4.0
    hinge_damping: float = 2e-3
    period: float = 0.005
    delay: float = 0.0073
    lag: float = 0.011
    limit: float = 60.0
    step_z: float = 1e-4
    step_phi: float = 1e-3
    start: float = 0.15
    push: tuple[float, float, float] = (20.0, 1.6, 0.1034)
    duration: float = 3.2


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


def move(rig: Rig, law) -> Motion:
    begin, lasts = rig.push[1:]
    sent = [(-1.0, 0.0)]  # when a command arrives at the drive, and it
    seen, x = None, np.array([0.0, rig.start, 0.0, 0.0, 0.0])
    times, states, commands = [], [], []
    for tick in range(math.ceil(rig.duration / rig.period - 1e-9)):
        now, end = tick * rig.period, min((tick + 1) * rig.period, rig.duration)
        position = np.round(x[:2] / (rig.step_z, rig.step_phi)) * (rig.step_z, rig.step_phi)
        rates = np.zeros(2) if seen is None else (position - seen) / rig.period
        seen = position
        commands.append(law(now, np.concatenate([position, rates])))
        sent.append((now + rig.delay, float(np.clip(commands[-1], -rig.limit, rig.limit))))
        cuts = sorted({t for t, _ in sent} | {begin, begin + lasts} | {now, end})
        for first, last in pairwise(t for t in cuts if now <= t <= end):
            middle = 0.5 * (first + last)
            wanted = next(f for t, f in reversed(sent) if t <= middle)
            pushed = rig.push[0] if begin <= middle < begin + lasts else 0.0
            part = solve_ivp(
                _slopes, (first, last), x, method="DOP853", rtol=1e-9, atol=1e-11,
                args=(rig, wanted, pushed), t_eval=np.linspace(first, last, 7),
            )  # fmt: skip
            times.append(part.t)
            states.append(part.y.T)
            x = part.y[:, -1]
        if fell := abs(x[1]) > 1.5:
            break
    state, time = np.concatenate(states), np.concatenate(times)
    made = {"state": state[:, :4], "force": state[:, 4], "command": np.array(commands)}
    return Motion(time=time, fell=fell, **made)


def _slopes(t: float, x: np.ndarray, rig: Rig, wanted: float, pushed: float) -> list[float]:
    """Lagrange's equations solved for the accelerations, and the lag of the drive."""
    _, phi, v, w, force = x
    ml, sin, cos = rig.pole * rig.half, math.sin(phi), math.cos(phi)
    mass = np.array([[rig.cart + rig.pole, -ml * cos], [-ml * cos, 4.0 / 3.0 * ml * rig.half]])
    cart = force + pushed - rig.rail_damping * v - ml * w * w * sin
    pole = ml * rig.gravity * sin - rig.hinge_damping * w
    return [v, w, *np.linalg.solve(mass, [cart, pole]), (wanted - force) / rig.lag]


RIG = Rig()
SCENARIO = afl.Scenario(
    name="own-rig", duration=RIG.duration, initial_state=(0.0, RIG.start, 0.0, 0.0),
    schedule={"cart_mass": RIG.cart, "half_length": RIG.half, "pole_mass": RIG.pole},
    disturbances=(afl.ForcePulse(force=RIG.push[0], start=RIG.push[1], duration=RIG.push[2]),),
    imperfections=afl.Imperfections(
        control_period=RIG.period, delay=RIG.delay, lag=RIG.lag, input_limit=RIG.limit,
        encoder_step={"z": RIG.step_z, "phi": RIG.step_phi}, differentiated=True,
        damping={"z": RIG.rail_damping, "phi": RIG.hinge_damping},
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
    mine, law = move(RIG, law_of(name)), law_of(name)
    run = afl.simulate_mujoco(SCENARIO, law)
    assert not mine.fell and run.outcome.kind == "completed"
    for column, most in ((0, 8.0 * RIG.step_z), (1, 3.0 * RIG.step_phi)):
        there = np.interp(run.time, mine.time, mine.state[:, column])
        assert np.abs(run.state[:, column] - there).max() <= most < 0.02 * np.ptp(there)
    most = [np.abs(x).max() for x in (mine.command, mine.force)]
    expected = [*most, float(np.trapezoid(mine.force**2, mine.time))]
    found = [run.metrics[name] for name in ("max_command", "max_force", "force_squared")]
    assert found == pytest.approx(expected, rel=0.02)
    limited = np.mean(np.abs(mine.command) >= RIG.limit)
    assert run.metrics["limited_share"] == pytest.approx(limited, abs=0.01)
    assert (limited > 0.0) == (name == "greedy")
    (row,) = afl.compare(SCENARIO, law, draws=1).rows
    judged = {one.requirement: one.value for one in row.requirements}
    _, begin, lasts = RIG.push
    spans = {"settling_time": (0.0, begin), "recover_within": (begin + lasts, RIG.duration)}
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
        falls = [move(replace(RIG, **{field: x}), law_of("firm")).fell
                 for x in (level / worse, level * worse)]  # fmt: skip
        assert falls == [False, True], name
