"""Which of the usual mistakes explains a difference between equations and a tree, if one does.

A suspect is a way to say it, and what would be left of the difference if the tree, or what the
equations are given, were changed so. All are fitted by the same line through all points: where M, h
and B are linear in the change, any share of it may explain the difference; else only all of it. A
suspect is named only if hardly anything is left, so a coincidence is no danger, and two mistakes
have no name.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property, partial
from operator import itemgetter
from typing import Any

import numpy as np

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.plants.differences import Difference, Left
from afl_mujoco.plants.plant import Floats
from afl_mujoco.plants.tree import Tree

Said = tuple[int, str]
"""How odd a mistake is: 0 for what is missing, doubled or so, 1 for a fraction, 2 for an arbitrary
number; and what it is, empty for none."""

Suspect = tuple[str | Callable[[float], Said], Left]
"""Words for all of it, or a function of the share that explains the difference; what all of it
would leave."""

Part = tuple[str, str, Floats]
"""A term: its name, whether it is in mass, bias or inputs, and itself."""

NOTHING: Said = 0, ""
EXPLAINED, ROUNDING = 1e-6, 1e-13
"""What a suspect may leave of the difference, and of the size of the terms."""

SINGULAR = 1e-6  # share of the least singular value of M: with less, accelerations may be any

SIGN, SLOPE = "the other sign", ", or what slides has another slope"

WORDS = {
    0.0: "is missing in", -1.0: f"has {SIGN} in", 2.0: "is doubled in", 0.5: "is halved in",
    math.pi / 180.0: "is in degrees, not radians, in", 180.0 / math.pi: "is in degrees in",
}  # fmt: skip
"""Factors that have a name of their own."""

FRACTIONS = {k / n: f"{k}/{n}" for n in (12, 4, 3, 2) for k in (1, 2, 3, 4) if k != n}

ALIKE = 3  # how many mistakes are named that look alike
SMALL = 1e-5  # step of differences in time, relative to the fastest rate
MANY = 4  # coordinates up to which every set of them is tried with the other sign; of more, pairs

PASSIVE = {
    "dof_damping": "damping", "jnt_stiffness": "stiffness", "dof_armature": "armature",
    "springref": "springref",
}  # fmt: skip

SCALES = (2.0, 0.5, 1e3, 1e-3, 100.0, 0.01, 180.0 / math.pi, math.pi / 180.0, 10.0, 0.1)
"""Factors by which equations misread a parameter."""


def _share(thing: str, c: float) -> Said:
    """Return that the equations have ``1 + c`` times a thing, in words."""
    for nice, words in WORDS.items():
        if math.isclose(1.0 + c, nice, rel_tol=1e-5, abs_tol=1e-5):
            return 0, f"{thing} {words} the equations"
    for nice, words in FRACTIONS.items():
        if math.isclose(1.0 + c, nice, rel_tol=1e-5):
            return 1, f"{thing} is {words} of MuJoCo's in the equations"
    times = f"{1.0 + c:.6g}" if abs(c) > 1e-4 else f"1 {'-' if c < 0 else '+'} {abs(c):.2g}"
    return 2, f"{thing} is {times} times MuJoCo's in the equations"


def _gravity(slides: bool, c: float) -> Said:
    odd, said = _share("gravity", c)
    return odd, said + SLOPE * (slides and odd == 2)


def _inertial(thing: str, c: float) -> Said:
    return _share(thing, c) if c > -1.0 - 1e-5 else NOTHING


def _amount(thing: str, has: Floats, c: float) -> Said:
    if np.ptp(has) > 0.0:  # a parameter
        return 2, f"{thing} is {abs(c):.6g} {'more' if c > 0 else 'less'} in the equations"
    here = has[0] + c if abs(has[0] + c) > 1e-9 * abs(c) else 0.0
    if here < 0.0 and thing.startswith("armature"):
        return NOTHING
    return 2 * (here != 0.0), f"{thing} is {here:.6g} in the equations and {has[0]:g} in MuJoCo"


def _drag(name: str, other: str, c: float) -> Said:
    more = f"{c:+.6g} {other}_dot more"
    return 2, f"the equation of {name} has {more}: a relative rate in its damping"


def _about(body: str, c: float) -> Said:
    if abs(abs(c) - 1.0) > 1e-5:
        return NOTHING
    sign = "+" if c > 0 else "-"
    return 0, f"inertia about another point: the equations have I {sign} m r^2 of body {body}"


class Search(Difference):
    """One search through all suspects, at points where equations and tree differ."""

    def first(self) -> str:
        """Return the mistakes that explain the difference, in words; empty if none does.

        Where nothing varies several look alike, and where a sign or a slope does: the round numbers
        first.
        """
        if not np.isfinite(self.start.rows).all():
            return ""
        with np.errstate(all="ignore"):
            odd = sorted(self.bodily(), key=itemgetter(0))
            found = list(dict.fromkeys(said for _, said in odd))
            varies = np.ptp(self.points.p, axis=0).any()
            turned = any(SIGN in said or SLOPE in said for said in found)
            if turned or not (found and varies):
                alone = varies and not turned
                more = itertools.islice(self.further(), 1 if alone else ALIKE)
                found = list(dict.fromkeys([*found, *(said for _, said in more)]))
        again = ["the mass with"] * (len(found) > ALIKE)  # one of the two explains it, and both
        again += ["the term gravity is"] * any(said.startswith("gravity ") for said in found)
        found = [said for said in found if not said.startswith(tuple(again))]
        hint = " (parameters that vary would tell)" * (len(found) > 1 and not varies)
        return ", or ".join(found[:ALIKE]) + hint

    def bodily(self) -> Iterator[Said]:
        """Yield what explains the difference by other numbers of the tree."""
        single = self.theirs.astype(np.float32) == self.theirs
        if np.abs(self.start.rows).max() < 1e-5 and single.all():
            yield 0, "the equations are in single precision"
            return
        families = [*self.families()]
        yield from self.explaining(*families)
        for family in families:
            yield from self.together(family)
        yield from self.explaining(self.lengths(), self.exchanged(), self.frames())

    def further(self) -> Iterator[Said]:
        """Yield what else explains the difference, the most usual first."""
        families = (self.parameters(), self.angles(), self.joints(), self.unwritten())
        yield from self.explaining(*families)
        yield from self.stale()
        single: Iterator[Suspect] = (
            (partial(_share, name), self.added(field, term)) for name, field, term in self.rows
        )
        yield from self.explaining(single, self.quarters(), self.factors())
        if not self.plant.terms:
            yield from self.single_accelerations()

    def explaining(self, *families: Iterable[Suspect]) -> Iterator[Said]:
        """Yield those of the suspects that explain the difference, each by itself."""
        for say, left in itertools.chain(*families):
            yield from _explained(say, self.start, left)

    @cached_property
    def rows(self) -> list[Part]:
        """Terms in all equations and in that of one coordinate: name, where it is, itself."""
        found = []
        for name, field, whole in self.parts():
            found.append((f"the term {name}", field, whole))
            if field == "bias":
                found += [
                    (f"the term {name} on {x}", field, _only(whole, (slice(None), i)))
                    for i, x in enumerate(self.plant.coordinates)
                ]
        return found

    # The suspects

    def families(self) -> Iterator[list[Suspect]]:
        """Yield changes of the tree that M, h and B are linear in, one for each place of it."""
        share, twice, more = partial(partial, _share), partial(_times, 2.0), lambda x, tree: x + 1.0
        gravity = partial(_gravity, bool(self.trees[0].slides.any()))
        yield [(gravity, self.edited(..., gravity=twice))]
        yield [(share(f"the gear of input {name}"), self.edited(k, actuator_gear=twice))
               for k, name in enumerate(self.plant.inputs)]  # fmt: skip
        for at_joint in (True, False):
            yield [(partial(_about, name), self.inertia(b, partial(_moved, b, at_joint)))
                   for b, name in self.bodies]  # fmt: skip
        for what, fields in (
            ("the inertia", ["body_inertia"]), ("the mass", ["body_mass"]),
            ("the mass with the inertia", ["body_inertia", "body_mass"]),
        ):  # fmt: skip
            yield [(partial(_inertial, f"{what} of body {name}"),
                    self.edited(b, **dict.fromkeys(fields, twice)))
                   for b, name in self.bodies]  # fmt: skip
        whole = {"mass": "the mass matrix", "bias": "the bias", "inputs": "the input matrix"}
        for some, what in [([x], whole[x]) for x in whole] + [([*whole], "every term")]:
            if self.plant.terms:
                twofold = {x: 2.0 * getattr(self.terms, x) for x in some}
                yield [(share(what), self.residual(**twofold))]
        for field, word in PASSIVE.items():
            has = np.array([getattr(tree, field) for tree in self.trees])
            things = [f"{word} of {name}" for name in self.plant.coordinates]
            varies = np.ptp(has, axis=0) > 0.0
            yield [(share(f"the {thing}"), self.edited(j, **{field: twice}))
                   for j, thing in enumerate(things) if varies[j]]  # fmt: skip
            yield [(partial(_amount, thing, has[:, j]), self.edited(j, **{field: more}))
                   for j, thing in enumerate(things)]  # fmt: skip
        names, bias, v = self.plant.coordinates, self.terms.bias, self.points.v
        yield [(partial(_drag, names[i], names[j]),
                self.residual(bias=bias + np.outer(v[:, j], np.eye(len(names))[i])))
               for i, j in itertools.permutations(range(len(names)), 2)]  # fmt: skip

    def together(self, family: Sequence[Suspect]) -> Iterator[Said]:
        """Yield the same mistake at several places."""
        start, all_of = self.start, [left for _, left in family]
        steps = np.array([(left.rows - start.rows).ravel() for left in all_of]).T
        if steps.size == 0 or len(family) < 2:
            return
        c = -np.linalg.lstsq(steps, start.rows.ravel(), rcond=1e-9)[0]
        if _is_left(start, start.moved(c, all_of)):
            return
        said = [_said(say, x) for (say, _), x in zip(family, c, strict=True) if abs(x) > 1e-5]
        if said and all(words for _, words in said):
            yield max(odd for odd, _ in said), "; ".join(words for _, words in said)

    def lengths(self) -> Iterator[Suspect]:
        """Yield changed places of bodies and of their centres of mass."""
        for (b, name), factor in itertools.product(self.bodies, (2.0, 0.5, -1.0, 0.0)):
            by, square = partial(_times, factor), partial(_times, factor**2)
            places = {"centre of mass": {"body_ipos": by}, "place": {"body_pos": by}}
            if factor > 0.0:
                places["length"] = {"body_ipos": by, "body_inertia": square}
            for word, change in places.items():
                hint = " (l for 2 l?)" if factor > 0.0 else ""
                _, said = _share(f"the {word} of body {name}", factor - 1.0)
                yield said + hint, self.edited(b, **change)

    def frames(self) -> Iterator[Suspect]:
        """Yield other orientations of bodies, and single components of their places."""
        for b, name in self.bodies:
            for field, word in (("body_ipos", "centre of mass"), ("body_pos", "place")):
                thing = f"the {word} of body {name}"
                for i, j, order in _exchanges(3):
                    said = f"{'xyz'[i]} and {'xyz'[j]} of {thing} are exchanged in the equations"
                    yield said, self.edited(b, **{field: lambda x, tree, order=order: x[order]})
                used = np.flatnonzero(getattr(self.trees[0], field)[b])
                single = used if len(used) > 1 else used[:0]  # one alone is the whole
                for i, factor in itertools.product(single, (-1.0, 0.0, 2.0, 0.5)):
                    scale = np.where(np.arange(3) == i, factor, 1.0)
                    _, said = _share(f"{'xyz'[i]} of {thing}", factor - 1.0)
                    yield said, self.edited(b, **{field: partial(_times, scale)})
            for factor, word in ((-1.0, "have the other sign"), (0.0, "are missing")):
                said = f"the products of inertia of body {name} {word} in the equations"
                scale = np.where(np.eye(3) > 0.0, 1.0, factor)
                yield said, self.inertia(b, partial(_times, scale))
            for i, axis in enumerate("xyz"):
                scale = np.where(np.arange(3) == i, 0.0, 1.0)
                _, said = _share(f"the inertia of body {name} about its own {axis}", -1.0)
                yield said, self.edited(b, body_inertia=partial(_times, scale))
            for i, j, order in _exchanges(3):
                pair = f"{'xyz'[i]} and {'xyz'[j]}"
                said = f"the inertias of body {name} about its {pair} are exchanged"
                left = self.edited(b, body_inertia=lambda x, tree, order=order: x[order])
                yield f"{said} in the equations", left
            said = f"two products of inertia of body {name} are exchanged in the equations"
            for _, _, order in _exchanges(3):
                yield said, self.inertia(b, partial(_crossed, order))
            for field, word in (("body_quat", "frame"), ("body_iquat", "inertia")):
                back = np.array([1.0, -1.0, -1.0, -1.0])
                upright = self.edited(b, **{field: lambda x, tree: np.eye(4)[0]})
                said = f"the orientation of the {word} of body {name} is"
                yield f"{said} missing in the equations", upright
                turned = self.edited(b, **{field: partial(_times, back)})
                yield f"{said} turned back in the equations", turned

    def joints(self) -> Iterator[Suspect]:
        """Yield other axes, anchors and references of joints, and exchanged rates."""
        for j, name in enumerate(self.plant.coordinates):
            for axis in np.vstack([np.eye(3), -np.eye(3)]):
                said = f"the axis of {name} is {axis.astype(int).tolist()} in the equations"
                yield said, self.edited(j, jnt_axis=lambda x, tree, axis=axis: axis)
            said = f"the anchor of {name} is missing in the equations"
            yield said, self.edited(j, jnt_pos=partial(_times, 0.0))
            for factor, word in ((0.0, "is missing"), (-1.0, "has the other sign")):
                said = f"the ref of {name} {word} in the equations"
                yield said, self.edited(j, ref=partial(_times, factor))
        said = 'angles of the MJCF are in degrees, for want of <compiler angle="radian"/>'
        hinges = np.where(self.trees[0].slides > 0, 1.0, 180.0 / math.pi)
        turns = dict.fromkeys(("body_quat", "body_iquat", "site_quat"), _in_radians)
        angles = dict.fromkeys(("ref", "springref"), partial(_times, hinges))
        yield said, self.edited(..., **turns, **angles)
        names = self.plant.coordinates
        for j, k, order in _exchanges(len(names)):
            said = f"the rates of {names[j]} and {names[k]} are exchanged in the equations"
            yield said, self.given(v=np.ascontiguousarray(self.points.v[:, order]))

    def parameters(self) -> Iterator[Suspect]:
        """Yield parameters in other units, and exchanged ones."""
        names, p = [*self.plant.parameters], self.points.p
        for (k, name), factor in itertools.product(enumerate(names), SCALES):
            said = f"the equations are right with {factor:.6g} {name} (unit, or l for 2 l?)"
            scale = np.where(np.arange(len(names)) == k, factor, 1.0)
            yield f"parameter {name}: {said}", self.given(p=p * scale)
        for j, k, order in _exchanges(len(names)):
            said = f"parameters {names[j]} and {names[k]} are exchanged in the equations"
            yield said, self.given(p=np.ascontiguousarray(p[:, order]))

    def exchanged(self) -> Iterator[Suspect]:
        """Yield pairs of inputs."""
        inputs = self.plant.inputs
        for j, k, order in _exchanges(len(inputs)):
            said = f"inputs {inputs[j]} and {inputs[k]} are exchanged in the equations"
            yield said, self.residual(inputs=self.terms.inputs[..., order])

    def angles(self) -> Iterator[Suspect]:
        """Yield coordinates measured in another way."""
        names, q, v = self.plant.coordinates, self.points.q, self.points.v
        own = np.eye(len(names))
        for ours, some in itertools.product(self.kept(), _subsets(len(names))):
            said = f"{_all([names[i] for i in some])} the other sign in the equations"
            flip = own.copy()
            flip[some, some] = -1.0
            yield said, self.turned(flip, ours)
        for words, turn in self.turns():
            places, rates = q @ turn.T, v @ turn.T
            tried = [("", self.turned(turn, ours)) for ours in self.kept()]
            tried += [("", self.given(q=places, v=rates)), (", not its rate", self.given(q=places))]
            for part, left in (*tried, (", of rates only", self.given(v=rates))):
                yield f"{words} of MuJoCo{part}: relative or absolute", left
        for i, name in enumerate(names):
            if not self.trees[0].slides[i]:
                yield from self.angle(own[i], name)

    def kept(self) -> list[tuple[str, ...]]:
        """Return what equations of other coordinates may have of MuJoCo's all the same."""
        return [(), ("inputs",), ("damping",), ("inputs", "damping")] if self.plant.terms else [()]

    def turns(self) -> Iterator[tuple[str, Floats]]:
        """Yield sums and differences of coordinates that are taken for one of them."""
        names, own = self.plant.coordinates, np.eye(len(self.plant.coordinates))
        for i, j in itertools.permutations(range(len(names)), 2):
            for sign, word in ((1.0, "+"), (-1.0, "-")):
                of = f"{names[i]} of the equations is {names[i]} {word} {names[j]}"
                yield of, own + sign * np.outer(own[i], own[j])
        tree = self.trees[0]
        chain, places = own.copy(), zip(tree.first_joint, tree.joint_count, strict=True)
        joints = [range(first, first + count) for first, count in places]
        for b, some in enumerate(joints):
            before: list[int] = []
            while b := int(tree.parent[b]):
                before += [j for j in joints[b] if not tree.slides[j]]
            for i in (i for i in some if not tree.slides[i]):
                chain[i, before] = 1.0
        if chain.sum() > len(names) + 1.0:  # else it is one of the sums
            yield "an angle of the equations is the sum of all up to it", chain

    def angle(self, own: Floats, name: str) -> Iterator[Suspect]:
        """Yield an angle in degrees, or from elsewhere."""
        q, v = self.points.q, self.points.v
        for factor in (180.0 / math.pi, math.pi / 180.0):
            scale = np.where(own > 0.0, factor, 1.0)
            said = f"{name} is in degrees in the equations"
            yield said, self.given(q=q * scale)
            said = f"{name} and its rate are in degrees in the equations"
            yield said, self.given(q=q * scale, v=v * scale)
        for quarters in (2, 1, -1):
            said = f"{name} is measured from {90 * quarters} degrees further in the equations"
            yield said, self.given(q=q + quarters * math.pi / 2.0 * own)

    def unwritten(self) -> Iterator[Suspect]:
        """Yield what goes with a parameter in the equations, and is not written."""
        fields = {"place": "body_pos", "centre of mass": "body_ipos", "mass": "body_mass",
                  "inertia": "body_inertia"}  # fmt: skip
        for k, (parameter, one) in enumerate(self.plant.parameters.items()):
            for (b, name), (word, field) in itertools.product(self.bodies, fields.items()):
                trees = [
                    tree._replace(**{field: getattr(tree, field) + (x - 1.0) * own})
                    for tree, x in zip(self.trees, self.points.p[:, k] / one.value, strict=True)
                    for own in (_only(getattr(tree, field), b),)
                ]
                said = f"the {word} of body {name} goes with {parameter} in the equations only"
                yield f"{said}: not written", self.left(trees)

    def stale(self) -> Iterator[Said]:
        """Yield a parameter that the equations do not read, and the constant in its place."""
        for k, (name, one) in enumerate(self.plant.parameters.items()):
            p = self.points.p.copy()

            def left(x: float, k: int = k, p: Floats = p) -> float:
                p[:, k] = x
                try:
                    found = self.left([self.tree_of(row) for row in p])
                except AflMujocoError:  # nothing is written there
                    return math.inf
                return float(np.abs(found.rows).max())

            moved = p.copy()
            moved[:, k] = 1.01 * p[:, k] + 0.001
            at = self.points._replace(p=moved)
            if np.array_equal(self.equations.at(at, gaps=True), self.theirs):
                low, high = float(one.low or 0.0), float(one.high or 0.0)
                value = min((one.value, _least(left, low, high)), key=left)
                if left(value) <= 1e-4 * np.abs(self.start.rows).max():
                    told = f"the equations have {name} = {value:.6g} whatever it is"
                    yield 0, f"stale constant: {told}"

    def parts(self) -> Iterator[Part]:
        """Yield the terms of the trees: whole, and of each body."""
        bare = [t._replace(dof_damping=0.0 * t.dof_damping, jnt_stiffness=0.0 * t.jnt_stiffness,
                           dof_armature=0.0 * t.dof_armature) for t in self.trees]  # fmt: skip
        yield from self.parts_of("", bare)
        for b, name in self.bodies:
            alone = [t._replace(body_mass=_only(t.body_mass, b),
                                body_inertia=_only(t.body_inertia, b)) for t in bare]  # fmt: skip
            yield from self.parts_of(f" of body {name}", alone)
        inputs, b_ = self.plant.inputs, self.terms.inputs
        pairs = itertools.product(enumerate(self.plant.coordinates), range(len(inputs)))
        for (i, name), k in pairs:
            yield f"input {inputs[k]} on {name}", "inputs", _only(b_, (slice(None), i, k))

    def parts_of(self, who: str, trees: Sequence[Tree]) -> Iterator[Part]:
        """Yield gravity, velocity terms by pairs of rates, and entries of the mass matrix."""
        (count, n), v, names = self.points.v.shape, self.points.v, self.plant.coordinates
        light = [t._replace(gravity=0.0 * t.gravity) for t in trees]

        def at_rates(tree: Sequence[Tree], *which: int) -> Floats:
            unit = np.isin(np.arange(n), which).astype(float)
            return self.terms_of(tree, np.tile(unit, (count, 1))).bias

        yield f"gravity{who}", "bias", at_rates(trees)
        alone = [at_rates(light, j) for j in range(n)]
        for j in range(n):
            yield f"{names[j]}_dot^2{who}", "bias", alone[j] * v[:, [j]] ** 2
        for i, j in itertools.combinations(range(n), 2):
            mixed = (at_rates(light, i, j) - alone[i] - alone[j]) * v[:, [i]] * v[:, [j]]
            yield f"{names[i]}_dot {names[j]}_dot{who}", "bias", mixed
        whole, gain = self.terms_of(light).bias, self.gain(light)
        for j in range(n):
            every = whole - self.terms_of(light, v * (np.arange(n) != j)).bias
            mixed = every - alone[j] * v[:, [j]] ** 2
            yield f"all velocity terms with {names[j]}_dot{who}", "bias", every
            yield f"mixed velocity terms with {names[j]}_dot{who}", "bias", mixed
        yield f"all velocity terms{who}", "bias", whole
        yield f"M' v{who}", "bias", gain
        yield f"1/2 v (dM/dq) v{who}", "bias", whole - gain
        mass = self.terms_of(trees).mass if who else self.terms.mass  # armatures are in the whole
        for i, j in itertools.product(range(n), repeat=2):
            entry = _only(mass, (slice(None), i, j))
            name = f"mass matrix {names[i]} {names[j]}{who}"
            yield name, "mass", entry
            if i < j:
                both = f"{name} and {names[j]} {names[i]}{who}"
                yield both, "mass", entry + np.swapaxes(entry, 1, 2)

    def gain(self, trees: Sequence[Tree]) -> Floats:
        """Return M' v, by differences."""
        q, v = self.points[:2]
        step = SMALL / np.maximum(1.0, np.abs(v).max(axis=1, keepdims=True))
        ahead, back = (self.terms_of(trees, q=q + s * step * v).mass for s in (1.0, -1.0))
        return np.asarray(((ahead - back) @ v[..., None])[..., 0] / (2.0 * step))

    def added(self, field: str, term: Floats) -> Left:
        """Return what is left if the tree had one term more."""
        return self.residual(**{field: getattr(self.terms, field) + term})

    def quarters(self) -> Iterator[Suspect]:
        """Yield one term with the sine of a hinge in place of its cosine, or the other way."""
        for i, name in enumerate(self.plant.coordinates):
            for turn in () if self.trees[0].slides[i] else (0.5 * math.pi, -0.5 * math.pi):
                other = copy.copy(self)
                other.__dict__.pop("rows", None)
                q = self.points.q + turn * np.eye(len(self.plant.coordinates))[i]
                other.points = self.points._replace(q=q)
                other.terms = other.terms_of(self.trees)
                for (term, field, here), (_, _, there) in zip(self.rows, other.rows, strict=True):
                    if not np.array_equal(here, there):
                        said = f"{term} has sine and cosine of {name} exchanged in the equations"
                        yield said, self.added(field, there - here)

    def factors(self) -> Iterator[Suspect]:
        """Yield one term that has a parameter as a factor once too often, or too seldom."""
        powers = {-1.0: "is without a factor {} in", 1.0: "has {} as a factor too much in"}
        pairs = itertools.product(self.rows, enumerate(self.plant.parameters))
        for (name, field, term), (k, parameter) in pairs:
            p = self.points.p[:, k].reshape(-1, *(1 for _ in term.shape[1:]))
            for power, words in powers.items():
                said = f"{name} {words.format(parameter)} the equations"
                yield said, self.added(field, (p**power - 1.0) * term)

    def single_accelerations(self) -> Iterator[Said]:
        """Yield one term of one acceleration, the others being right."""
        m, h, b, _ = self.terms
        u = self.points.u[..., None]
        right = np.linalg.solve(m, b @ u - h[..., None])[..., 0].astype(np.float64)
        wrong = self.theirs - right
        size = np.abs(right).max(axis=1, keepdims=True)
        bad = np.flatnonzero(np.abs(wrong / size).max(axis=0) > 1e-9)
        if len(bad) != 1:
            say = partial(_share, "every acceleration")
            yield from _explained(say, _bare(wrong), _bare(wrong - right))
            shares = self.theirs / right
            if np.all(np.ptp(shares, axis=1) <= EXPLAINED * np.abs(shares - 1.0).max(axis=1)):
                yield 0, "all accelerations have one factor, which is not 1: the determinant"
            return
        i = int(bad[0])
        name, inverse, start = self.plant.coordinates[i], np.linalg.inv(m)[:, i], wrong[:, i]
        say = partial(_share, f"the acceleration of {name}")
        yield from _explained(say, _bare(start), _bare(start - right[:, i]))
        for term, field, x in self.parts():
            force = {"mass": lambda x: x @ right[..., None], "inputs": lambda x: -x @ u}
            pieces = inverse * (force[field](x)[..., 0] if field in force else x)
            say = partial(_share, f"the term {term} in the acceleration of {name}")
            for piece in (pieces.sum(axis=1), *pieces.T):
                yield from _explained(say, _bare(start), _bare(start + piece))


