"""The criteria: the limits of all checks are here and nowhere else, and how a value is judged."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

ANY = "any"
"""Scenario and controller of a check that depends on neither."""


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
        """Raise if it passes beyond its limit, or fails within it."""
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


_ALL_STATES = "m, rad, m/s, rad/s"

# fmt: off
_LIST = (
    Criterion(
        "A1", "1", 1e-11,
        "max |qacc - (P3),(P4)| / (1 + |(P3),(P4)|), 10 000 random states",
        "the same equations in another form: round-off of the larger terms, with margin",
        "MuJoCo's model has the paper's equations of motion over the whole box of parameters",
        "that the closed loop is integrated well",
    ),
    Criterion(
        "A2", "1", 1e-13,
        "max relative error of mass matrix and impulse jump, 1000 states",
        "three products and a cosine: round-off",
        "masses, lever arm and rod inertia enter the mass matrix, by which an impulse acts",
        "gravity and velocity terms, which A1 covers",
    ),
    Criterion(
        "A3", "count", 0,
        "numbers of a mutated MjModel or its qacc other than a fresh compile's",
        "a mutation that refreshes every derived constant gives the same bits, but for stat; qacc "
        "with friction, limits and contact",
        "the live mutation misses no field and no derived constant",
        "that the fields are the right ones, which A1 covers",
    ),
    Criterion(
        "A4", "1", 0.3,
        "|observed order of mj_step RK4 - 4|, free swing",
        "3.7 to 4.3 over four step sizes",
        "MuJoCo's RK4 converges to the solution of (P3), (P4) as it should",
        "the closed loop, which B2 covers",
    ),
    Criterion(
        "A4e", "1", 0.1,
        "|observed order of mj_step Euler - 1|, free swing",
        "0.9 to 1.1 over four step sizes",
        "the same for MuJoCo's Euler",
        "the closed loop",
    ),
    Criterion(
        "A5", _ALL_STATES, 1e-13,
        "max |mj_step - textbook RK4 step| along the sampled run",
        "one step of the same method on the same equations: round-off",
        "each deployed step is an RK4 step of the analytic equations under the held force and the"
        " parameters of its middle",
        "how the errors of the steps add up, which B3 covers",
    ),
    Criterion(
        "A6e", "J", 1e-10,
        "max |energy gained in MuJoCo - work - energy added by parameter changes|",
        "quadrature at the integrator's tolerance, 1e-12",
        "energy is conserved except for the work of the forces and the booked parameter changes",
        "that such changes are physical, which B7 examines",
    ),
    Criterion(
        "A6p", "N s", 1e-10,
        "max |momentum gained in MuJoCo - impulse - momentum added by parameter changes|",
        "quadrature at the integrator's tolerance, 1e-12",
        "the same for the momentum along z",
        "the same",
    ),
    Criterion(
        "A7", "SI", 0,
        "max difference under mirror and common scale, qacc and force",
        "negation and doubling change no bit of a mantissa",
        "both signs are treated alike, and only the ratios of masses and force matter",
        "signs that are wrong in both halves alike, which A1 covers",
    ),
    Criterion(
        "A7z", "1", 1e-12,
        "max |qacc(z + 1) - qacc(z)| / (1 + |qacc|)",
        "world coordinates of the bodies enter MuJoCo's sums: round-off",
        "no force depends on where the cart is",
        "-",
    ),
    Criterion(
        "A8", _ALL_STATES, 1e-10,
        "max |state_DOP853 - state_Radau|, a jump of M and a ramp of l",
        "two methods at rtol 1e-12 and 1e-11",
        "the reference does not depend on its method",
        "errors of the shared right-hand side",
    ),
    Criterion(
        "A8m", "1", 0.3,
        "|observed order of RK4 - 4| on a manufactured motion with M(t), l(t)",
        "3.7 to 4.3 over four step sizes",
        "with M(t), l(t) in every stage RK4 keeps its order",
        "the controller in the loop",
    ),
    Criterion(
        "A8x", _ALL_STATES, 1e-10,
        "max |state_DOP853 - manufactured motion|",
        "DOP853 at rtol 1e-13",
        "under the forces that (P1), (P2) require for the manufactured motion, MuJoCo follows it",
        "-",
    ),
    Criterion(
        "A10", "count", 0,
        "runs that differ when repeated here and in a fresh process, all simulators",
        "same inputs, same bits",
        "runs are repeatable on one machine; the tests add the number of workers",
        "equality across machines",
    ),
    Criterion(
        "B1", _ALL_STATES, 1e-9,
        "max |state_mujoco_exact - state_ode|",
        "one integrator (DOP853, rtol 1e-12) on both right-hand sides: only the model form can "
        "differ",
        "MuJoCo's closed loop is the paper's, over the whole run",
        "errors of the integrator and of the controller, which both sides share",
    ),
    Criterion(
        "B2", _ALL_STATES, 1e-5,
        "max |state_mujoco_continuous - state_ode|, 1 ms",
        "RK4's error at 1 ms, about 5e-6 on the paper's scenarios, all of it from the first fast "
        "milliseconds",
        "another integrator, and another treatment of the schedule, give the same run",
        "errors below 5e-6",
    ),
    Criterion(
        "B2o", "1", 0.3,
        "|observed order of continuous mode - 4|, 2 to 0.25 ms",
        "3.7 to 4.3 over four step sizes, jumps and pulses included",
        "the remaining difference in B2 is RK4's own error and vanishes with the step",
        "-",
    ),
    Criterion(
        "B2b", _ALL_STATES, 1e-10,
        "max |state_mujoco_continuous - state_ode_rk4|",
        "the same RK4 steps on both right-hand sides: round-off grown along the run",
        "both sides take the same steps",
        "errors common to both integrations, which B2 covers",
    ),
    Criterion(
        "B3", _ALL_STATES, 1e-8,
        "max |state_mujoco_sampled - state_ode_held|",
        "control and schedule are held alike: only MuJoCo's RK4 error at 1 ms remains, about "
        "5e-10 on the paper's scenarios",
        "the run as deployed is the exact solution of the held problem",
        "the error of the hold itself, which B4 and B5 measure",
    ),
    Criterion(
        "B4", "1", 0.1,
        "|observed order of sampled mode in the control period - 1|, 2 to 0.25 ms",
        "zero-order hold: 0.9 to 1.1",
        "the error of holding the control is proportional to the period",
        "-",
    ),
    Criterion(
        "B4f", "1", 0.1,
        "|observed order of sampled mode in the control period - 1|, 0.25 to 0.125 ms",
        "zero-order hold: 0.9 to 1.1, where the period is short for any loop of a rig",
        "the error of holding the control is proportional to the period",
        "-",
    ),
    Criterion(
        "B4r", _ALL_STATES, 0.001,
        "max |sampled mode extrapolated to period 0 - state_ode|",
        "Richardson extrapolation from 0.5 and 0.25 ms: the second order remains",
        "as the period shrinks the deployed run tends to the ideal ODE and nothing else",
        "-",
    ),
    Criterion(
        "B4s", "1", 0.2,
        "|observed order of schedule sampling - 2|, 4 to 0.5 ms",
        "parameters are taken at the middle of each step: 1.8 to 2.2",
        "the schedule is sampled at mid-step",
        "schedules without ramps, where there is nothing to sample",
    ),
    Criterion(
        "B5", "1", 0.05,
        "error budget: residual / total",
        "the parts add up except for their products",
        "the difference of the deployed run is explained, source by source",
        "-",
    ),
    Criterion(
        "B6", "1", 0.3,
        "error of continuous mode at 0.25 ms / at 1 ms",
        "a matching model's error vanishes (1/256 for RK4)",
        "the error vanishes with the step, where that of a different model stays (B6d)",
        "what B2o leaves open: B2o fails at a model error far below what fails here",
    ),
    Criterion(
        "B6d", "1", 0.1,
        "|1 - error at 0.25 ms / at 1 ms| of a pole with a capsule's inertia, nominal, fixed",
        "the error of a different model must plateau",
        "the plateau test can fail: it detects an inertia that is 13 % too large",
        "-",
    ),
    Criterion(
        "B7", _ALL_STATES, 1e-9,
        "max |state_mujoco_exact - state_ode|, stretching rod, momenta kept",
        "as B1, with the terms in l' that the paper leaves out",
        "both sides agree on the stretching rod; the table of the effect shows how much the "
        "omission matters",
        "which physics a given hardware has",
    ),
)

_ANY_LIST = (
    Criterion(
        "A1e", "1", 1e-11,
        "max |qacc - equations|, share of the largest component, random points",
        "the same equations in another form: round-off, times the condition of the mass matrix",
        "MuJoCo's model obeys the plant's own equations, of which MuJoCo knows nothing",
        "that the closed loop is integrated well",
    ),
    Criterion(
        "A1t", "1", 1e-11,
        "max |qacc - tree|, share of the largest component, random points",
        "as A1e; the tree reads the MJCF and what the plant writes by a recursion of our own",
        "MuJoCo's accelerations are those of the tree in the MJCF",
        "that this tree is the plant that is meant, which A1e covers",
    ),
    Criterion(
        "A1x", "1", 1e-11,
        "max |equations - tree|, share of the largest component, random points",
        "as A1e",
        "the equations are those of the tree in the MJCF, whatever the engine",
        "-",
    ),
    Criterion(
        "A1c", "count", 0,
        "rows that fail in afl-mujoco check, term by term",
        "each has a limit of its own there",
        "mass matrix, bias and inputs agree one by one; energy changes by the work that is done",
        "-",
    ),
    Criterion(
        "A3n", "count", 0,
        "numbers of a model written in place other than a recompile's",
        "a mutation that refreshes every derived constant gives the same bits",
        "writing the parameters while it runs misses no field and no derived constant",
        "that the fields are the right ones, which A1e covers",
    ),
    Criterion(
        "A4f", "1", 0.3,
        "|observed order of mj_step RK4 - 4|, free motion without damping",
        "3.7 to 4.3 over four step sizes, against DOP853 on MuJoCo's own accelerations",
        "MuJoCo's RK4 converges as it should on this plant",
        "the equations and the closed loop",
    ),
    Criterion(
        "A5s", "1", 1e-13,
        "max |mj_step - textbook RK4 step| / (1 + |x|) along the sampled run",
        "one step of the same method on the plant's own equations: round-off",
        "each deployed step is an RK4 step of the equations under the held inputs and the"
        " parameters of its middle",
        "how the errors of the steps add up, and the steps with an impulse",
    ),
    Criterion(
        "A6f", "J", 1e-10,
        "max |energy gained| in MuJoCo in free motion without damping; above 1 J a share of it",
        "DOP853 at rtol 1e-13, the energy that of the tree",
        "forces of the plant conserve the energy of the tree in the MJCF",
        "inputs, damping and changes of parameters, for which A1c has the power",
    ),
    Criterion(
        "A10r", "count", 0,
        "runs that differ when repeated, exact and as deployed",
        "same inputs, same bits",
        "runs are repeatable on one machine",
        "a fresh process, and equality across machines",
    ),
    Criterion(
        "B1r", "SI", 1e-9,
        "max |state_mujoco_exact - state_ode|, the ODE restarted from MuJoCo every 0.25 s",
        "one integrator (DOP853, rtol 1e-12) on both right-hand sides: only the model form can "
        "differ; a restart keeps an unstable plant from amplifying round-off",
        "MuJoCo's closed loop is that of the plant's equations, along the whole run",
        "errors of the integrator and of the controller, which both sides share",
    ),
)
# fmt: on

CRITERIA: Mapping[str, Criterion] = MappingProxyType({c.id: c for c in (*_LIST, *_ANY_LIST)})
"""Every criterion by its id, in the order of the report; last those of another plant alone."""
