"""The checks of a plant that is not the cart-pole: MuJoCo against its own equations, if any."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.plant import Floats
from afl_mujoco.plants.tree import Tree, terms_of
from afl_mujoco.plants.writer import PlantModel
from afl_mujoco.scenario.scenario import Scenario, Segment
from afl_mujoco.scenario.time_steps import time_grid
from afl_mujoco.simulation.bound_controllers import bound
from afl_mujoco.simulation.integrator import integrate
from afl_mujoco.simulation.judgement import reached_ranges
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from afl_mujoco.simulation.mujoco_rollout import line_of, simulate_mujoco, transition
from afl_mujoco.simulation.ode import Loop, require_equations
from afl_mujoco.simulation.ode_fixed_step import simulate_ode_held
from afl_mujoco.simulation.simulate import MovingTrees, simulate_ode
from afl_mujoco.simulation.trajectory import COMPLETED, Outcome, Trajectory, criterion_of
from afl_mujoco.studies.check import check
from afl_mujoco.studies.shared.run import run_of
from afl_mujoco.studies.verify.cases import DEPLOYED, Case, reported_runs
from afl_mujoco.studies.verify.checks import ANY, CRITERIA, Check, judged, one_step_difference
from afl_mujoco.studies.verify.convergence import STEPS, Study, last_state, sampled_study, studied
from afl_mujoco.studies.verify.explanation import Growth, Judged, error_budget, moving

EVERY = 0.25  # how long the ODE runs before it starts again from MuJoCo's state [s]
FREE = 1.0  # length of a free motion [s]
STIR = 3.0  # largest rate by which a free motion starts off the scenario's start [rad/s, m/s]
PARTS = 10  # parts of a free motion: each starts where it should, so that none amplifies an error
HALVINGS = 12  # most steps of it: a part, halved until no error is left
SHOWN = (1e-12, 1e-3)  # errors between which an order can be seen: above round-off, and small
FINE = (2.5e-4, 1.25e-4)  # control periods between which the order of the hold is observed [s]
FINER = (1, 4, 16)  # of a loop that is fast, the order is seen at shorter ones alone
STILL = 1e-9  # largest error of a run in which so little happens that there is no order to be seen

NUDGE = 1e-7  # change of the initial state whose growth is shown

# --- the plant ------------------------------------------------------------------------------------


def of_plant(scenario: Scenario) -> list[Check]:
    """Return the checks that need no controller, at the scenario's parameters and beyond."""
    plant = scenario.plant
    box = {}
    for name, one in plant.parameters.items():
        reached = [x for x in (*scenario.spans[name], one.low, one.high) if x is not None]
        box[name] = min(reached), max(reached)
    found = check(plant, box=box)
    rows, checks = {row.id: row for row in found.checks}, []
    written = ("mutation", "recompile")
    for id, side in (("A1e", "model"), ("A1t", "engine"), ("A1x", "tree")):
        if row := rows.get(f"{side}.accelerations"):
            taken = replace(CRITERIA[id], limit=row.limit).judge(row.value)
            checks.append(taken if taken.passed else replace(taken, reason=found.headline))
    stale = [rows[id].value for id in written if id in rows]
    failed = [row for row in found.checks if not row.passed and row.id not in written]
    values = {"A1c": float(len(failed))} | ({"A3n": sum(stale)} if stale else {})
    study, lost = free_motion(scenario)
    values["A6f"] = lost
    if len(study.steps) >= 3:
        values["A4f"] = study.deviation(4.0)
    return [*checks, *judged(values, ANY, ANY)]


