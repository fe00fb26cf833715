"""Judge the identified model by recordings of the cart-pole.

`hardware_protocol.toml` beside this file says how; it was fixed before any of them was predicted.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from afl_mujoco.errors import InvalidValueError, require_count
from afl_mujoco.identification import export, pole, prediction, rig
from afl_mujoco.identification.identify import Identified, identify_pole, require_units, windows_of
from afl_mujoco.identification.log import Log, read_logs
from afl_mujoco.identification.prediction import Errors, errors_of, load_estimates, predicted_by_rig
from afl_mujoco.report.blocks import (
    Block,
    Cell,
    Figure,
    Matrix,
    Report,
    listed,
    percent,
    plain,
    short,
)
from afl_mujoco.scenario.imperfections import LARGEST_SEED
from afl_mujoco.scenario.requirements import NONE
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.studies.shared.arrays import Array
from afl_mujoco.studies.shared.contract import Progress, Study, silent
from afl_mujoco.studies.shared.identified_parts import Shown, draw_log, shown_of
from afl_mujoco.studies.shared.run import run_all

MOST_DRAWS = 100_000


@dataclass(frozen=True, kw_only=True)
class Options:
    """Judge the identified model on recordings of a real cart-pole that it was not fitted to.

    Example: afl-mujoco hardware --logs my-logs --estimates renders/my-rig/estimates.json

    Reports the errors by horizon, each term of the equations, verdicts by a protocol that was fixed
    beforehand, and what controllers would do on that cart-pole. The exit code is 1 if one
    statement does not hold, or the recordings can decide none, else 0.
    """

    logs: str | None = None
    """Folder of recordings; by default those that come with the package and were not fitted."""
    estimates: str | None = None
    """Estimates that `afl-mujoco identify` wrote; by default those that come with the package."""
    draws: int = 200
    """Cart-poles drawn from the distribution of the estimates, on which controllers run."""
    seed: int = 1
    """Seed of the draws."""


class Request(NamedTuple):
    """What is judged, and on what."""

    logs: Sequence[Log]
    identified: Identified
    draws: int
    seed: int


@cache
def protocol() -> dict[str, Any]:
    """Return how recordings are predicted, and the statements that are judged."""
    path = Path(__file__).with_name("hardware_protocol.toml")
    return tomllib.loads(path.read_text(encoding="utf-8"))


def prepare(options: Options) -> Request:
    """Return what the options ask for, or raise if a rule is broken."""
    o = options
    require_count("draws", o.draws, 0, MOST_DRAWS)
    require_count("seed", o.seed, 0, LARGEST_SEED)
    identified = load_estimates(prediction.ESTIMATES if o.estimates is None else Path(o.estimates))
    if o.estimates is not None and o.logs is None:
        raise InvalidValueError("logs", "must be given with estimates of another cart-pole")
    identified.scatter()  # raises without a drive
    logs = read_logs([prediction.CHOOSE if o.logs is None else o.logs], identified.description)
    return Request(logs, identified, o.draws, o.seed)


# --- what is found ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """A term of the equations, from the judged recordings alone, with its 95 % interval."""

    value: float
    low: float
    high: float
    expected: float | None  # what the equations demand; None where they leave it open
    unit: str
    title: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """A statement of the protocol, judged."""

    id: str
    statement: str
    measure: str
    limit: float
    reason: str  # for the limit
    value: float | None  # None if these recordings cannot decide it
    at_least: bool  # whether the value must reach the limit; else it must not exceed it
    suspected: str = ""  # cause of a statement that does not hold, or why it is not decided

    @property
    def holds(self) -> bool | None:
        """Whether the statement holds; None if that is not decided."""
        if self.value is None:
            return None
        return bool(self.value >= self.limit if self.at_least else self.value <= self.limit)


@dataclass(frozen=True, slots=True, kw_only=True)
class Survival:
    """A controller on the identified cart-pole, and on some drawn from the estimates."""

    controller: str
    angles: dict[str, float]  # by a change, the largest start that it survives [rad]; 0 if none
    runs: int
    survived: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """What recordings say about the identified model."""

    logs: tuple[str, ...]  # names of the recordings
    fitted: tuple[str, ...]  # of those that the estimates were fitted to: they prove nothing
    identified: Identified
    terms: dict[str, Term]  # of the pole's equation, by name: gravity, coupling and friction
    held_out: tuple[Errors, ...]  # of the whole in MuJoCo, given the command, by horizon
    # the same for starts around which no row is missing; the command of a missing row is unknown
    whole: tuple[Errors, ...]
    pole: tuple[Errors, ...]  # of the pole alone, given the motion of the cart
    nominal: tuple[Errors, ...]  # of the cart-pole as its owners give it, given the command
    statements: tuple[Statement, ...]  # of the protocol
    band: Array  # horizons [s], and the rms errors of z [m] and phi [rad] after them, shape (3, H)
    recorded: Shown  # a recording beside its predictions
    # what controllers would do on that cart-pole; empty if nothing was drawn, or the estimates are
    # too uncertain to draw from
    survival: tuple[Survival, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every statement that could be decided holds, and one could be."""
        found = {one.holds for one in self.statements}
        return True in found and False not in found


