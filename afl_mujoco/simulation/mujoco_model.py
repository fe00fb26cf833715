"""A plant as MuJoCo simulates it, with imperfections, and where compiled code finds it."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import inlined_kernel, jitable, kernel, load, store
from afl_mujoco.errors import InvalidValueError, UnknownNameError
from afl_mujoco.plants.cartpole import CART_POLE, model_file
from afl_mujoco.plants.library import (
    mj_apply_ft,
    mj_com_pos,
    mj_com_vel,
    mj_forward,
    mj_kinematics,
    mujoco,
    write_row,
)
from afl_mujoco.plants.plant import Floats, Plant, require_seen_limits
from afl_mujoco.plants.writer import PlantModel
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.values import require_positive

FRICTION_SOLREF, FRICTION_SOLIMP = (0.004, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Constraint of dry friction; the first impedance is that of a joint that does not slide."""

STOP_SOLREF = (0.005, 1.0)
"""Constraint of the end stops [s, 1]: stiffer than MuJoCo's default, critically damped."""

PASSIVE = (
    *("dof_damping", "dof_armature", "dof_frictionloss", "dof_solref", "dof_solimp"),
    *("jnt_limited", "jnt_range", "jnt_solref"),
)
"""Fields of MjModel that hold the passive physics."""

DAMPED = 1e-3  # largest share of the amplitude of what rings that RK4 may take in a run

INTEGRATORS = {
    name: getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}")
    for name in ("RK4", "Euler", "implicit", "implicitfast")
}
"""MuJoCo's integrators by their MJCF name."""


def require_integrator(name: str) -> None:
    """Raise if MuJoCo has no such integrator."""
    if name not in INTEGRATORS:
        raise UnknownNameError.among("integrator", name, INTEGRATORS)


class Addresses(NamedTuple):
    """Where compiled code finds MuJoCo's structures and their numbers."""

    model: int
    data: int
    timestep: int
    qpos: int
    qvel: int
    ctrl: int
    applied: int  # generalised forces
    qacc: int
    smooth: int  # accelerations without friction and stops
    n: int  # how many coordinates
    k: int  # and inputs there are
    # of masses of bodies, their orientations, those of their inertias, their centres and velocities
    bodies: NDArray[np.int64]
    parents: NDArray[np.int64]  # which body carries each
    work: Floats  # work space of `rate_forces`
    structures: NDArray[np.int64]  # of the model and of scratch data, for `library.write_row`
    targets: NDArray[np.int64]  # of what a row of the writer has


@inlined_kernel
def read_numbers(address, out):
    """Read consecutive numbers."""
    for i in range(len(out)):
        out[i] = load(address + 8 * i)


@inlined_kernel
def write_numbers(address, values):
    """Write consecutive numbers."""
    for i in range(len(values)):
        store(address + 8 * i, values[i])


@inlined_kernel
def read_state(at, out):
    """Read the state in MjData, shape (2 n,) or longer."""
    for i in range(at.n):
        out[i] = load(at.qpos + 8 * i)
        out[at.n + i] = load(at.qvel + 8 * i)


@inlined_kernel
def write_state(at, state):
    """Write the state into MjData."""
    for i in range(at.n):
        store(at.qpos + 8 * i, state[i])
        store(at.qvel + 8 * i, state[at.n + i])


@kernel
def forward(at, state, inputs, forces, out):
    """Write MuJoCo's accelerations for a state, inputs and generalised forces."""
    write_state(at, state)
    write_numbers(at.ctrl, inputs)
    write_numbers(at.applied, forces)
    mj_forward(at.model, at.data)
    read_numbers(at.qacc, out)


@kernel
def impulse_jump(at, impulse, out):
    """Write the jump of the rates under ideal impulses along the coordinates, both of shape (n,).

    Friction and stops do not act during an impulse. Without them accelerations are linear in the
    force: a force equal to `impulse` changes them by the inverse mass matrix times the impulse.
    """
    for i in range(at.k):
        store(at.ctrl + 8 * i, 0.0)
    write_numbers(at.applied, impulse)
    mj_forward(at.model, at.data)
    read_numbers(at.smooth, out)
    for i in range(at.n):
        store(at.applied + 8 * i, 0.0)
    mj_forward(at.model, at.data)
    for i in range(at.n):
        out[i] -= load(at.smooth + 8 * i)


@jitable
def _turned(address, vector, out):
    """Add a matrix of MuJoCo times a vector."""
    for i in range(3):
        for j in range(3):
            out[i] += load(address + 8 * (3 * i + j)) * vector[j]


