"""The checks: equations without a loop (A1 to A3, A7), closed loops (A5, B1 to B3), references."""

from __future__ import annotations

import math
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.control.controller import Controller
from afl_mujoco.control.gains import FIXED_GAINS
from afl_mujoco.control.law import control_force
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.plants.cartpole_equations import (
    cart_acceleration,
    mass_matrix,
    pole_acceleration,
    velocity_jump,
)
from afl_mujoco.plants.library import write_row
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.parameters import NOMINAL, CartPoleParameters
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import staircase
from afl_mujoco.scenario.time_steps import held_disturbances
from afl_mujoco.simulation.integrator import rk4_step, work_space
from afl_mujoco.simulation.mujoco_model import SimulatedModel, impulse_jump, write_state
from afl_mujoco.simulation.mujoco_rollout import MODES, momenta, simulate_mujoco
from afl_mujoco.simulation.ode import simulate_ode
from afl_mujoco.simulation.ode_fixed_step import held_steps
from afl_mujoco.simulation.trajectory import COMPLETED, TIPPED, Trajectory
from afl_mujoco.studies.verify.convergence import Study, difference, free_swing_study, last_state

ANY = "any"  # scenario and controller of a check that depends on neither


@dataclass(frozen=True, slots=True)
class Criterion:
    """A quantity and the largest value that passes; a value that is not finite fails."""

    id: str
    unit: str
    limit: float
    quantity: str  # what is measured
    reason: str  # why this limit
    proves: str  # what a value within the limit proves, and what it leaves open
    leaves_open: str

    def judge(self, value: float, scenario: str = ANY, controller: str = ANY) -> Check:
        """Return the check of a measured value."""
        finite = math.isfinite(value)
        return Check(
            id=self.id,
            scenario=scenario,
            controller=controller,
            quantity=self.quantity,
            unit=self.unit,
            value=float(value) if finite else None,
            limit=self.limit,
            comparison="<=",
            passed=finite and value <= self.limit,
            reason=self.reason,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One judged value: a row of report.json, field for field."""

    id: str
    scenario: str
    controller: str
    quantity: str
    unit: str
    value: float | None  # None if it is not finite, as where one run fell and the other did not
    limit: float
    comparison: str
    passed: bool
    reason: str

    def __post_init__(self) -> None:
        if self.passed != (self.value is not None and self.value <= self.limit):
            raise ValueError(f"passed must follow from value and limit, got {self.passed}")
        if self.id not in CRITERIA:
            raise ValueError(f"check must be one of {', '.join(CRITERIA)}, got {self.id!r}")

    @property
    def rank(self) -> float:
        """How close it is to its limit or beyond it, among checks of one criterion."""
        return math.inf if self.value is None else self.value


def judged(values: Mapping[str, float], scenario: str, controller: str) -> tuple[Check, ...]:
    """Return the checks of measured values by id, in the order of the criteria."""
    known = [CRITERIA[id] for id in CRITERIA if id in values]
    return tuple(one.judge(values[one.id], scenario, controller) for one in known)


_TEXT = Path(__file__).with_name("criteria.toml").read_text(encoding="utf-8")
CRITERIA: Mapping[str, Criterion] = MappingProxyType(
    {id: Criterion(id=id, **one) for id, one in tomllib.loads(_TEXT).items()}
)
"""Every criterion by its id, in the order of the report; last those of another plant alone."""

# --- equations ------------------------------------------------------------------------------------

STATES = 10_000
PLANTS = 100
_LOW = {"cart_mass": 0.1, "pole_mass": 0.01, "half_length": 0.05, "gravity": 1.0}
_HIGH = {"cart_mass": 2.0, "pole_mass": 0.5, "half_length": 1.0, "gravity": 20.0}


def equation_checks(seed: int = 0) -> tuple[Check, ...]:
    """Run A1, A2, A3 and A7."""
    exact, shifted = asymmetry(np.random.default_rng([seed, 7]))
    return (
        CRITERIA["A1"].judge(acceleration_error(np.random.default_rng([seed, 1]))),
        CRITERIA["A2"].judge(mass_matrix_error(np.random.default_rng([seed, 2]))),
        CRITERIA["A3"].judge(stale_numbers(np.random.default_rng([seed, 3]))),
        CRITERIA["A7"].judge(exact),
        CRITERIA["A7z"].judge(shifted),
    )


def random_plant(rng: np.random.Generator) -> CartPoleParameters:
    """Return a plant drawn from the whole box of parameters."""
    return CartPoleParameters(**{key: rng.uniform(_LOW[key], _HIGH[key]) for key in _LOW})


_numbers = attrgetter(*_LOW)


def _changes(model: SimulatedModel, plants: Sequence[CartPoleParameters]) -> Iterator[None]:
    """Make the model each of some plants in turn."""
    at = model.addresses
    for row in model.rows(np.array([_numbers(p) for p in plants])):
        write_row(at.structures, at.targets, row)
        yield


def _draws(rng: np.random.Generator, count: int, steepest: float) -> list[Any]:
    ends = (10.0, steepest, 10.0, 10.0)
    return [
        (random_plant(rng), rng.uniform(-1.0, 1.0, 4) * ends, rng.uniform(-200.0, 200.0))
        for _ in range(count)
    ]


def acceleration_error(rng: np.random.Generator, states: int = STATES) -> float:
    """Return the largest scaled difference between MuJoCo's qacc and (P3), (P4)."""
    model, draws = SimulatedModel(CART_POLE), _draws(rng, states, np.pi)
    worst = 0.0
    changes = _changes(model, [p for p, *_ in draws])
    for (p, state, force), _ in zip(draws, changes, strict=True):
        measured = model.accelerations(state, force)
        _, phi, _, phi_dot = state
        both = (cart_acceleration, pole_acceleration)
        expected = np.array([of(phi, phi_dot, force, *_numbers(p)) for of in both])
        error = np.abs(measured - expected) / (1.0 + np.abs(expected))
        worst = max(worst, float(error.max())) if np.isfinite(error).all() else np.inf
    return worst


def mass_matrix_error(rng: np.random.Generator, states: int = 1000) -> float:
    """Return the largest relative error of MuJoCo's mass matrix, and of the jump by an impulse."""
    model = SimulatedModel(CART_POLE)
    draws = [(random_plant(rng), rng.uniform(-np.pi, np.pi)) for _ in range(states)]
    jumped, worst = np.empty(2), 0.0
    changes = _changes(model, [p for p, _ in draws])
    for (p, phi), _ in zip(draws, changes, strict=True):
        state = np.array([0.0, phi, 0.0, 0.0])
        columns = [momenta(model, np.array([*state[:2], *unit])) for unit in np.eye(2)]
        expected = mass_matrix(state, p)
        error = np.abs(np.stack(columns, axis=1) - expected) / np.abs(expected).max()
        write_state(model.addresses, state)
        impulse_jump(model.addresses, np.array([1.0, 0.0]), jumped)
        jump = velocity_jump(state, 1.0, p)
        jump_error = np.abs(jumped - jump).max() / np.abs(jump).max()
        worst = max(worst, float(error.max()), float(jump_error))
    return worst


def asymmetry(rng: np.random.Generator, states: int = 1000) -> tuple[float, float]:
    """Return how far mirrored or scaled, and shifted, motions are from symmetric."""
    model, draws = SimulatedModel(CART_POLE), _draws(rng, states, 1.5)
    plants = [p for p, *_ in draws]
    twice = [replace(p, cart_mass=2 * p.cart_mass, pole_mass=2 * p.pole_mass) for p in plants]
    as_drawn, heavier = _changes(model, plants), _changes(model, twice)
    exact = shift = 0.0
    for p, state, force in draws:
        next(as_drawn)
        here, mirrored, shifted = (
            model.accelerations(x, u)
            for x, u in ((state, force), (-state, -force), (state + np.eye(4)[0], force))
        )
        next(heavier)
        scaled = model.accelerations(state, 2.0 * force)
        odd = control_force(state, p, FIXED_GAINS) + control_force(-state, p, FIXED_GAINS)
        exact = max(exact, float(np.abs([here + mirrored, here - scaled]).max()), float(abs(odd)))
        shift = max(shift, float((np.abs(here - shifted) / (1.0 + np.abs(here))).max()))
    return exact, shift


def stale_numbers(rng: np.random.Generator, plants: int = PLANTS) -> int:
    """Count the numbers in which a mutated model, or its qacc, differs from a fresh compile."""
    mutated = SimulatedModel(CART_POLE, edit=add_passive_physics)
    stale = 0
    for _ in range(plants):
        values = np.array(_numbers(random_plant(rng)))
        mutated.write(values)
        fresh = mutated.writer.compile(mutated.rows(values)[0])
        stale += differing_numbers(mutated.mj_model, fresh)
        state = rng.uniform(-1.0, 1.0, 4) * (1.2, np.pi, 5.0, 5.0)
        there = _qacc(mutated.mj_model, mutated.mj_data, state)
        stale += int(np.sum(there != _qacc(fresh, mujoco.MjData(fresh), state)))
    return stale


def differing_numbers(one: mujoco.MjModel, other: mujoco.MjModel) -> int:
    """Count the elements in which the arrays of two models differ; `stat` is left out."""
    count = 0
    for owner, twin in ((one, other), (one.opt, other.opt)):
        for name in dir(owner):
            array = getattr(owner, name)
            if not name.startswith("_") and isinstance(array, np.ndarray):
                count += int(np.sum(array != getattr(twin, name)))
    return count


def add_passive_physics(spec: mujoco.MjSpec) -> None:
    """Add friction, limits and contact, which reveal stale derived constants."""
    for name, reach in (("z", 1.0), ("phi", 2.5)):
        joint = spec.joint(name)
        joint.frictionloss, joint.damping, joint.armature = 0.05, [0.02, 0.0, 0.0], 0.001
        joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, [-reach, reach]
    pole = spec.geom("pole")
    pole.contype = pole.conaffinity = 1
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    place = {"size": [10, 10, 0.1], "pos": [0, 0, -0.3]}
    spec.worldbody.add_geom(name="ground", type=plane, contype=1, conaffinity=1, **place)


def _qacc(model: mujoco.MjModel, data: mujoco.MjData, state: Floats) -> Floats:
    """Return MuJoCo's accelerations at a state, solved from a cold start."""
    mujoco.mj_resetData(model, data)
    data.qpos, data.qvel, data.ctrl = state[:2], state[2:], 3.0
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)