def _bare(rows: Floats) -> Left:
    return Left(rows, np.ones((1, 1, 1)))


def _explained(say: str | Callable[[float], Said], start: Left, left: Left) -> Iterator[Said]:
    """Yield the words for the share of a change with which nothing is left, if there is one."""
    step = left.rows - start.rows
    square = float(np.sum(step * step))
    if square > 0.0 and np.isfinite(square):
        c = -float(np.sum(start.rows * step)) / square
        if not _is_left(start, start.moved([c], [left])) and (said := _said(say, c))[1]:
            yield said


def _said(say: str | Callable[[float], Said], c: float) -> Said:
    """Return what a share of a suspect is called; of one in plain words all of it, or nothing."""
    if isinstance(say, str):
        return (0, say) if abs(c - 1.0) < 1e-5 else NOTHING
    return say(c)


def _is_left(start: Left, left: Left) -> bool:
    """Return whether something is left, or whether any accelerations would leave nothing."""
    if not np.abs(left.rows).max() <= EXPLAINED * np.abs(start.rows).max() + ROUNDING:
        return True
    root = np.sqrt(np.abs(np.diagonal(start.mass, axis1=1, axis2=2)))
    scale = root[:, :, None] * root[:, None, :]
    least = [np.linalg.svd(x / scale, compute_uv=False)[:, -1] for x in (left.mass, start.mass)]
    return not bool((least[0] >= SINGULAR * least[1]).all())


