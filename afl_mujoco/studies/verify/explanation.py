"""Why runs differ by as much as they do: error budget (B5), ledger (A6), B2o, B4, B6, B7."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from afl_mujoco.control.catalogue import CONTROLLERS
from afl_mujoco.control.controller import Controller
from afl_mujoco.plants.cartpole_equations import linear_momentum, plant, terms, total_energy
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.scenario.time_steps import time_grid
from afl_mujoco.simulation.integrator import along_z, integrate, scipy_solver
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.mujoco_rollout import closed_loop, momenta, simulate_mujoco, transition
from afl_mujoco.simulation.ode_fixed_step import Holds, simulate_ode_held
from afl_mujoco.simulation.simulate import simulate_ode
from afl_mujoco.simulation.trajectory import COMPLETED, Trajectory, criterion_of
from afl_mujoco.studies.shared.arrays import Array
from afl_mujoco.studies.shared.run import Run
from afl_mujoco.studies.verify.cases import Simulated
from afl_mujoco.studies.verify.checks import CRITERIA, Check, judged, state_difference
from afl_mujoco.studies.verify.convergence import (
    STEPS,
    continuous_study,
    sampled_study,
    schedule_study,
    studied,
)

# --- the error budget ---------------------------------------------------------------------------

SUBSTEPS = 2  # RK4 steps in each held step of the parts: their errors cancel in the differences

SOURCES: Mapping[str, str] = {
    "control_hold": "inputs held",
    "schedule_sampling": "parameters frozen over a step",
    "disturbance_timing": "disturbance moved to the steps",
    "integrator": "MuJoCo's integrator",
    "model_form": "model form",
}
"""The sources of the difference, in words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """A difference from the ideal ODE, and what each source alone contributes."""

    total: float  # sampled mode against the ODE
    model_form: float  # MuJoCo's dynamics against the analytic ones, under one integrator
    integrator: float  # MuJoCo's steps against the exact solution with the same holds
    control_hold: float  # the force held over each control period
    schedule_sampling: float  # M and l frozen over each step at the values of its middle
    disturbance_timing: float  # pulses and impulses moved to the steps
    residual: float  # the total minus the sum of the parts


@dataclass(frozen=True, slots=True, kw_only=True)
class AtWorst(Parts):
    """The signed difference where it is largest: there the parts and the residual add up to it."""

    state: str  # its name
    unit: str
    time: float  # [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorBudget(Parts):
    """Each the largest of any state at any instant [m, rad, m/s, rad/s]."""

    scenario: str
    controller: str
    at_worst: AtWorst

    @property
    def residual_share(self) -> float:
        """The residual as a share of the total; 0 if there is no difference at all."""
        return self.residual / self.total if self.total else 0.0


def error_budget(
    scenario: Scenario,
    controller: Controller,
    runs: Mapping[str, Trajectory],
    substeps: int = SUBSTEPS,
) -> ErrorBudget | None:
    """Return the budget of a case from its runs; None if one did not reach its end."""
    if any(run.outcome.kind != COMPLETED for run in runs.values()):
        return None
    settings = runs["mujoco sampled"].provenance["settings"]
    times, period = runs["mujoco sampled"].time, settings["control_period"]

    def part(**holds: Any) -> Trajectory:
        how: Any = {"timestep": settings["timestep"], "holds": Holds(**holds)}
        return simulate_ode_held(scenario, controller, **how, substeps=substeps)

    followed = part()
    changes = any(schedule.breakpoints for schedule in scenario.schedule.values())
    held = {
        "control_hold": part(control_period=period),
        "schedule_sampling": part(schedule=True) if changes else followed,
        "disturbance_timing": part(disturbance=True) if scenario.disturbances else followed,
    }
    every = {**runs, **held, "followed": followed}
    rows = {name: np.searchsorted(run.time, times - 1e-9) for name, run in every.items()}
    if any(rows[name][-1] >= len(run.time) for name, run in every.items()):
        return None
    at = {name: run.state[rows[name]] for name, run in every.items()}
    total = at["mujoco sampled"] - at["ode"]
    parts = {
        "model_form": at["mujoco exact"] - at["ode"],
        "integrator": at["mujoco sampled"] - at["ode held"],
        **{name: at[name] - at["followed"] for name in held},
    }
    curves = {"total": total, **parts, "residual": total - sum(parts.values())}
    row, column = np.unravel_index(np.abs(curves["total"]).argmax(), curves["total"].shape)
    signed = {name: float(curve[row, column]) for name, curve in curves.items()}
    state, units = scenario.plant.states[column], scenario.plant.units
    return ErrorBudget(
        scenario=scenario.name,
        controller=controller.name,
        at_worst=AtWorst(state=state, unit=units[state], time=float(times[row]), **signed),
        **{name: float(np.abs(curve).max()) for name, curve in curves.items()},
    )


