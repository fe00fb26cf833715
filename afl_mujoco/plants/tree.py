"""Mass matrix, bias and inputs of a tree of hinges and slides, by our own recursion over arrays.

The second opinion on the engine, and on the writer: it reads the numbers of the MJCF and the rows
of a plant's ``write``, never a model that was written into, and knows no engine. All is in the
frame of the world, spatial vectors are (angular, linear) about its origin (R. Featherstone, Rigid
Body Dynamics Algorithms, 2008).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import jitable, kernel
from afl_mujoco.plants.plant import Floats

Whole = NDArray[np.int64]


class Tree(NamedTuple):
    """A tree of b bodies, the world first, n hinges and slides and k motors, as arrays."""

    parent: Whole  # (b,)
    first_joint: Whole  # (b,)
    joint_count: Whole  # (b,)
    body_pos: Floats  # (b, 3) [m], in the frame of the parent
    body_quat: Floats  # (b, 4)
    body_ipos: Floats  # (b, 3) [m]
    body_iquat: Floats  # (b, 4)
    body_mass: Floats  # (b,) [kg]
    body_inertia: Floats  # (b, 3) [kg m^2], about the centre of mass
    slides: Whole  # (n,), 1 for a slide, 0 for a hinge
    jnt_axis: Floats  # (n, 3)
    jnt_pos: Floats  # (n, 3) [m]
    ref: Floats  # (n,), coordinate in the configuration that the MJCF shows
    springref: Floats  # (n,), coordinate at which a spring is at rest
    jnt_stiffness: Floats  # (n,)
    dof_damping: Floats  # (n,)
    dof_armature: Floats  # (n,)
    gravity: Floats  # (3,) [m/s^2]
    motor_joint: Whole  # (k,), -1 for a motor at a site
    motor_site: Whole  # (k,), -1 for a motor of a joint
    motor_gain: Floats  # (k,), force for each unit of control, before the gear
    actuator_gear: Floats  # (k, 6)
    site_body: Whole  # (s,)
    site_pos: Floats  # (s, 3) [m]
    site_quat: Floats  # (s, 4)
    # how bodies move in their frames where parameters have rates: first and second derivatives in
    # time of body_pos and of body_ipos, and the first of body_inertia, (b, 5, 3)
    drift: Floats


@jitable
def _add(factor, vector, out):
    """Add a multiple of a vector; NumPy's array expressions take half a second each to compile."""
    for i in range(3):
        out[i] += factor * vector[i]


@jitable
def _add_turned(matrix, vector, out):
    for i in range(3):
        for j in range(3):
            out[i] += matrix[i, j] * vector[j]


@jitable
def _add_cross(a, b, out):
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] += a[j] * b[k] - a[k] * b[j]


@jitable
def _turn_by(frame, quat):
    """Replace a frame by itself times the rotation of a unit quaternion."""
    row, w = np.zeros(3), quat[0]
    for i in range(3):
        for j in range(3):
            row[j] = frame[i, j]
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            x, y, z = quat[j + 1], quat[k + 1], quat[m + 1]
            # column j of the matrix of w + (x, y, z), its axes renamed so that j is the first
            frame[i, j] = row[j] * (1.0 - 2.0 * (y * y + z * z))
            frame[i, j] += 2.0 * (row[k] * (x * y + w * z) + row[m] * (x * z - w * y))


@jitable
def _momentum(mass, moment, inertia, motion, out):
    """Fill I V, of m, m c and R I R' + m (c c 1 - c c') about the world's origin."""
    for i in range(3):
        out[0, i], out[1, i] = 0.0, mass * motion[1, i]
    _add_turned(inertia, motion[0], out[0])
    _add_cross(moment, motion[1], out[0])
    _add_cross(motion[0], moment, out[1])


@jitable
def _move_joint(tree, j, shift, frame, place, motion):
    """Move what a joint carries, and fill its motion for a unit rate, (w, velocity at 0)."""
    _add_turned(frame, tree.jnt_axis[j], motion[tree.slides[j]])
    if tree.slides[j]:
        _add(shift, motion[1], place)
        return
    arm, twist = np.zeros(3), np.zeros(4)
    _add_turned(frame, tree.jnt_pos[j], place)
    _add_cross(place, motion[0], motion[1])  # what turns about p moves the origin by p x w
    twist[0] = np.cos(0.5 * shift)
    _add(np.sin(0.5 * shift), tree.jnt_axis[j], twist[1:])
    _turn_by(frame, twist)
    _add_turned(frame, tree.jnt_pos[j], arm)
    _add(-1.0, arm, place)


