"""Check whether the MJCF of a plant obeys its equations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import tyro

from afl_mujoco.errors import InvalidValueError, UnknownNameError, require_count, told
from afl_mujoco.plants.equations import POINTS, Points, load_equations, split
from afl_mujoco.plants.plant import Floats, Plant, load_plant
from afl_mujoco.plants.suspects import Search
from afl_mujoco.plants.tree import Tree, terms_of
from afl_mujoco.report.blocks import Block, Cell, Matrix, Report, plain
from afl_mujoco.studies.shared.contract import Progress, Study, silent

PlantName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PLANT")]

MOST = 1_000_000
LIMIT = 1e-11
"""What accelerations and terms may differ by, relative to the largest component of the point."""

ROUNDING = 30.0 * float(np.finfo(float).eps)
"""Accelerations solve for M: they may differ by this times its condition, where that is more."""

RECOMPILED = 100
"""Random parameters at which a model written in place is compared with one compiled afresh."""

SEARCHED = 16  # points at which suspects are tried
REACH = np.array([[np.pi, 5.0], [1.0, 2.0]])
"""Largest coordinate and rate that are drawn, of a hinge and of a slide, where nothing says."""

BOTH = np.array([-1.0, 1.0])

NARROW = 0.2  # range of a hinge that is hardly meant in radians
INPUT = 10.0  # largest input that is drawn of one without a ctrlrange
SINGLE = 1e-6  # relative difference by which single precision may explain it
FEW = 200  # points at which what takes finite differences is looked at
HUGE = 1e300  # in place of what is not finite, which JSON has not


@dataclass(frozen=True, kw_only=True)
class Options:
    """Check whether the MJCF of a plant obeys its equations, at any state and any parameters.

    Example: afl-mujoco check furuta.py:plant

    Compares MuJoCo, the equations and a tree reference of our own at random points, term by term
    where the equations are given in terms; then energy, and models written in place with models
    compiled afresh. Writes check.json. The exit code is 0 if everything agrees, 1 if something does
    not, 2 if the plant has what no equations of a tree can describe.
    """

    plant: PlantName = "cart-pole"
    """A plant as FILE.py:NAME or MODULE:NAME; the file is executed."""
    samples: int = 1000
    """Number of random points."""
    seed: int = 0
    """Seed of the random points."""
    box: Annotated[dict[str, tuple[float, float]], tyro.conf.arg(metavar="NAME LOW HIGH ...")] = (
        field(default_factory=dict)
    )
    """Where to draw a coordinate, rate, input or parameter, in place of its range."""


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    return Request(load_plant(options.plant), options.samples, options.seed, options.box)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One row: a quantity and the limit that it must not exceed, or must reach."""

    id: str
    quantity: str
    value: float
    limit: float
    comparison: Literal["<=", ">="] = "<="
    passed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Worst:
    """Where the difference is largest."""

    coordinate: str
    term: str
    difference: float
    q: Mapping[str, float]
    v: Mapping[str, float]
    u: Mapping[str, float]
    p: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Result:
    """A plant checked.

    Attributes
    ----------
    plant, samples, seed
        What was checked, at how many points.
    headline
        The answer: where they differ, and the usual mistake that explains it, if one does.
    verdict
        ``"pass"`` or ``"fail"``.
    model_verified
        False where there are no equations: then only engine and mutation were held against others.
        Whether all holds is `passed`.
    checks
        Rows: id, quantity, value, limit, passed.
    worst
        Coordinate, term, q, v, u and p of the largest difference.
    notes
        What the comparison leaves out, and how the equations were called.
    """

    plant: str
    samples: int
    seed: int
    headline: str
    verdict: Literal["pass", "fail"]
    model_verified: bool
    checks: tuple[Check, ...]
    worst: Worst
    notes: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return self.verdict == "pass"

    def __repr__(self) -> str:
        return f"<{self.headline}>"

    def __str__(self) -> str:
        """Return the table and the answer as text."""
        from afl_mujoco.report.terminal import to_text

        shown = report(self)
        return to_text([*shown.blocks, f"{shown.word}: {plain(shown.headline)}"])


