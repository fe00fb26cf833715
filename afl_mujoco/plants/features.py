"""What equations of a tree of hinges and slides cannot describe: refused, or left out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.library import mujoco

DISABLE, TRANSMISSION = mujoco.mjtDisableBit, mujoco.mjtTrn

SWITCHES = {
    "constraint": 'contacts alone are off by contact="disable"',
    "limit": "give no range to what should have none",
    "frictionloss": "give no frictionloss to what should have none",
    "damper": "give no damping to what should have none",
    "clampctrl": "give no ctrlrange to what should have none",
}
"""Flags of MJCF that switch off what imperfections and limits of inputs set, and what to do."""

LEFT_OUT = "left out"  # in place of a remedy: the comparison does without it, and says so

ALTERED = {
    "boundmass": "0", "boundinertia": "0", "settotalmass": "-1", "balanceinertia": "false",
    "fusestatic": "false",
}  # fmt: skip
"""Attributes of MJCF's compiler that alter what a parameter writes, with the value to give them."""


def _features(m: Any) -> tuple[tuple[str, Any, str], ...]:
    """Return features, where the model has them, and what to set; a joint's are by joint."""
    off = m.opt.disableflags
    at_site = (m.actuator_trntype == TRANSMISSION.mjTRN_SITE) & (m.actuator_trnid[:, 1] < 0)
    joints = [TRANSMISSION.mjTRN_JOINT, TRANSMISSION.mjTRN_JOINTINPARENT]
    at_joint = np.isin(m.actuator_trntype, joints)
    euler, rk4 = int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_RK4)
    own = 'set {0}="0", or give it to the joint'
    return (
        ("equality constraint", m.neq, "remove <equality>"),
        ("tendon", m.ntendon, "remove <tendon>"),
        ("flex", m.nflex, "remove <deformable>"),
        ("mocap body", m.nmocap, 'set mocap="false"'),
        ("plugin", m.nplugin, "remove <extension>"),
        ("activation state of an actuator", m.na, 'set dyntype="none"'),
        ("sleep", m.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP,
         'remove <flag sleep="enable"/>'),
        ("switched off group of actuators", m.opt.disableactuator,
         "remove <option actuatorgroupdisable>"),
        ("fluid", m.opt.density, 'set <option density="0"/>'),
        ("fluid", m.opt.viscosity, 'set <option viscosity="0"/>'),
        ("polynomial stiffness", getattr(m, "jnt_stiffnesspoly", 0), "give stiffness one number"),
        ("polynomial damping", getattr(m, "dof_dampingpoly", 0), "give damping one number"),
        ("polynomial damping of actuator", getattr(m, "actuator_dampingpoly", 0),
         "give damping one number"),
        ("servo of actuator", (m.actuator_gaintype != 0) | (m.actuator_biastype != 0),
         "use <motor>, or gaintype=fixed and biastype=none"),
        ("transmission of actuator", ~(at_joint | at_site),
         "use joint=, or site= without refsite="),
        *((f"{name} of actuator", getattr(m, f"actuator_{name}", 0), own.format(name))
          for name in ("armature", "damping", "delay")),
        ("dry friction (frictionloss)", m.dof_frictionloss, LEFT_OUT),
        ("joint limits (range)", m.jnt_limited, LEFT_OUT),
        ("limits of inputs (ctrlrange, forcerange)",
         m.actuator_ctrllimited | m.actuator_forcelimited, LEFT_OUT),
        ("limits of the actuators' force on joints (actuatorfrcrange)", m.jnt_actfrclimited,
         LEFT_OUT),
        ("gravity compensation (gravcomp)", m.body_gravcomp, LEFT_OUT),
        ("the steps of an implicit integrator", m.opt.integrator > rk4, LEFT_OUT),
        ("implicit damping of Euler's steps (eulerdamp)",
         m.dof_damping * (m.opt.integrator == euler and not off & DISABLE.mjDSBL_EULERDAMP),
         LEFT_OUT),
        ("the restart of a run that diverges (autoreset)", not off & DISABLE.mjDSBL_AUTORESET,
         LEFT_OUT),
    )  # fmt: skip


