"""No run ends as it does because of its integrator: at half the step it ends the same way."""

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.scenario.imperfections import IMPERFECTIONS, Imperfections
from afl_mujoco.simulation.mujoco_model import INTEGRATORS

FAST = afl.Scenario(
    name="fast", duration=1.5, initial_state=(0.0, 0.2, 0.0, 0.0),
    schedule={"cart_mass": afl.staircase([0.5], [0.1, 0.3]),
              "half_length": afl.staircase([1.0], [0.05, 0.1])},
    imperfections=Imperfections(control_period=0.002),
)  # fmt: skip
"""A light cart and a short pole, on which damping and inertias act fastest."""

PASSIVE = ("damping.z", "damping.phi", "dry_friction.z", "armature.phi", "end_stops.z")
"""The other integrators are of first order, and so differ at the edge of what a loop tolerates;
of these it is stability that is asked, which passive physics decides."""


@pytest.mark.parametrize(("one", "integrator"), [
    (one, by) for one in IMPERFECTIONS for by in INTEGRATORS if by == "RK4" or one.name in PASSIVE
], ids=lambda x: getattr(x, "name", x))  # fmt: skip
def test_at_half_the_step_a_run_ends_the_same_way(one, integrator: str) -> None:
    for level in np.geomspace(one.benign, one.harsh, 3).tolist():
        scenario = FAST.changed(one.options(level))
        run = afl.simulate_mujoco(scenario, "lqr", integrator=integrator)
        step = 0.5 * run.provenance["settings"]["timestep"]
        finer = afl.simulate_mujoco(scenario, "lqr", timestep=step, integrator=integrator)
        said = f"{one.name} at {level:g}: {run.outcome}, at half the step {finer.outcome}"
        assert run.outcome.kind == finer.outcome.kind, said
        assert run.outcome.time == pytest.approx(finer.outcome.time, rel=0.02), said
