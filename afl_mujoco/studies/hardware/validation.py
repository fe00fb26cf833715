"""The identified model against recordings, by the protocol."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.identification import pole, rig
from afl_mujoco.identification.export import certain
from afl_mujoco.identification.identify import (
    Identified,
    identify_pole,
    require_radians,
    windows_of,
)
from afl_mujoco.identification.log import Log
from afl_mujoco.identification.prediction import (
    Errors,
    Starts,
    errors_of,
    predicted_by_pole,
    predicted_by_rig,
    starts_of,
    straight_on,
)
from afl_mujoco.report.numbers import short
from afl_mujoco.studies.contract import Progress, silent
from afl_mujoco.studies.hardware.outlook import outlook
from afl_mujoco.studies.hardware.protocol import Prediction, load_protocol
from afl_mujoco.studies.hardware.result import Judged, Recorded, Result, Term

Array = NDArray[np.float64]

BAND = 26
"""Number of horizons up to half a second at which the band of a prediction is measured."""

NO_REACTION = 1e-6
"""Mass ratio at which the cart does not feel the pole."""


def validate(
    logs: Sequence[Log],
    identified: Identified,
    source: str,
    *,
    draws: int,
    seed: int,
    workers: int = 1,
    progress: Progress = silent,
) -> Result:
    """Judge an identified model on recordings.

    Parameters
    ----------
    logs
        The recordings.
    identified
        The estimates, which must include the drive.
    source
        Where the recordings are.
    draws, seed
        Number of cart-poles drawn from the distribution of the estimates, and the seed for it.
    workers
        Number of threads; the results do not depend on it.
    """
    d, values, protocol = identified.description, identified.values, load_protocol()
    require_radians(logs, d)
    progress("judging", 0, 6)
    terms = _terms(logs, identified)
    progress("judging", 1, 6)
    p = protocol.prediction
    starts = starts_of(logs, p.past, max(p.horizons), p.every)
    by_pole = _with_position(predicted_by_pole(starts, values, d))
    pole_errors = errors_of(starts, by_pole, p.horizons, values, d, position=False)
    progress("judging", 2, 6)
    drive = identified.drive
    if drive is None or drive.scatter_z is None:
        raise InvalidValueError("estimates", "must include cart and drive")
    scatter = (drive.scatter_z, drive.scatter_phi)
    read, states = predicted_by_rig(starts, values, d, scatter, workers=workers)
    held_out = errors_of(starts, read, p.horizons, values, d)
    progress("judging", 3, 6)
    baselines = _baselines(starts, identified, scatter, states, p, workers)
    progress("judging", 4, 6)
    judged = _judge(identified, terms, pole_errors, held_out)
    whole = errors_of(starts, read, p.horizons, values, d, whole=True)
    horizons = np.linspace(0.0, 0.5, BAND)
    spread = errors_of(starts, read, horizons.tolist(), values, d)
    band = np.array([horizons, [e.rms_z or 0.0 for e in spread], [e.rms_phi for e in spread]])
    most = int(np.bincount(starts.windows.log).argmax())
    recorded = _recorded(logs[most], most, starts, read, identified)
    survival = outlook(identified, draws, seed, workers) if draws and certain(identified) else ()
    progress("judging", 6, 6)
    return Result(
        source=source,
        logs=tuple(log.name for log in logs),
        fitted=tuple(log.name for log in logs if log.name in identified.logs),
        identified=identified,
        terms=terms,
        held_out=held_out,
        whole=whole,
        pole=pole_errors,
        baselines=baselines,
        statements=judged,
        speeds=(
            max(float(np.abs(np.gradient(log.z, log.time)).max()) for log in logs),
            max(float(np.abs(np.gradient(log.angle, log.time)).max()) for log in logs),
        ),
        reach=max(float(np.abs(log.z).max()) for log in logs),
        turned=max(float(np.ptp(log.angle)) for log in logs),
        band=band,
        recorded=recorded,
        survival=survival,
    )


def _terms(logs: Sequence[Log], identified: Identified) -> dict[str, Term]:
    """Return the terms of the pole's equation, estimated again from the recordings alone."""
    found, _ = identify_pole(windows_of(logs), identified.description)
    expected = {
        "gravity_term": identified.description.nominal.gravity_term, "coupling": 1.0,
    }  # fmt: skip
    names = {"gravity_term": "gravity"}
    return {
        names.get(one.name, one.name): Term(
            value=float(value), low=float(value - half), high=float(value + half),
            expected=expected.get(one.name), unit=one.unit, title=one.title,
        )
        for one, value, half in zip(
            found.parameters, found.values, found.half_widths, strict=True
        )
        if one.name in ("gravity_term", "coupling", "damping", "friction")
    }  # fmt: skip


def nominal_values(identified: Identified) -> dict[str, float]:
    """Return the parameters of pole and rig as the owners give them, with ideal sensors."""
    d = identified.description
    n = d.nominal
    whole, inertia = n.cart_mass + n.pole_mass, 4.0 / 3.0 * n.pole_mass * n.half_length**2
    ideal = dict.fromkeys((one.name for one in pole.parameters_of(d)), 0.0)
    drive = dict.fromkeys((one.name for one in rig.parameters_of(d)), 0.0)
    return {
        **ideal,
        **drive,
        "angle_scale": 1.0,
        "gravity_term": n.gravity_term,
        "coupling": 1.0,
        "damping": n.hinge_damping / inertia,
        "mass_ratio": n.pole_mass / whole,
        "gain": n.force / whole,
        "decay": n.rail_damping / whole,
    }


