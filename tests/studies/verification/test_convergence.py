"""Refinement studies compare like with like, at the instants that every step size has."""

from dataclasses import replace

import afl_mujoco as afl
from afl_mujoco.control.controller import LINEAR
from afl_mujoco.studies.verification.checks.convergence import STEPS, difference, sampled_study

NOTHING = afl.StateFeedback(
    name="nothing", kind=LINEAR, gains=afl.GainGrid.constant((0.0, 0.0, 0.0, 0.0))
)
GLIDING = replace(
    afl.SCENARIOS["nominal"],
    initial_state=(0.0, 0.0, 2.0, 0.0),
    cart_mass=afl.staircase((0.101,), (0.5, 1.0)),
    duration=0.4,
)


def test_a_breakpoint_off_the_largest_step_is_no_instant_of_a_sampled_study():
    reference = afl.simulate_ode(GLIDING, NOTHING, sample_period=STEPS[0])
    assert 0.101 in reference.time.tolist()
    study, residue = sampled_study(GLIDING, NOTHING, reference)
    assert max(*study.errors, residue) < 1e-9


def test_a_run_that_ends_before_the_reference_has_no_difference_however_fine():
    reference = afl.simulate_ode(GLIDING, NOTHING, sample_period=4e-3)
    shorter = replace(GLIDING, duration=0.2)
    run = afl.simulate_mujoco(shorter, NOTHING, "continuous", timestep=1e-3)
    assert len(run.time) > len(reference.time)
    assert difference(run, reference) == float("inf")