# --- the ledger of energy and momentum ------------------------------------------------------------

SAMPLE_PERIOD = 0.1  # spacing of the instants at which the ledger is closed [s]
_WORK, _RAMP_ENERGY, _IMPULSE, _RAMP_MOMENTUM, _JUMP_ENERGY, _JUMP_MOMENTUM = range(4, 10)


def ledger(scenario: Scenario, controller: Controller) -> tuple[float, float]:
    """Return the energy [J] and momentum [N s] that MuJoCo gained and nothing accounts for."""
    model = SimulatedModel(scenario.plant, edit=_measure_energy)
    rate = closed_loop(model, scenario, controller)
    arrive = transition(model, scenario)

    def derivative(time: float, state: Floats, segment: Segment) -> Sequence[float]:
        motion = rate(time, state, segment)
        force = float(model.mj_data.ctrl[0] + model.mj_data.qfrc_applied[0])
        energy, momentum = _ramp_power(scenario, state, time, segment)
        return (*motion, force * state[2], energy, force, momentum, 0.0, 0.0)

    def book(state: Floats, before: Segment | None, after: Segment) -> Floats:
        arrived = arrive(state, before, after)
        new = _parameters(scenario, after, after.start)
        was, now = state[:4], arrived[:4]
        if before is not None:
            old = _parameters(scenario, before, before.end)
            arrived[_JUMP_ENERGY] += total_energy(was, new) - total_energy(was, old)
            arrived[_JUMP_MOMENTUM] += linear_momentum(was, new) - linear_momentum(was, old)
        arrived[_WORK] += total_energy(now, new) - total_energy(was, new)
        arrived[_IMPULSE] += along_z(after.impulse)
        return arrived

    def measured(time: float, state: Floats) -> tuple[float, float]:
        model.write(scenario.values_at(time))
        momentum = momenta(model, state[:4])  # MuJoCo computes the energy there too
        return float(model.mj_data.energy.sum()), float(momentum[0])

    times = time_grid(scenario, SAMPLE_PERIOD)
    criterion, nodes = criterion_of(scenario), controller.nodes_within(scenario.spans)
    solver = scipy_solver(derivative, criterion)
    states, _ = integrate(scenario, solver, book, times, nodes=nodes, quadratures=6)
    accounts = [_WORK, _RAMP_ENERGY, _JUMP_ENERGY], [_IMPULSE, _RAMP_MOMENTUM, _JUMP_MOMENTUM]
    booked = np.stack([states[:, one].sum(axis=1) for one in accounts], axis=1)
    held = np.array([measured(t, x) for t, x in zip(times.tolist(), states, strict=False)])
    energy, momentum = np.abs(held - held[0] - booked).max(axis=0).tolist()
    return energy, momentum


def _ramp_power(
    scenario: Scenario, state: Floats, time: float, segment: Segment
) -> tuple[float, float]:
    """Return what the ramps add per second to energy [W] and momentum [N] at fixed velocities."""
    _, phi, z_dot, phi_dot = state[:4].tolist()
    _, m, length, gravity = segment.values_at(time).tolist()
    (_, mass_rate), _, (_, length_rate), _ = segment.lines
    cos = float(np.cos(phi))
    by_length = m * (4.0 / 3.0 * length * phi_dot**2 - z_dot * phi_dot * cos + gravity * cos)
    energy = 0.5 * z_dot**2 * mass_rate + by_length * length_rate
    return energy, z_dot * mass_rate - m * phi_dot * cos * length_rate


def _parameters(scenario: Scenario, segment: Segment, time: float) -> CartPoleParameters:
    """Return the plant at a time of a segment, the limit from inside it."""
    values = segment.values_at(time).tolist()
    return CartPoleParameters(**dict(zip(scenario.schedule, values, strict=True)))


def _measure_energy(spec: mujoco.MjSpec) -> None:
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY


# --- orders, omissions, all of a case -------------------------------------------------------------