def _baselines(
    starts: Starts,
    identified: Identified,
    scatter: tuple[float, float],
    states: Array,
    protocol: Prediction,
    workers: int,
) -> dict[str, tuple[Errors, ...]]:
    """Return the errors of the baselines of the protocol."""
    d, values = identified.description, identified.values
    nominal = nominal_values(identified)
    owners, _ = predicted_by_rig(starts, nominal, d, scatter, workers=workers)
    alone = {**values, "mass_ratio": NO_REACTION}
    cart, _ = predicted_by_rig(starts, alone, d, scatter, workers=workers)
    angle = predicted_by_pole(starts, {**values, "coupling": 0.0}, d)
    found: dict[str, tuple[Array, Mapping[str, float]]] = {
        "nominal": (owners, nominal),
        "uncoupled": (np.stack([cart[:, 0], angle], axis=1), values),
        "constant_velocity": (straight_on(starts, states, values), values),
    }
    return {
        name: errors_of(starts, read, protocol.horizons, of, d)
        for name, (read, of) in found.items()
    }


def _with_position(angle: Array) -> Array:
    """Return predicted angles beside positions that are not predicted, shape (B, 2, n)."""
    return np.stack([np.zeros_like(angle), angle], axis=1)


def _judge(
    identified: Identified,
    terms: Mapping[str, Term],
    pole_errors: Sequence[Errors],
    held_out: Sequence[Errors],
) -> tuple[Judged, ...]:
    """Judge every statement of the protocol."""
    gravity, coupling = terms["gravity"], terms["coupling"]
    driven, whole = _after(pole_errors, 0.2), _after(held_out, 0.5)
    zone = identified.description.phi.dead_zone
    why = ""
    if zone is not None and driven.clear_phi is not None:
        why = (
            "readings missing before the start, across the dead zone: without such starts it is "
            f"{short(driven.clear_phi, 3)}"
        )
    late = "commands that arrive late, or a drive that is not linear"
    measured: dict[str, tuple[float | None, float, bool, str]] = {
        "gravity": (
            _off(gravity),
            _width(gravity),
            False,
            "the given length, or the hinge",
        ),
        "coupling": (_off(coupling), _width(coupling), False, "the scale of the position"),
        "pole-0.2": (driven.away_phi, 0.0, False, why),
        "rig-0.5-phi": (whole.explained_phi, 0.0, True, late),
        "rig-0.5-z": (whole.explained_z, 0.0, True, late),
    }
    judged = []
    own = identified.description.limits
    for one in load_protocol().statements:
        if one.id in own:
            one = replace(one, limit=own[one.id], reason="as the description of the cart-pole says")
        value, width, at_least, suspected = measured[one.id]
        if value is None:
            suspected = "not decided: these recordings never get there, or have no known resolution"
        elif width > one.limit:
            value, suspected = None, "not decided: the interval is wider than the limit"
        found = Judged(
            id=one.id, statement=one.statement, measure=one.measure, limit=one.limit,
            reason=one.reason, value=value, at_least=at_least,
        )  # fmt: skip
        judged.append(found if found.holds else replace(found, suspected=suspected))
    return tuple(judged)


def _off(term: Term) -> float | None:
    """Return the relative difference of a term from its expected value."""
    return None if term.expected is None else abs(term.value / term.expected - 1.0)


def _width(term: Term) -> float:
    """Return half the interval of a term, relative to its expected value."""
    return 0.5 * (term.high - term.low) / abs(term.expected or 1.0)


def _after(errors: Sequence[Errors], horizon: float) -> Errors:
    """Return the errors after a horizon [s]."""
    return next(one for one in errors if one.horizon == horizon)


def _recorded(
    log: Log, number: int, starts: Starts, read: Array, identified: Identified
) -> Recorded:
    """Return a recording beside the predictions of half a second, one after the other."""
    values, w = identified.values, starts.windows
    scale, offset = values.get("angle_scale", 1.0), values["angle_offset"]
    turn, first = 2.0 * np.pi, starts.past - 1
    mine = np.flatnonzero(w.log == number)
    chosen, free_from = [], -np.inf
    for b in mine:
        if w.time[b, first] >= free_from:
            chosen.append(b)
            free_from = w.time[b, first] + 0.5
    rows = slice(first, first + round(0.5 / w.spacing) + 1)
    part = np.array(chosen, dtype=np.int64)
    angle = scale * read[part, 1, rows] + offset + turn * w.turns[part, rows]
    return Recorded(
        name=log.name,
        time=log.time,
        z=log.z,
        phi=np.where(log.valid, scale * log.phi + offset + turn * log.turns, np.nan),
        command=log.command,
        starts=w.time[part, first],
        predicted_time=w.time[part, rows],
        predicted_z=read[part, 0, rows],
        predicted_phi=angle,
    )