def check(
    plant: Plant | str,
    samples: int = 1000,
    seed: int = 0,
    *,
    box: Mapping[str, tuple[float, float]] | None = None,
) -> Result:
    """Check whether a plant's MJCF obeys its equations, and whether its parameters are written.

    Parameters
    ----------
    plant
        The plant, or where it is: ``"furuta.py:plant"``.
    samples
        Number of random states, parameters and inputs.
    seed
        Seed of these.
    box
        Where to draw: bounds by the name of a coordinate, a rate, an input or a parameter. By
        default the MJCF's ranges, else hinges all around, and `Parameter.low` to `Parameter.high`.

    Returns
    -------
    Result
        ``passed``, ``model_verified``, ``checks``, ``worst`` and ``headline``; printed, the table.

    Raises
    ------
    AflMujocoError
        If the plant has what no equations of a tree can describe, or breaks a rule.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> afl.check("cart-pole", samples=100).passed
    True
    """
    found = load_plant(plant) if isinstance(plant, str) else plant
    if not isinstance(found, Plant):
        raise InvalidValueError("plant", "must be an afl.Plant", told(plant, repr))
    return run(Request(found, samples, seed, box or {}))


class Point(NamedTuple):
    """Terms of ``M v' + h = B u`` at all points, and the accelerations."""

    mass: Floats  # (N, n, n)
    bias: Floats  # (N, n)
    inputs: Floats  # (N, n, k)
    accelerations: Floats  # (N, n)


WORDS = {"mass": "mass matrix", "bias": "bias", "inputs": "input", "accelerations": "accelerations"}
"""Terms, those that say most first."""