def free_motion(scenario: Scenario) -> tuple[Study, float]:
    """Return the error of MuJoCo's RK4 in undamped motion, and the energy it gains [J]."""
    model = PlantModel(scenario.plant, compared=True)
    row = model.rows(scenario.values_at(0.0))[0]
    model.write(row)
    tree, m, d = Tree(**model.tree(row)), model.mj_model, model.mj_data
    model.move_freely(FREE / PARTS)
    n = m.nv
    start = np.array(scenario.initial_state)
    start[n:] += np.random.default_rng(0).uniform(-STIR, STIR, n)

    def rate(_: float, state: Floats) -> Floats:
        d.qpos, d.qvel, d.ctrl = state[:n], state[n:], 0.0
        mujoco.mj_forward(m, d)
        return np.concatenate([state[n:], d.qacc])

    def energy(state: Floats) -> Floats:
        return terms_of(tree, state[:n].copy(), state[n:].copy()).energy

    path = [start]
    for _ in range(PARTS):
        path.append(last_state(rate, path[-1], FREE / PARTS))
    energies = np.array([energy(state) for state in path])
    lost = float(np.abs(energies.sum(axis=1) - energies[0].sum()).max())
    steps, errors = [], []
    for count in (2 ** np.arange(HALVINGS)).tolist():
        model.move_freely(FREE / PARTS / count)
        gaps = []
        for before, after in pairwise(path):
            mujoco.mj_resetData(m, d)
            d.qpos, d.qvel = before[:n], before[n:]
            mujoco.mj_step(m, d, count)
            gaps.append((np.concatenate([d.qpos, d.qvel]) - after) / (1.0 + np.abs(after)))
        error = float(np.sqrt(np.mean(np.square(gaps))))
        if error < SHOWN[0]:
            break
        if error < SHOWN[1]:
            steps.append(m.opt.timestep)
            errors.append(error)
    scale = max(1.0, float(np.ptp(energies[:, 1])), float(energies[:, 0].max()))
    return Study(tuple(steps[-4:]), tuple(errors[-4:])), lost / scale


# --- a case ---------------------------------------------------------------------------------------


def judge(case: Case) -> Judged:
    """Do as `validate.judge` does for the cart-pole."""
    scenario, controller, settings = case
    ideal, h, period = scenario.ideal, settings.timestep, settings.control_period
    loop = bound(controller, ideal)

    def simulated(mode: str) -> Trajectory:
        hold = period if mode == "sampled" else None
        return simulate_mujoco(ideal, loop, mode, timestep=h, control_period=hold)

    runs = {f"mujoco {mode}": simulated(mode) for mode in ("exact", "continuous", "sampled")}
    exact, sampled = runs["mujoco exact"], runs[DEPLOYED]
    growth = None
    again = [(exact, simulated("exact")), (sampled, simulated("sampled"))]
    unlike = [any(x.tobytes() != y.tobytes() for x, y in ((a.state, b.state), (a.input, b.input)))
              for a, b in again]  # fmt: skip
    values = {"A10r": float(sum(unlike))}
    if scenario.plant.has_equations:
        for words, first in reached_ranges(scenario.plant, exact):
            rule = f"must stay where equations hold, but {words}, at {first:.3g} s"
            raise InvalidValueError(f"the run of {controller.name} on {scenario.name}", rule)
        runs = {"ode": simulate_ode(ideal, loop, sample_period=h), **runs}
        values["A5s"] = one_step_difference(ideal, sampled, _sizes(sampled)[1:])
        values["B1r"] = restarted_difference(ideal, loop, exact, h)
        growth = growth_of(ideal, loop, runs["ode"], exact, h)
    part = studied(ideal)
    reference = simulate_mujoco(part, loop, "exact", timestep=STEPS[0])
    ended = all(run.outcome.kind == COMPLETED for run in (*runs.values(), reference))
    held = np.ptp(reference.command, axis=0).any()  # a constant is held without an error
    if ended and held and not _comes_round(reference):
        for finer in FINER:
            hold, _ = sampled_study(part, loop, reference, tuple(h / finer for h in FINE))
            if max(hold.errors) <= STILL:
                break
            values["B4f"] = hold.deviation(1.0)
            if values["B4f"] <= CRITERIA["B4f"].limit:
                break
    budget = None
    middles = np.array([0.5 * (segment.start + segment.end) for segment in ideal.segments])
    rates_act = ideal.acting_rates(middles).any()  # which the held equations leave out
    if settings.full and scenario.plant.has_equations and not rates_act:
        step = sampled.provenance["settings"]["timestep"]
        twin = simulate_ode_held(ideal, loop, timestep=step, control_period=period, substeps=2)
        whole = {name: runs[name] for name in ("ode", "mujoco exact", DEPLOYED)}
        budget = error_budget(ideal, loop, {**whole, "ode held": twin}, substeps=1)
    deployed = sampled
    if scenario != ideal:
        deployed = simulate_mujoco(scenario, bound(controller, scenario))
    return Judged(
        judged(values, scenario.name, controller.name),
        reported_runs(ideal, loop, runs),
        run_of(scenario, controller, deployed),
        moving(sampled),
        budget,
        growth=growth,
    )


