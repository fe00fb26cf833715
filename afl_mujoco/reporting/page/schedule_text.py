"""A schedule in words, from its curve: how M, l and the push go over time."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.document.numbers import short

TOLERANCE = 1e-6
"""Slopes that differ by less are one slope: a share of the largest value, per second."""

JUMP = 1e-3
"""How much must change between two instants to be a jump: a share of the largest value."""

MOST = 8
"""Changes up to which a schedule is told one by one."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A straight piece of a curve.

    Attributes
    ----------
    start, end
        When it begins and ends [s].
    first, last
        Its values there.
    jump
        Whether it is a jump, seen between two neighbouring instants.
    """

    start: float
    end: float
    first: float
    last: float
    jump: bool = False

    @property
    def level(self) -> bool:
        """Whether the value stays."""
        scale = max(abs(self.first), abs(self.last))
        return abs(self.last - self.first) <= TOLERANCE * scale


def straight_pieces(time: NDArray[np.float64], values: NDArray[np.float64]) -> list[Piece]:
    """Cut a piecewise-linear curve where its slope changes.

    Parameters
    ----------
    time
        Instants [s], shape (N,), two at least.
    values
        The curve, shape (N,).
    """
    scale = float(np.abs(values).max())
    slopes = np.diff(values) / np.diff(time)
    kinks = np.flatnonzero(np.abs(np.diff(slopes)) > TOLERANCE * scale) + 1
    cuts = [0, *kinks.tolist(), len(time) - 1]
    pieces: list[Piece] = []
    for i, j in itertools.pairwise(cuts):
        piece = Piece(float(time[i]), float(time[j]), float(values[i]), float(values[j]))
        if j > i + 1 or len(cuts) == 2:
            pieces.append(piece)
        elif abs(piece.last - piece.first) > JUMP * scale:
            pieces.append(Piece(piece.start, piece.end, piece.first, piece.last, jump=True))
        # What is left is a kink between two instants: a sliver that tells nothing.
    return pieces


def schedule_text(time: NDArray[np.float64], values: NDArray[np.float64], unit: str) -> str:
    """Say how a parameter goes over time.

    Parameters
    ----------
    time
        Instants [s], shape (N,).
    values
        The parameter, shape (N,).
    """
    pieces = straight_pieces(time, values)
    changes = list(_changes(pieces, unit))
    start = f"{short(float(values[0]))} {unit}"
    if not changes:
        return f"{start} throughout"
    if len(changes) > MOST:
        least, most = (short(float(x)) for x in (values.min(), values.max()))
        return f"{least} to {most} {unit}, {len(changes)} changes"
    return "; ".join((start, *changes))


def _changes(pieces: list[Piece], unit: str) -> Iterator[str]:
    """Say every jump and ramp."""
    for piece in pieces:
        to = f"{short(piece.last)} {unit}"
        if piece.jump:
            yield f"jumps to {to} at {short(piece.end)} s"
        elif not piece.level:
            way = "rises" if piece.last > piece.first else "falls"
            yield f"{way} to {to} over {short(piece.start)} to {short(piece.end)} s"


def push_text(time: NDArray[np.float64], push: NDArray[np.float64]) -> str:
    """Say when a disturbing force pushes the cart.

    Parameters
    ----------
    time
        Instants [s], shape (N,).
    push
        The force [N], shape (N,).
    """
    if not push.any():
        return "none"
    edges = np.flatnonzero(np.diff(push)) + 1
    cuts = [0, *edges.tolist(), len(time) - 1]
    told = [
        f"{short(float(push[i]))} N over {short(float(time[i]))} to {short(float(time[j]))} s"
        for i, j in itertools.pairwise(cuts)
        if push[i]
    ]
    return "; ".join(told) if len(told) <= MOST else f"{len(told)} pulses"


def breakpoints(time: NDArray[np.float64], *curves: NDArray[np.float64]) -> tuple[float, ...]:
    """Return the instants at which a prescribed curve begins to change or jumps [s].

    Parameters
    ----------
    time
        Instants [s], shape (N,).
    curves
        M, l and the push, shape (N,) each.
    """
    found = {0.0}
    for values in curves:
        for piece in straight_pieces(time, values):
            found.add(piece.end if piece.jump else piece.start)
    return tuple(sorted(round(t, 9) for t in found))
