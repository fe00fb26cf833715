"""Check whether the MJCF of a plant obeys its equations, at any state and any parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import tyro
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError, UnknownNameError, require_count, told
from afl_mujoco.plants.equations import POINTS, Equations, load_equations
from afl_mujoco.plants.plant import Plant, load_plant
from afl_mujoco.plants.suspects import Points, name_suspect
from afl_mujoco.plants.tree import Tree, terms_of
from afl_mujoco.report.blocks import Block, Cell, Matrix, Report
from afl_mujoco.report.markdown import plain
from afl_mujoco.studies.contract import Progress, Study, silent

Floats = NDArray[np.float64]

PlantName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PLANT")]

MOST = 1_000_000
LIMIT = 1e-11
"""What accelerations and terms may differ by, relative to the largest component of the point."""

ROUNDING = 30.0 * float(np.finfo(float).eps)
"""Accelerations solve for M: they may differ by this times its condition, where that is more."""

RECOMPILED = 100
"""Random parameters at which a model written in place is compared with one compiled afresh."""

SEARCHED = 16
"""Points at which suspects are tried."""

REACH = {"hinge": (np.pi, 5.0), "slide": (1.0, 2.0)}
"""Largest coordinate and rate that are drawn, where neither the MJCF nor the user says."""

INPUT = 10.0
"""Largest input that is drawn of one without a ctrlrange."""

FEW = 200
"""Points at which what takes finite differences is looked at."""

HUGE = 1e300
"""In place of what is not finite, which JSON has not."""

SEGMENTS, SEGMENT = 5, 0.05
"""Parts of a run for its energy ledger, each [s] with other parameters."""


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


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    return Request(load_plant(options.plant), options.samples, options.seed, {})


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
        Whether equations were checked and hold; without any only engine and mutation were.
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
        """Summarise the answer in one line."""
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


class Sampled(NamedTuple):
    """Terms at the points, of MuJoCo, the tree or the equations; empty where these have none."""

    accelerations: Floats  # (N, n)
    mass: Floats  # (N, n, n)
    bias: Floats  # (N, n)
    inputs: Floats  # (N, n, k)


WORDS = {"accelerations": "accelerations", "mass": "mass matrix", "bias": "bias", "inputs": "input"}


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
        self.rows = self.model.rows(self.points.p)
        self.model.require(self.rows, self.points.p)
        self.trees = [Tree(**self.model.tree(row)) for row in self.rows]
        self.tree_of = lambda p: Tree(**self.model.tree(self.model.rows(p)[0]))
        self.equations = None
        if plant.has_equations:
            few = self.draw(POINTS, seed + 1)
            self.equations = load_equations(plant, list(zip(*few, strict=True)))
        self.checks: list[Check] = []

    def draw(self, count: int, seed: int) -> Points:
        """Return random points; those of a smaller number are the first of a larger."""
        m, plant = self.model.mj_model, self.plant
        reach = [REACH[joint] for joint in self.model.kinds]
        bounds = {
            name: tuple(m.jnt_range[j]) if m.jnt_limited[j] else (-reach[j][0], reach[j][0])
            for j, name in enumerate(plant.coordinates)
        }
        bounds |= {f"{x}_dot": (-r, r) for x, (_, r) in zip(plant.coordinates, reach, strict=True)}
        for k, name in enumerate(plant.inputs):
            limited = m.actuator_ctrllimited[k]
            bounds[name] = tuple(m.actuator_ctrlrange[k]) if limited else (-INPUT, INPUT)
        bounds |= {x: (float(one.low), float(one.high)) for x, one in plant.parameters.items()}  # type: ignore[arg-type]
        for name, pair in self.box.items():
            if name not in bounds:
                raise UnknownNameError.among("box", name, bounds)
            bounds[name] = _bounds(name, pair)
        low, high = np.array(list(bounds.values())).T
        found = low + (high - low) * np.random.default_rng(seed).random((count, len(low)))
        n, k = len(plant.coordinates), len(plant.inputs)
        return Points(*map(np.ascontiguousarray, np.split(found, [n, 2 * n, 2 * n + k], axis=1)))

    # Three ways to the same numbers

    def engine(self) -> Sampled:
        """Return MuJoCo's terms, its parameters written in place."""
        found = []
        for q, v, u, row in zip(*self.points[:3], self.rows, strict=True):
            self.model.write(row)
            found.append(self.model.at(q, v, u))
        m, h, b, a = map(np.array, zip(*found, strict=True))
        return Sampled(a, m, h, b)

    def tree(self) -> Sampled:
        """Return the terms of the tree reference, from the same rows."""
        states = zip(self.trees, self.points.q, self.points.v, strict=True)
        m, h, b, _ = map(np.array, zip(*(terms_of(*x) for x in states), strict=True))
        return Sampled(self.solved(m, h, b), m, h, b)

    def asked(self, equations: Equations) -> Sampled:
        """Return what the equations give."""
        raw = np.array([equations.raw(*x) for x in zip(*self.points, strict=True)])
        if not np.isfinite(raw).all():
            i = int(np.argmin(np.isfinite(raw).all(axis=1)))
            rule = "must be finite; box= of afl.check leaves singularities out"
            raise InvalidValueError(
                "terms" if self.plant.terms else "accelerations", rule,
                f"{raw[i].tolist()} at q = {self.points.q[i].tolist()}",
            )  # fmt: skip
        if not self.plant.terms:
            return Sampled(raw, *(np.empty(0) for _ in range(3)))
        count, n = self.points.q.shape
        m, h, b = np.split(raw, [n * n, n * n + n], axis=1)
        m, b = m.reshape(count, n, n), b.reshape(count, n, -1)
        return Sampled(self.solved(m, h, b), m, h, b)

    def solved(self, mass: Floats, bias: Floats, inputs: Floats) -> Floats:
        """Return accelerations; of singular mass matrices, which are a failure, the shortest."""
        force = inputs @ self.points.u[..., None] - bias[..., None]
        try:
            return np.asarray(np.linalg.solve(mass, force)[..., 0], np.float64)
        except np.linalg.LinAlgError:
            return np.asarray((np.linalg.pinv(mass) @ force)[..., 0], np.float64)

    # Rows

    def add(self, id: str, quantity: str, value: float, limit: float, least: bool = False) -> bool:
        """Add a row, and return whether it passed."""
        passed = bool(value >= limit if least else value <= limit)
        known = float(np.nan_to_num(value, nan=HUGE, posinf=HUGE, neginf=-HUGE))
        self.checks.append(
            Check(id=id, quantity=quantity, value=known, limit=float(limit),
                  comparison=">=" if least else "<=", passed=passed)
        )  # fmt: skip
        return passed

    def compare(self, id: str, who: str, one: Sampled, other: Sampled, *terms: str) -> bool:
        """Add a row for each term that two have, and return whether they agree."""
        rounding = ROUNDING * _condition(self.reference.mass)
        agreed = [
            self.add(f"{id}{i}", f"{WORDS[name]}: {who}",
                     float(self.gap(name, one, other).max(initial=0.0)),
                     max(LIMIT, rounding) if name == "accelerations" else LIMIT)
            for i, name in enumerate(terms, 1)
        ]  # fmt: skip
        return all(agreed)

    def gap(self, term: str, one: Sampled, other: Sampled) -> Floats:
        """Return how far two are apart in a term, as shares of what it consists of."""
        floor = 1e-3 * (self.points.v**2).max(axis=1)  # rates alone may give nothing but rounding
        size = np.abs(self.reference.mass).max(axis=(1, 2))
        floors = {"accelerations": floor, "bias": floor * size}
        return _difference(getattr(one, term), getattr(other, term), floors.get(term, 0.0))

    def run(self, progress: Progress) -> Result:
        """Return the result: the pointwise comparison first, the rest only if it agrees."""
        progress("checking", 0, 3)
        self.reference, engine = self.tree(), self.engine()
        every, first = tuple(WORDS), "accelerations"
        headline, theirs = "", None
        if not self.compare("A", "MuJoCo against the tree", engine, self.reference, *every):
            headline, worst = self.engine_differs(engine)
        if self.equations is not None:
            theirs = self.asked(self.equations)
            self.compare("B", "equations against MuJoCo", theirs, engine, first)
            terms = every if self.plant.terms else (first,)
            self.compare("C", "equations against the tree", theirs, self.reference, *terms)
            if self.plant.terms:
                self.invariants(self.equations, theirs.mass)
            if not headline and self.failed:
                headline, worst = self.equations_differ(self.equations, theirs)
        progress("checking", 1, 3)
        if not headline:
            worst = self.worst_of(first, theirs or self.reference, engine)
            self.engine_alone()
            progress("checking", 2, 3)
            self.mutation()
            headline = next((f"{x.quantity}: {x.value:.3g}" for x in self.failed), self.good())
        progress("checking", 3, 3)
        return Result(
            plant=self.plant.name, samples=self.samples, seed=self.seed,
            headline=f"{self.plant.name}: {headline}",
            verdict="fail" if self.failed else "pass",
            model_verified=self.equations is not None and not self.failed,
            checks=tuple(self.checks), worst=worst, notes=self.notes(),
        )  # fmt: skip

    @property
    def failed(self) -> list[Check]:
        """The rows that do not hold."""
        return [one for one in self.checks if not one.passed]

    def good(self) -> str:
        """Return the headline of a plant that passes."""
        moving = [name for name, one in self.plant.parameters.items() if one.rate == "enters"]
        rate = f" (rate of {', '.join(moving)}: engine only)" if moving else ""
        if self.equations is None:
            return f"engine and mutation verified; model not: no equations{rate}"
        largest = max(one.value for one in self.checks if one.id[0] in "BC")
        points = f"{self.samples} points, to {largest:.1e}"
        return f"MuJoCo obeys the equations at {points}{rate}"

    def notes(self) -> tuple[str, ...]:
        """Return what a reader should know."""
        out = [f"Left out: {'; '.join(self.model.notes)}."] if self.model.notes else []
        how = [f"Equations: {self.equations.how}."] if self.equations else []
        return (*out, *how)

    # What does not need a second model

    def invariants(self, equations: Equations, m: Floats) -> None:
        """Add what holds of any mass matrix and any velocity terms."""
        swapped = np.swapaxes(m, 1, 2)
        self.add("D1", "mass matrix is symmetric", float(_difference(m, swapped).max()), LIMIT)
        root = np.sqrt(np.abs(np.einsum("nii->ni", m)))
        root = np.where(root > 0.0, root, 1.0)
        least = np.linalg.eigvalsh(0.5 * (m + swapped) / root[:, :, None] / root[:, None, :]).min()
        self.add("D2", "mass matrix is positive: least eigenvalue", float(least), 1e-12, least=True)
        few = [x[:FEW] for x in (self.points.q, self.points.v, self.points.p, self.trees)]
        work = [_work(equations, q, v, p, t.dof_damping) for q, v, p, t in zip(*few, strict=True)]
        quadratic, linear = np.max(work, axis=0)
        self.add("D3", "work of the velocity terms is 1/2 v M' v", quadratic, 1e-8)
        self.add("D4", "terms linear in rates do the work of the damping only", linear, 1e-8)

    def engine_alone(self) -> None:
        """Add that inertias are of bodies, and that energy is kept while parameters change."""
        a, b, c = np.sort([t.body_inertia[t.body_mass > 0.0] for t in self.trees[:FEW]]).T
        least = ((a + b - c) / np.where(c > 0.0, c, 1.0)).min(initial=1.0)
        self.add("E1", "inertias are of bodies: (A + B - C) / C", float(least), -1e-12, least=True)
        step, left = 1e-3, np.inf
        while left > 1e-9 and step > 1e-4:  # until steps are no matter
            left, step = max(self.unaccounted(i, step) for i in range(2)), 0.5 * step
        self.add("E2", "energy over a run whose parameters change, relative", left, 1e-8)

    def unaccounted(self, start: int, step: float) -> float:
        """Return the share of energy that work does not account for, in a run by RK4."""
        q, v, u = (x[start % len(x)] for x in self.points[:3])
        x, n, worst = np.concatenate([q, 0.3 * v, [0.0]]), len(q), 0.0  # work is one more state
        for part in range(SEGMENTS):
            i = (7 * start + part) % len(self.rows)
            self.model.write(self.rows[i])
            rates = partial(self.rates, self.trees[i].dof_damping, u)
            before, x[2 * n] = terms_of(self.trees[i], x[:n], x[n : 2 * n]).energy, 0.0
            for _ in range(round(SEGMENT / step)):
                a = rates(x)
                b = rates(x + 0.5 * step * a)
                c = rates(x + 0.5 * step * b)
                x = x + step / 6.0 * (a + 2.0 * b + 2.0 * c + rates(x + step * c))
            after = terms_of(self.trees[i], x[:n], x[n : 2 * n]).energy
            size = max(np.abs(before).max(), np.abs(after).max(), abs(x[2 * n]), 1e-12)
            worst = max(worst, abs(after.sum() - before.sum() - x[2 * n]) / size)
        return float(worst)

    def rates(self, damping: Floats, u: Floats, x: Floats) -> Floats:
        """Return v, MuJoCo's accelerations and the power of inputs and damping."""
        n = len(damping)
        v, there = x[n : 2 * n], self.model.at(x[:n], x[n : 2 * n], u)
        return np.concatenate([v, there.accelerations, [v @ (there.inputs @ u - damping * v)]])

    def mutation(self) -> None:
        """Add how many numbers of a model written in place differ from one compiled afresh."""
        found = Counter(self.model.differing(self.model.last))
        self.add(
            "F1", f"numbers unlike a recompile, after the run{_where(found)}", found.total(), 0
        )
        for row in self.rows[:RECOMPILED]:
            self.model.write(row)
            found += Counter(self.model.differing(row))
        what = f"numbers unlike a recompile, {len(self.rows[:RECOMPILED])} random parameters"
        self.add("F2", what + _where(found), found.total(), 0)

    # What differs

    def worst_of(self, term: str, one: Sampled, other: Sampled) -> Worst:
        """Return where two differ most in a term, and in which coordinate."""
        i, gap = self.point_of(term, one, other)
        here = gap.reshape(len(gap), -1).max(axis=1, initial=0.0)
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

    def point_of(self, term: str, one: Sampled, other: Sampled) -> tuple[int, Floats]:
        """Return the point at which two differ most, and the difference there."""
        gap = self.gap(term, one, other)
        i = int(np.argmax(gap.reshape(len(gap), -1).max(axis=1)))
        return i, gap[i]

    def failing(self, prefix: str) -> str:
        """Return the term that says most: M, h or B before the accelerations."""
        terms = dict(
            zip(("2", "3", "4", "1"), ("mass", "bias", "inputs", "accelerations"), strict=True)
        )
        bad = {one.id for one in self.failed}
        return next((term for i, term in terms.items() if prefix + i in bad), "accelerations")

    def engine_differs(self, engine: Sampled) -> tuple[str, Worst]:
        """Return the headline where MuJoCo is not the tree that its MJCF describes."""
        worst = self.worst_of(term := self.failing("A"), engine, self.reference)
        i, _ = self.point_of(term, engine, self.reference)
        self.model.write(self.rows[i])
        why = "something in the MJCF that equations of a tree do not have?"
        if found := self.model.differing(self.rows[i]):
            why = f"written in place it is another model{_where(found)}"
        return f"{worst.term}, {worst.coordinate}: MuJoCo is not the tree of its MJCF: {why}", worst

    def equations_differ(self, equations: Equations, theirs: Sampled) -> tuple[str, Worst]:
        """Return the headline where the equations are not those of the tree."""
        worst = self.worst_of(term := self.failing("C"), theirs, self.reference)
        gap = self.gap(term, theirs, self.reference)
        most = np.argsort(-gap.reshape(len(gap), -1).max(axis=1))[: SEARCHED // 2]
        few = np.unique([*most, *np.linspace(0, len(gap) - 1, SEARCHED // 2).astype(int)])
        points = Points(*(x[few] for x in self.points))
        suspect = name_suspect(self.plant, equations, self.tree_of, self.model.bodies, points)
        where = f"{worst.term}, {worst.coordinate}"
        if suspect:
            return f"{where}: {suspect}?", worst
        broken = next((f"; not so: {x.quantity}" for x in self.failed if x.id[0] == "D"), "")
        most_of = f"up to {worst.difference:.2g} of the largest component"
        return f"{where}: equations and MJCF differ by {most_of}{broken}", worst


def _work(
    equations: Equations, q: Floats, v: Floats, p: Floats, damping: Floats
) -> tuple[float, float]:
    """Return the work of terms quadratic and linear in rates that should not be, relative.

    v h(q, v) is not zero: quadratic terms give 1/2 v M' v, linear ones what the damping takes.
    """
    still, ahead, back = (equations.terms(q, s * v, p)[1] for s in (0.0, 1.0, -1.0))
    quadratic, linear = 0.5 * (ahead + back) - still, 0.5 * (ahead - back)
    step = 1e-3 / max(1.0, float(np.abs(v).max()))
    a, b, c, d = (equations.terms(q + s * step * v, v, p)[0] for s in (1.0, -1.0, 2.0, -2.0))
    rate, speed = (8.0 * (a - b) - (c - d)) / (12.0 * step), np.abs(v)
    work = float(v @ quadratic - 0.5 * v @ rate @ v)
    size = float(speed @ np.abs(quadratic) + 0.5 * speed @ np.abs(rate) @ speed)
    lost = float(v @ linear - damping @ v**2)
    other = float(speed @ np.abs(linear) + damping @ v**2 + 1e-6 * size)
    return abs(work) / max(size, 1e-9), abs(lost) / max(other, 1e-9)


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
    """Return absolute differences as shares of the largest component of each point.

    floor: The least size of a component, (N,): what should be zero is rounding, and no share of it.
    """
    axes = tuple(range(1, one.ndim))
    size = np.maximum(np.abs(one), np.abs(other)).max(axis=axes, initial=0.0)
    size = np.maximum(size, floor)
    gap = np.abs(one - other) / np.where(size > 0.0, size, 1.0).reshape(-1, *(1 for _ in axes))
    return np.where(np.isnan(gap), np.inf, gap)


def _condition(mass: Floats) -> float:
    """Return the largest condition of mass matrices, units aside."""
    root = np.sqrt(np.einsum("nii->ni", mass))
    return float(np.linalg.cond(mass / root[:, :, None] / root[:, None, :]).max())


def _where(found: Mapping[str, int]) -> str:
    """Return the fields that differ, in brackets."""
    return f" ({', '.join(list(found)[:4])})" if found else ""


def run(request: Request, *, progress: Progress = silent) -> Result:
    """Return the plant checked."""
    return request.run(progress)


def report(result: Result) -> Report:
    """Return the answer and the table."""
    rows: list[list[Cell | str]] = [
        [one.id, one.quantity, f"{one.value:.3g}", f"{one.comparison} {one.limit:.3g}",
         Cell("holds", "good") if one.passed else Cell("fails", "bad")]
        for one in result.checks
    ]  # fmt: skip
    caption = f"{result.plant} at {result.samples} random points"
    table = Matrix(caption=caption, columns=["", "quantity", "value", "limit", ""], rows=rows)
    blocks: list[Block] = [table, *map(plain, result.notes)]
    if not result.passed:
        w = result.worst
        named = [w.q, {f"{name}_dot": x for name, x in w.v.items()}, w.u, w.p]
        at = ", ".join(f"{name} = {x:.4g}" for some in named for name, x in some.items())
        blocks.append(plain(f"Largest in {w.term}, {w.coordinate}, at {at}."))
    return Report(headline=result.headline, blocks=blocks, passed=result.passed)


STUDY = Study(
    name="check",
    title="A plant and its equations",
    order=1,
    schema=1,
    configuration=Options,
    prepare=prepare,
    run=run,
)