def _comes_round(run: Trajectory) -> bool:
    """Return whether a deviation that wraps jumps, and with it what a controller may ask for."""
    nearest = run.state - run.away  # the target, and so many turns
    return bool((np.ptp(nearest, axis=0) > np.pi).any())


def _sizes(run: Trajectory) -> Floats:
    """Return by what differences are divided: round-off is a share of what states have reached."""
    reached: Floats = np.maximum.accumulate(np.abs(run.state))
    return np.maximum(1.0, reached)


def growth_of(
    scenario: Scenario, controller: Controller, ode: Trajectory, exact: Trajectory, period: float
) -> Growth:
    """Return how far the codes are apart over the whole run, and how much a difference grows."""
    start = np.array(scenario.initial_state)
    moved = replace(scenario, initial_state=tuple((start + NUDGE).tolist()))
    nudged = simulate_mujoco(moved, controller, "exact", timestep=period)

    def apart(run: Trajectory) -> float | None:
        alike = run.outcome.kind == exact.outcome.kind and len(run.time) == len(exact.time)
        return float(np.abs(run.state - exact.state).max()) if alike else None

    grown = apart(nudged)
    return Growth(
        scenario=scenario.name, controller=controller.name, difference=apart(ode),
        amplification=None if grown is None else grown / NUDGE,
    )  # fmt: skip


def restarted_difference(
    scenario: Scenario, controller: Controller, exact: Trajectory, period: float
) -> float:
    """Return the largest difference of the ODE from MuJoCo, from whose state it restarts.

    period: Time between the rows of `exact`, which may have one alone [s].
    """
    loop = Loop(scenario, MovingTrees(scenario.plant), controller)
    solver = loop.solver(criterion_of(scenario))
    rows = np.searchsorted(exact.time, np.arange(EVERY, exact.time[-1], EVERY) - 1e-9)
    marks = dict(zip(exact.time[rows].tolist(), exact.state[rows], strict=True))

    def restarting(segment: Segment, state: Floats, times: Floats) -> tuple[Floats, Outcome | None]:
        found: list[Floats] = []
        inside = [mark for mark in marks if segment.start < mark < segment.end]
        for part in segment.cut_at(inside):
            here = times[(times >= part.start) & (times <= part.end)]
            if found:
                state, here = marks[part.start], here[here > part.start]
            samples, outcome = solver(part, state, here)
            found.append(samples)
            if outcome is not None:
                return np.concatenate(found), outcome
        return np.concatenate(found), None

    times = time_grid(scenario, period)
    nodes = controller.nodes_within(scenario.spans)
    states, outcome = integrate(scenario, restarting, loop.arrive, times, nodes=nodes)
    if outcome.kind != exact.outcome.kind:
        return math.inf
    count = min(len(states), len(exact.state))
    gaps = np.abs(states[:count] - exact.state[:count]) / _sizes(exact)[:count]
    return float(gaps.max())


def require_comparable(scenario: Scenario) -> None:
    """Raise if its equations, or MuJoCo's exact mode, cannot say what happens in a scenario."""
    if scenario.plant.has_equations:
        require_equations(scenario)
    model = SimulatedModel(scenario.plant)
    arrive, start = transition(model, scenario), np.array(scenario.initial_state)
    for segment in scenario.segments:
        line_of(model, segment)
        arrive(start, None, segment)
