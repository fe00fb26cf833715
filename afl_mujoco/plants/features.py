"""What equations of a tree of hinges and slides cannot describe: refused, or left out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.library import mujoco

DISABLE = mujoco.mjtDisableBit

UNSUPPORTED = {mujoco.mjtJoint.mjJNT_FREE: "free", mujoco.mjtJoint.mjJNT_BALL: "ball"}

LEFT_OUT = DISABLE.mjDSBL_LIMIT | DISABLE.mjDSBL_FRICTIONLOSS | DISABLE.mjDSBL_CLAMPCTRL
"""What a comparison of accelerations switches off: constraints and clamps, not equations."""

ALTERED = {
    "boundmass": "0", "boundinertia": "0", "settotalmass": "-1", "balanceinertia": "false",
    "fusestatic": "false",
}  # fmt: skip
"""Attributes of MJCF's compiler that alter what a parameter writes, with the value to give them."""


def require_compiler(spec: Any) -> None:
    """Raise if the compiler would alter or ignore what is written."""
    for name, value in ALTERED.items():
        given = getattr(spec.compiler, name)
        if given > 0:  # false, 0 and -1 leave everything as it is
            raise InvalidValueError(f"<compiler {name}>", f'must be "{value}"', f"{given:g}")
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        rule = 'must be "auto" or "false": masses that are written would be ignored'
        raise InvalidValueError("<compiler inertiafromgeom>", rule, '"true"')
    for joint in spec.joints:
        if np.any(joint.springdamper):
            rule = "must be given as stiffness and damping: it depends on the mass"
            raise InvalidValueError(f"<joint {joint.name!r} springdamper>", rule)


def require_describable(model: Any) -> None:
    """Raise on the first feature that the equations of a tree cannot describe."""
    for feature, remedy in itertools.chain(_things(model), _motors(model), _touching(model)):
        raise InvalidValueError(feature, f"cannot be described by equations of a tree: {remedy}")


def _things(m: Any) -> Iterator[tuple[str, str]]:
    """Yield kinds of joints, and of things beside bodies, and what to do about them."""
    for joint in range(m.njnt):
        kind = {int(x): word for x, word in UNSUPPORTED.items()}.get(int(m.jnt_type[joint]))
        if kind:
            name = m.joint(joint).name
            yield f"{kind} joint {name!r}", 'not yet; use joints of type="hinge" and "slide"'
    for count, what in (
        (m.neq, "equality constraint: remove <equality>"), (m.ntendon, "tendon: remove <tendon>"),
        (m.nflex, "flex: remove <deformable>"), (m.nmocap, 'mocap body: set mocap="false"'),
        (m.nplugin, "plugin: remove <extension>"),
        (m.na, 'activation state of an actuator: set dyntype="none"'),
    ):  # fmt: skip
        if count:
            yield tuple(what.split(": "))  # type: ignore[misc]
    for name in ("density", "viscosity"):
        if getattr(m.opt, name):
            yield "fluid", f'set <option {name}="0"/>'
    for name in ("jnt_stiffnesspoly", "dof_dampingpoly", "actuator_dampingpoly"):
        if np.any(getattr(m, name, 0)):
            word = name.partition("_")[2].removesuffix("poly")
            yield f"polynomial {word}", f"give {word} one number"


def _motors(m: Any) -> Iterator[tuple[str, str]]:
    """Yield actuators that are not a force proportional to their input."""
    transmission = mujoco.mjtTrn
    for k in range(m.nu):
        who = f"actuator {m.actuator(k).name!r}"
        if m.actuator_gaintype[k] != 0 or m.actuator_biastype[k] != 0:
            yield f"servo of {who}", "use <motor>, or gaintype=fixed and biastype=none"
        through = transmission(int(m.actuator_trntype[k]))
        at_site = through == transmission.mjTRN_SITE and m.actuator_trnid[k, 1] < 0
        if (
            through not in (transmission.mjTRN_JOINT, transmission.mjTRN_JOINTINPARENT)
            and not at_site
        ):
            yield f"transmission of {who}", "use joint=, or site= without refsite="
        for name in ("armature", "damping", "delay"):
            if np.any(getattr(m, f"actuator_{name}")[k]):
                yield f"{name} of {who}", f'set {name}="0", or give it to the joint'


def _touching(m: Any) -> Iterator[tuple[str, str]]:
    """Yield pairs of bodies that may touch."""
    for one, other in _pairs(m):
        bodies = f"{m.body(m.geom_bodyid[one]).name!r} and {m.body(m.geom_bodyid[other]).name!r}"
        remedy = 'set contype="0" and conaffinity="0" on the geoms, or <flag contact="disable"/>'
        yield f"contact of bodies {bodies}", remedy


def _pairs(m: Any) -> Iterator[tuple[int, int]]:
    """Yield pairs of geoms that MuJoCo lets collide."""
    if m.opt.disableflags & (DISABLE.mjDSBL_CONTACT | DISABLE.mjDSBL_CONSTRAINT):
        return
    yield from zip(map(int, m.pair_geom1), map(int, m.pair_geom2), strict=True)
    excluded = {frozenset((int(x) >> 16, int(x) & 0xFFFF)) for x in m.exclude_signature}
    weld, filtered = m.body_weldid, not m.opt.disableflags & DISABLE.mjDSBL_FILTERPARENT
    for one, other in itertools.combinations(range(m.ngeom), 2):
        a, b = int(m.geom_bodyid[one]), int(m.geom_bodyid[other])
        masks = m.geom_contype[one] & m.geom_conaffinity[other]
        masks |= m.geom_contype[other] & m.geom_conaffinity[one]
        parents = (
            weld[m.body_parentid[weld[a]]] == weld[b],
            weld[m.body_parentid[weld[b]]] == weld[a],
        )
        related = filtered and weld[a] and weld[b] and any(parents)
        if masks and weld[a] != weld[b] and frozenset((a, b)) not in excluded and not related:
            yield one, other


def notes_on(m: Any) -> list[str]:
    """Return what the comparison leaves out, although MuJoCo has it."""
    flags = m.opt.disableflags
    integrator, known = int(m.opt.integrator), mujoco.mjtIntegrator
    damped = np.any(m.dof_damping) and integrator == int(known.mjINT_EULER)
    limited = np.any(m.actuator_ctrllimited) or np.any(m.actuator_forcelimited)
    found = {
        "dry friction (frictionloss)": np.any(m.dof_frictionloss),
        "joint limits (range)": np.any(m.jnt_limited) and not flags & DISABLE.mjDSBL_LIMIT,
        "limits of inputs (ctrlrange, forcerange)": limited,
        "limits of the actuators' force on joints (actuatorfrcrange)": np.any(m.jnt_actfrclimited),
        "gravity compensation (gravcomp)": np.any(m.body_gravcomp),
        "the steps of an implicit integrator": integrator > int(known.mjINT_RK4),
        "implicit damping of Euler's steps (eulerdamp)": damped
        and not flags & DISABLE.mjDSBL_EULERDAMP,
        "the restart of a run that diverges (autoreset)": not flags & DISABLE.mjDSBL_AUTORESET,
    }
    return [what for what, there in found.items() if there]


def compare_only_what_equations_have(spec: Any) -> None:
    """Switch off in a description what `notes_on` says is left out."""
    spec.option.disableflags |= LEFT_OUT | DISABLE.mjDSBL_AUTORESET
    for body in spec.bodies:
        body.gravcomp = 0.0
    for joint in spec.joints:
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    for actuator in spec.actuators:
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
