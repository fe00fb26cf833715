"""A model-predictive controller that minimises the paper's objective itself, by CasADi and IPOPT.

Run: python benchmarks/bench_mpc.py [--schedules 60] [--seed 0] [--workers 2]
Needs CasADi: pip install casadi

At every control period it solves an optimal control problem for a piecewise constant force: (P1),
(P2) with M and l as they are now, for it does not foresee their changes, and the objective (O1)
from now on, the largest force so far included; what comes after its horizon costs about what LQR
would pay. Nothing of it is tuned on schedules. Its force is held between control periods, while the
retuned fixed gains that it is compared with are evaluated continuously. Where a problem is not
solved, the paper's law acts.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
from typing import Any

try:
    import casadi as ca
except ImportError:
    raise SystemExit("bench_mpc needs CasADi: pip install casadi") from None
import numpy as np
from bench_gain_functions import FIXED, told
from scipy.linalg import solve_continuous_are

import afl_mujoco as afl
from afl_mujoco.control import cartpole_feedback as design
from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.pool import compute_all, open_executor
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.studies.verify.claims import with_objective
from research.gain_tuning import paper_scales
from research.random_schedules import random_scenario

PERIOD = 0.02
"""Control period [s]."""

INTERVALS = (1,) * 15 + (3,) * 15 + (5,) * 24
"""Lengths of the stretches of constant force ahead, in control periods: 3.6 s in all."""

LIMITS = np.array([20.0, 1.5, 30.0, 60.0] * (len(INTERVALS) + 1) + [400.0] * (len(INTERVALS) + 1))
"""Largest states [m, rad, m/s, rad/s] and forces [N] of a plan, far beyond what it needs."""

NEAR = 0.02
"""Largest state below which LQR goes on."""

SMALL = 0.05
"""Cost of the force, so that it is smooth where the objective does not care."""

WIDTH = 0.05
"""Where abs(x) is rounded off [m, rad], so that it has a derivative."""


def rates(x: Any, force: Any, p: Any) -> Any:
    """(P1), (P2) solved for the accelerations; p is (M, m, l, g)."""
    mass, pole, length, gravity = p[0], p[1], p[2], p[3]
    s, c, w = ca.sin(x[1]), ca.cos(x[1]), x[3]
    # (M + m) z'' - m l c phi'' = F - m l s w^2;  -c z'' + (4/3) l phi'' = g s
    push = force - pole * length * s * w * w
    cart = (push + 0.75 * pole * gravity * s * c) / (mass + pole - 0.75 * pole * c * c)
    return ca.vertcat(x[2], w, cart, 0.75 * (cart * c + gravity * s) / length)


def step(x: Any, force: Any, p: Any) -> Any:
    """RK4 over one control period."""
    h = PERIOD
    a = rates(x, force, p)
    b = rates(x + 0.5 * h * a, force, p)
    c = rates(x + 0.5 * h * b, force, p)
    d = rates(x + h * c, force, p)
    return x + h / 6.0 * (a + 2 * b + 2 * c + d)


def size(x: Any) -> Any:
    """abs(x), rounded off."""
    return ca.sqrt(x * x + WIDTH**2) - WIDTH


def problem(iterations: int, barrier: float) -> Any:
    """The optimal control problem as IPOPT takes it."""
    scales = paper_scales()
    count = len(INTERVALS)
    states, forces, peak = ca.SX.sym("x", 4, count + 1), ca.SX.sym("F", count), ca.SX.sym("peak")
    now, plant, before = ca.SX.sym("now", 4), ca.SX.sym("plant", 4), ca.SX.sym("before")
    after = ca.SX.sym("P", 4, 4)
    cost, equal, below = peak / scales.max_force, [states[:, 0] - now], [before - peak]
    for k, periods in enumerate(INTERVALS):
        x = states[:, k]
        force = forces[k]
        for _ in range(periods):
            ahead = step(x, force, plant)
            below += [force - peak, -force - peak]
            cost += SMALL * PERIOD * (force / scales.max_force) ** 2
            for axis, scale in ((0, scales.iae_z), (1, scales.iae_phi)):
                cost += 0.5 * PERIOD * (size(x[axis]) + size(ahead[axis])) / scale
            x = ahead
        equal.append(states[:, k + 1] - x)
    last = states[:, count]
    cost += ca.sqrt(last.T @ after @ last + 1e-2)
    unknowns = ca.vertcat(ca.vec(states), forces, peak)
    rules = ca.vertcat(*equal, *below)
    given = ca.vertcat(now, plant, before, ca.vec(after))
    options = {
        "print_time": False,
        "error_on_fail": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "max_iter": iterations,
            "tol": 1e-4,
            "mu_init": barrier,
            "warm_start_init_point": "yes",
            "acceptable_tol": 1e-3,
            "acceptable_iter": 3,
        },
    }
    solver = ca.nlpsol("mpc", "ipopt", {"x": unknowns, "f": cost, "g": rules, "p": given}, options)
    lower = np.concatenate([np.zeros(4 * (count + 1)), np.full(1 + 2 * sum(INTERVALS), -np.inf)])
    return solver, lower, np.zeros(len(lower))


class ModelPredictive:
    """The controller, made anew for each run: it remembers its plan and the largest force."""

    def __init__(self) -> None:
        self.first, self.lower, self.upper = problem(200, 1e-2)
        self.solver, _, _ = problem(30, 1e-3)
        self.duals: dict = {}
        self.peak, self.plan, self.asked, self.failed = 0.0, None, 0, 0

    def __call__(self, time: float, state: Any, belief: Any) -> float:
        """Return the force [N]."""
        p = np.array([belief.cart_mass, belief.pole_mass, belief.half_length, belief.gravity])
        gain, after = linear(*p)
        x = np.array(state)
        if np.abs(x).max() < NEAR:
            self.plan = None
            return float(-gain @ x)
        given = np.concatenate([x, p, [self.peak], after.ravel()])
        rules = {"p": given, "lbg": self.lower, "ubg": self.upper, "lbx": -LIMITS, "ubx": LIMITS}
        self.asked += 1
        plan = None
        if self.plan is not None:
            plan = self.solved(self.solver, {"x0": self.plan, **self.duals, **rules})
        if plan is None:  # M or l jumped, or nothing is known yet
            plan = self.solved(self.first, {"x0": first_guess(x, belief, p), **rules})
        if plan is None:
            self.failed, self.plan = self.failed + 1, None
            force = float(afl.control_force(x, belief, afl.FIXED_GAINS))
        else:
            force, self.plan = float(plan[4 * (len(INTERVALS) + 1)]), shifted(plan)
        self.peak = max(self.peak, abs(force))
        return force

    def solved(self, solver: Any, problem: dict) -> Any:
        """Return the plan, None if there is none."""
        found = solver(**problem)
        self.duals = {"lam_x0": found["lam_x"], "lam_g0": found["lam_g"]}
        plan = np.array(found["x"]).ravel()
        return plan if solver.stats()["success"] and np.isfinite(plan).all() else None


TIMES = PERIOD * np.concatenate([[0.0], np.cumsum(INTERVALS)])


def shifted(plan: Any) -> Any:
    """The plan from one control period later on."""
    count = len(INTERVALS)
    states, forces = plan[: 4 * (count + 1)].reshape(-1, 4), plan[4 * (count + 1) : -1]
    later = TIMES + PERIOD
    moved = np.stack([np.interp(later, TIMES, column) for column in states.T], axis=1)
    held = forces[
        np.minimum(np.searchsorted(TIMES, later[:-1] + 1e-9, side="right") - 1, count - 1)
    ]
    return np.concatenate([moved.ravel(), held, plan[-1:]])


def first_guess(x: Any, plant: Any, p: Any) -> Any:
    """The run under the paper's law with fixed gains."""
    states, held, peak = [x], [], 0.0
    for periods in INTERVALS:
        forces = []
        for _ in range(10 * periods):
            force = float(afl.control_force(x, plant, afl.FIXED_GAINS))
            forces.append(force)
            peak = max(peak, abs(force))
            x = x + 0.1 * PERIOD * np.array(rates(x, force, p)).ravel()
        states.append(x)
        held.append(np.mean(forces))
    return np.concatenate([*states, held, [peak]])