# --- closed loops ---------------------------------------------------------------------------------

B2_CONTROLLERS, B2_TIMESTEP = ("fixed", "adaptive"), 1e-3
"""Where B2 is judged: its limit is for RK4's error at 1 ms under the paper's two controllers."""


def closed_loop_checks(
    scenario: Scenario, controller: Controller, runs: Mapping[str, Trajectory]
) -> tuple[Check, ...]:
    """Judge the runs of one scenario and controller."""
    values = {
        "A5": one_step_difference(scenario, runs["mujoco sampled"]),
        "B1": state_difference(runs["mujoco exact"], runs["ode"]),
        "B2b": state_difference(runs["mujoco continuous"], runs["ode RK4"]),
        "B3": state_difference(runs["mujoco sampled"], runs["ode held"]),
    }
    timestep = runs["mujoco continuous"].provenance["settings"]["timestep"]
    if controller.name in B2_CONTROLLERS and timestep == B2_TIMESTEP:
        values["B2"] = state_difference(runs["mujoco continuous"], runs["ode"])
    return judged(values, scenario.name, controller.name)


def state_difference(one: Trajectory, other: Trajectory) -> float:
    """Return the largest difference of any state at any instant that both runs report.

    The difference is infinite if the runs did not end the same way, or leave nothing to compare.
    If both fell, they are compared up to `TIPPED`: beyond it the controller amplifies round-off.
    """
    if one.outcome.kind != other.outcome.kind:
        return math.inf
    count = min(len(one.time), len(other.time))
    if one.outcome.kind == COMPLETED and len(one.time) != len(other.time):
        return math.inf
    if not np.allclose(one.time[:count], other.time[:count], rtol=0.0, atol=1e-9):
        return math.inf
    difference = np.abs(one.state[:count] - other.state[:count])
    if one.outcome.kind != COMPLETED:
        steep = np.abs(one.state[:count, 1]) > TIPPED
        difference = difference[: int(np.argmax(steep)) if steep.any() else count]
    return float(difference.max()) if difference.size else math.inf


