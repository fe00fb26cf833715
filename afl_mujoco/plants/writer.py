"""A plant in MuJoCo: what its parameters are in the model, written in place or compiled afresh.

The only writer of models. Absolute values go to addresses, then ``mj_setConst`` on scratch data (it
overwrites ``qpos``) refreshes what MuJoCo derives from them: a model written in place equals one
compiled afresh, number for number. MuJoCo ends the process on what it refuses there, so every row
is checked before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import AflMujocoError, FileError, InvalidValueError, UnknownNameError, told
from afl_mujoco.loading import told_of
from afl_mujoco.plants.features import (
    DISABLE,
    compare_only_what_equations_have,
    require_compiler,
    require_describable,
)
from afl_mujoco.plants.library import mujoco
from afl_mujoco.plants.plant import Floats, Plant, Shape
from afl_mujoco.values import require_finite

FIELDS = {
    "body mass": ("body_mass", 1), "body ipos": ("body_ipos", 3), "body pos": ("body_pos", 3),
    "body inertia": ("body_inertia", 3), "geom size": ("geom_size", 3), "geom pos": ("geom_pos", 3),
    "site pos": ("site_pos", 3), "joint damping": ("dof_damping", 1),
    "joint armature": ("dof_armature", 1), "joint stiffness": ("jnt_stiffness", 1),
    "joint frictionloss": ("dof_frictionloss", 1), "actuator gear": ("actuator_gear", 6),
    "option gravity": ("gravity", 3),
}  # fmt: skip
"""What can be written: field of MjModel, and how many numbers it has."""

WORLD = "world"

SMALLEST = float(mujoco.mjMINVAL)  # MuJoCo refuses masses and inertias of moving bodies below this
SAME = 1e-12  # rows from arrays and one by one agree to this: NumPy's powers round differently


class Target(NamedTuple):
    """One number of the model."""

    kind: str
    name: str
    field: str
    item: int

    def __str__(self) -> str:
        scalar = FIELDS[f"{self.kind} {self.field}"][1] == 1
        parts = (self.kind, self.name, self.field, "" if scalar else str(self.item))
        return " ".join(filter(None, parts))


NEAR = 1e-2
"""Step of the differences along a rate, as a share of the parameter: exact for polynomials up to
the fourth degree, to 1e-10 for others that are as smooth."""

FIRST, SECOND = np.array([1, -8, 0, 8, -1]) / 12.0, np.array([-1, 16, -30, 16, -1]) / 12.0
"""Differences of five values at unit steps."""

ROUNDING = 1e-13  # of what is written, within which a difference is 0

DRIFTS = {"body_pos": 0, "body_ipos": 2, "body_inertia": 4}
"""Fields whose derivatives move a body in its frame, and where they stand."""


class PlantModel:
    """A plant's MuJoCo model, at first nominal; `compared` as equations can describe it."""

    def __init__(
        self, plant: Plant, *, compared: bool = False, alter: Callable[[Any], None] | None = None
    ) -> None:
        plant.require_unchanged()
        self.plant = plant
        self.details: dict[str, float] = dict(plant.details)
        self._spec = spec = _read(plant)
        self._require_names()
        values = self._first(self._written(plant.nominal))
        self.targets, self.last = [*values], np.array([*values.values()])
        if not np.array_equal(self.rows(plant.nominal)[0], self.last):
            raise InvalidValueError("write", "must return the same for the same p, but does not")
        inertial = {("body", "mass"), ("body", "ipos"), ("body", "inertia")}
        masses = any((x.kind, x.field) in inertial or x.kind == "geom" for x in self.targets)
        require_compiler(spec, masses=masses)
        meshes = [x for x in _massive(spec) if x.type == mujoco.mjtGeom.mjGEOM_MESH]
        every = spec.compiler.inertiafromgeom == 1  # whatever <inertial> says
        self.weighs_meshes = any(every or not x.parent.explicitinertial for x in meshes)
        self._freeze_inertias()
        self.require(self.last[None])
        plain = self.compile(self.last)
        self._require_read(plain)
        self.notes = require_describable(plain)
        if compared:
            compare_only_what_equations_have(spec)
        if alter is not None:
            self._store(spec, self.last)
            alter(spec)
        self.mj_model = m = self.compile(self.last)
        self.mj_data, self._scratch = mujoco.MjData(m), mujoco.MjData(m)
        self._places = [self._place(one) for one in self.targets]
        self._base = {name: np.array(x) for name, x in self._tree_fields(m).items()}
        self._require_kept()
        self._require_parameters_used()
        # raises for a mass
        self.drift(plant.nominal[None], plant.entering[None].astype(np.float64))

    @cached_property
    def _compared(self) -> dict[str, list[str]]:
        """The fields that are compared; model.stat stays what it was, on purpose."""
        return {
            place: [x for x in dir(holder) if x[0] != "_" and _is_numbers(getattr(holder, x))]
            for place, holder in (("model", self.mj_model), ("opt", self.mj_model.opt))
        }

    def _require_names(self) -> None:
        """Raise unless coordinates and inputs are all of the MJCF's, in its order."""
        for one in self._spec.joints:
            if one.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                rule = 'must be of type "hinge" or "slide": free and ball joints are not taken yet'
                raise InvalidValueError(f"joint {one.name!r}", rule)
        for thing, given, there, kind in (
            ("coordinates", self.plant.coordinates, self._spec.joints, "joint"),
            ("inputs", self.plant.inputs, self._spec.actuators, "actuator"),
        ):
            names = tuple(one.name for one in there)
            if len(names) > len(given) and not any(names):
                rule = f"must be of <{kind}>s with names; the MJCF has {len(names)} without one"
                raise InvalidValueError(thing, rule, f"{tuple(given)}")
            known = [*filter(None, names)] or [f"the names of the {kind}s, of which none has"]
            for name in given:
                if name not in names:
                    raise UnknownNameError.among(thing, name, known)
            if tuple(given) != names:
                rule = f"must be every {kind} of the MJCF in its order, {names}"
                raise InvalidValueError(thing, rule, f"{tuple(given)}")

    def _require_read(self, m: Any) -> None:
        """Raise unless the plant knows of its MJCF what the compiler makes of it."""
        rule = "must be in the MJCF, or in a file that it includes itself: its {} is not seen"
        for i, name in enumerate(self.plant.coordinates):
            slides = m.jnt_type[i] == int(mujoco.mjtJoint.mjJNT_SLIDE)
            if (self.plant.units[name] == "m") != slides:
                raise InvalidValueError(f"joint {name!r}", rule.format("type"))
            if slides and name in self.plant.wraps:
                raise InvalidValueError("wraps", "must be hinges, which come round", repr(name))
        for i, name in enumerate(self.plant.inputs):
            own, gain = np.array([-np.inf, np.inf]), m.actuator_gainprm[i, 0] or 1.0
            for limited, ends, share in (
                (m.actuator_ctrllimited[i], m.actuator_ctrlrange[i], 1.0),
                (m.actuator_forcelimited[i], m.actuator_forcerange[i], gain),
            ):
                least, most = sorted(ends / share) if limited else own
                own = np.array([max(own[0], least), min(own[1], most)])
            if not np.array_equal(self.plant.limits[i], own):
                which = "ctrlrange or forcerange"
                raise InvalidValueError(f"actuator {name!r}", rule.format(which))

    def _written(self, values: Floats) -> Mapping[str, Any]:
        """Return what ``write`` returns for parameters, and the details of the plant."""
        if self.plant.write is None:
            return {}
        p = self.plant.named(values)
        vars(p).update(self.details)
        given = dict(vars(p))
        with told_of("write", given=p):
            found = self.plant.write(p)
        if not isinstance(found, Mapping):
            raise InvalidValueError("write", "must return a dictionary", told(found, repr)[:80])
        if vars(p).keys() != given.keys() or any(vars(p)[k] is not given[k] for k in given):
            raise InvalidValueError("write", "must not change p, but does")
        return found

    def _first(self, found: Mapping[str, Any]) -> dict[Target, float]:
        values: dict[Target, float] = {}
        for target, value in self._numbers(found):
            if target in values:
                raise InvalidValueError(f"write: {target}", "must be written once, but is twice")
            _holder(self._spec, target)  # raises if there is none
            values[target] = require_finite(f"write: {target}", value)
        return values

    def _numbers(self, found: Mapping[str, Any]) -> Iterator[tuple[Target, Any]]:
        for key, value in found.items():
            if isinstance(value, Shape):
                kind, _, name = str(key).partition(" ")
                if kind != "body" or not name:
                    raise InvalidValueError(f"write: {key!r}", 'must be "body NAME" for a shape')
                yield Target("body", name, "mass", 0), value.mass
                for field, three in (("ipos", value.center), ("inertia", value.inertia)):
                    yield from ((Target("body", name, field, i), x) for i, x in enumerate(three))
                continue
            start, length = _parsed(key)
            if length == 1:
                yield start, value
                continue
            if not isinstance(value, tuple | list | np.ndarray) or not 0 < len(value) <= length:
                rule = f"must be a tuple of {length} numbers, or have an index 0 to {length - 1}"
                raise InvalidValueError(f"write: {key!r}", rule, told(value, repr)[:80])
            if len(value) < length and start.field not in ("size", "gear"):
                raise InvalidValueError(f"write: {key!r}", f"must be {length} numbers", len(value))
            yield from ((start._replace(item=i), x) for i, x in enumerate(value))

    def _freeze_inertias(self) -> None:
        """Make explicit what is written or depends on it: then in place equals afresh."""
        spec, written = self._spec, {(one.kind, one.name) for one in self.targets}
        try:
            inferred = self.compile(np.array([]))
        except InvalidValueError as error:
            inferred, why = None, str(error)
        for name in [one.name for one in spec.bodies if ("body", one.name) in written]:
            parts = [t.field for t in self.targets if t[:2] == ("body", name) and t.field != "pos"]
            if not parts:
                continue
            body = spec.body(name)
            body.simple = 0  # mj_setConst ends the process on a body compiled as simple
            full = not np.isnan(body.fullinertia[0])
            if full and "inertia" in parts:
                rule = "must be diaginertia: one that is written is about the body's own axes"
                raise InvalidValueError(f"<inertial fullinertia> of body {name!r}", rule)
            if len(parts) == 7:  # mass, ipos and inertia
                body.iquat = (1.0, 0.0, 0.0, 0.0)
                body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            elif full or not body.explicitinertial:
                if inferred is None:
                    rule = "must have an <inertial>, or mass, ipos and inertia be written, for the"
                    raise InvalidValueError(f"body {name!r}", f"{rule} {why}")
                there = inferred.body(name)
                body.fullinertia = np.full(6, np.nan)
                body.mass, body.ipos = float(there.mass[0]), there.ipos
                body.iquat, body.inertia = there.iquat, there.inertia
            body.explicitinertial = True
        for geom in _massive(spec):
            body = geom.parent
            if ("geom", geom.name) in written and not body.explicitinertial:
                rule = "must have an <inertial>, or be written, since a geom that has its mass is"
                raise InvalidValueError(f"body {body.name!r}", rule, f"geom {geom.name!r}")

    def _place(self, target: Target) -> tuple[str, int, int]:
        """Return field of MjModel, row and column of a target."""
        field, _ = FIELDS[f"{target.kind} {target.field}"]
        if target.kind == "option":
            return field, 0, target.item
        row = getattr(self.mj_model, target.kind)(target.name).id
        joint = field.startswith("dof")
        return field, int(self.mj_model.jnt_dofadr[row]) if joint else row, target.item

    def rows(self, parameters: Floats) -> Floats:
        """Return the values of all targets, a row for each row of parameters."""
        table = np.atleast_2d(parameters)
        if not self.targets:
            return np.empty((len(table), 0))
        if len(table) == 1:
            return self._row(table[0])
        try:
            fast = self._row(table)
        except AflMujocoError:
            fast = None  # a write that knows no arrays
        seen = sorted({0, len(table) // 2, len(table) - 1})
        slow = np.array([self._row(table[i])[0] for i in seen])
        if fast is not None and np.allclose(fast[seen], slow, rtol=SAME, atol=0.0):
            return fast
        return np.array([self._row(row)[0] for row in table])

    def _row(self, values: Floats) -> Floats:
        numbers = dict(self._numbers(self._written(values)))
        if others := numbers.keys() ^ set(self.targets):
            raise InvalidValueError(f"write: {min(others)}", "must be written for every p")
        columns = np.empty((len(self.targets), 1 if values.ndim == 1 else len(values)))
        for target, column in zip(self.targets, columns, strict=True):
            try:
                column[:] = np.asarray(numbers[target], float)
            except (TypeError, ValueError):
                value = told(numbers[target], repr)[:80]
                raise InvalidValueError(f"write: {target}", "must be a number", value) from None
        return columns.T.copy()

    def drift(self, parameters: Floats, rates: Floats) -> Floats:
        """Return first and second derivatives of body_pos and body_ipos, first of inertia."""
        found = np.zeros((len(parameters), self.mj_model.nbody, 5, 3))
        size = np.maximum(np.abs(parameters), 1e-3 * np.maximum(np.abs(self.plant.nominal), 1e-3))
        with np.errstate(divide="ignore"):
            step = NEAR * (size / np.abs(rates)).min(axis=1, initial=np.inf)
        moving = np.flatnonzero(np.isfinite(step))
        if not moving.size:
            return found
        step, p, rates = step[moving, None], parameters[moving], rates[moving]
        near = np.concatenate([p + k * step * rates for k in range(-2, 3)])
        rows = self.rows(near).reshape(5, len(p), -1)
        first = np.tensordot(FIRST, rows, 1) / step
        second = np.tensordot(SECOND, rows, 1) / step**2
        rounding = ROUNDING * np.abs(rows).max(axis=0)
        first[np.abs(first) * step <= rounding] = 0.0
        second[np.abs(second) * step**2 <= rounding] = 0.0
        moved = zip(self._places, self.targets, first.T, second.T, strict=True)
        for (field, i, k), target, x, y in moved:
            if field == "body_mass" and x.any():
                rule = "must not change with a parameter whose rate enters: a mass has a jump"
                raise InvalidValueError(f"write: {target}", rule)
            if (place := DRIFTS.get(field)) is not None:
                found[moving, i, place, k] = x
                if field != "body_inertia":
                    found[moving, i, place + 1, k] = y
        return found

    def require(self, rows: Floats, parameters: Floats | None = None) -> None:
        """Raise unless MuJoCo takes every row."""
        for bad, target, rule in self._rules(rows):
            if np.any(bad):
                i = int(np.argmax(bad))
                p = self.plant.nominal if parameters is None else parameters[i]
                pairs = zip(self.plant.parameters, p, strict=True)
                at = ", ".join(f"{name} = {x:.6g}" for name, x in pairs)
                value = f"{rows[i, self.targets.index(target)]:.6g}{at and f' at {at}'}"
                raise InvalidValueError(f"write: {target}", rule, value)

    def _rules(self, rows: Floats) -> Iterator[tuple[NDArray[np.bool_], Target, str]]:
        """Yield for each rule where it is broken, by what, and its words."""
        column = {target: rows[:, i] for i, target in enumerate(self.targets)}
        for target, x in column.items():
            yield ~np.isfinite(x), target, "must be finite"
            if target.field in ("mass", "inertia"):
                yield ~(x >= SMALLEST), target, "must be positive"
            if target.field == "size":
                yield ~(x >= 0.0), target, "must not be negative"
        for target in column:
            if target.field == "inertia":
                there = self._spec.body(target.name).inertia  # of those that are not written
                whole = [column.get(target._replace(item=i), there[i]) for i in range(3)]
                a, b, c = (whole[(target.item + k) % 3] for k in (1, 2, 3))
                bad = np.broadcast_to(~(a + b >= c), len(rows))
                yield bad, target, "must be at most the sum of the other two"

    def compile(self, row: Floats) -> Any:
        """Return a model compiled afresh with a row of values, or none of them."""
        spec = self._spec.copy()
        self._store(spec, row)
        try:
            return spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            said = f"is refused: {_one_line(error)}"
            raise InvalidValueError(f"model of plant {self.plant.name!r}", said) from None

    def _store(self, spec: Any, row: Floats) -> None:
        """Write a row of values, or none of them, into a description."""
        for target, value in zip(self.targets, row, strict=False):
            holder, field = _holder(spec, target)
            new = np.array(getattr(holder, field), float)
            new[target.item if new.ndim else ()] = value
            setattr(holder, field, new if new.ndim else float(value))

    def _require_kept(self) -> None:
        """Raise if the compiler makes other numbers of what is written, at 0 of places too."""
        row = np.array([
            0.1 if one.field == "pos" and value == 0.0 else value
            for one, value in zip(self.targets, self.last, strict=True)
        ])  # fmt: skip
        moved = self.mj_model if np.array_equal(row, self.last) else self.compile(row)
        for target, value, (field, i, k) in zip(self.targets, row, self._places, strict=True):
            kept = float(_table(field, self._held(field, moved))[i, k])
            if kept != value:
                why = ": fromto, a mesh or a <frame>?" if target.kind == "geom" else ": a <frame>?"
                rule = "must be in the model as it is written, but the compiler makes it"
                rule += f" {kept:.6g}{why}"
                raise InvalidValueError(f"write: {target}", rule, f"{value:.6g}")

    def _require_parameters_used(self) -> None:
        """Raise if a parameter changes nothing that is written."""
        for k, (name, one) in enumerate(self.plant.parameters.items()):
            p = np.array([self.plant.nominal, self.plant.nominal])
            others = (x for x in (one.high, one.low) if x != one.value)
            p[1, k] = next(others, 1.001 * one.value if one.value else 1e-3)
            if np.array_equal(*self.rows(p)):
                rule = "must change something that write returns, but nothing does"
                raise InvalidValueError(f"parameter {name!r}", rule)

    def _held(self, field: str, model: Any = None) -> Any:
        holder = self.mj_model if model is None else model
        return holder.opt.gravity if field == "gravity" else getattr(holder, field)

    @property
    def addresses(self) -> NDArray[np.int64]:
        """Addresses of the targets in the model, for `library.write_row`."""
        views = ((_table(field, self._held(field)), i, k) for field, i, k in self._places)
        return np.array([x[i, k:].ctypes.data for x, i, k in views], np.int64)

    @property
    def structures(self) -> NDArray[np.int64]:
        """Addresses of the model and of the scratch data, for `library.write_row`."""
        return np.array([self.mj_model._address, self._scratch._address], np.int64)

    def write(self, row: Floats) -> None:
        """Write a row of values into the model in place, and refresh what depends on it."""
        if np.array_equal(row, self.last):
            return
        for value, (field, i, k) in zip(row, self._places, strict=True):
            _table(field, self._held(field))[i, k] = value
        mujoco.mj_setConst(self.mj_model, self._scratch)
        self.last = np.array(row)

    def move_freely(self, timestep: float) -> None:
        """Switch damping off, and let MuJoCo step by RK4 with a timestep [s]."""
        self.mj_model.dof_damping[:] = 0.0
        self.mj_model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        self.mj_model.opt.timestep = timestep

    def at(self, q: Floats, v: Floats, u: Floats) -> tuple[Floats, ...]:
        """Return M, h and B at a state, as the model is now, and the accelerations."""
        m, d = self.mj_model, self.mj_data
        n, k = m.nv, m.nu
        mass, inputs = np.zeros((n, n)), np.zeros((n, k))
        d.qpos[:], d.qvel[:] = q, v
        for i in range(k):
            d.ctrl[:] = np.eye(k)[i]
            mujoco.mj_forward(m, d)
            inputs[:, i] = d.qfrc_actuator
        d.ctrl[:] = u
        mujoco.mj_forward(m, d)
        mujoco.mj_fullM(m, d, mass)
        return mass, d.qfrc_bias - d.qfrc_passive, inputs, d.qacc.copy()

    @property
    def bodies(self) -> list[str]:
        """The names of all bodies, the world first."""
        return [self.mj_model.body(b).name for b in range(self.mj_model.nbody)]

    def differing(self, row: Floats) -> dict[str, int]:
        """Return how many numbers of each field differ from a model compiled afresh with a row."""
        fresh, found = self.compile(row), {}
        for place, names in self._compared.items():
            mine, its = (x if place == "model" else x.opt for x in (self.mj_model, fresh))
            for name in names:
                one, other = np.asarray(getattr(mine, name)), np.asarray(getattr(its, name))
                if one.tobytes() != other.tobytes() and (count := int(np.sum(one != other))):
                    found[name] = count
        return found

    def tree(self, row: Floats) -> dict[str, Any]:
        """Return the arrays of a tree: those of the MJCF, then a row; never the live model."""
        found = {name: array.copy() for name, array in self._base.items()}
        for value, (field, i, k) in zip(row, self._places, strict=True):
            if field in found:
                _table(field, found[field])[i, k] = value
        off = self.mj_model.opt.disableflags
        for flag, name in (
            (DISABLE.mjDSBL_GRAVITY, "gravity"), (DISABLE.mjDSBL_SPRING, "jnt_stiffness"),
            (DISABLE.mjDSBL_ACTUATION, "motor_gain"),
        ):  # fmt: skip
            if off & flag:
                found[name][:] = 0.0
        return found

    @staticmethod
    def _tree_fields(m: Any) -> dict[str, Any]:
        same = (
            *("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia"),
            *("jnt_axis", "jnt_pos", "dof_damping", "dof_armature", "actuator_gear"),
            *("site_pos", "site_quat"),
        )
        site = m.actuator_trntype == int(mujoco.mjtTrn.mjTRN_SITE)
        joint = m.actuator_trnid[:, 0]
        return {name: getattr(m, name) for name in same} | {
            "jnt_stiffness": np.array(m.jnt_stiffness).reshape(m.njnt, -1)[:, 0],
            "parent": m.body_parentid.astype(np.int64),
            "first_joint": m.body_jntadr.astype(np.int64),
            "joint_count": m.body_jntnum.astype(np.int64),
            "slides": (m.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE)).astype(np.int64),
            "ref": m.qpos0,
            "springref": m.qpos_spring,
            "gravity": m.opt.gravity,
            "motor_joint": np.where(site, -1, joint).astype(np.int64),
            "motor_site": np.where(site, joint, -1).astype(np.int64),
            "motor_gain": m.actuator_gainprm[:, 0],
            "site_body": m.site_bodyid.astype(np.int64),
            "drift": np.zeros((m.nbody, 5, 3)),
        }


def _massive(spec: Any) -> Iterator[Any]:
    """Yield the geoms that have a mass, but for those of the world."""
    for one in spec.geoms:
        mass = one.density if np.isnan(one.mass) else one.mass
        if mass > 0.0 and one.parent.name != WORLD:
            yield one


def _is_numbers(held: Any) -> bool:
    return isinstance(held, np.ndarray | int | float) and np.size(held) > 0


def _table(field: str, array: Any) -> Any:
    """Return an array of a field as a table with a row for each thing that has it."""
    return array.reshape(1 if field == "gravity" else len(array), -1)


@lru_cache(maxsize=1024)
def _parsed(key: Any) -> tuple[Target, int]:
    """Return the first target of a key of ``write``, and how many numbers it takes."""
    words = key.split() if isinstance(key, str) else []
    index = int(words.pop()) if len(words) > 2 and words[-1].isdecimal() else None
    kind, field = (words[0], words[-1]) if len(words) > 1 else ("", "")
    name = " ".join(words[1:-1])
    if f"{kind} {field}" not in FIELDS or (kind == "option") != (not name):
        known = [x.replace(" ", " NAME ") for x in FIELDS if not x.startswith("option")]
        raise UnknownNameError.among("write", key, ["body NAME", *known, "option gravity"])
    length = FIELDS[f"{kind} {field}"][1]
    if index is not None and index >= length:
        rule = f"must have an index below {length}" if length > 1 else "must have no index"
        raise InvalidValueError(f"write: {key!r}", rule, index)
    return Target(kind, name, field, index or 0), 1 if index is not None else length


def _holder(spec: Any, target: Target) -> tuple[Any, str]:
    if target.kind == "option":
        return spec.option, target.field
    found = getattr(spec, target.kind)(target.name)
    if found is None:
        every = getattr(spec, "bodies" if target.kind == "body" else f"{target.kind}s")
        names = [one.name for one in every if one.name and one.name != WORLD]
        raise UnknownNameError.among(f"write: {target.kind}", target.name, names)
    return found, target.field


def _read(plant: Plant) -> Any:
    path = plant.model if isinstance(plant.model, Path) else None
    if path and not path.is_file():
        raise FileError.none_at(path)
    try:
        if path:
            return mujoco.MjSpec.from_file(str(path))
        return mujoco.MjSpec.from_string(plant.model)
    except (ValueError, mujoco.FatalError) as error:
        place = str(path or f"MJCF of plant {plant.name!r}")
        raise FileError(place, f"cannot be parsed: {_one_line(error)}") from None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).removeprefix("Error: ").split())