def linear(mass: float, pole: float, length: float, gravity: float) -> tuple[Any, Any]:
    """The gains of LQR, and P: sqrt(x' P x) is about what (O1) costs from x on under it."""
    return _linear(round(mass, 3), pole, round(length, 3), gravity)


@functools.cache
def _linear(mass: float, pole: float, length: float, gravity: float) -> tuple[Any, Any]:
    """The same."""
    p = CartPoleParameters(cart_mass=mass, pole_mass=pole, half_length=length, gravity=gravity)
    accelerated = design.accelerated_mass(p)
    a, b = design.upright_model(p)
    b = b * accelerated
    weight = design.LARGEST_ACCELERATION**-2
    states = np.diag([x**-2 for x in design.LARGEST_STATE])
    cost = solve_continuous_are(a, b[:, None], states, [[weight]])
    return accelerated * (b @ cost) / weight, cost


def objectives(unit: tuple[int, int]) -> tuple[float, float, int, int]:
    """The objective under fixed gains and under the controller; its problems, and those
    without a solution."""
    scenario, made = random_scenario(*unit), []

    def controller() -> ModelPredictive:
        made.append(ModelPredictive())
        return made[-1]

    deployed = dataclasses.replace(as_controller(controller), call_limit=60.0)
    fixed = afl.simulate_ode_rk4(scenario, FIXED, timestep=2e-3)
    run = afl.simulate_ode_held(scenario, deployed, timestep=2e-3, control_period=PERIOD)
    found = []
    for law, one in ((FIXED, fixed), (deployed, run)):
        score = with_objective(metrics(scenario, law, one), paper_scales())["objective"]
        found.append(np.inf if score is None else score)
    asked = max(made, key=lambda one: one.asked)
    return found[0], found[1], asked.asked, asked.failed


def main() -> None:
    parser = argparse.ArgumentParser(description="Judge a model-predictive controller.")
    parser.add_argument("--schedules", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    units = [(options.seed, index) for index in range(options.schedules)]
    with open_executor(options.workers) as executor:
        found = np.array(compute_all(objectives, units, executor))
    print(f"{len(units)} schedules of seed {options.seed}: share won, share won by 1 %, mean")
    told("model-predictive control", found[:, 0], found[:, 1])
    asked, failed = found[:, 2].sum(), found[:, 3].sum()
    print(f"    {asked:.0f} problems, {failed:.0f} of them not solved")


if __name__ == "__main__":
    main()