@jitable
def _crossed(a, b, factor, out):
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] += factor * (a[j] * b[k] - a[k] * b[j])


@kernel
def rate_forces(at, drift, state, kick, out):
    """Write the generalised forces by which rates of parameters act on the motion, shape (n,).

    Each body needs a force m r'' beside that of a plant whose parameters stay, for what its centre
    moves in its own frame and its frame in that of each body that carries it, 2 w x u + R d'', and
    a torque I' w; -J' of these is what acts, by MuJoCo's own kinematics. With `kick` it is of a
    jump of the rates, an impulse of d''; the state is at rest.
    """
    write_state(at, state)
    jump = 3 if kick else 0
    mj_kinematics(at.model, at.data)
    mj_com_pos(at.model, at.data)
    mj_com_vel(at.model, at.data)
    masses, frames, axes, centres, velocities = at.bodies
    at.work[:] = 0.0
    size = 3 * len(at.parents)
    for i in range(at.n):
        out[i] = 0.0
    for b in range(1, len(at.parents)):
        up, parts = at.parents[b], drift[15 * b : 15 * b + 15]
        needed, above = at.work[3 * b : 3 * b + 3], at.work[3 * up : 3 * up + 3]
        spin = at.work[size + 3 * b : size + 3 * b + 3]
        carrier = at.work[size + 3 * up : size + 3 * up + 3]  # the rate of what carries it
        for i in range(3):
            needed[i] = above[i]
            spin[i] = load(velocities + 48 * b + 8 * i)
        held, force = at.work[2 * size : 2 * size + 3], at.work[2 * size + 3 : 2 * size + 6]
        torque, turn = at.work[2 * size + 6 : 2 * size + 9], at.work[2 * size + 9 :]
        held[:] = force[:] = torque[:] = turn[:] = 0.0
        _turned(frames + 72 * up, parts[:3], held)
        _crossed(carrier, held, 2.0, needed)
        _turned(frames + 72 * up, parts[3 - jump : 6 - jump], needed)
        held[:] = 0.0
        for i in range(3):
            force[i] = needed[i]
        _turned(frames + 72 * b, parts[6:9], held)
        _crossed(spin, held, 2.0, force)
        _turned(frames + 72 * b, parts[9 - jump : 12 - jump], force)
        for i in range(3):  # I' w, along the axes of the inertia
            for j in range(3):
                turn[i] -= load(axes + 72 * b + 8 * (3 * j + i)) * spin[j] * parts[12 + i]
            force[i] *= -load(masses + 8 * b)
        _turned(axes + 72 * b, turn, torque)
        wrench = force.ctypes.data, torque.ctypes.data
        mj_apply_ft(at.model, at.data, wrench[0], wrench[1], centres + 24 * b, b, out.ctypes.data)


def carried_momenta(model: SimulatedModel, values: Floats, rates: Floats, state: Floats) -> Floats:
    """Write parameters; return the momenta that rates give a plant at rest, N p'."""
    model.write(values)
    n = model.addresses.n
    if not rates.any():
        return np.zeros(n)
    found, at_rest = np.empty(n), np.concatenate([state[:n], np.zeros(n)])
    drift = model.writer.drift(values[None], rates[None]).ravel()
    rate_forces(model.addresses, drift, at_rest, True, found)
    return -found