def one_step_difference(scenario: Scenario, run: Trajectory, sizes: Floats | float = 1.0) -> float:
    """Compare steps without jumps or rates, each state by its size, to textbook RK4 steps."""
    middles = 0.5 * (run.time[:-1] + run.time[1:])
    disturbed = held_disturbances(scenario, run.time)
    struck = np.asarray(disturbed.impulse.any(axis=1))
    # one at the start of a step is in the state there, at the end of the step before
    jumped = np.logical_and(struck, disturbed.split > 0.0)
    jumped[:-1] |= np.logical_and(struck[1:], disturbed.split[1:] <= 0.0)
    events = np.searchsorted(middles, [*scenario.events]) - 1
    jumped[events[(events >= 0) & (events < len(jumped))]] = True
    jumped |= scenario.acting_rates(middles).any(axis=1)  # their forces are held over a step
    after = held_steps(scenario, run)
    gap = (np.abs(run.state[1:] - after) / sizes)[~jumped]
    return float(gap.max(initial=0.0)) if np.isfinite(gap).all() else math.inf


# --- references and methods -----------------------------------------------------------------------

RK4_STEPS = (8e-3, 4e-3, 2e-3, 1e-3)
EULER_STEPS = (4e-3, 2e-3, 1e-3, 5e-4)
MANUFACTURED_STEPS = (2e-2, 1e-2, 5e-3, 2.5e-3)
MANUFACTURED_DURATION = 2.0
SHORT_DURATION = 0.6

