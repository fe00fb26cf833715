"""The MuJoCo cart-pole, and the only writer of its MjModel.

Compiled loops reach MuJoCo's structures through an array of addresses and its library through
`numba.types.ExternalFunction`, so that no interpreter stands in their way.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from llvmlite import binding
from numba import types
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel, load, store
from afl_mujoco.errors import FileError, InvalidValueError, UnknownNameError
from afl_mujoco.graphics import choose_backend
from afl_mujoco.scenario.parameters import CartPoleParameters, require_positive
from afl_mujoco.scenario.realism import IDEAL, Realism
from afl_mujoco.simulation.rig.description import (
    AXIAL_SHARE,
    CART_HALF_SIZE,
    PASSIVE,
    describe,
    model_file,
    passive_arrays,
    pole_inertia,
)

choose_backend()
import mujoco  # noqa: E402  (it reads MUJOCO_GL when imported)

INTEGRATORS = {
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
"""MuJoCo's integrators by their MJCF name."""


def _load_library() -> None:
    """Make MuJoCo's C functions visible to compiled code."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco*", "mujoco.dll"):
        for library in sorted(folder.glob(pattern)):
            binding.load_library_permanently(str(library))
            return
    raise FileError(str(folder), "holds no MuJoCo library")


_load_library()
_void_model_data = types.void(types.intp, types.intp)
mj_forward = types.ExternalFunction("mj_forward", _void_model_data)
mj_reset_data = types.ExternalFunction("mj_resetData", _void_model_data)
mj_step = types.ExternalFunction("mj_step", _void_model_data)
_mj_set_const = types.ExternalFunction("mj_setConst", _void_model_data)

# Places in the array of addresses that compiled code is given.
MODEL, DATA, SCRATCH = 0, 1, 2
CART_MASS, CART_INERTIA, POLE_MASS, POLE_INERTIA, POLE_COM = 3, 4, 5, 6, 7
GEOM_HALF_LENGTH, GEOM_CENTRE, TIP, GRAVITY = 8, 9, 10, 11
Z, PHI, Z_DOT, PHI_DOT, CONTROL, PUSH, Z_DDOT, PHI_DDOT = 12, 13, 14, 15, 16, 17, 18, 19
TORQUE, SHAPE, Z_DDOT_SMOOTH, PHI_DDOT_SMOOTH = 20, 21, 22, 23


@kernel
def write_parameters(at, cart_mass, pole_mass, half_length, gravity):
    """Write every model field that depends on the parameters, then refresh the derived constants.

    Parameters
    ----------
    at
        `CartPoleModel.addresses`.
    cart_mass, pole_mass, half_length, gravity
        M, m [kg], l [m], g [m/s^2].
    """
    x2, y2, z2 = CART_HALF_SIZE[0] ** 2, CART_HALF_SIZE[1] ** 2, CART_HALF_SIZE[2] ** 2
    store(at[CART_MASS], cart_mass)
    store(at[CART_INERTIA], cart_mass * ((y2 + z2) / 3.0))
    store(at[CART_INERTIA] + 8, cart_mass * ((x2 + z2) / 3.0))
    store(at[CART_INERTIA] + 16, cart_mass * ((x2 + y2) / 3.0))
    rod = pole_mass * half_length * half_length / 3.0
    store(at[POLE_MASS], pole_mass)
    tip_share, radius = load(at[SHAPE]), load(at[SHAPE] + 8)
    across = pole_inertia(rod, pole_mass, half_length, tip_share, radius)
    store(at[POLE_INERTIA], across)
    store(at[POLE_INERTIA] + 8, across)
    store(at[POLE_INERTIA] + 16, AXIAL_SHARE * across)
    store(at[POLE_COM], (1.0 + tip_share) * half_length)
    store(at[GEOM_HALF_LENGTH], half_length)
    store(at[GEOM_CENTRE], half_length)
    store(at[TIP], 2.0 * half_length)
    store(at[GRAVITY], -gravity)
    _mj_set_const(at[MODEL], at[SCRATCH])


@kernel
def write_state(at, z, phi, z_dot, phi_dot):
    """Write the state into MjData."""
    store(at[Z], z)
    store(at[PHI], phi)
    store(at[Z_DOT], z_dot)
    store(at[PHI_DOT], phi_dot)


@kernel
def forward(at, z, phi, z_dot, phi_dot, force, push, torque=0.0):
    """Return MuJoCo's (z'', phi'') for a state, an actuator force and generalised forces."""
    write_state(at, z, phi, z_dot, phi_dot)
    store(at[CONTROL], force)
    store(at[PUSH], push)
    store(at[TORQUE], torque)
    mj_forward(at[MODEL], at[DATA])
    return load(at[Z_DDOT]), load(at[PHI_DDOT])


@kernel
def strike(at, z, phi, z_dot, phi_dot, impulse):
    """Return the jump of (z_dot, phi_dot) under an ideal impulse on the cart.

    Without friction and stops, which an impulse outruns, accelerations are linear in the force: the
    difference that the force `impulse` makes is the inverse mass matrix times the impulse.
    """
    forward(at, z, phi, z_dot, phi_dot, 0.0, impulse)
    z_with, phi_with = load(at[Z_DDOT_SMOOTH]), load(at[PHI_DDOT_SMOOTH])
    forward(at, z, phi, z_dot, phi_dot, 0.0, 0.0)
    return z_with - load(at[Z_DDOT_SMOOTH]), phi_with - load(at[PHI_DDOT_SMOOTH])


