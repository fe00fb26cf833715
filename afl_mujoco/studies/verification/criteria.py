"""The list of criteria: the limits of all checks are here and nowhere else."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from afl_mujoco.studies.verification.check import Criterion

_ALL_STATES = "m, rad, m/s, rad/s"

_LIST = (
    Criterion(
        id="A1",
        quantity="max |qacc - (P3),(P4)| / (1 + |(P3),(P4)|), 10 000 random states, plants",
        unit="1",
        limit=1e-11,
        reason="the same equations in another form: round-off of the larger terms, with margin",
        proves="MuJoCo's model has the paper's equations of motion over the whole box of "
        "parameters",
        leaves_open="that the closed loop is integrated well",
    ),
    Criterion(
        id="A2",
        quantity="max relative error of MuJoCo's mass matrix and impulse jump, 1000 states, plants",
        unit="1",
        limit=1e-13,
        reason="three products and a cosine: round-off",
        proves="masses, lever arm and rod inertia enter the mass matrix, by which an impulse acts",
        leaves_open="gravity and velocity terms, which A1 covers",
    ),
    Criterion(
        id="A3",
        quantity="numbers in which a mutated MjModel (except stat), or its qacc with friction, "
        "limits and contact, differs from a fresh compile",
        unit="count",
        limit=0,
        reason="a mutation that refreshes every derived constant gives the same bits as a "
        "fresh compile",
        proves="the live mutation misses no field and no derived constant",
        leaves_open="that the fields are the right ones, which A1 covers",
    ),
    Criterion(
        id="A4",
        quantity="|observed order of mj_step RK4 - 4|, free swing",
        unit="1",
        limit=0.3,
        reason="3.7 to 4.3 over four step sizes",
        proves="MuJoCo's RK4 converges to the solution of (P3), (P4) as it should",
        leaves_open="the closed loop, which B2 covers",
    ),
    Criterion(
        id="A4e",
        quantity="|observed order of mj_step Euler - 1|, free swing",
        unit="1",
        limit=0.1,
        reason="0.9 to 1.1 over four step sizes",
        proves="the same for MuJoCo's Euler",
        leaves_open="the closed loop",
    ),
    Criterion(
        id="A5",
        quantity="max |mj_step - textbook RK4 step| along the sampled run",
        unit=_ALL_STATES,
        limit=1e-13,
        reason="one step of the same method on the same equations: round-off",
        proves="each deployed step is an RK4 step of the analytic equations under the held "
        "force and the parameters of its middle",
        leaves_open="how the errors of the steps add up, which B3 covers",
    ),
    Criterion(
        id="A6e",
        quantity="max |energy gained in MuJoCo - work - energy added by parameter changes|",
        unit="J",
        limit=1e-10,
        reason="quadrature at the integrator's tolerance, 1e-12",
        proves="energy is conserved except for the work of the forces and the booked parameter "
        "changes",
        leaves_open="that such changes are physical, which B7 examines",
    ),
    Criterion(
        id="A6p",
        quantity="max |momentum gained in MuJoCo - impulse - momentum added by parameter changes|",
        unit="N s",
        limit=1e-10,
        reason="quadrature at the integrator's tolerance, 1e-12",
        proves="the same for the momentum along z",
        leaves_open="the same",
    ),
    Criterion(
        id="A7",
        quantity="max difference under mirror and common scale, MuJoCo's qacc and the force",
        unit="SI",
        limit=0,
        reason="negation and doubling change no bit of a mantissa",
        proves="both signs are treated alike, and only the ratios of masses and force matter",
        leaves_open="signs that are wrong in both halves alike, which A1 covers",
    ),
    Criterion(
        id="A7z",
        quantity="max |qacc(z + 1) - qacc(z)| / (1 + |qacc|)",
        unit="1",
        limit=1e-12,
        reason="world coordinates of the bodies enter MuJoCo's sums: round-off",
        proves="no force depends on where the cart is",
        leaves_open="-",
    ),
    Criterion(
        id="A8",
        quantity="max |state_DOP853 - state_Radau|, a jump of M and a ramp of l",
        unit=_ALL_STATES,
        limit=1e-10,
        reason="two methods at rtol 1e-12 and 1e-11",
        proves="the reference does not depend on its method",
        leaves_open="errors of the shared right-hand side",
    ),
    Criterion(
        id="A8m",
        quantity="|observed order of RK4 - 4| on a manufactured motion with M(t), l(t)",
        unit="1",
        limit=0.3,
        reason="3.7 to 4.3 over four step sizes",
        proves="with M(t), l(t) in every stage RK4 keeps its order",
        leaves_open="the controller in the loop",
    ),
    Criterion(
        id="A8x",
        quantity="max |state_DOP853 - manufactured motion|",
        unit=_ALL_STATES,
        limit=1e-10,
        reason="DOP853 at rtol 1e-13",
        proves="under the forces that (P1), (P2) require for the manufactured motion, MuJoCo "
        "follows it",
        leaves_open="-",
    ),
    Criterion(
        id="A10",
        quantity="runs that differ when repeated here and in a fresh process, all simulators",
        unit="count",
        limit=0,
        reason="same inputs, same bits",
        proves="runs are repeatable on one machine; the tests add the number of workers",
        leaves_open="equality across machines",
    ),
    Criterion(
        id="B1",
        quantity="max |state_mujoco_exact - state_ode|",
        unit=_ALL_STATES,
        limit=1e-9,
        reason="one integrator (DOP853, rtol 1e-12) on both right-hand sides: only the model "
        "form can differ",
        proves="MuJoCo's closed loop is the paper's, over the whole run",
        leaves_open="errors of the integrator and of the controller, which both sides share",
    ),
    Criterion(
        id="B2",
        quantity="max |state_mujoco_continuous - state_ode|, 1 ms",
        unit=_ALL_STATES,
        limit=1e-5,
        reason="RK4's error at 1 ms, about 5e-6 on the paper's scenarios, all of it from the "
        "first fast milliseconds",
        proves="another integrator, and another treatment of the schedule, give the same run",
        leaves_open="errors below 5e-6",
    ),
    Criterion(
        id="B2o",
        quantity="|observed order of continuous mode - 4|, 2 to 0.25 ms",
        unit="1",
        limit=0.3,
        reason="3.7 to 4.3 over four step sizes, jumps and pulses included",
        proves="the remaining difference in B2 is RK4's own error and vanishes with the step",
        leaves_open="-",
    ),
    Criterion(
        id="B2b",
        quantity="max |state_mujoco_continuous - state_ode_rk4|",
        unit=_ALL_STATES,
        limit=1e-10,
        reason="the same RK4 steps on both right-hand sides: round-off grown along the run",
        proves="both sides take the same steps",
        leaves_open="errors common to both integrations, which B2 covers",
    ),
    Criterion(
        id="B3",
        quantity="max |state_mujoco_sampled - state_ode_held|",
        unit=_ALL_STATES,
        limit=1e-8,
        reason="control and schedule are held alike: only MuJoCo's RK4 error at 1 ms remains, "
        "about 5e-10 on the paper's scenarios",
        proves="the run as deployed is the exact solution of the held problem",
        leaves_open="the error of the hold itself, which B4 and B5 measure",
    ),
    Criterion(
        id="B4",
        quantity="|observed order of sampled mode in the control period - 1|, 2 to 0.25 ms",
        unit="1",
        limit=0.1,
        reason="zero-order hold: 0.9 to 1.1",
        proves="the error of holding the control is proportional to the period",
        leaves_open="-",
    ),
    Criterion(
        id="B4r",
        quantity="max |sampled mode extrapolated to period 0 - state_ode|",
        unit=_ALL_STATES,
        limit=1e-3,
        reason="Richardson extrapolation from 0.5 and 0.25 ms: the second order remains",
        proves="as the period shrinks the deployed run tends to the ideal ODE and nothing else",
        leaves_open="-",
    ),
    Criterion(
        id="B4s",
        quantity="|observed order of schedule sampling - 2|, 4 to 0.5 ms",
        unit="1",
        limit=0.2,
        reason="parameters are taken at the middle of each step: 1.8 to 2.2",
        proves="the schedule is sampled at mid-step",
        leaves_open="schedules without ramps, where there is nothing to sample",
    ),
    Criterion(
        id="B5",
        quantity="error budget: residual / total",
        unit="1",
        limit=0.05,
        reason="the parts add up except for their products",
        proves="the difference of the deployed run is explained, source by source",
        leaves_open="-",
    ),
    Criterion(
        id="B6",
        quantity="error of continuous mode at 0.25 ms / at 1 ms",
        unit="1",
        limit=0.3,
        reason="a matching model's error vanishes (1/256 for RK4)",
        proves="the error vanishes with the step, where that of a different model stays (B6d)",
        leaves_open="what B2o leaves open: B2o fails at a model error far below what fails here",
    ),
    Criterion(
        id="B6d",
        quantity="|1 - error at 0.25 ms / at 1 ms| of a pole with a capsule's inertia, nominal, "
        "fixed",
        unit="1",
        limit=0.1,
        reason="the error of a different model must plateau",
        proves="the plateau test can fail: it detects an inertia that is 13 % too large",
        leaves_open="-",
    ),
    Criterion(
        id="B7",
        quantity="max |state_mujoco_exact - state_ode|, stretching rod, momenta kept",
        unit=_ALL_STATES,
        limit=1e-9,
        reason="as B1, with the terms in l' that the paper leaves out",
        proves="both sides agree on the stretching rod; the table of the effect shows how much "
        "the omission matters",
        leaves_open="which physics a given hardware has",
    ),
)

CRITERIA: Mapping[str, Criterion] = MappingProxyType({c.id: c for c in _LIST})
"""Every criterion by its id, in the order of the report."""