class SimulatedModel:
    """A plant's MuJoCo model, at first nominal, which can be changed while it runs."""

    def __init__(
        self,
        plant: Plant,
        *,
        timestep: float = 1e-3,
        integrator: str = "RK4",
        edit: Callable[[mujoco.MjSpec], None] | None = None,
        imperfections: Imperfections = IDEAL,
    ) -> None:
        require_integrator(integrator)
        require_positive("timestep", timestep)

        def alter(spec: Any) -> None:
            spec.option.timestep = timestep
            spec.option.integrator = INTEGRATORS[integrator]
            spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
            if edit is not None:
                edit(spec)

        self.plant = plant
        self.writer = PlantModel(plant, alter=alter)
        self.mj_model, model = self.writer.mj_model, self.writer.mj_model
        # the drives keep within the limits of the inputs, and say that they do
        model.actuator_ctrllimited[:] = model.actuator_forcelimited[:] = 0
        limited = np.flatnonzero(model.jnt_actfrclimited).tolist()
        require_seen_limits(model.joint(joint).name for joint in limited)
        self._compiled = {name: getattr(model, name).copy() for name in PASSIVE}
        self.drive(self.writer.mj_data)
        if imperfections != IDEAL:
            self.set_imperfections(imperfections)

    def drive(self, data: mujoco.MjData) -> None:
        """Make `data`, as of a dm_control Physics, what compiled code works on."""
        self.mj_data = data
        self.addresses = _addresses(self, data)

    def write(self, values: Floats) -> None:
        """Change the parameters: derived constants refreshed, state kept."""
        write_row(self.addresses.structures, self.addresses.targets, self.rows(values)[0])

    def rows(self, values: Floats) -> Floats:
        """Return what parameters, shape (N, parameters), are in the model, each checked."""
        rows = self.writer.rows(values)
        self.writer.require(rows, np.atleast_2d(values))
        return rows

    def accelerations(self, state: Floats, inputs: Any = 0.0, forces: Any = 0.0) -> Floats:
        """Return MuJoCo's accelerations under inputs and generalised forces."""
        at = self.addresses
        found, exerted, beside = np.empty(at.n), np.empty(at.k), np.empty(at.n)
        exerted[:], beside[:] = inputs, forces
        forward(at, np.array(state, np.float64), exerted, beside, found)
        return found

    def course(self, values: Floats) -> tuple[Floats, NDArray[np.int64]]:
        """Return the rows that a course of values writes, and which is when; rates may follow."""
        changed = np.ones(len(values), dtype=np.bool_)
        changed[1:] = (values[1:] != values[:-1]).any(axis=1)
        parameters = values[changed][:, : len(self.plant.parameters)]
        return np.ascontiguousarray(self.rows(parameters)), np.cumsum(changed) - 1

    def set_imperfections(self, imperfections: Imperfections) -> None:
        """Take passive physics and mass distribution; then write the parameters."""
        r, m = imperfections.of_plant(self.plant), self.mj_model
        for name, array in self._compiled.items():
            getattr(m, name)[:] = array
        for i, name in enumerate(self.plant.coordinates):
            m.dof_damping[i] += r.at(f"damping.{name}")
            m.dof_armature[i] += r.at(f"armature.{name}")
            if (friction := r.at(f"dry_friction.{name}")) > 0.0:
                m.dof_frictionloss[i] += friction
                m.dof_solref[i], m.dof_solimp[i] = FRICTION_SOLREF, FRICTION_SOLIMP
            if (stop := r.at(f"end_stops.{name}")) is not None:
                least, most = m.jnt_range[i] if m.jnt_limited[i] else (-np.inf, np.inf)
                m.jnt_range[i] = max(least, -stop), min(most, stop)
                m.jnt_limited[i], m.jnt_solref[i] = True, STOP_SOLREF
        self.writer.details = {name: getattr(r, name) for name in self.plant.details}

    def fastest_rate(self, scenario: Scenario, spans: Mapping[str, tuple[float, float]]) -> float:
        """Return the rate [1/s] of which no step may exceed the reciprocal, by dampers and springs.

        Within spans of parameters, at 0 and where a scenario starts and should be; 0 without any.
        Of MuJoCo's integrators only RK4 is explicit in the damping, and takes (w h)^6 / 144 of the
        amplitude of what rings at w in each step.
        """
        duration, target = scenario.duration, scenario.target
        places = self.mj_model.qpos0.copy(), scenario.initial_state[: len(target)], target
        model, n = self.mj_model, self.mj_model.nv
        explicit, rates = model.opt.integrator == INTEGRATORS["RK4"], [0.0]
        mass, data = np.zeros((n, n)), mujoco.MjData(model)
        corners = itertools.product(*(dict.fromkeys(span) for span in spans.values()))
        for values, q in itertools.product(corners, places):
            self.write(np.array(values))
            damping = model.dof_damping * explicit
            stiffness = np.reshape(model.jnt_stiffness, (n, -1))[:, 0]
            if not (damping.any() or stiffness.any()):
                continue
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, mass)
            drag, pull = (np.linalg.solve(mass, np.diag(x)) for x in (damping, stiffness))
            found = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-pull, -drag]]))
            rates.append(float(np.abs(found).max()))
            if explicit:
                rings = 1.0 / np.maximum(-found.real, 1.0 / duration)  # so long [s]
                taken = np.abs(found.imag) ** 6 * rings / (144.0 * DAMPED)
                rates.append(float(taken.max() ** 0.2))
        return max(rates)

    def compute_only(self) -> None:
        """Disable what one tree without contacts does not need: the same bits sooner."""
        bits, model = mujoco.mjtDisableBit, self.mj_model
        needless = bits.mjDSBL_SENSOR | bits.mjDSBL_CONTACT | bits.mjDSBL_ISLAND
        flags = model.opt.disableflags | int(needless)
        constraint = int(bits.mjDSBL_CONSTRAINT)
        may_rub = any(one.field == "frictionloss" for one in self.writer.targets)
        constrained = may_rub or model.dof_frictionloss.any() or model.jnt_limited.any()
        model.opt.disableflags = flags & ~constraint if constrained else flags | constraint

    def generalised(self, channels: Floats) -> tuple[Floats, ...]:
        """Return forces on `channels_of` along coordinates, and beside drives at sites."""
        model, k = self.mj_model, len(self.plant.inputs)
        along, beside = channels[:, k:].copy(), np.zeros((len(channels), k))
        for i in range(k):
            if not channels[:, i].any():
                continue
            drive = ("actuator", self.plant.inputs[i])
            geared = any(one[:2] == drive for one in self.writer.targets)
            if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_SITE or geared:
                beside[:, i] = channels[:, i]
                continue
            gear = model.actuator_gear[i, 0] * model.actuator_gainprm[i, 0]
            along[:, model.actuator_trnid[i, 0]] += gear * channels[:, i]
        return along, beside

    def along(self, thing: str, channels: Floats) -> Floats:
        """Return forces on `channels_of` along coordinates alone, or raise."""
        found, beside = self.generalised(channels)
        if beside.any():
            rule = "must name a coordinate: this input acts at a site, or by a gear that is written"
            raise InvalidValueError(thing, rule)
        return found