class Request:
    """A check: what raises is found when it is made."""

    def __init__(
        self, plant: Plant, samples: int, seed: int, box: Mapping[str, tuple[float, float]]
    ) -> None:
        from afl_mujoco.plants.writer import PlantModel

        require_count("samples", samples, 1, MOST)
        require_count("seed", seed, 0, 2**32 - 1)
        self.plant, self.samples, self.seed, self.box = plant, samples, seed, box
        self.model = PlantModel(plant, compared=True)
        self.points = self.draw(samples, seed)
        if plant.signals:  # raises if one gives no number
            from afl_mujoco.simulation.trajectory import signals_of

            some = slice(0, SEARCHED)
            signals_of(plant, np.hstack(self.points[:2])[some], self.points.p[some])
        self.rows = self.model.rows(self.points.p)
        self.model.require(self.rows, self.points.p)
        self.trees = [Tree(**self.model.tree(row)) for row in self.rows]
        self.equations = self.answers = None
        if plant.has_equations:
            self.equations = load_equations(plant, self.draw(POINTS, seed + 1))
            self.answers = self.equations.at(self.points)

    def draw(self, count: int, seed: int) -> Points:
        """Return random points; those of a smaller number are the first of a larger."""
        m, plant = self.model.mj_model, self.plant
        reach = REACH[self.model.tree(self.model.last)["slides"]]
        places = np.where(m.jnt_limited[:, None], m.jnt_range, reach[:, :1] * BOTH)
        inputs = np.where(m.actuator_ctrllimited[:, None], m.actuator_ctrlrange, INPUT * BOTH)
        given = [(one.low, one.high) for one in plant.parameters.values()]
        names = (*plant.states, *plant.inputs, *plant.parameters)
        pairs = [*places, *(reach[:, 1:] * BOTH), *inputs, *given]
        bounds: dict[str, Any] = dict(zip(names, pairs, strict=True))
        for name, pair in self.box.items():
            if name not in bounds:
                raise UnknownNameError.among("box", name, bounds)
            bounds[name] = _bounds(name, pair)
        low, high = np.array(list(bounds.values()), dtype=float).T
        hinges = zip(plant.coordinates, m.jnt_limited, m.jnt_range, strict=True)
        self.narrow = {
            name: ends for name, limited, ends in hinges
            if limited and plant.units[name] == "rad" and np.ptp(ends) < NARROW
            and name not in self.box
        }  # fmt: skip
        self.drawn = ", ".join(
            f"{name} {a:.3g} to {b:.3g}" for name, (a, b) in bounds.items()
            if name not in plant.parameters or name in self.box
        )  # fmt: skip
        found = low + (high - low) * np.random.default_rng(seed).random((count, len(low)))
        n, k = len(plant.coordinates), len(plant.inputs)
        return Points(*map(np.ascontiguousarray, np.split(found, [n, 2 * n, 2 * n + k], axis=1)))

    # Three ways to the same numbers

    def engine(self) -> Point:
        """Return MuJoCo's terms, its parameters written in place."""
        found = []
        for q, v, u, row in zip(*self.points[:3], self.rows, strict=True):
            self.model.write(row)
            found.append(self.model.at(q, v, u))
        return Point(*map(np.array, zip(*found, strict=True)))

    def tree(self) -> Point:
        """Return the terms of the tree reference, from the same rows."""
        states = zip(self.trees, self.points.q, self.points.v, strict=True)
        return self.solved(*map(np.array, [*zip(*(terms_of(*x) for x in states), strict=True)][:3]))

    def solved(self, mass: Floats, bias: Floats, inputs: Floats) -> Point:
        """Add the accelerations; of singular mass matrices, which are a failure, the shortest."""
        force = inputs @ self.points.u[..., None] - bias[..., None]
        try:
            found = np.linalg.solve(mass, force)[..., 0]
        except np.linalg.LinAlgError:
            found = (np.linalg.pinv(mass) @ force)[..., 0]
        return Point(mass, bias, inputs, np.asarray(found, np.float64))

    # Rows

    def add(self, id: str, quantity: str, value: float, limit: float, least: bool = False) -> None:
        """Add a row."""
        self.checks.append(
            Check(
                id=id, quantity=quantity, limit=float(limit), comparison=">=" if least else "<=",
                value=float(np.nan_to_num(value, nan=HUGE, posinf=HUGE, neginf=-HUGE)),
                passed=bool(value >= limit if least else value <= limit),
            )
        )  # fmt: skip

    @property
    def failed(self) -> list[Check]:
        """The rows that do not hold."""
        return [one for one in self.checks if not one.passed]

    def compare(
        self, who: str, one: Point, other: Point, side: str, compared: Sequence[str]
    ) -> str:
        """Add a row for each term, and return the failed one that says most; empty if none does."""
        bad = ""
        for term in compared:
            limit = LIMIT
            if term == "accelerations":
                limit = max(LIMIT, ROUNDING * _condition(self.reference.mass))
            value = float(self.gap(term, one, other).max(initial=0.0))
            self.add(f"{side}.{term}", f"{WORDS[term]}: {who}", value, limit)
            bad = bad or (term if self.failed[-1:] == self.checks[-1:] else "")
        return bad

    def gap(self, term: str, one: Point, other: Point) -> Floats:
        """Return how far two are apart in a term, as shares of what it consists of."""
        floor = 1e-3 * (self.points.v**2).max(axis=1)  # rates alone may give nothing but rounding
        size = np.abs(self.reference.mass).max(axis=(1, 2))
        floors = {"accelerations": floor, "bias": floor * size}
        return _difference(getattr(one, term), getattr(other, term), floors.get(term, 0.0))

    def run(self, progress: Progress) -> Result:
        """Return the result: the pointwise comparison first, the rest only if it agrees."""
        self.checks: list[Check] = []
        progress("checking", 0, 3)
        self.reference, engine = self.tree(), self.engine()
        headline, worst = "", self.worst_of("accelerations", self.reference, engine)
        who = "MuJoCo against the tree"
        if bad := self.compare(who, engine, self.reference, "engine", [*WORDS]):
            worst = self.worst_of(bad, engine, self.reference)
            headline = f"{_place(worst)}: MuJoCo is not the tree of its MJCF: {self.why(worst)}"
        if self.answers is not None:
            said, place = self.with_equations(self.answers, engine)
            if not headline:
                headline, worst = said, place
        progress("checking", 1, 3)
        if looked_further := not self.failed:
            self.engine_alone(engine)
            progress("checking", 2, 3)
            self.mutation()
        progress("checking", 3, 3)
        if not headline:
            headline = next((f"{x.quantity}: {x.value:.3g}" for x in self.failed), self.good())
        notes = [f"Left out: {'; '.join(self.model.notes)}."] if self.model.notes else []
        if not looked_further:
            notes.append("Not looked at, since terms differ: energy, and models written in place.")
        notes.append(f"Drawn from {self.drawn}; other parameters from their low to their high.")
        if self.held and self.equations:
            notes.append(f"Drawn at one value, for want of low and high: {', '.join(self.held)}.")
        notes += [f"Equations: {self.equations.how}."] if self.equations else []
        return Result(
            plant=self.plant.name, samples=self.samples, seed=self.seed,
            headline=f"{self.plant.name}: {headline}", verdict="fail" if self.failed else "pass",
            model_verified=self.equations is not None, checks=tuple(self.checks), worst=worst,
            notes=tuple(notes),
        )  # fmt: skip

    def good(self) -> str:
        """Return the headline of a plant that passes."""
        moving = [name for name, one in self.plant.parameters.items() if one.rate == "enters"]
        rate = f" (rate of {', '.join(moving)}: engine only)" if moving else ""
        rate += "".join(
            f"; {name} only within {low:.3g} to {high:.3g} rad: its range, in degrees?"
            for name, (low, high) in self.narrow.items()
        )
        acting = [x for x in self.model.notes if x.startswith(("dry friction", "gravity comp"))]
        rate += f"; left out: {', '.join(acting)}" * bool(acting)
        if self.equations is None:
            return f"engine and mutation verified; model not: no equations{rate}"
        if unread := self.unread():
            rate += f"; the equations do not read {', '.join(unread)}: drawn at one value"
        largest = max(x.value for x in self.checks if x.id.startswith(("model.", "tree.")))
        return f"MuJoCo obeys the equations at {self.samples} points, to {largest:.1e}{rate}"

    @property
    def held(self) -> list[str]:
        """The parameters that are drawn at one value."""
        return [name for name, one in self.plant.parameters.items() if one.low == one.high]

    def unread(self) -> list[str]:
        """Return those of which the equations do not depend on the value."""
        found, names = [], [*self.plant.parameters]
        few = Points(*(x[:FEW] for x in self.points))
        for name in self.held:
            moved = few.p + (np.arange(len(names)) == names.index(name)) * (0.01 * few.p + 1e-3)
            assert self.equations is not None and self.answers is not None
            there = self.equations.at(few._replace(p=moved), gaps=True)
            found += [name] * bool(np.array_equal(there, self.answers[:FEW]))
        return found

    def why(self, worst: Worst) -> str:
        """Return why MuJoCo is not the tree that its MJCF describes."""
        row = self.model.rows(np.array([[*worst.p.values()]]))[0]
        self.model.write(row)
        if found := self.model.differing(row):
            return f"written in place it is another model{_fields(found)}"
        return "something in the MJCF that equations of a tree do not have?"

    def with_equations(self, answers: Floats, engine: Point) -> tuple[str, Worst]:
        """Add what equations give; return the headline where they are not the tree's, and where."""
        if self.plant.terms:
            theirs, compared = self.solved(*split(self.plant, answers)), [*WORDS]
        else:
            theirs = self.reference._replace(accelerations=answers)
            compared = ["accelerations"]
        bad = self.compare("equations against MuJoCo", theirs, engine, "model", ["accelerations"])
        other = self.compare("equations against the tree", theirs, self.reference, "tree", compared)
        if self.plant.terms:
            self.invariants(theirs.mass)
        worst = self.worst_of(other or "accelerations", theirs, self.reference if other else engine)
        if not (bad or other):
            return "", worst  # what an invariant says has words of its own
        if other and (suspect := self.suspect(self.gap(other, theirs, self.reference))):
            return f"{_place(worst)}: {suspect}?", worst
        most = f"up to {worst.difference:.2g} of the largest component"
        others = (x.quantity for x in self.failed if "." not in x.id)
        broken = next((f"; this fails too: {x}" for x in others), "")
        return f"{_place(worst)}: equations and MJCF differ by {most}{broken}", worst

    def suspect(self, gap: Floats) -> str:
        """Return the usual mistake that explains the difference, tried where it is large or not."""
        if self.model.weighs_meshes and gap.max() < SINGLE:
            return "MuJoCo keeps meshes in single precision: give their bodies an <inertial>"
        most = np.argsort(-gap.reshape(len(gap), -1).max(axis=1))[: SEARCHED // 2]
        few = np.unique([*most, *np.linspace(0, len(gap) - 1, SEARCHED // 2).astype(int)])
        assert self.equations is not None
        return Search(
            self.plant, self.equations, lambda p: Tree(**self.model.tree(self.model.rows(p)[0])),
            self.model.bodies, Points(*(x[few] for x in self.points)),
        ).first()  # fmt: skip

    def worst_of(self, term: str, one: Point, other: Point) -> Worst:
        """Return where two differ most in a term, and in which coordinate."""
        gaps = self.gap(term, one, other)
        i = int(np.argmax(gaps.reshape(len(gaps), -1).max(axis=1)))
        gap, here = gaps[i], gaps[i].reshape(len(gaps[i]), -1).max(axis=1, initial=0.0)
        j = int(np.argmax(here))
        if term == "mass" and np.diag(gap).max() >= 0.5 * gap.max():
            # an inertia is in every row below its joint: the last one names it
            j = int(np.flatnonzero(np.diag(gap) >= 0.5 * gap.max())[-1])
        plant = self.plant
        names = (plant.coordinates, plant.coordinates, plant.inputs, [*plant.parameters])
        places = zip(Points._fields, names, self.points, strict=True)
        at = {x: dict(zip(some, map(float, rows[i]), strict=True)) for x, some, rows in places}
        most = float(np.nan_to_num(here[j], nan=HUGE, posinf=HUGE))
        return Worst(coordinate=plant.coordinates[j], term=WORDS[term], difference=most, **at)

    # What does not need a second model

    def invariants(self, m: Floats) -> None:
        """Add what holds of any mass matrix and any velocity terms."""
        swapped = np.swapaxes(m, 1, 2)
        apart = float(_difference(m, swapped).max())
        self.add("symmetric", "mass matrix is symmetric", apart, LIMIT)
        root = np.sqrt(np.abs(np.einsum("nii->ni", m)))
        root = np.where(root > 0.0, root, 1.0)
        least = np.linalg.eigvalsh(0.5 * (m + swapped) / root[:, :, None] / root[:, None, :]).min()
        self.add("positive", "mass matrix is positive: least eigenvalue", least, 1e-12, least=True)
        quadratic, linear = self.work()
        self.add("quadratic", "work of the velocity terms is 1/2 v M' v", quadratic, 1e-8)
        self.add("linear", "terms linear in rates do the work of the damping only", linear, 1e-8)

    def work(self) -> tuple[float, float]:
        """Return the work that terms quadratic and linear in rates should not do, relative."""
        few = Points(*(x[:FEW] for x in self.points))
        damping = np.array([tree.dof_damping for tree in self.trees[:FEW]])

        def terms(q: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
            assert self.equations is not None
            return split(self.plant, self.equations.at(few._replace(q=q, v=v), gaps=True))

        v, speed = few.v, np.abs(few.v)
        still, ahead, back = (terms(few.q, s * v)[1] for s in (0.0, 1.0, -1.0))
        quadratic, linear = 0.5 * (ahead + back) - still, 0.5 * (ahead - back)
        fastest = np.maximum(1.0, speed.max(1))
        rate = _slope(lambda s: terms(few.q + s * v, v)[0], 1e-3 / fastest)
        gain, most = (
            0.5 * np.einsum("ki,kij,kj->k", x, y, x) for x, y in ((v, rate), (speed, np.abs(rate)))
        )
        # differences of biases are rounding of the whole bias where there are no such terms
        whole = np.einsum("ki,ki->k", speed, np.abs(ahead) + np.abs(back) + np.abs(still))
        # and differences of mass matrices that of the whole matrix
        mass = np.abs(terms(few.q, v)[0])
        steady = 1e-3 * np.einsum("ki,kij,kj->k", speed, mass, speed) * fastest
        size = np.einsum("ki,ki->k", speed, np.abs(quadratic)) + most + 1e-6 * whole + steady
        lost, taken = np.einsum("ki,ki->k", v, linear), np.einsum("ki,ki->k", damping, v**2)
        other = np.einsum("ki,ki->k", speed, np.abs(linear)) + taken + 1e-6 * whole
        gained = np.einsum("ki,ki->k", v, quadratic)
        return _largest(gained - gain, size), _largest(lost - taken, other)

    def engine_alone(self, engine: Point) -> None:
        """Add that inertias are of bodies, and that energy changes by the work that is done."""
        a, b, c = np.sort([t.body_inertia[t.body_mass > 0.0] for t in self.trees[:FEW]]).T
        least = ((a + b - c) / np.where(c > 0.0, c, 1.0)).min(initial=1.0)
        self.add("inertias", "inertias are of bodies: (A + B - C) / C", least, -1e-12, least=True)
        lost = self.ledger(engine)
        self.add("energy", "energy changes by the work of inputs and damping", lost, 1e-8)

    def ledger(self, engine: Point) -> float:
        """Return MuJoCo's power that is not accounted for, relative; no integrator is in it."""
        trees, (q, v, u, _) = self.trees[:FEW], (x[:FEW] for x in self.points)
        m, h, b, a = (x[:FEW] for x in engine)
        damping = np.array([tree.dof_damping for tree in trees])

        def energy(s: Floats) -> Floats:
            states = zip(trees, q + s * v, v + s * a, strict=True)
            return np.array([terms_of(*x).energy.sum() for x in states])

        fastest = np.maximum(1.0, np.maximum(np.abs(v).max(1), np.sqrt(np.abs(a).max(1))))
        gained = _slope(energy, 1e-3 / fastest)
        rounded = 1e-4 * fastest * np.abs(energy(np.zeros((len(q), 1))))  # over the step
        pushed = (b @ u[..., None])[..., 0]
        power = np.einsum("ki,ki->k", v, pushed - damping * v)
        forces = (np.abs(m) @ np.abs(a)[..., None])[..., 0] + np.abs(h) + np.abs(pushed)
        return _largest(gained - power, np.einsum("ki,ki->k", np.abs(v), forces) + rounded)

    def mutation(self) -> None:
        """Add how many numbers of a model written in place differ from one compiled afresh."""
        found = Counter(self.model.differing(self.model.last))
        what = f"numbers unlike a recompile, after {len(self.rows)} points{_fields(found)}"
        self.add("mutation", what, found.total(), 0)
        for row in self.rows[:RECOMPILED]:
            self.model.write(row)
            found += Counter(self.model.differing(row))
        what = f"numbers unlike a recompile, {len(self.rows[:RECOMPILED])} random parameters"
        self.add("recompile", what + _fields(found), found.total(), 0)


def _place(worst: Worst) -> str:
    return f"{worst.term}, {worst.coordinate}"


def _fields(found: Mapping[str, int]) -> str:
    return f" ({', '.join(list(found)[:4])})" if found else ""


def _bounds(name: str, pair: Any) -> tuple[float, float]:
    try:
        low, high = map(float, pair)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not (np.isfinite([low, high]).all() and low <= high):
        rule = "must be two finite numbers, the lower one first"
        raise InvalidValueError(f"box {name}", rule, told(pair, repr))
    return low, high


def _difference(one: Floats, other: Floats, floor: Floats | float = 0.0) -> Floats:
    """Return differences as shares of each point's largest component, or of `floor` (N,)."""
    axes = tuple(range(1, one.ndim))
    largest = np.maximum(np.abs(one), np.abs(other)).max(axis=axes, initial=0.0)
    size = np.maximum(largest, floor)
    gap = np.abs(one - other) / np.where(size > 0.0, size, 1.0).reshape(-1, *(1 for _ in axes))
    return np.where(np.isnan(gap), np.inf, gap)


def _condition(mass: Floats) -> float:
    """Return the largest condition of mass matrices, units aside."""
    root = np.sqrt(np.einsum("nii->ni", mass))
    return float(np.linalg.cond(mass / root[:, :, None] / root[:, None, :]).max())


def _slope(function: Callable[[Floats], Floats], step: Floats) -> Floats:
    """Return the derivative at 0 of a function of one number a point, to the fourth order."""
    a, b, c, d = (function(s * step[:, None]) for s in (1.0, -1.0, 2.0, -2.0))
    return np.asarray(((8.0 * (a - b) - (c - d)).T / (12.0 * step)).T)


def _largest(wrong: Floats, size: Floats) -> float:
    """Return the largest share; equations may have no value beside a point."""
    return float(np.nanmax(np.abs(wrong) / np.maximum(size, 1e-9), initial=0.0))


def run(request: Request, *, progress: Progress = silent) -> Result:
    """Return the plant checked."""
    return request.run(progress)


def report(result: Result) -> Report:
    """Return the answer and the table."""
    rows: list[list[Cell | str]] = [
        [one.quantity, f"{one.value:.3g}", f"{one.comparison} {one.limit:.3g}",
         Cell("holds", "good") if one.passed else Cell("fails", "bad")]
        for one in result.checks
    ]  # fmt: skip
    caption = f"{result.plant} at {result.samples} random points"
    table = Matrix(caption=caption, columns=["quantity", "value", "limit", ""], rows=rows)
    blocks: list[Block] = [table, *map(plain, result.notes)]
    if not result.passed:
        w = result.worst
        named = [w.q, {f"{name}_dot": x for name, x in w.v.items()}, w.u, w.p]
        at = ", ".join(f"{name} = {x:.4g}" for some in named for name, x in some.items())
        blocks.append(plain(f"Largest in {w.term}, {w.coordinate}, at {at}."))
    return Report(headline=result.headline, blocks=blocks, passed=result.passed)


STUDY = Study(module=__name__, name="check", title="A plant and its equations", order=1, schema=1)
