"""Which of the usual mistakes explains a difference between equations and a tree, if one does.

Each suspect is a change of the tree, of what the equations are given, or one term of them. What is
linear in the change is fitted by a line through all points; a suspect is named only if hardly
anything is left of the difference, so a coincidence is no danger, and two mistakes have no name.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.plants.equations import Equations
from afl_mujoco.plants.plant import Plant
from afl_mujoco.plants.tree import Terms, Tree, terms_of

Floats = NDArray[np.float64]

EXPLAINED = 1e-6
"""What a suspect may leave of the difference."""

WORDS = {
    0.0: "is missing in", -1.0: "has the other sign in", 2.0: "is doubled in", 0.5: "is halved in",
    math.pi / 180.0: "is in degrees, not radians, in", 180.0 / math.pi: "is in degrees in",
}  # fmt: skip
"""Factors that have a name of their own."""

FRACTIONS = {k / n: f"{k}/{n}" for n in (2, 3, 4, 12) for k in (1, 2, 3, 4) if k != n}

PASSIVE = {
    "dof_damping": "damping", "jnt_stiffness": "stiffness", "dof_armature": "armature",
    "springref": "springref",
}  # fmt: skip

SCALES = (2.0, 0.5, 1e3, 1e-3, 100.0, 0.01, 180.0 / math.pi, math.pi / 180.0, -1.0, 10.0, 0.1)
"""Factors by which equations misread a parameter."""


class Points(NamedTuple):
    """Points at which equations and tree differ."""

    q: Floats  # (K, n)
    v: Floats  # (K, n)
    u: Floats  # (K, k)
    p: Floats  # (K, parameters)


class Part(NamedTuple):
    """A term: its name, and what it is in M, h and B; the rest is zero."""

    name: str
    mass: Floats  # (K, n, n)
    bias: Floats  # (K, n)
    inputs: Floats  # (K, n, k)


def name_suspect(
    plant: Plant,
    equations: Equations,
    tree_of: Callable[[Floats], Tree],
    bodies: Sequence[str],
    points: Points,
) -> str:
    """Return the mistake that explains the difference, in words; empty if none does.

    tree_of: Returns the tree for a row of parameters.
    """
    with np.errstate(all="ignore"):
        return next(_Search(plant, equations, tree_of, bodies, points).found(), "")


def _share(thing: str, c: float) -> str:
    """Return that the equations have ``1 + c`` times a thing, in words."""
    for nice, words in WORDS.items():
        if math.isclose(1.0 + c, nice, rel_tol=1e-5, abs_tol=1e-5):
            return f"{thing} {words} the equations"
    for nice, words in FRACTIONS.items():
        if math.isclose(1.0 + c, nice, rel_tol=1e-5):
            return f"{thing} is {words} of MuJoCo's in the equations"
    return f"{thing} is {1.0 + c:.6g} times MuJoCo's in the equations"


def _amount(thing: str, has: float, c: float) -> str:
    return f"{thing} is {round(has + c, 9):.6g} in the equations and {has:g} in MuJoCo"


def _about(body: str, c: float) -> str:
    if abs(abs(c) - 1.0) > 1e-5:
        return ""
    sign = "+" if c > 0 else "-"
    return f"inertia about another point: the equations have I {sign} m r^2 of body {body}"


class _Search:
    """One search through all suspects."""

    def __init__(
        self,
        plant: Plant,
        equations: Equations,
        tree_of: Callable[[Floats], Tree],
        bodies: Sequence[str],
        points: Points,
    ) -> None:
        self.plant, self.equations, self.tree_of = plant, equations, tree_of
        self.bodies, self.points = bodies, points
        self.trees = [tree_of(p) for p in points.p]
        self.theirs = self.answers(points)
        self.terms = self.terms_of(self.trees)
        self.scales = self.sizes()
        self.start = self.residual(self.theirs, self.terms)

    # What is compared: M, h and B, or, of accelerations, the force that is left over.

    def answers(self, at: Points) -> Floats:
        """Return what the equations give, (K, n (n + 1 + k)) or (K, n)."""
        return np.array([self.equations.raw(*x) for x in zip(*at, strict=True)])

    def terms_of(self, trees: Sequence[Tree], v: Floats | None = None) -> Terms:
        """Return the terms of trees at the points, stacked."""
        rates = self.points.v if v is None else v
        found = [terms_of(t, q, w) for t, q, w in zip(trees, self.points.q, rates, strict=True)]
        return Terms(*map(np.array, zip(*found, strict=True)))

    def split(self, answers: Floats) -> tuple[Floats, Floats, Floats]:
        """Return M, h and B from what equations in terms gave."""
        count, n = self.points.q.shape
        mass, bias, inputs = np.split(answers, [n * n, n * n + n], axis=1)
        return mass.reshape(count, n, n), bias, inputs.reshape(count, n, -1)

    def sizes(self) -> Floats:
        """Return the size of M, h and B at each point, (K, 3); of accelerations of the forces."""
        if self.plant.terms:
            parts = self.split(self.theirs)
        else:
            m, h, b, _ = self.terms
            parts = (m @ self.theirs[..., None], h, b @ self.points.u[..., None])
        found = np.array([np.abs(x).reshape(len(x), -1).max(axis=1, initial=0.0) for x in parts]).T
        if not self.plant.terms:
            found[:] = found.max(axis=1, keepdims=True)
        return np.where(found > 0.0, found, 1.0)

    def residual(self, answers: Floats, terms: Terms) -> Floats:
        """Return equations minus tree, scaled, one row a point; affine in M, h and B."""
        if self.plant.terms:
            parts = zip(self.split(answers), terms[:3], strict=True)
            return self.flat(*(mine - its for mine, its in parts))
        return self.force(answers, terms.mass, terms.bias, terms.inputs)

    def force(self, answers: Floats, mass: Floats, bias: Floats, inputs: Floats) -> Floats:
        """Return ``M a + h - B u``, scaled."""
        pushed = mass @ answers[..., None] - inputs @ self.points.u[..., None]
        found: Floats = (pushed[..., 0] + bias) / self.scales[:, :1]
        return found

    def flat(self, mass: Floats, bias: Floats, inputs: Floats) -> Floats:
        """Return differences of M, h and B as rows, each block by its size."""
        blocks = [x.reshape(len(x), -1) for x in (mass, bias, inputs)]
        return np.hstack([x / self.scales[:, i, None] for i, x in enumerate(blocks)])

    def explained(self, residual: Floats) -> bool:
        return bool(np.abs(residual).max() <= EXPLAINED * np.abs(self.start).max() + 1e-13)

    # The suspects, the most usual first

    def found(self) -> Iterator[str]:
        """Yield what explains the difference."""
        if not np.isfinite(self.start).all():
            return
        families = [[(say, self.change(trees)) for say, trees in one] for one in self.families()]
        for say, step in itertools.chain(*families):
            if (c := _line(self.start, step)) is not None and (said := say(c)):
                yield said
        for family in families:
            if len(family) > 1:
                yield from self.together(family)
        yield from self.lengths()
        yield from self.parameters()
        yield from self.angles()
        yield from self.exchanged()
        yield from self.stale()
        yield from self.single_terms()
        if not self.plant.terms:
            yield from self.single_accelerations()

    def change(self, trees: Sequence[Tree]) -> Floats:
        """Return what other trees change in the residual."""
        return self.residual(self.theirs, self.terms_of(trees)) - self.start

    def edited(self, field: str, index: int | None, change: Callable[..., Any]) -> list[Tree]:
        """Return the trees with a row of one field changed; index None for all of it."""
        found = []
        for tree in self.trees:
            array = getattr(tree, field).copy()
            rows = slice(None) if index is None else slice(index, index + 1)
            array[rows] = change(array[rows], tree)
            found.append(tree._replace(**{field: array}))
        return found

    def families(self) -> Iterator[list[tuple[Callable[[float], str], list[Tree]]]]:
        """Yield kinds of changes that M, h and B are linear in, one for each place of the tree."""

        def doubled(field: str, index: int | None) -> list[Tree]:
            return self.edited(field, index, lambda x, tree: 2.0 * x)

        first, inputs, names = self.trees[0], self.plant.inputs, self.plant.coordinates
        yield [(partial(_share, "gravity"), doubled("gravity", None))]
        gears = [
            (f"the gear of input {x}", doubled("actuator_gear", k)) for k, x in enumerate(inputs)
        ]
        yield [(partial(_share, thing), trees) for thing, trees in gears]
        bodies = [*enumerate(self.bodies)][1:]
        moved = [(x, self.edited("body_inertia", b, partial(_moved, b))) for b, x in bodies]
        yield [(partial(_about, name), trees) for name, trees in moved]
        inertia = [(f"the inertia of body {x}", doubled("body_inertia", b)) for b, x in bodies]
        mass = [(f"the mass of body {x}", doubled("body_mass", b)) for b, x in bodies]
        both = [
            (
                f"mass and inertia of body {name}",
                [
                    m._replace(body_inertia=i.body_inertia)
                    for m, i in zip(one[1], two[1], strict=True)
                ],
            )
            for (_, name), one, two in zip(bodies, mass, inertia, strict=True)
        ]
        for family in (inertia, mass, both):
            yield [(partial(_share, thing), trees) for thing, trees in family]
        for field, word in PASSIVE.items():
            yield [
                (
                    partial(_amount, f"{word} of {name}", getattr(first, field)[j]),
                    self.edited(field, j, lambda x, tree: x + 1.0),
                )
                for j, name in enumerate(names)
            ]

    def together(self, family: Sequence[tuple[Callable[[float], str], Floats]]) -> Iterator[str]:
        """Yield the same mistake at several places."""
        steps = np.array([step.ravel() for _, step in family]).T
        c = -np.linalg.lstsq(steps, self.start.ravel(), rcond=1e-9)[0]
        if not self.explained(self.start + (steps @ c).reshape(self.start.shape)):
            return
        said = [say(x) for (say, _), x in zip(family, c, strict=True) if abs(x) > 1e-5]
        if all(said):
            yield "; ".join(said)

    def lengths(self) -> Iterator[str]:
        """Yield changed places of bodies and of their centres of mass."""
        bodies = [*enumerate(self.bodies)][1:]
        for (b, name), factor in itertools.product(bodies, (2.0, 0.5, -1.0, 0.0)):
            for field, word in (("body_ipos", "centre of mass"), ("body_pos", "place")):
                trees = self.edited(field, b, lambda x, tree, factor=factor: factor * x)
                if self.explained(self.residual(self.theirs, self.terms_of(trees))):
                    yield _share(f"the {word} of body {name} (l for 2 l?)", factor - 1.0)
            trees = self.edited("body_ipos", b, lambda x, tree, factor=factor: factor * x)
            whole = self.edited("body_inertia", b, lambda x, tree, factor=factor: factor**2 * x)
            both = [
                t._replace(body_inertia=i.body_inertia) for t, i in zip(trees, whole, strict=True)
            ]
            if factor > 0.0 and self.explained(self.residual(self.theirs, self.terms_of(both))):
                yield _share(f"the length of body {name} (l for 2 l?)", factor - 1.0)

    def fits(self, at: Points, turn: Floats | None = None) -> bool:
        """Return whether the equations are right when given other things.

        turn: The coordinates that they are given, as a matrix times MuJoCo's.
        """
        given = self.answers(at)
        if turn is not None and self.plant.terms:
            m, h, b = self.split(given)
            parts = (turn.T @ m @ turn, h @ turn, turn.T @ b)
            given = np.hstack([x.reshape(len(x), -1) for x in parts])
        elif turn is not None:
            given = np.linalg.solve(turn, given.T).T.astype(np.float64)
        return self.explained(self.residual(given, self.terms))

    def parameters(self) -> Iterator[str]:
        """Yield parameters in other units, and exchanged ones."""
        names, at = [*self.plant.parameters], self.points
        for (k, name), factor in itertools.product(enumerate(names), SCALES):
            p = at.p.copy()
            p[:, k] *= factor
            if self.fits(at._replace(p=p)):
                said = f"the equations are right with {factor:.6g} {name}"
                yield f"parameter {name}: {said} (unit, or l for 2 l?)"
        for j, k in itertools.combinations(range(len(names)), 2):
            p = at.p.copy()
            p[:, [j, k]] = p[:, [k, j]]
            if self.fits(at._replace(p=p)):
                yield f"parameters {names[j]} and {names[k]} are exchanged in the equations"

    def angles(self) -> Iterator[str]:
        """Yield coordinates measured in another way."""
        at, n = self.points, self.points.q.shape[1]
        for i, name in enumerate(self.plant.coordinates):
            turn = np.eye(n)
            turn[i, i] = -1.0
            if self.fits(at._replace(q=at.q @ turn, v=at.v @ turn), turn):
                yield f"{name} has the other sign in the equations"
            for j, sign in itertools.product(range(n), (1.0, -1.0)):
                turn = np.eye(n)
                turn[i, j] += sign
                if i != j and self.fits(at._replace(q=at.q @ turn.T, v=at.v @ turn.T), turn):
                    of = f"{name} {'+' if sign > 0 else '-'} {self.plant.coordinates[j]}"
                    yield f"{name} of the equations is {of} of MuJoCo: relative or absolute?"
            if not self.trees[0].slides[i]:
                yield from self.angle(i, name)

    def angle(self, i: int, name: str) -> Iterator[str]:
        """Yield an angle in degrees, or from elsewhere."""
        at, own = self.points, np.eye(self.points.q.shape[1])[i]
        for factor in (180.0 / math.pi, math.pi / 180.0):
            scale = np.where(own > 0.0, factor, 1.0)
            if self.fits(at._replace(q=at.q * scale)):
                yield f"{name} is in degrees in the equations"
            if self.fits(at._replace(q=at.q * scale, v=at.v * scale)):
                yield f"{name} and its rate are in degrees in the equations"
        for quarters in (2, 1, -1):
            if self.fits(at._replace(q=at.q + quarters * math.pi / 2.0 * own)):
                yield f"{name} is measured from {90 * quarters} degrees further in the equations"

    def exchanged(self) -> Iterator[str]:
        """Yield pairs of inputs."""
        inputs = self.plant.inputs
        for j, k in itertools.combinations(range(len(inputs)), 2):
            order = np.arange(len(inputs))
            order[[j, k]] = k, j
            turned = self.terms._replace(inputs=self.terms.inputs[..., order])
            if self.explained(self.residual(self.theirs, turned)):
                yield f"inputs {inputs[j]} and {inputs[k]} are exchanged in the equations"

    def stale(self) -> Iterator[str]:
        """Yield a parameter that the equations do not read, and the constant in its place."""
        at = self.points
        for k, (name, one) in enumerate(self.plant.parameters.items()):
            moved = at.p.copy()
            moved[:, k] = 1.01 * moved[:, k] + 0.001
            if not np.array_equal(self.answers(at._replace(p=moved)), self.theirs):
                continue

            def left(x: float, k: int = k) -> float:
                fixed = at.p.copy()
                fixed[:, k] = x
                terms = self.terms_of([self.tree_of(p) for p in fixed])
                return float(np.abs(self.residual(self.theirs, terms)).max())

            low, high = float(one.low or 0.0), float(one.high or 0.0)
            value = min((one.value, _least(left, low, high)), key=left)
            if left(value) <= 1e-4 * np.abs(self.start).max():
                yield f"stale constant: the equations have {name} = {value:.6g} whatever it is"

    def parts(self) -> Iterator[Part]:
        """Yield the terms of the trees: whole, and of each body."""
        bare = [
            t._replace(dof_damping=0 * t.dof_damping, jnt_stiffness=0 * t.jnt_stiffness,
                       dof_armature=0 * t.dof_armature)
            for t in self.trees
        ]  # fmt: skip
        yield from self.parts_of("", bare)
        for b, name in [*enumerate(self.bodies)][1:]:
            alone = [
                t._replace(body_mass=_only(t.body_mass, b), body_inertia=_only(t.body_inertia, b))
                for t in bare
            ]
            yield from self.parts_of(f" of body {name}", alone)
        names, inputs = self.plant.coordinates, self.plant.inputs
        for i, k in itertools.product(range(len(names)), range(len(inputs))):
            entry = np.zeros_like(self.terms.inputs)
            entry[:, i, k] = self.terms.inputs[:, i, k]
            yield self.part(f"input {inputs[k]} on {names[i]}", inputs=entry)

    def part(self, name: str, **what: Floats) -> Part:
        """Return a part that has nothing else."""
        zero = {x: np.zeros_like(getattr(self.terms, x)) for x in ("mass", "bias", "inputs")}
        return Part(name, **{**zero, **what})

    def parts_of(self, who: str, trees: Sequence[Tree]) -> Iterator[Part]:
        """Yield gravity, velocity terms by pairs of rates, and entries of the mass matrix."""
        (count, n), v, names = self.points.v.shape, self.points.v, self.plant.coordinates
        light = [t._replace(gravity=0 * t.gravity) for t in trees]

        def at_rates(tree: Sequence[Tree], *which: int) -> Floats:
            unit = np.isin(np.arange(n), which).astype(float)
            return self.terms_of(tree, np.tile(unit, (count, 1))).bias

        yield self.part(f"gravity{who}", bias=at_rates(trees))
        alone = [at_rates(light, j) for j in range(n)]
        for j in range(n):
            yield self.part(f"{names[j]}_dot^2{who}", bias=alone[j] * v[:, [j]] ** 2)
        for i, j in itertools.combinations(range(n), 2):
            mixed = (at_rates(light, i, j) - alone[i] - alone[j]) * v[:, [i]] * v[:, [j]]
            yield self.part(f"{names[i]}_dot {names[j]}_dot{who}", bias=mixed)
        yield self.part(f"all velocity terms{who}", bias=self.terms_of(light).bias)
        mass = self.terms_of(trees).mass
        for i, j in itertools.product(range(n), repeat=2):
            entry = np.zeros_like(mass)
            entry[:, i, j] = mass[:, i, j]
            name = f"mass matrix {names[i]} {names[j]}{who}"
            yield self.part(name, mass=entry)
            if i < j:
                yield self.part(f"{name}, twice there", mass=entry + np.swapaxes(entry, 1, 2))

    def single_terms(self) -> Iterator[str]:
        """Yield one term, in all equations or in that of one coordinate."""
        for part in self.parts():
            rows = [None, *range(len(self.plant.coordinates))] if part.bias.any() else [None]
            for row in rows:
                bias = part.bias if row is None else _only(part.bias.T, row).T
                if self.plant.terms:
                    step = -self.flat(part.mass, bias, part.inputs)
                else:
                    step = self.force(self.theirs, part.mass, bias, part.inputs)
                if (c := _line(self.start, step)) is not None:
                    where = "" if row is None else f" on {self.plant.coordinates[row]}"
                    yield _share(f"the term {part.name}{where}", c)

    def single_accelerations(self) -> Iterator[str]:
        """Yield one term of one acceleration, the others being right."""
        m, h, b, _ = self.terms
        u = self.points.u[..., None]
        right = np.linalg.solve(m, b @ u - h[..., None])[..., 0].astype(np.float64)
        wrong = self.theirs - right
        size = np.abs(right).max(axis=1, keepdims=True)
        bad = np.flatnonzero(np.abs(wrong / size).max(axis=0) > 1e-9)
        shares = self.theirs / right
        if len(bad) > 1 and np.allclose(shares, shares[:, :1], rtol=1e-7):
            yield "all accelerations have one factor, which is not 1: the determinant?"
        if len(bad) != 1:
            return
        i = int(bad[0])
        name, inverse = self.plant.coordinates[i], np.linalg.inv(m)[:, i]
        if (c := _line(wrong[:, i], -right[:, i])) is not None:
            yield _share(f"the acceleration of {name}", c)
        for part in self.parts():
            pushed = part.mass @ right[..., None] - part.inputs @ u
            pieces = inverse * (pushed[..., 0] + part.bias)
            for piece in (pieces.sum(axis=1), *pieces.T):
                if (c := _line(wrong[:, i], piece)) is not None:
                    yield _share(f"the term {part.name} in the acceleration of {name}", c)


def _line(start: Floats, step: Floats) -> float | None:
    """Return c with ``start + c step = 0``, None if there is none."""
    square = float(np.sum(step * step))
    if square == 0.0 or not np.isfinite(square):
        return None
    c = -float(np.sum(start * step)) / square
    left = np.abs(start + c * step).max()
    return c if left <= EXPLAINED * np.abs(start).max() + 1e-13 else None


def _moved(body: int, inertia: Floats, tree: Tree) -> Floats:
    """Return the inertia of a body about its joint, m r^2 more."""
    joint = tree.jnt_pos[tree.first_joint[body]] if tree.joint_count[body] else np.zeros(3)
    arm = tree.body_ipos[body] - joint
    found: Floats = inertia + tree.body_mass[body] * (arm @ arm - arm * arm)
    return found


def _only(array: Floats, index: int) -> Floats:
    """Return an array with all but one row zero."""
    found = np.zeros_like(array)
    found[index] = array[index]
    return found


def _least(function: Callable[[float], float], low: float, high: float) -> float:
    """Return about where a function of one number is least."""
    from scipy.optimize import minimize_scalar

    reach = 0.1 * (high - low) or 0.1
    bounds = (low - reach, high + reach)
    found = minimize_scalar(function, bounds=bounds, method="bounded", options={"xatol": 1e-9})
    return float(found.x)