@jitable
def _kinematics(tree, q, v, place, frame, motion, velocity, acceleration, owner):
    """Fill where bodies are and how they move; accelerations are those at constant rates."""
    step = np.zeros((2, 3))
    for i in range(3):
        frame[0, i, i] = 1.0
        acceleration[0, 1, i] = -tree.gravity[i]  # gravity is the world's acceleration upwards
    for b in range(1, len(tree.parent)):
        up = tree.parent[b]
        _add(1.0, place[up], place[b])
        for i in range(3):
            _add(1.0, frame[up, i], frame[b, i])
        for i in range(2):
            _add(1.0, velocity[up, i], velocity[b, i])
            _add(1.0, acceleration[up, i], acceleration[b, i])
        for i in range(2):
            _add(-1.0, step[i], step[i])
        _add_turned(frame[up], tree.drift[b, 0], step[1])  # u = R d', and u' = w x u + R d''
        _add(1.0, step[1], velocity[b, 1])
        _add_cross(velocity[up, 0], step[1], acceleration[b, 1])
        _add_turned(frame[up], tree.drift[b, 1], acceleration[b, 1])
        _add_turned(frame[up], tree.body_pos[b], place[b])
        _turn_by(frame[b], tree.body_quat[b])
        for j in range(tree.first_joint[b], tree.first_joint[b] + tree.joint_count[b]):
            owner[j] = b
            _move_joint(tree, j, q[j] - tree.ref[j], frame[b], place[b], motion[j])
            for i in range(2):
                _add(-1.0, step[i], step[i])
                _add(v[j], motion[j, i], step[i])
            # S' = V x S: the axis is carried along by what lies below it in the tree
            _add_cross(velocity[b, 0], step[0], acceleration[b, 0])
            _add_cross(velocity[b, 0], step[1], acceleration[b, 1])
            _add_cross(velocity[b, 1], step[0], acceleration[b, 1])
            for i in range(2):
                _add(1.0, step[i], velocity[b, i])


@jitable
def _move_origin(tree, place, motion, velocity, acceleration, energy):
    """Put the origin between the bodies: moments about one far away cancel to rounding."""
    middle, bodies = np.zeros(3), len(place)
    for b in range(1, bodies):
        _add(1.0 / (bodies - 1), place[b], middle)
    for b in range(1, bodies):
        _add(-1.0, middle, place[b])
        _add_cross(velocity[b, 0], middle, velocity[b, 1])
        _add_cross(acceleration[b, 0], middle, acceleration[b, 1])
        for i in range(3):
            energy[1] -= tree.gravity[i] * tree.body_mass[b] * middle[i]
    for j in range(len(motion)):
        _add_cross(motion[j, 0], middle, motion[j, 1])


@jitable
def _inertias(tree, place, frame, moment, inertia):
    """Fill the first moments and inertias of bodies about the origin."""
    for b in range(1, len(tree.parent)):
        centre, own, mass = np.zeros(3), np.zeros((3, 3)), tree.body_mass[b]
        _add(1.0, place[b], centre)
        _add_turned(frame[b], tree.body_ipos[b], centre)
        for i in range(3):
            _add(1.0, frame[b, i], own[i])
        _turn_by(own, tree.body_iquat[b])
        _add(mass, centre, moment[b])
        for i in range(3):
            for j in range(3):
                inertia[b, i, j] -= mass * centre[i] * centre[j]
                inertia[b, i, i] += mass * centre[j] * centre[j]
                for k in range(3):
                    inertia[b, i, j] += own[i, k] * tree.body_inertia[b, k] * own[j, k]


@jitable
def _forces(tree, velocity, acceleration, moment, inertia, force, energy):
    """Fill the forces I A + V x* I V that bodies need, and add the energies of bodies."""
    held = np.zeros((2, 3))
    for b in range(1, len(tree.parent)):
        mass = tree.body_mass[b]
        _momentum(mass, moment[b], inertia[b], acceleration[b], force[b])
        _momentum(mass, moment[b], inertia[b], velocity[b], held)
        for i in range(3):
            energy[0] += 0.5 * (held[0, i] * velocity[b, 0, i] + held[1, i] * velocity[b, 1, i])
            energy[1] -= tree.gravity[i] * moment[b, i]
        _add_cross(velocity[b, 0], held[0], force[b, 0])
        _add_cross(velocity[b, 1], held[1], force[b, 0])
        _add_cross(velocity[b, 0], held[1], force[b, 1])


@jitable
def _drifting(tree, frame, velocity, moment, force):
    """Add what bodies need whose centre and inertia change: m (2 w x u + R d'') and I' w."""
    for b in range(1, len(tree.parent)):
        drift, own, move = np.zeros((2, 3)), np.zeros((3, 3)), np.zeros(3)
        _add_turned(frame[b], tree.drift[b, 2], move)
        _add_cross(velocity[b, 0], move, drift[1])
        _add(1.0, drift[1], drift[1])
        _add_turned(frame[b], tree.drift[b, 3], drift[1])
        _add_cross(moment[b], drift[1], drift[0])  # m c x (2 w x u + R d'')
        _add(1.0, drift[0], force[b, 0])
        _add(tree.body_mass[b], drift[1], force[b, 1])
        for i in range(3):
            _add(1.0, frame[b, i], own[i])
        _turn_by(own, tree.body_iquat[b])
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    rate = own[i, k] * tree.drift[b, 4, k] * own[j, k]
                    force[b, 0, i] += rate * velocity[b, 0, j]