class CartPoleModel(SimulatedModel):
    """A compiled MuJoCo cart-pole whose parameters can be changed while it runs.

    Parameters
    ----------
    parameters
        The plant to compile.
    file
        The MJCF of `models/`: ``"cartpole.xml"``, or ``"scene.xml"`` for pictures.
    **settings
        MuJoCo's timestep [s], by default 1e-3, and its integrator, by default ``"RK4"``.

    Attributes
    ----------
    mj_model, mj_data
        The compiled `mujoco.MjModel` and its `mujoco.MjData`.

    Raises
    ------
    UnknownNameError
        If there is no such integrator.
    InvalidValueError
        If the timestep is not positive.
    """

    def __init__(
        self, parameters: CartPoleParameters, *, file: str = "cartpole.xml", **settings: Any
    ) -> None:
        super().__init__(shown(CART_POLE, file), **settings)
        self.set_parameters(parameters)

    def set_parameters(self, parameters: CartPoleParameters) -> None:
        """Change the plant: absolute values, derived constants refreshed, state kept.

        Parameters
        ----------
        parameters
            The new plant.
        """
        self.write(np.array([getattr(parameters, name) for name in self.plant.parameters]))


def shown(plant: Plant, file: str) -> Plant:
    """Return the cart-pole with another MJCF of `models/`."""
    return plant if file == "cartpole.xml" else replace(plant, model=model_file(file))


def _addresses(model: SimulatedModel, data: mujoco.MjData) -> Addresses:
    if data.qpos.dtype != np.float64:
        raise InvalidValueError("MuJoCo", "must be built in double precision", data.qpos.dtype)
    own = model.mj_model

    def first(array: Floats) -> int:
        return int(array.ctypes.data)

    bodies = (own.body_mass, data.xmat, data.ximat, data.xipos, data.cvel)
    return Addresses(
        model=own._address,
        data=data._address,
        timestep=_timestep_address(own),
        qpos=first(data.qpos),
        qvel=first(data.qvel),
        ctrl=first(data.ctrl),
        applied=first(data.qfrc_applied),
        qacc=first(data.qacc),
        smooth=first(data.qacc_smooth),
        n=len(model.plant.coordinates),
        k=len(model.plant.inputs),
        bodies=np.array([first(one) for one in bodies]),
        parents=own.body_parentid.astype(np.int64),
        work=np.zeros(6 * own.nbody + 12),
        structures=model.writer.structures,
        targets=model.writer.addresses,
    )


def _timestep_address(model: mujoco.MjModel) -> int:
    """Return where the timestep is: MuJoCo's options have it at some place before gravity."""
    gravity, own, mark = model.opt.gravity.ctypes.data, model.opt.timestep, 0.123456789
    places = range(gravity - 8, model._address - 8, -8)
    model.opt.timestep = mark
    found = [place for place in places if ctypes.c_double.from_address(place).value == mark]
    model.opt.timestep = own
    if len(found) != 1:
        rule = "must keep its timestep before gravity"
        raise InvalidValueError("MuJoCo", rule, mujoco.__version__)
    return found[0]
