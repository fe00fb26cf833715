"""The MJCF cart-pole, and the one writer of its parameters, also while it runs."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel, load, store
from afl_mujoco.errors import FileError, InvalidValueError, UnknownNameError
from afl_mujoco.plants.library import mj_forward as mj_forward
from afl_mujoco.plants.library import mj_reset_data as mj_reset_data
from afl_mujoco.plants.library import mj_set_const
from afl_mujoco.plants.library import mj_step as mj_step
from afl_mujoco.plants.library import mujoco as mujoco
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.scenario.parameters import CartPoleParameters, PlantRange
from afl_mujoco.values import require_positive

CART_HALF_SIZE = (0.2, 0.15, 0.1)
"""Half-size of the cart's box [m]; its inertia is that of a uniform box, but it never rotates."""

POLE_RADIUS = 0.02
"""Radius of the drawn pole [m]; by default the pole of the physics is a slender rod."""

AXIAL_SHARE = 0.01
"""Inertia about the pole's own axis, about which it never rotates, as a share of that across it."""


FRICTION_SOLREF, FRICTION_SOLIMP = (0.004, 1.0), (0.99, 0.9999, 0.001, 0.5, 2.0)
"""Constraint of dry friction: below break-away the cart creeps at some 1e-5 m/s."""

STOP_SOLREF = (0.005, 1.0)
"""Constraint of the end stops [s, 1]: stiffer than MuJoCo's default, critically damped."""

PASSIVE = (
    *("dof_damping", "dof_armature", "dof_frictionloss", "dof_solref", "dof_solimp"),
    *("jnt_limited", "jnt_range", "jnt_solref"),
)
"""Fields of MjModel that hold the passive physics."""


def model_file(name: str) -> Path:
    """Return the path of a file of `models/`, in an installed wheel or in the source tree."""
    packaged = Path(str(resources.files("afl_mujoco") / "models" / name))
    return packaged if packaged.exists() else packaged.parents[2] / "models" / name


@register_jitable
def capsule_inertia(mass, half_length, radius):
    """Return the inertia across a uniform solid capsule, about its middle [kg m^2].

    mass: Its mass [kg].
    half_length, radius: Half the length of its cylinder, and the radius of cylinder and end caps
        [m].
    """
    length = 2.0 * half_length
    caps = mass * (4.0 * radius) / (4.0 * radius + 3.0 * length)  # volumes without pi r^2 / 3
    barrel = mass - caps
    return barrel * (radius * radius / 4.0 + length * length / 12.0) + caps * (
        0.4 * radius * radius + length * length / 4.0 + 0.375 * length * radius
    )


@register_jitable
def pole_inertia(rod, pole_mass, half_length, tip_share, radius):
    """Return the pole's inertia across it, about its own centre of mass [kg m^2].

    A share of the mass is a point at the tip, the rest a rod or capsule centred at `half_length`;
    the centre of mass lies at ``(1 + tip_share) half_length``.

    rod: Inertia of the whole mass as a slender rod [kg m^2], the result without share and radius.
    pole_mass, half_length: m [kg] and l [m].
    """
    if radius > 0.0:
        rod = capsule_inertia(pole_mass, half_length, radius)
    between = tip_share * (1.0 - tip_share) * pole_mass * half_length * half_length
    return (1.0 - tip_share) * rod + between


def describe(spec: Any, p: CartPoleParameters) -> None:
    """Write the parameters of the ideal plant into the description that is about to be compiled."""
    x2, y2, z2 = (half * half for half in CART_HALF_SIZE)
    rod = p.pole_mass * p.half_length * p.half_length / 3.0
    cart, pole, geom = spec.body("cart"), spec.body("pole"), spec.geom("pole")
    cart.mass = p.cart_mass
    cart.inertia = [p.cart_mass * (sum_ / 3.0) for sum_ in (y2 + z2, x2 + z2, x2 + y2)]
    pole.mass = p.pole_mass
    pole.inertia = [rod, rod, AXIAL_SHARE * rod]
    pole.ipos = [0.0, 0.0, p.half_length]
    spec.geom("cart").size = CART_HALF_SIZE
    geom.size = [POLE_RADIUS, p.half_length, 0.0]
    geom.pos = [0.0, 0.0, p.half_length]
    spec.site("tip").pos = [0.0, 0.0, 2.0 * p.half_length]
    spec.option.gravity = [0.0, 0.0, -p.gravity]