# --- the recordings and the model ---------------------------------------------------------------

BAND = 26  # number of horizons up to half a second at which the band of a prediction is measured


def run(request: Request, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Judge the model on the recordings; the result does not depend on the workers."""
    logs, identified, draws, seed = request
    d, values, p = identified.description, identified.values, protocol()["prediction"]
    horizons = p["horizons"]
    require_units(logs, d)
    progress("judging", 0, 3)
    terms = _terms(logs, identified)
    starts = prediction.starts_of(logs, p["past"], max(horizons), p["every"])
    angle = prediction.predicted_by_pole(starts, values, d)
    by_pole = np.stack([np.zeros_like(angle), angle], axis=1)
    driven = errors_of(starts, by_pole, horizons, values, d, position=False)
    predicted = partial(
        predicted_by_rig, starts, description=d, scatter=identified.scatter(), workers=workers
    )
    read = predicted(values)
    held_out = errors_of(starts, read, horizons, values, d)
    progress("judging", 1, 3)
    owners = predicted(nominal := nominal_values(identified))
    progress("judging", 2, 3)
    steps = np.linspace(0.0, 0.5, BAND)
    spread = errors_of(starts, read, steps.tolist(), values, d)
    most = int(np.bincount(starts.log).argmax())
    known = draws and export.certain(identified)
    survival = outlook(identified, draws, seed, workers) if known else ()
    progress("judging", 3, 3)
    return Result(
        logs=tuple(log.name for log in logs),
        fitted=tuple(log.name for log in logs if log.name in identified.logs),
        identified=identified,
        terms=terms,
        held_out=held_out,
        whole=errors_of(starts, read, horizons, values, d, whole=True),
        pole=driven,
        nominal=errors_of(starts, owners, horizons, nominal, d),
        statements=_judge(identified, terms, driven, held_out),
        band=np.array([steps, [e.rms_z or 0.0 for e in spread], [e.rms_phi for e in spread]]),
        recorded=shown_of(logs[most], starts, read, values, most),
        survival=survival,
    )


def _terms(logs: Sequence[Log], identified: Identified) -> dict[str, Term]:
    """Return the terms of the pole's equation, estimated again from the recordings alone."""
    found, _ = identify_pole(windows_of(logs), identified.description)
    expected = {"gravity_term": identified.description.nominal.gravity_term, "coupling": 1.0}
    return {
        name.removesuffix("_term"): Term(
            value=one.value, low=one.low, high=one.high, expected=expected.get(name),
            unit=one.unit, title=one.title,
        )
        for name, one in found.estimates.items()
        if name in ("gravity_term", "coupling", "damping", "friction")
    }  # fmt: skip


def nominal_values(identified: Identified) -> dict[str, float]:
    """Return the parameters of pole and rig as the owners give them, with ideal sensors."""
    d, n = identified.description, identified.description.nominal
    start = {one.name: one.start for one in (*pole.parameters_of(d), *rig.parameters_of(d))}
    return {
        **dict.fromkeys(start, 0.0),
        **{name: start[name] for name in ("gravity_term", "coupling", "mass_ratio", "gain")},
        "angle_scale": 1.0,
        "damping": n.hinge_damping / (4.0 / 3.0 * n.pole_mass * n.half_length**2),
        "decay": n.rail_damping / (n.cart_mass + n.pole_mass),
    }


def _judge(
    identified: Identified,
    terms: Mapping[str, Term],
    by_pole: Sequence[Errors],
    held_out: Sequence[Errors],
) -> tuple[Statement, ...]:
    (driven,) = (one for one in by_pole if one.horizon == 0.2)
    (whole,) = (one for one in held_out if one.horizon == 0.5)
    why = ""
    if identified.description.phi.dead_zone is not None and driven.clear_phi is not None:
        why = "readings missing before the start, across the dead zone: without such starts it is "
        why += short(driven.clear_phi, 3)
    late = "commands that arrive late, or a drive that is not linear"
    # value, half the width of its interval, whether it must be reached, and what is suspected
    measured: dict[str, tuple[float | None, float, bool, str]] = {
        "gravity": (*_off(terms["gravity"]), False, "the given length, or the hinge"),
        "coupling": (*_off(terms["coupling"]), False, "the scale of the position"),
        "pole-0.2": (driven.away_phi, 0.0, False, why),
        "rig-0.5-phi": (whole.explained_phi, 0.0, True, late),
        "rig-0.5-z": (whole.explained_z, 0.0, True, late),
    }
    judged = []
    for one in protocol()["statements"]:
        value, width, at_least, suspected = measured[one["id"]]
        if value is None:
            suspected = "not decided: these recordings never get there, or have no known resolution"
        elif width > one["limit"]:
            value, suspected = None, "not decided: the interval is wider than the limit"
        found = Statement(**one, value=value, at_least=at_least)
        judged.append(found if found.holds else replace(found, suspected=suspected))
    return tuple(judged)


def _off(term: Term) -> tuple[float, float]:
    """Return how far a term is from its expected value, and half its interval, relative to it."""
    expected = term.expected or 1.0
    return abs(term.value / expected - 1.0), 0.5 * (term.high - term.low) / abs(expected)


# --- what controllers would do on it ------------------------------------------------------------

CONTROLLERS = ("adaptive", "adaptive-retuned", "lqr")
"""The paper's controller, the same with gains found here, and a baseline."""

ANGLES = (1, 2, 3, 5, 7, *range(10, 85, 5))  # starting angles that are tried, to either side [deg]

AS_IT_IS = "as it is"


def changes(scenario: Scenario) -> dict[str, Scenario]:
    """Return a cart-pole as it is, and with its limits relaxed, by the name of the change."""
    r, rail = scenario.imperfections, scenario.rail
    longer = {} if rail is None else {"end_stops.z": 4.0 * rail}
    stronger = {} if r.input_limit is None else {"input_limit": 4.0 * r.input_limit}
    found: dict[str, dict[str, Any]] = {
        AS_IT_IS: {},
        "rail and force x4": {**longer, **stronger},
        "drive makes up for rail damping": {"damping.z": 0.0},
    }
    return {
        name: replace(scenario, imperfections=r.changed(changed), requirements=NONE)
        for name, changed in found.items()
        if name == AS_IT_IS or changed
    }


def outlook(
    identified: Identified, count: int, seed: int, workers: int = 1
) -> tuple[Survival, ...]:
    """Return what each controller survives, also on cart-poles drawn from the estimates."""
    from afl_mujoco.control.catalogue import find_controller

    base = changes(export.with_values(identified, identified.values))
    drawn = export.draws(identified, count, seed)
    found = []
    for controller in map(find_controller, CONTROLLERS):

        def passes(scenarios: Sequence[Scenario], one: Any = controller) -> list[bool]:
            return [not run.failure for run in run_all(one, scenarios, threads=workers)]

        angles = {}
        for name, changed in base.items():
            tilts = [sign * math.radians(angle) for angle in ANGLES for sign in (-1.0, 1.0)]
            starts = [replace(changed, initial_state=(0.0, phi, 0.0, 0.0)) for phi in tilts]
            held = np.array(passes(starts)).reshape(-1, 2).all(axis=1)
            smaller = int(np.argmin(np.append(held, False)))  # that are survived, one and all
            angles[name] = math.radians(ANGLES[smaller - 1]) if smaller else 0.0
        survived = sum(passes(drawn))
        found.append(
            Survival(controller=controller.name, angles=angles, runs=count, survived=survived)
        )
    return tuple(found)


# --- what is shown ------------------------------------------------------------------------------


def report(result: Result) -> Report:
    """Return what is shown of a validation."""
    by = {how: [x.id for x in result.statements if x.holds is how] for how in (True, False, None)}
    recordings = f"{len(result.logs)} recording{'s' * (len(result.logs) > 1)}"
    headline = f"{len(by[True])} of {len(result.statements)} statements hold on {recordings}"
    headline += f" · not: {', '.join(by[False])}" if by[False] else ""
    headline += f" · not decided: {', '.join(by[None])}" if by[None] else ""
    blocks: list[Block] = [_statements(result)]
    if result.fitted:
        told = f"No proof, if they are the same recordings: {listed(result.fitted, 'and')} have "
        blocks.append(plain(f"{told}names of recordings that the estimates were fitted to."))
    figure = Figure(
        name="hardware-recording",
        title=f"{result.recorded.name}, measured and predicted",
        caption="Dots: measured (none in the dead zone of the angle). Lines: MuJoCo under the "
        "recorded command, for half a second from each fitted state. Bands: twice the rms error "
        "of all recordings after that time.",
        draw=partial(draw_log, result.recorded, result.band * [[1.0], [2.0], [2.0]]),
    )
    blocks += [figure, *([_outlook(result.survival)] if result.survival else [])]
    return Report(headline=headline, passed=result.passed, blocks=blocks)


VERDICTS = {
    True: Cell("holds", "good"),
    False: Cell("fails", "bad"),
    None: Cell("not decided", "open"),
}


def _statements(result: Result) -> Matrix:
    rows: list[list[Cell | str]] = []
    for one in result.statements:
        shares = "share" in one.measure or "relative" in one.measure
        value, limit = ((percent if shares else short)(x, 3) for x in (one.value, one.limit))
        limit = f"{'≥' if one.at_least else '≤'} {limit}" + " counts" * ("counts" in one.measure)
        rows.append([one.id, value, limit, VERDICTS[one.holds], one.statement, one.suspected])
    return Matrix(
        caption="Statements of the protocol",
        columns=["Statement", "Measured", "Limit", "Verdict", "What it says", "Suspected"],
        rows=rows,
    )


def _outlook(found: Sequence[Survival]) -> Matrix:
    rows = [
        [what, *(f"{math.degrees(one.angles[what]):.0f}°" for one in found)]
        for what in found[0].angles
    ]
    drawn = f"drawn from the estimates, from within {math.degrees(export.TILT):.1f}°"
    rows.append([drawn, *(f"{one.survived} of {one.runs}" for one in found)])
    return Matrix(
        caption="Largest starting angle from which a controller, as deployed on this "
        "cart-pole, ends upright and never reaches the end of its rail; 0°: none that was tried",
        columns=["Cart-pole", *(one.controller for one in found)],
        rows=rows,
    )


STUDY = Study(module=__name__, name="hardware", title="Measured hardware", order=81, schema=4)
