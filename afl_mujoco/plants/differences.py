"""A difference between equations and a tree, and what would be left of it if one were changed.

What is compared: M, h and B, or, of accelerations, the force that is left over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from afl_mujoco.plants.equations import Equations, Points, split
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.plants.tree import Terms, Tree, terms_of


class Left(NamedTuple):
    """What is left of a difference, and the mass matrices with which it is."""

    rows: Floats  # equations minus tree, scaled, one row a point
    mass: Floats  # (K, n, n), as it is where M is compared itself

    def moved(self, shares: Sequence[float] | Floats, others: Sequence[Left]) -> Left:
        """Return what shares of some changes leave; `others` are what all of each leaves."""
        rows, mass = (
            own + np.tensordot(shares, np.array(changed) - own, 1)
            for own, changed in zip(self, zip(*others, strict=True), strict=True)
        )
        return Left(rows, mass)


class Difference:
    """Equations and tree of a plant at points where they differ."""

    def __init__(
        self,
        plant: Plant,
        equations: Equations,
        tree_of: Callable[[Floats], Tree],
        bodies: Sequence[str],
        points: Points,
    ) -> None:
        self.plant, self.equations, self.tree_of, self.points = plant, equations, tree_of, points
        self.bodies = [(b, name or str(b)) for b, name in enumerate(bodies)][1:]
        self.trees = [tree_of(p) for p in points.p]
        self.theirs = equations.at(points, gaps=True)
        self.terms = self.terms_of(self.trees)
        self.scales = self.sizes()
        self.start = self.residual()

    def terms_of(
        self, trees: Sequence[Tree], v: Floats | None = None, q: Floats | None = None
    ) -> Terms:
        """Return the terms of trees at the points, stacked."""
        rates = self.points.v if v is None else v
        places = self.points.q if q is None else q
        found = [terms_of(*one) for one in zip(trees, places, rates, strict=True)]
        return Terms(*map(np.array, zip(*found, strict=True)))

    def sizes(self) -> Floats:
        """Return the size of M, h and B at each point, (K, 3); of accelerations of the forces."""
        m, h, b, _ = self.terms
        if self.plant.terms:
            parts = split(self.plant, self.theirs)
        else:
            parts = (m @ self.theirs[..., None], h, b @ self.points.u[..., None])
        found = np.array([np.abs(x).reshape(len(x), -1).max(axis=1, initial=0.0) for x in parts]).T
        if not self.plant.terms:
            found[:] = found.max(axis=1, keepdims=True)
        return np.where(found > 0.0, found, 1.0)

    def residual(self, answers: Floats | None = None, **changed: Floats) -> Left:
        """Return equations minus tree, affine in M, h and B."""
        theirs = self.theirs if answers is None else answers
        m, h, b, _ = self.terms._replace(**changed)
        if self.plant.terms:
            gaps = [x - y for x, y in zip(split(self.plant, theirs), (m, h, b), strict=True)]
            rows = [x.reshape(len(x), -1) / self.scales[:, i, None] for i, x in enumerate(gaps)]
            return Left(np.hstack(rows), self.terms.mass)
        pushed = m @ theirs[..., None] - b @ self.points.u[..., None]
        return Left((pushed[..., 0] + h) / self.scales[:, :1], m)

    def edited(self, index: Any, **change: Callable[..., Any]) -> Left:
        """Return what is left if some of each field were what functions of it and a tree return."""
        trees = []
        for tree in self.trees:
            fields = {name: getattr(tree, name).copy() for name in change}
            for name, function in change.items():
                fields[name][index] = function(fields[name][index], tree)
            trees.append(tree._replace(**fields))
        return self.left(trees)

    def left(self, trees: Sequence[Tree]) -> Left:
        """Return what is left if the trees were others."""
        return self.residual(**self.terms_of(trees)._asdict())

    def inertia(self, body: int, change: Callable[[Floats, Tree], Floats]) -> Left:
        """Return what is left with another inertia of a body, (3, 3) along the body's axes."""
        from scipy.spatial.transform import Rotation

        trees = []
        for tree in self.trees:
            inertias, quats = tree.body_inertia.copy(), tree.body_iquat.copy()
            turn = Rotation.from_quat(quats[body], scalar_first=True).as_matrix()
            moments, axes = np.linalg.eigh(change(turn * inertias[body] @ turn.T, tree))
            axes[:, 0] *= np.linalg.det(axes)
            inertias[body] = moments
            quats[body] = Rotation.from_matrix(axes).as_quat(scalar_first=True)
            trees.append(tree._replace(body_inertia=inertias, body_iquat=quats))
        return self.left(trees)

    def given(self, **changed: Floats) -> Left:
        """Return what is left if the equations were given other things."""
        return self.residual(self.equations.at(self.points._replace(**changed), gaps=True))

    def turned(self, turn: Floats, ours: Sequence[str] = ()) -> Left:
        """Return what is left if the equations were of `turn` times MuJoCo's coordinates."""
        q, v = self.points.q @ turn.T, self.points.v @ turn.T
        found = self.equations.at(self.points._replace(q=q, v=v), gaps=True)
        if not self.plant.terms:
            return self.residual(np.linalg.solve(turn, found.T).T.astype(np.float64))
        m, h, b = split(self.plant, found)
        damping = np.array([tree.dof_damping for tree in self.trees]) * ("damping" in ours)
        h = (h - damping * v) @ turn + damping * self.points.v
        parts = (turn.T @ m @ turn, h, b if "inputs" in ours else turn.T @ b)
        return self.residual(np.hstack([x.reshape(len(x), -1) for x in parts]))
