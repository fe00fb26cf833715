"""Predictions of an identified cart-pole, and what ships with the package."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from afl_mujoco.errors import FileError, InvalidValueError
from afl_mujoco.files import read_json
from afl_mujoco.identification import pole, rig
from afl_mujoco.identification.description import Description, load_description
from afl_mujoco.identification.identify import Identified
from afl_mujoco.identification.least_squares import Array, explained, fitted_starts
from afl_mujoco.identification.log import Log, Windows, cut, read_logs, stride_of

FOLDER = Path(__file__).parent / "data" / "cartpole"
"""Recordings, their origin and licence, their description, and the estimates."""

FIT, CHOOSE = FOLDER / "fit", FOLDER / "validate"
"""The recordings used for identification, and those used by default to judge the model."""

DESCRIPTION, ESTIMATES = FOLDER / "description.toml", FOLDER / "estimates.json"


def described_logs(
    logs: Sequence[str], description: str | None, default: Sequence[Path]
) -> tuple[list[Log], Description]:
    """Return logs with their description; without both, some that come with the package."""
    if bool(logs) != (description is not None):
        thing = "description" if logs else "logs"
        raise InvalidValueError(thing, "must be given: logs need their description")
    known = load_description(description or DESCRIPTION)
    return read_logs(logs or default, known), known


def load_estimates(path: Path = ESTIMATES) -> Identified:
    """Return the estimates in a file that `afl-mujoco identify` wrote."""
    wrong, again = "has no estimates of afl-mujoco identify", "run afl-mujoco identify"
    found = read_json(path, Identified, wrong, again)
    known = pole.parameters_of(found.description)
    if found.drive is not None:
        known += rig.parameters_of(found.description)
    expected = [one.name for one in known]
    rule = f"must be as that command writes them: {again}"
    if list(found.values) != expected:
        named = ", ".join({*expected} ^ {*found.values}) or "their order"
        raise FileError(f"{path} {wrong}: {named}", rule)
    return found


AWAY = 0.5  # angle from upright beyond which a small error does not grow by itself [rad]
LONG_GAP = 5.0  # gap between rows, in their spacing, that a prediction may not have
SEEN = 5  # number of readings of the angle that a fitted state needs


def starts_of(logs: Sequence[Log], past: float, longest: float, every: float) -> Windows:
    """Return windows that begin every so many seconds, with a past to fit and a horizon."""
    period = min(log.period for log in logs)
    spacing = stride_of(period) * period
    rows = round(past / spacing) + 1
    length = (rows - 1) * spacing + longest
    return cut(logs, length, every, seen=SEEN, past=rows, gap=LONG_GAP, least=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Errors of predictions after some time."""

    horizon: float  # time after the start [s]
    # root of the mean squared error [rad, m]; None for a signal that was not predicted
    rms_phi: float
    rms_z: float | None
    counts_phi: float | None  # the same in counts of the sensors [1]; None without a resolution
    counts_z: float | None
    explained_phi: float  # share of variance explained, for the angle without its turns [1]
    explained_z: float | None
    # `counts_phi` of predictions whose start and end are more than `AWAY` from upright
    away_phi: float | None
    clear_phi: float | None  # the same, for starts before which no reading of the angle is missing
    starts: int  # number of starts, in all and away from upright
    away: int


def errors_of(
    w: Windows,
    predicted: Array,
    horizons: Sequence[float],
    values: Mapping[str, float],
    description: Description,
    *,
    position: bool = True,
    whole: bool = False,
) -> tuple[Errors, ...]:
    """Return the errors of predicted z and phi, shape (B, 2, n), after each horizon [s]."""
    d, v, there = description, {**pole.NONE, **values}, np.arange(w.count)
    angle = v["angle_scale"] * w.phi + v["angle_offset"]
    angle -= 2.0 * np.pi * np.round(angle / (2.0 * np.pi))  # without whole turns
    found = []
    for horizon in horizons:
        rows, near = w.rows(horizon)
        near = near & (w.there[there, rows] > 0.0) & (w.whole if whole else True)
        good = near & (w.valid[there, rows] > 0.0)
        off = (predicted[there, 1, rows] - w.phi[there, rows])[good]
        away = (np.abs(angle[there, rows]) > AWAY) & (np.abs(angle[:, w.past - 1]) > AWAY)
        clear = (away & (w.valid[:, : w.past] > 0.0).all(axis=1))[good]
        away = away[good]
        z_off = (predicted[there, 0, rows] - w.z[there, rows])[near]
        found.append(
            Errors(
                horizon=horizon,
                rms_phi=v["angle_scale"] * _rms(off),
                rms_z=_rms(z_off) if position else None,
                counts_phi=_counts(off, d.phi.count),
                counts_z=_counts(z_off, d.z.count) if position else None,
                explained_phi=explained(v["angle_scale"] * off, angle[there, rows][good]),
                explained_z=explained(z_off, w.z[there, rows][near]) if position else None,
                away_phi=_counts(off[away], d.phi.count) if away.any() else None,
                clear_phi=_counts(off[clear], d.phi.count) if clear.any() else None,
                starts=int(good.sum()),
                away=int(away.sum()),
            )
        )
    return tuple(found)


def predicted_by_pole(w: Windows, values: Mapping[str, float], description: Description) -> Array:
    """Return the predicted readings of the angle for a known motion of the cart, shape (B, n)."""
    scale = description.phi.count or 1e-6
    read = partial(pole.Drive(w, description.nominal.gravity).readings, values)
    own = fitted_starts(
        lambda x: w.before * (read(x) - w.phi) / (1e3 * scale), w.starts[:, [1, 3]],
        pole.START_SCALE,
    )  # fmt: skip
    return read(own)


def predicted_by_rig(
    w: Windows,
    values: Mapping[str, float],
    description: Description,
    scatter: tuple[float, float],
    *,
    workers: int = 1,
) -> Array:
    """Return the predicted readings for known commands, shape (B, 2, n).

    The scatter of position and angle [m, rad] weights their readings.
    """
    whole, first = rig.Rig(w, description, workers), w.where(slice(None), w.past)
    past = rig.Rig(first, description, workers)
    measured = np.stack([first.z, first.phi], axis=1)
    weights = np.stack([first.there, first.valid], axis=1) / np.array(scatter)[:, None]

    def errors(own: Array) -> Array:
        return np.reshape(weights * (past.readings(values, own) - measured), (w.count, -1))

    own = fitted_starts(lambda x: errors(x) / 1e3, w.starts, rig.START_SCALE, rounds=3)
    own = fitted_starts(errors, own, rig.START_SCALE, rounds=2)
    return whole.read(values, whole.motion(values, own))


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2))) if errors.size else float("nan")


def _counts(errors: Array, resolution: float) -> float | None:
    return _rms(errors) / resolution if resolution > 0.0 else None