CAPSULE_EXCESS = 0.13
"""Relative excess of the inertia of the drawn capsule over that of the slender rod."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Omission:
    """What frozen M and l leave out (decision D9): change of any state, None if one fell."""

    scenario: str
    controller: str
    stretching_rod: float | None  # of the terms in the rate of l, velocities kept at steps
    momenta_kept: float | None  # of momenta kept at steps instead, M and l frozen otherwise


SPARSE = 0.02  # spacing of the instants of a replay [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """How far the two codes are apart after a whole run, beside how much any difference grows."""

    scenario: str
    controller: str
    difference: float | None  # of any state at any instant; None if one fell and the other did not
    amplification: float | None  # of a small change of the initial state


class Judged(NamedTuple):
    """What is found of one case."""

    checks: tuple[Check, ...]
    runs: tuple[Simulated, ...]
    row: Run
    moving: tuple[Array, Array]  # the run as deployed on the ideal loop, for its replay
    budget: ErrorBudget | None = None
    omission: Omission | None = None
    growth: Growth | None = None  # of another plant than the cart-pole


def moving(run: Trajectory) -> tuple[Array, Array]:
    """Return instants [s] and states of a run that are enough to replay it, its last among them."""
    kept = np.diff(np.floor(run.time / SPARSE + 1e-6), prepend=-1.0) > 0.0
    kept[-1] = True
    return run.time[kept], run.state[kept]


def explain(
    scenario: Scenario, controller: Controller, runs: Mapping[str, Trajectory], *, full: bool
) -> tuple[tuple[Check, ...], ErrorBudget | None, Omission | None]:
    """Explain the runs of one case: by the error budget, in full by all that this file has."""
    if any(run.outcome.kind != COMPLETED for run in runs.values()):
        return (), None, None
    names, budget = (scenario.name, controller.name), error_budget(scenario, controller, runs)
    values = {} if budget is None else {"B5": budget.residual_share}
    if not full:
        return judged(values, *names), budget, None
    part = studied(scenario)
    reference = simulate_ode(part, controller, sample_period=STEPS[0])
    sampled, residue = sampled_study(part, controller, reference)
    continuous = continuous_study(part, controller, reference)
    schedule = schedule_study(part, controller)
    orders = {"B2o": (continuous, 4.0), "B4": (sampled, 1.0), "B4s": (schedule, 2.0)}
    energy, momentum = ledger(part, controller)
    agreement, omission = _omission(part, controller)
    values |= {
        "A6e": energy,
        "A6p": momentum,
        "B4r": residue,
        "B6": continuous.reduction,
        "B7": agreement,
        **{id: one.deviation(order) for id, (one, order) in orders.items() if one is not None},
    }
    return judged(values, *names), budget, omission


def _omission(scenario: Scenario, controller: Controller) -> tuple[float, Omission]:
    """Return how far both sides agree on what the paper omits, and how much it matters."""
    h = STEPS[0]

    def case(**acting: Any) -> Scenario:
        own = dict(plant.parameters)
        own["cart_mass"] = replace(own["cart_mass"], jump=acting.get("jump", "velocities"))
        own["half_length"] = replace(own["half_length"], **acting)
        changed = replace(plant, name="changing", parameters=own, accelerations=None, terms=terms)
        return replace(scenario, plant=changed)

    frozen = simulate_ode(case(), controller, sample_period=h)

    def matters(**acting: Any) -> float | None:
        changed = simulate_ode(case(**acting), controller, sample_period=h)
        found = state_difference(changed, frozen)
        return found if math.isfinite(found) else None

    whole = case(rate="enters", jump="momenta")
    exact = simulate_mujoco(whole, controller, "exact", timestep=h)
    return state_difference(exact, simulate_ode(whole, controller, sample_period=h)), Omission(
        scenario=scenario.name,
        controller=controller.name,
        stretching_rod=matters(rate="enters"),
        momenta_kept=matters(jump="momenta"),
    )


def plateau_check() -> Check:
    """Run B6d: the plateau test on a model that is different on purpose."""
    scenario, controller = studied(SCENARIOS["nominal"]), CONTROLLERS["fixed"]
    excess = CAPSULE_EXCESS * scenario.pole_mass * scenario.half_length.at(0.0) ** 2 / 3.0

    def thicken(spec: mujoco.MjSpec) -> None:
        spec.joint("phi").armature = excess

    reference = simulate_ode(scenario, controller, sample_period=STEPS[0])
    study = continuous_study(scenario, controller, reference, edit=thicken)
    return CRITERIA["B6d"].judge(abs(1.0 - study.reduction))