_SHORT = replace(
    SCENARIOS["step-trapezoid"],
    schedule={**SCENARIOS["step-trapezoid"].schedule, "cart_mass": staircase((0.3,), (0.5, 1.0))},
    duration=SHORT_DURATION,
)


def reference_checks() -> tuple[Check, ...]:
    """Run A4, A8 and A10."""
    study, exactness = manufactured_study()
    return (
        CRITERIA["A4"].judge(free_swing_study("RK4", RK4_STEPS).deviation(4.0)),
        CRITERIA["A4e"].judge(free_swing_study("Euler", EULER_STEPS).deviation(1.0)),
        CRITERIA["A8"].judge(second_method_difference()),
        CRITERIA["A8m"].judge(study.deviation(4.0)),
        CRITERIA["A8x"].judge(exactness),
        CRITERIA["A10"].judge(differing_runs()),
    )


def second_method_difference() -> float:
    """Return the largest difference between DOP853 and Radau on a closed loop with a jump."""
    controller = CONTROLLERS["adaptive"]
    explicit = simulate_ode(_SHORT, controller, sample_period=0.05)
    implicit = simulate_ode(
        _SHORT, controller, sample_period=0.05, method="Radau", rtol=1e-11, atol=1e-13
    )
    return difference(explicit, implicit)


def differing_runs() -> int:
    """Return how many runs differ in any bit when repeated here and in a fresh process."""
    path = f"import sys; sys.path[:] = {sys.path!r}"  # no other module than here
    script = f"{path}; from {__name__} import run_digests; print(*run_digests())"
    command = [sys.executable, "-P", "-c", script]
    fresh = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    repeats = zip(run_digests(), run_digests(), fresh, strict=True)
    return sum(len(set(digests)) > 1 for digests in repeats)


def run_digests() -> tuple[str, ...]:
    """Return the SHA-256 of states and forces of one run in each simulator."""
    controller = CONTROLLERS["adaptive"]
    runs = [simulate_mujoco(_SHORT, controller, mode) for mode in MODES]
    return tuple(
        sha256(run.state.tobytes() + run.force.tobytes()).hexdigest()
        for run in (simulate_ode(_SHORT, controller), *runs)
    )


def manufactured(time: float) -> tuple[Floats, tuple[float, float], Floats]:
    """Return the manufactured motion: state, (M, l) and (z'', phi'') at a time."""
    z, phi = 0.3 * np.sin(time), 0.5 * np.cos(1.3 * time)
    z_dot, phi_dot = 0.3 * np.cos(time), -0.65 * np.sin(1.3 * time)
    plant = 1.0 + 0.5 * np.sin(time), 0.5 + 0.2 * np.sin(0.7 * time)
    second = np.array([-z, -1.69 * phi])
    return np.array([z, phi, z_dot, phi_dot]), plant, second


def required_forces(time: float) -> tuple[float, float]:
    """Return the forces on z [N] and phi [N m] that (P2) and (P1) need for that motion."""
    (_, phi, _, phi_dot), (mass, length), (z_ddot, phi_ddot) = manufactured(time)
    m, g, sin, cos = NOMINAL.pole_mass, NOMINAL.gravity, np.sin(phi), np.cos(phi)
    force = (mass + m) * z_ddot - m * length * (phi_ddot * cos - phi_dot**2 * sin)
    inertia = 4.0 / 3.0 * m * length**2 * phi_ddot
    torque = inertia - m * length * z_ddot * cos - m * g * length * sin
    return float(force), float(torque)


def manufactured_study() -> tuple[Study, float]:
    """Return RK4's and DOP853's errors around MuJoCo's dynamics on the manufactured motion."""
    model, work = SimulatedModel(CART_POLE), work_space(4)

    def rate(time: float, state: Floats) -> Floats:
        _, (mass, length), _ = manufactured(time)
        model.write(np.array([mass, NOMINAL.pole_mass, length, NOMINAL.gravity]))
        force, torque = required_forces(time)
        return np.array([*state[2:], *model.accelerations(state, force, (0.0, torque))])

    def rates(_: None, time: float, state: Floats, slopes: Any) -> None:
        slopes[:] = rate(time, state)

    start, end = manufactured(0.0)[0], manufactured(MANUFACTURED_DURATION)[0]
    errors = []
    for h in MANUFACTURED_STEPS:
        state = start.copy()
        for k in range(round(MANUFACTURED_DURATION / h)):
            rk4_step(rates, None, k * h, h, state, work, state)
        errors.append(float(np.abs(state - end).max()))
    exactness = float(np.abs(last_state(rate, start, MANUFACTURED_DURATION) - end).max())
    return Study(MANUFACTURED_STEPS, tuple(errors)), exactness