@jitable
def _carries(parent, low, high):
    """Return whether a body is another, or one that carries it."""
    while high > low:
        high = parent[high]
    return high == low


@jitable
def _power(motion, force):
    total = 0.0
    for i in range(3):
        total += motion[0, i] * force[0, i] + motion[1, i] * force[1, i]
    return total


@jitable
def _motors(tree, place, frame, motion, owner, inputs):
    """Fill B: the gear of a joint's motor, J' of the wrench of a motor at a site."""
    for k in range(len(tree.motor_joint)):
        if tree.motor_joint[k] >= 0:
            inputs[tree.motor_joint[k], k] = tree.motor_gain[k] * tree.actuator_gear[k, 0]
            continue
        site = tree.motor_site[k]
        b = tree.site_body[site]
        at, own, wrench = np.zeros(3), np.zeros((3, 3)), np.zeros((2, 3))
        _add(1.0, place[b], at)
        for i in range(3):
            _add(1.0, frame[b, i], own[i])
        _add_turned(frame[b], tree.site_pos[site], at)
        _turn_by(own, tree.site_quat[site])
        _add_turned(own, tree.actuator_gear[k, 3:], wrench[0])
        _add_turned(own, tree.actuator_gear[k, :3], wrench[1])
        _add_cross(at, wrench[1], wrench[0])  # about the origin
        for j in range(len(owner)):
            if _carries(tree.parent, owner[j], b):
                inputs[j, k] = tree.motor_gain[k] * _power(motion[j], wrench)


@jitable
def _collect(tree, q, v, motion, owner, moment, inertia, force, mass, bias, energy):
    """Fill M and h: what lies beyond a joint moves as one rigid body, and needs one force."""
    total = np.zeros(len(tree.parent))
    for b in range(len(tree.parent)):
        total[b] = tree.body_mass[b]
    for b in range(len(tree.parent) - 1, 0, -1):
        up = tree.parent[b]
        total[up] += total[b]
        _add(1.0, moment[b], moment[up])
        for i in range(3):
            _add(1.0, inertia[b, i], inertia[up, i])
        for i in range(2):
            _add(1.0, force[b, i], force[up, i])
    held = np.zeros((2, 3))
    for j in range(len(q)):
        b, stretch = owner[j], q[j] - tree.springref[j]
        bias[j] = _power(motion[j], force[b])
        bias[j] += tree.dof_damping[j] * v[j] + tree.jnt_stiffness[j] * stretch
        energy[0] += 0.5 * tree.dof_armature[j] * v[j] * v[j]
        energy[1] += 0.5 * tree.jnt_stiffness[j] * stretch * stretch
        _momentum(total[b], moment[b], inertia[b], motion[j], held)
        for i in range(j + 1):
            carried = _carries(tree.parent, owner[i], b)
            mass[i, j] = mass[j, i] = _power(motion[i], held) if carried else 0.0
        mass[j, j] += tree.dof_armature[j]


@kernel
def terms(tree, q, v, mass, bias, inputs, energy):
    """Fill M, h and B, and the two energies, which do not count where bodies drift."""
    bodies, n = len(tree.parent), len(q)
    place, frame, owner = np.zeros((bodies, 3)), np.zeros((bodies, 3, 3)), np.zeros(n, np.int64)
    motion, velocity = np.zeros((n, 2, 3)), np.zeros((bodies, 2, 3))
    acceleration, force = np.zeros((bodies, 2, 3)), np.zeros((bodies, 2, 3))
    moment, inertia = np.zeros((bodies, 3)), np.zeros((bodies, 3, 3))
    energy[0] = energy[1] = 0.0
    for i in range(inputs.size):
        inputs[i // inputs.shape[1], i % inputs.shape[1]] = 0.0
    _kinematics(tree, q, v, place, frame, motion, velocity, acceleration, owner)
    _move_origin(tree, place, motion, velocity, acceleration, energy)
    _inertias(tree, place, frame, moment, inertia)
    _forces(tree, velocity, acceleration, moment, inertia, force, energy)
    _drifting(tree, frame, velocity, moment, force)
    _motors(tree, place, frame, motion, owner, inputs)
    _collect(tree, q, v, motion, owner, moment, inertia, force, mass, bias, energy)


class Terms(NamedTuple):
    """M, h and B of ``M v' + h = B u``, and the kinetic and potential energy [J]."""

    mass: Floats  # (n, n)
    bias: Floats  # (n,)
    inputs: Floats  # (n, k)
    energy: Floats  # (2,)


def terms_of(tree: Tree, q: Floats, v: Floats) -> Terms:
    """Return the terms of a tree at a state."""
    n, k = len(q), len(tree.motor_joint)
    found = Terms(np.empty((n, n)), np.empty(n), np.empty((n, k)), np.empty(2))
    terms(tree, q, v, *found)
    return found