def require_describable(m: Any) -> list[str]:
    """Return what the comparison leaves out, or raise on what equations cannot describe."""
    for name, remedy in SWITCHES.items():
        if m.opt.disableflags & getattr(DISABLE, f"mjDSBL_{name.upper()}"):
            rule = f"must be left out, since it switches off what imperfections set: {remedy}"
            raise InvalidValueError(f"<flag {name}>", rule, '"disable"')
    notes = []
    for what, where, remedy in itertools.chain(_features(m), _touching(m)):
        if not np.any(where):
            continue
        if remedy == LEFT_OUT:
            notes.append(what)
            continue
        kind = what.rpartition(" ")[2]
        if kind in ("joint", "actuator") and np.ndim(where):
            what += f" {getattr(m, kind)(int(np.argwhere(where)[0, 0])).name!r}"
        raise InvalidValueError(what, f"cannot be described by equations of a tree: {remedy}")
    return notes


def _touching(m: Any) -> Iterator[tuple[str, Any, str]]:
    """Yield pairs of bodies with geoms that MuJoCo lets collide."""
    if m.opt.disableflags & DISABLE.mjDSBL_CONTACT:
        return
    pairs = [*zip(m.geom_bodyid[m.pair_geom1], m.geom_bodyid[m.pair_geom2], strict=True)]
    excluded = {frozenset((int(x) >> 16, int(x) & 0xFFFF)) for x in m.exclude_signature}
    weld, filtered = m.body_weldid, not m.opt.disableflags & DISABLE.mjDSBL_FILTERPARENT
    for one, other in itertools.combinations(range(m.ngeom), 2):
        a, b = int(m.geom_bodyid[one]), int(m.geom_bodyid[other])
        mine, its = weld[a], weld[b]
        family = weld[m.body_parentid[mine]] == its or weld[m.body_parentid[its]] == mine
        if not (
            mine == its
            or frozenset((a, b)) in excluded
            or (filtered and mine and its and family)
            or not (m.geom_contype[one] & m.geom_conaffinity[other]
                    or m.geom_contype[other] & m.geom_conaffinity[one])
        ):  # fmt: skip
            pairs.append((a, b))
    remedy = 'set contype="0" and conaffinity="0" on the geoms, or <flag contact="disable"/>'
    for a, b in pairs:
        yield f"contact of bodies {m.body(int(a)).name!r} and {m.body(int(b)).name!r}", True, remedy


def require_compiler(spec: Any, *, masses: bool) -> None:
    """Raise if the compiler would alter or ignore what is written, masses or not."""
    for name, value in ALTERED.items():
        given = getattr(spec.compiler, name)
        if given > 0:  # false, 0 and -1 leave everything as it is
            raise InvalidValueError(f"<compiler {name}>", f'must be "{value}"', f"{given:g}")
    from_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if masses and from_geoms:
        rule = 'must be "auto" or "false": masses that are written would be ignored'
        raise InvalidValueError("<compiler inertiafromgeom>", rule, '"true"')
    for joint in spec.joints:
        if np.any(joint.springdamper):
            rule = "must be given as stiffness and damping: it depends on the mass"
            raise InvalidValueError(f"<joint {joint.name!r} springdamper>", rule)


def compare_only_what_equations_have(spec: Any) -> None:
    """Switch off in a description what is left out."""
    spec.option.disableflags |= int(DISABLE.mjDSBL_LIMIT) | int(DISABLE.mjDSBL_AUTORESET)
    without_dry_friction(spec)
    for body in spec.bodies:
        body.gravcomp = 0.0
    without_limits_of_inputs(spec)


def without_dry_friction(spec: Any) -> None:
    """Switch off dry friction in a description: near rest MuJoCo's is a stiff damper."""
    spec.option.disableflags |= int(DISABLE.mjDSBL_FRICTIONLOSS)


def without_limits_of_inputs(spec: Any) -> None:
    """Let inputs be of any size in a description."""
    spec.option.disableflags |= int(DISABLE.mjDSBL_CLAMPCTRL)
    for joint in spec.joints:
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    for actuator in spec.actuators:
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