def passive_arrays(
    compiled: Mapping[str, NDArray[Any]], imperfections: Imperfections, slider: Any, hinge: Any
) -> dict[str, NDArray[Any]]:
    """Return the fields of MjModel with the passive physics of `imperfections`."""
    arrays, r = {name: array.copy() for name, array in compiled.items()}, imperfections
    z, phi = slider.dofadr[0], hinge.dofadr[0]
    arrays["dof_damping"][[z, phi]] += r.at("damping.z"), r.at("damping.phi")
    arrays["dof_armature"][[z, phi]] += r.at("armature.z"), r.at("armature.phi")
    for dof, friction in ((z, r.at("dry_friction.z")), (phi, r.at("dry_friction.phi"))):
        if friction > 0.0:
            arrays["dof_frictionloss"][dof] += friction
            arrays["dof_solref"][dof], arrays["dof_solimp"][dof] = FRICTION_SOLREF, FRICTION_SOLIMP
    if (rail := r.at("end_stops.z")) is not None:
        arrays["jnt_limited"][slider.id] = True
        arrays["jnt_range"][slider.id] = -rail, rail
        arrays["jnt_solref"][slider.id] = STOP_SOLREF
    return arrays


INTEGRATORS = {
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
"""MuJoCo's integrators by their MJCF name."""


def require_integrator(name: str) -> None:
    """Raise if MuJoCo has no such integrator."""
    if name not in INTEGRATORS:
        raise UnknownNameError.among("integrator", name, INTEGRATORS)


ADDRESSES = np.dtype(
    [
        (name, np.int64)
        for name in (
            *("model", "data", "scratch"),
            *("cart_mass", "cart_inertia", "pole_mass", "pole_inertia", "pole_com"),
            *("geom_half_length", "geom_centre", "tip", "timestep", "gravity", "shape"),
            *("z", "phi", "z_dot", "phi_dot", "control", "push", "torque"),
            *("z_ddot", "phi_ddot", "z_ddot_smooth", "phi_ddot_smooth"),
        )
    ]
)
"""Record of the addresses of MuJoCo's structures and of their numbers that compiled code uses."""


@kernel
def write_parameters(at, cart_mass, pole_mass, half_length, gravity):
    """Write every model field that depends on the parameters, then refresh the derived constants.

    cart_mass, pole_mass, half_length, gravity: M, m [kg], l [m], g [m/s^2].
    """
    x2, y2, z2 = CART_HALF_SIZE[0] ** 2, CART_HALF_SIZE[1] ** 2, CART_HALF_SIZE[2] ** 2
    store(at.cart_mass, cart_mass)
    store(at.cart_inertia, cart_mass * ((y2 + z2) / 3.0))
    store(at.cart_inertia + 8, cart_mass * ((x2 + z2) / 3.0))
    store(at.cart_inertia + 16, cart_mass * ((x2 + y2) / 3.0))
    rod = pole_mass * half_length * half_length / 3.0
    store(at.pole_mass, pole_mass)
    tip_share, radius = load(at.shape), load(at.shape + 8)
    across = pole_inertia(rod, pole_mass, half_length, tip_share, radius)
    store(at.pole_inertia, across)
    store(at.pole_inertia + 8, across)
    store(at.pole_inertia + 16, AXIAL_SHARE * across)
    store(at.pole_com, (1.0 + tip_share) * half_length)
    store(at.geom_half_length, half_length)
    store(at.geom_centre, half_length)
    store(at.tip, 2.0 * half_length)
    store(at.gravity, -gravity)
    mj_set_const(at.model, at.scratch)


@kernel
def read_state(at):
    """Return the state in MjData."""
    return load(at.z), load(at.phi), load(at.z_dot), load(at.phi_dot)


@kernel
def write_state(at, z, phi, z_dot, phi_dot):
    """Write the state into MjData."""
    store(at.z, z)
    store(at.phi, phi)
    store(at.z_dot, z_dot)
    store(at.phi_dot, phi_dot)


@kernel
def forward(at, z, phi, z_dot, phi_dot, force, push, torque=0.0):
    """Return MuJoCo's (z'', phi'') for a state, an actuator force and generalised forces."""
    write_state(at, z, phi, z_dot, phi_dot)
    store(at.control, force)
    store(at.push, push)
    store(at.torque, torque)
    mj_forward(at.model, at.data)
    return load(at.z_ddot), load(at.phi_ddot)


@kernel
def impulse_jump(at, z, phi, z_dot, phi_dot, impulse):
    """Return the jump of (z_dot, phi_dot) under an ideal impulse on the cart.

    Friction and stops do not act during an impulse. Without them accelerations are linear in the
    force: a force equal to `impulse` changes them by the inverse mass matrix times the impulse.
    """
    forward(at, z, phi, z_dot, phi_dot, 0.0, impulse)
    z_with, phi_with = load(at.z_ddot_smooth), load(at.phi_ddot_smooth)
    forward(at, z, phi, z_dot, phi_dot, 0.0, 0.0)
    return z_with - load(at.z_ddot_smooth), phi_with - load(at.phi_ddot_smooth)


class CartPoleModel:
    """A compiled MuJoCo cart-pole whose parameters can be changed while it runs.

    Parameters
    ----------
    parameters
        The plant to compile.
    timestep
        MuJoCo's timestep [s].
    integrator
        ``"RK4"``, ``"Euler"``, ``"implicit"`` or ``"implicitfast"``.
    file
        The MJCF of `models/`: ``"cartpole.xml"``, or ``"scene.xml"`` for pictures.
    edit
        Called with the `mujoco.MjSpec` before it is compiled, to add what the paper leaves out.
    imperfections
        Passive physics and mass distribution, on top of what `edit` adds.

    Attributes
    ----------
    mj_model, mj_data
        The compiled `mujoco.MjModel` and its `mujoco.MjData`.
    addresses
        Where compiled code finds them: a NumPy record.

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
        imperfections: Imperfections = IDEAL,
    ) -> None:
        require_integrator(integrator)
        path = model_file(file)
        try:
            spec = mujoco.MjSpec.from_file(str(path))
        except ValueError as error:
            raise FileError(str(path), f"is not MJCF: {error}") from None
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
        if imperfections != IDEAL:
            self.set_imperfections(imperfections, parameters)

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

    def set_imperfections(
        self, imperfections: Imperfections, parameters: CartPoleParameters
    ) -> None:
        """Change passive physics and mass distribution to those of `imperfections` alone.

        Parameters
        ----------
        imperfections
            Damping, friction, armature and end stops are added to the model as it was compiled.
        parameters
            The plant.
        """
        joints = self.mj_model.joint("z"), self.mj_model.joint("phi")
        for name, array in passive_arrays(self._compiled, imperfections, *joints).items():
            getattr(self.mj_model, name)[:] = array
        self._shape[:] = imperfections.tip_mass_share, imperfections.pole_radius
        self.set_parameters(parameters)

    def decay_rate(self, plants: PlantRange) -> float:
        """Return the fastest rate [1/s] at which damping slows a joint, where the step must follow.

        Of MuJoCo's integrators only RK4 is explicit in the damping: its steps must not be longer
        than the decay. For the others, and without damping, the rate is 0.

        Parameters
        ----------
        plants
            The plants of a run; it is fastest at one of their extremes.
        """
        model, data = self.mj_model, self._scratch
        damping = np.array(model.dof_damping)
        if model.opt.integrator != INTEGRATORS["RK4"] or not damping.any():
            return 0.0
        mass, rates = np.zeros((model.nv, model.nv)), []
        for cart_mass, half_length in itertools.product(plants.cart_mass, plants.half_length):
            p = (cart_mass, plants.pole_mass, half_length, plants.gravity)
            write_parameters(self.addresses, *p)
            mujoco.mj_resetData(model, data)
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, mass)
            rates.append(np.abs(np.linalg.eigvals(np.linalg.solve(mass, np.diag(damping)))).max())
        return float(max(rates))

    def compute_only(self, imperfections: Imperfections) -> None:
        """Disable what MuJoCo need not compute: the same bits in up to a third less time.

        Cart and pole are one tree, so there is one island of constraints at most and none to be
        found. Every other flag stays as it is, including the one that disables MuJoCo's own reset
        of a bad state.
        """
        bits, r = mujoco.mjtDisableBit, imperfections
        needless = bits.mjDSBL_SENSOR | bits.mjDSBL_CONTACT | bits.mjDSBL_ISLAND
        flags = self.mj_model.opt.disableflags | int(needless)
        constraint = int(bits.mjDSBL_CONSTRAINT)
        friction = max(r.at("dry_friction.z"), r.at("dry_friction.phi"))
        constrained = friction > 0.0 or r.at("end_stops.z") is not None
        self.mj_model.opt.disableflags = flags & ~constraint if constrained else flags | constraint


def _addresses(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    scratch: mujoco.MjData,
    shape: NDArray[np.float64],
) -> Any:
    """Return a record of the addresses of everything that compiled code reads and writes."""

    def element(array: NDArray[np.float64], *index: int) -> int:
        if array.dtype != np.float64:
            raise InvalidValueError("MuJoCo", "must be built in double precision", array.dtype)
        offset = sum(int(i) * stride for i, stride in zip(index, array.strides, strict=True))
        return int(array.ctypes.data) + offset

    cart, pole = model.body("cart").id, model.body("pole").id
    geom, tip = model.geom("pole").id, model.site("tip").id
    slider, hinge = model.joint("z"), model.joint("phi")
    z, phi = slider.qposadr[0], hinge.qposadr[0]
    z_dof, phi_dof = slider.dofadr[0], hinge.dofadr[0]
    addresses = np.zeros(1, ADDRESSES)
    places = {
        "model": model._address,
        "data": data._address,
        "scratch": scratch._address,
        "cart_mass": element(model.body_mass, cart),
        "cart_inertia": element(model.body_inertia, cart, 0),
        "pole_mass": element(model.body_mass, pole),
        "pole_inertia": element(model.body_inertia, pole, 0),
        "pole_com": element(model.body_ipos, pole, 2),
        "geom_half_length": element(model.geom_size, geom, 1),
        "geom_centre": element(model.geom_pos, geom, 2),
        "tip": element(model.site_pos, tip, 2),
        "timestep": _timestep_address(model),
        "gravity": element(model.opt.gravity, 2),
        "z": element(data.qpos, z),
        "phi": element(data.qpos, phi),
        "z_dot": element(data.qvel, z_dof),
        "phi_dot": element(data.qvel, phi_dof),
        "control": element(data.ctrl, model.actuator("force").id),
        "push": element(data.qfrc_applied, z_dof),
        "z_ddot": element(data.qacc, z_dof),
        "phi_ddot": element(data.qacc, phi_dof),
        "torque": element(data.qfrc_applied, phi_dof),
        "shape": element(shape, 0),
        "z_ddot_smooth": element(data.qacc_smooth, z_dof),
        "phi_ddot_smooth": element(data.qacc_smooth, phi_dof),
    }
    for name, address in places.items():
        addresses[name] = address
    return addresses[0]


def _timestep_address(model: mujoco.MjModel) -> int:
    """Return where the timestep is: MuJoCo's options have it at some place before gravity."""
    gravity, own, mark = model.opt.gravity.ctypes.data, model.opt.timestep, 0.123456789
    places = range(gravity - 8, model._address - 8, -8)
    model.opt.timestep = mark
    found = [place for place in places if ctypes.c_double.from_address(place).value == mark]
    model.opt.timestep = own
    if len(found) != 1:
        raise InvalidValueError(
            "MuJoCo", "must keep its timestep before gravity", mujoco.__version__
        )
    return found[0]
