"""The map of attraction in MuJoCo, as deployed: `mj_step`, the control held over each step."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from afl_mujoco.compiled import kernel, load, store
from afl_mujoco.control.compiled_law import given_force
from afl_mujoco.control.law import Law
from afl_mujoco.execution.threads import Task, require_threads, share
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.scenario.sampling import whole_steps
from afl_mujoco.simulation.attraction.cells import (
    FALLEN,
    FOUND,
    SETTLED,
    UNDECIDED,
    AttractionMap,
    Cells,
    Settling,
    within,
)
from afl_mujoco.simulation.mujoco_model import (
    CONTROL,
    DATA,
    MODEL,
    PHI,
    PHI_DOT,
    Z_DOT,
    CartPoleModel,
    Z,
    mj_reset_data,
    mj_step,
    write_parameters,
    write_state,
)
from afl_mujoco.simulation.trajectory import FALL_ANGLE, STATE_LIMIT, within_limits

TIMESTEP = 2e-3
"""Physics step, and how long the control is held [s]."""

UNUSED = (
    mujoco.mjtDisableBit.mjDSBL_SENSOR,
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    mujoco.mjtDisableBit.mjDSBL_CONTACT,
)
"""What MuJoCo need not compute for the ideal plant: the same bits in a third less time."""


def map_in_mujoco(
    cells: Cells,
    controller: Law,
    *,
    settling: Settling | None = None,
    timestep: float = TIMESTEP,
    integrator: str = "RK4",
    threads: int = 1,
    progress: Callable[[int], None] = lambda cells: None,
) -> AttractionMap:
    """Return how MuJoCo's loop, as deployed, ends from every cell.

    Parameters
    ----------
    cells
        Where the rollouts start, and on which plants.
    controller
        What is commanded, held over each step.
    settling
        When a rollout has settled; its times are whole steps.
    timestep
        Physics step [s].
    integrator
        MuJoCo's integrator, as of `CartPoleModel`.
    threads
        Threads to share the cells among, each with a model of its own; the result does not depend
        on it.
    progress
        Called with how many more cells are done.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule, or a gain is not positive somewhere.
    """
    settling = Settling() if settling is None else settling
    models = [
        CartPoleModel(NOMINAL, timestep=timestep, integrator=integrator, edit=_without_unused)
        for _ in range(require_threads(threads))
    ]
    rules = (
        whole_steps("dwell", settling.dwell, "timestep", timestep),
        whole_steps("horizon", settling.horizon, "timestep", timestep),
        timestep,
        cells.pole_mass,
        cells.gravity,
    )
    kind = controller.compiled.kind  # raises if the law is no compiled one
    masses, lengths = cells.plants.T
    law = controller.law_inputs(masses, lengths, cells.pole_mass, cells.gravity)
    bands = np.array(settling.bands)
    found = np.empty((len(cells.starts), len(FOUND)))

    def march_on(model: CartPoleModel) -> Task:
        return lambda part: march_cells(
            model.addresses, kind, cells.starts[part], law[part], cells.plants[part],
            bands, rules, found[part],
        )  # fmt: skip

    share(len(found), [march_on(model) for model in models], progress)
    settings = settling.describe() | {"timestep": timestep, "integrator": integrator}
    return AttractionMap.of(cells, controller.name, "mujoco", settings, found)


def _without_unused(spec: mujoco.MjSpec) -> None:
    """Switch off what the ideal plant has none of."""
    for bit in UNUSED:
        spec.option.disableflags |= int(bit)


@kernel
def _march(at, kind, start, law, bands, rules, found):
    """March one rollout to its end and write what is found."""
    dwell, count, timestep = rules
    state, outcome = start.copy(), UNDECIDED
    peak_z, peak_force, stayed, done = 0.0, 0.0, -1, 0
    write_state(at, state[0], state[1], state[2], state[3])
    while True:
        peak_z = max(peak_z, abs(state[0]))
        stayed = stayed + 1 if within(state, bands) else -1
        if abs(state[1]) >= FALL_ANGLE or not within_limits(state):
            outcome = FALLEN
        elif stayed >= dwell:
            outcome = SETTLED
        if outcome != UNDECIDED or done == count:
            break
        force = given_force(kind, state, law)
        if not abs(force) < STATE_LIMIT:
            outcome = FALLEN
            break
        peak_force = max(peak_force, abs(force))
        store(at[CONTROL], force)
        mj_step(at[MODEL], at[DATA])
        state[0], state[1] = load(at[Z]), load(at[PHI])
        state[2], state[3] = load(at[Z_DOT]), load(at[PHI_DOT])
        done += 1
    found[0], found[1], found[2], found[3] = outcome, done * timestep, peak_z, peak_force


@kernel
def march_cells(at, kind, starts, laws, plants, bands, rules, found):
    """March rollouts one after the other, each from data that are reset.

    Parameters
    ----------
    at
        `CartPoleModel.addresses`.
    kind
        Of law, as of `compiled_law`.
    starts
        Initial states, shape (N, 4).
    laws
        What the law is given on each plant, shape (N, 7) or (N, 8).
    plants
        (M, l), shape (N, 2).
    bands
        Of the four states, shape (4,).
    rules
        Dwell and horizon in steps, timestep [s], m [kg], g [m/s^2].
    found
        Takes what `FOUND` names, shape (N, 4).
    """
    dwell, count, timestep, pole_mass, gravity = rules
    for i in range(len(starts)):
        mj_reset_data(at[MODEL], at[DATA])
        write_parameters(at, plants[i, 0], pole_mass, plants[i, 1], gravity)
        _march(at, kind, starts[i], laws[i], bands, (dwell, count, timestep), found[i])