def _times(factor: float | Floats, x: Floats, tree: Tree) -> Floats:
    return factor * x


def _moved(body: int, at_joint: bool, inertia: Floats, tree: Tree) -> Floats:
    """Return the inertia of a body about its joint or the origin of its frame, m r^2 more."""
    arm = tree.body_ipos[body]
    if at_joint and tree.joint_count[body]:
        arm = arm - tree.jnt_pos[tree.first_joint[body]]
    found: Floats = inertia + tree.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return found


def _crossed(order: Sequence[int], inertia: Floats, tree: Tree) -> Floats:
    """Return an inertia with the products of axes in another order."""
    moments = np.diag(np.diag(inertia))
    return moments + (inertia - moments)[np.ix_(order, order)]


def _in_radians(quats: Floats, tree: Tree) -> Floats:
    """Return rotations by as many radians as these have degrees, about the same axes.

    Larger ones than a turn would be are not of angles of the MJCF, but of a `fullinertia`.
    """
    from scipy.spatial.transform import Rotation

    if not len(quats):
        return quats
    turns = Rotation.from_quat(quats, scalar_first=True).as_rotvec()
    small = np.linalg.norm(turns, axis=1, keepdims=True) < math.radians(2.0 * math.pi)
    turns = np.where(small, np.degrees(turns), turns)
    return np.asarray(Rotation.from_rotvec(turns).as_quat(scalar_first=True))


def _subsets(count: int) -> Iterator[list[int]]:
    for size in range(1, (count if count <= MANY else 2) + 1):
        yield from map(list, itertools.combinations(range(count), size))


def _all(names: Sequence[str]) -> str:
    return f"{names[0]} has" if len(names) == 1 else f"{' and '.join(names)} have"


def _only(array: Floats, index: Any) -> Floats:
    found = np.zeros_like(array)
    found[index] = array[index]
    return found


def _exchanges(count: int) -> Iterator[tuple[int, int, list[int]]]:
    """Yield each pair of numbers, and the order in which they are exchanged."""
    for j, k in itertools.combinations(range(count), 2):
        yield j, k, [{j: k, k: j}.get(i, i) for i in range(count)]


def _least(function: Callable[[float], float], low: float, high: float) -> float:
    from scipy.optimize import minimize_scalar

    reach = 0.1 * (high - low) or 0.1
    bounds = (low - reach, high + reach)
    found = minimize_scalar(function, bounds=bounds, method="bounded", options={"xatol": 1e-9})
    return float(found.x)
