"""The closed loop in MuJoCo as deployed, its law told by the estimator what the plant is.

`bench_estimator.py` runs it; it is no benchmark by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

import afl_mujoco as afl
from afl_mujoco.compiled import load, store
from afl_mujoco.control.compiled_law import scheduled_force
from afl_mujoco.control.estimation import estimator
from afl_mujoco.control.estimation.settings import GRAVITY, POLE_MASS, EstimatorSettings
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation import mujoco_model as mm
from afl_mujoco.tuning.gain_cost import paper_scales

Array = NDArray[np.float64]

DT = 1e-3
TRUE, ESTIMATED, NOMINAL = 0, 1, 2
FILTERED, MEASURED = 1, 2
GAINS = {
    name: afl.CONTROLLERS[name].gain_function.coefficients  # type: ignore[attr-defined]
    for name in ("adaptive", "fixed")
}
CONTROL, PUSH, MODEL, DATA = mm.CONTROL, mm.PUSH, mm.MODEL, mm.DATA
Z, PHI, Z_DOT, PHI_DOT = mm.Z, mm.PHI, mm.Z_DOT, mm.PHI_DOT
write_parameters, write_state, mj_step = mm.write_parameters, mm.write_state, mm.mj_step


@njit
def measured(state, noise, step):
    """What the sensors say of (z, phi)."""
    z, phi = state[0] + noise[0], state[1] + noise[1]
    if step[0] > 0.0:
        return step[0] * np.rint(z / step[0]), step[1] * np.rint(phi / step[1])
    return z, phi


@njit
def commanded(state, seen, true, memory, settings, gains, told, fed):
    """The force of the law; `told` says what it believes, `fed` which state it gets."""
    belief = estimator.estimate(memory)
    if told == TRUE:
        belief = true
    if told == NOMINAL:
        belief = (1.0, 0.5)
    x = (state[0], state[1], state[2], state[3])
    if fed == FILTERED:
        x = estimator.filtered_state(memory)
    if fed == MEASURED:
        x = (seen[0], seen[1], memory[2], memory[3])
    believed = (belief[0], settings[POLE_MASS], belief[1], settings[GRAVITY])
    return scheduled_force(x[0], x[1], x[2], x[3], believed, gains)


@njit
def march(at, initial, truth, push, noise, step, gains, told, fed, settings, hold, late):
    """March by `mj_step`; return states, forces and (M, l) as estimated, until the pole falls.

    `truth` has (M, l) for each step, `noise` and `step` are of (z, phi); the force acts `late`
    steps after it is commanded, of which the estimator knows nothing.
    """
    count = len(push)
    states, forces, found = np.empty((count + 1, 4)), np.zeros(count + 1), np.empty((count + 1, 2))
    memory = np.zeros(estimator.MEMORY_SIZE)
    states[0] = initial
    write_state(at, initial[0], initial[1], initial[2], initial[3])
    force = 0.0
    for k in range(count + 1):
        s, true = states[k], (truth[min(k, count - 1), 0], truth[min(k, count - 1), 1])
        if k % hold == 0:
            seen = measured(s, noise[k], step)
            if k == 0:
                estimator.start(memory, settings, seen[0], seen[1])
            else:
                estimator.update(memory, settings, seen[0], seen[1], force, DT * hold)
            force = commanded(s, seen, true, memory, settings, gains, told, fed)
        forces[k] = force
        found[k, 0], found[k, 1] = estimator.estimate(memory)
        if k == count or not (abs(s[1]) < 1.57 and abs(force) < 1e6):
            return states[: k + 1], forces[: k + 1], found[: k + 1]
        write_parameters(at, true[0], settings[POLE_MASS], true[1], settings[GRAVITY])
        store(at[CONTROL], forces[k - late] if k >= late else 0.0)
        store(at[PUSH], push[k])
        mj_step(at[MODEL], at[DATA])
        after = states[k + 1]
        after[0], after[1] = load(at[Z]), load(at[PHI])
        after[2], after[3] = load(at[Z_DOT]), load(at[PHI_DOT])
    return states, forces, found


@dataclass(frozen=True, kw_only=True)
class Rig:
    """What is measured and what is not known of it."""

    noise: tuple[float, float] = (0.0, 0.0)  # m, rad
    step: tuple[float, float] = (0.0, 0.0)  # m, rad
    hold: int = 1  # ms
    late: int = 0  # ms
    damping: float = 0.0  # N s/m
    friction: float = 0.0  # N

    def settings(self, **changes: float) -> EstimatorSettings:
        """The estimator's settings where the noise is known and the rest is not."""
        least = (1e-5, 1e-5)
        pairs = zip(self.noise, self.step, least, strict=True)
        sigma = [max(float(np.hypot(n, s / 12**0.5)), x) for n, s, x in pairs]
        return EstimatorSettings(position_noise=sigma[0], angle_noise=sigma[1], **changes)


@dataclass(frozen=True)
class Run:
    """A run and what was estimated in it."""

    scenario: Scenario
    state: Array
    force: Array
    found: Array

    @property
    def survived(self) -> bool:
        return len(self.state) == round(self.scenario.duration / DT) + 1

    @property
    def truth(self) -> Array:
        middles = (np.arange(len(self.state) - 1) + 0.5) * DT
        return np.stack([self.scenario.cart_mass(middles), self.scenario.half_length(middles)], 1)

    @property
    def error(self) -> Array:
        """ln of estimate over truth at the end of each step, shape (N, 2)."""
        return np.asarray(np.log(self.found[1:] / self.truth))

    @property
    def terms(self) -> Array:
        """The terms of (O1), normalised: two integrals and the largest force."""
        scales = paper_scales()
        z, phi = (float(np.trapezoid(np.abs(x), dx=DT)) for x in self.state.T[:2])
        peak = float(np.abs(self.force).max())
        return np.array([z / scales.iae_z, phi / scales.iae_phi, peak / scales.max_force])


def run(
    scenario: Scenario,
    rig: Rig,
    *,
    gains: str = "adaptive",
    told: int = ESTIMATED,
    fed: int = FILTERED,
    seed: int = 0,
    settings: EstimatorSettings | None = None,
) -> Run:
    def rough(spec: mujoco.MjSpec) -> None:
        spec.joint("slider").damping = [rig.damping, 0.0, 0.0]
        spec.joint("slider").frictionloss = rig.friction

    edit = rough if rig.damping or rig.friction else None
    model = mm.CartPoleModel(scenario.parameters_at(0.0), timestep=DT, edit=edit)
    count = round(scenario.duration / DT)
    middles = (np.arange(count) + 0.5) * DT
    truth = np.stack([scenario.cart_mass(middles), scenario.half_length(middles)], axis=1)
    noise = np.random.default_rng(seed).standard_normal((count + 1, 2)) * rig.noise
    states, forces, found = march(
        model.addresses, np.array(scenario.initial_state), truth, scenario.pushes(middles), noise,
        np.array(rig.step), GAINS[gains], told, fed, (settings or rig.settings()).array,
        rig.hold, rig.late,
    )  # fmt: skip
    return Run(scenario, states, forces, found)