class CartPoleModel:
    """A compiled MuJoCo cart-pole whose parameters can be changed while it runs.

    Parameters
    ----------
    parameters
        The plant to compile.
    timestep
        MuJoCo's timestep [s].
    integrator
        A key of `INTEGRATORS`.
    file
        The MJCF of `models/`: ``"cartpole.xml"``, or ``"scene.xml"`` for pictures.
    edit
        Called with the `mujoco.MjSpec` before it is compiled, to add what the paper leaves out.
    realism
        Passive physics and mass distribution, on top of what `edit` adds.

    Attributes
    ----------
    mj_model, mj_data
        The compiled `mujoco.MjModel` and its `mujoco.MjData`.
    addresses
        Where compiled code finds them, shape (24,), int64.

    Raises
    ------
    AflMujocoError
        If a setting breaks its rule, or the MJCF cannot be read.
    """

    def __init__(
        self,
        parameters: CartPoleParameters,
        *,
        timestep: float = 1e-3,
        integrator: str = "RK4",
        file: str = "cartpole.xml",
        edit: Callable[[mujoco.MjSpec], None] | None = None,
        realism: Realism = IDEAL,
    ) -> None:
        if integrator not in INTEGRATORS:
            raise UnknownNameError.among("integrator", integrator, INTEGRATORS)
        path = model_file(file)
        try:
            spec = mujoco.MjSpec.from_file(str(path))
        except ValueError as error:
            raise FileError(str(path), f"is no MJCF: {error}") from None
        spec.option.timestep = require_positive("timestep", timestep)
        spec.option.integrator = INTEGRATORS[integrator]
        describe(spec, parameters)
        if edit is not None:
            edit(spec)
        try:
            self.mj_model = spec.compile()
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise InvalidValueError("MuJoCo model", f"must compile: {reason}") from None
        self.mj_data = mujoco.MjData(self.mj_model)
        self._scratch, self._shape = mujoco.MjData(self.mj_model), np.zeros(2)
        self._compiled = {name: getattr(self.mj_model, name).copy() for name in PASSIVE}
        self.drive(self.mj_data)
        if realism != IDEAL:
            self.set_realism(realism, parameters)

    def drive(self, data: mujoco.MjData) -> None:
        """Make `data` the state that compiled code reads and writes.

        Parameters
        ----------
        data
            An MjData of this model, for example that of a dm_control Physics.
        """
        self.mj_data = data
        self.addresses = _addresses(self.mj_model, data, self._scratch, self._shape)

    def set_parameters(self, parameters: CartPoleParameters) -> None:
        """Change the plant: absolute values, derived constants refreshed, state kept.

        Parameters
        ----------
        parameters
            The new plant.
        """
        p = parameters
        write_parameters(self.addresses, p.cart_mass, p.pole_mass, p.half_length, p.gravity)

    def set_realism(self, realism: Realism, parameters: CartPoleParameters) -> None:
        """Change passive physics and mass distribution: those of `realism`, and no others set here.

        Parameters
        ----------
        realism
            Damping, friction, armature and end stops are added to the model as it was compiled.
        parameters
            The plant.
        """
        joints = self.mj_model.joint("slider"), self.mj_model.joint("hinge")
        for name, array in passive_arrays(self._compiled, realism, *joints).items():
            getattr(self.mj_model, name)[:] = array
        self._shape[:] = realism.tip_mass_share, realism.pole_radius
        self.set_parameters(parameters)


def _addresses(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    scratch: mujoco.MjData,
    shape: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Return the addresses of everything that compiled code reads and writes, shape (24,)."""

    def element(array: NDArray[np.float64], *index: int) -> int:
        if array.dtype != np.float64:
            raise InvalidValueError("MuJoCo", "must be built in double precision", array.dtype)
        offset = sum(int(i) * stride for i, stride in zip(index, array.strides, strict=True))
        return int(array.ctypes.data) + offset

    cart, pole = model.body("cart").id, model.body("pole").id
    geom, tip = model.geom("pole").id, model.site("tip").id
    slider, hinge = model.joint("slider"), model.joint("hinge")
    z, phi = slider.qposadr[0], hinge.qposadr[0]
    z_dof, phi_dof = slider.dofadr[0], hinge.dofadr[0]
    addresses = [
        model._address,
        data._address,
        scratch._address,
        element(model.body_mass, cart),
        element(model.body_inertia, cart, 0),
        element(model.body_mass, pole),
        element(model.body_inertia, pole, 0),
        element(model.body_ipos, pole, 2),
        element(model.geom_size, geom, 1),
        element(model.geom_pos, geom, 2),
        element(model.site_pos, tip, 2),
        element(model.opt.gravity, 2),
        element(data.qpos, z),
        element(data.qpos, phi),
        element(data.qvel, z_dof),
        element(data.qvel, phi_dof),
        element(data.ctrl, model.actuator("force").id),
        element(data.qfrc_applied, z_dof),
        element(data.qacc, z_dof),
        element(data.qacc, phi_dof),
        element(data.qfrc_applied, phi_dof),
        element(shape, 0),
        element(data.qacc_smooth, z_dof),
        element(data.qacc_smooth, phi_dof),
    ]
    return np.array(addresses, dtype=np.int64)
