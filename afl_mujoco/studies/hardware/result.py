"""What recordings say about the identified model."""

from __future__ import annotations

from dataclasses import dataclass

from afl_mujoco.identification.identify import Identified
from afl_mujoco.identification.prediction import Errors
from afl_mujoco.studies.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """A term of the equations, from the judged recordings alone.

    Attributes
    ----------
    value, low, high
        The estimate, and its 95 % interval.
    expected
        What the equations demand; None where they leave it open.
    unit, title
        Its unit and its title.
    """

    value: float
    low: float
    high: float
    expected: float | None
    unit: str
    title: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A statement of the protocol, judged.

    Attributes
    ----------
    id, statement, measure, limit, reason
        As in the protocol.
    value
        What was measured; None if these recordings cannot decide it.
    at_least
        Whether the value must reach the limit; else it must not exceed it.
    suspected
        Suspected cause of a statement that does not hold, or why it is not decided; empty for one
        that holds.
    """

    id: str
    statement: str
    measure: str
    limit: float
    reason: str
    value: float | None
    at_least: bool
    suspected: str = ""

    @property
    def holds(self) -> bool:
        """Whether the statement holds; one that is not decided neither holds nor fails."""
        if self.value is None:
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    @property
    def fails(self) -> bool:
        """Whether the recordings show that the statement does not hold."""
        return self.value is not None and not self.holds


@dataclass(frozen=True, slots=True, kw_only=True)
class Survival:
    """A controller on the identified cart-pole.

    Attributes
    ----------
    controller
        Its name.
    angles
        By the name of a change, the largest starting angle from which it ends upright without
        reaching the end of its rail, as it does from every smaller one that was tried [rad]; 0 if
        there is none.
    runs, survived
        Number of runs on cart-poles drawn from the estimates, the pole slightly tilted at the
        start, and how many of them survived.
    """

    controller: str
    angles: dict[str, float]
    runs: int
    survived: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recorded:
    """A recording beside its predictions.

    Attributes
    ----------
    name
        Name of the recording.
    time, z, phi, command
        Its readings as states [s, m, rad], NaN where there is none, and its command, shape (N,).
    starts
        Instants of the starts [s], shape (S,).
    predicted_time, predicted_z, predicted_phi
        Predictions from each start on [s, m, rad], shape (S, n).
    """

    name: str
    time: Array
    z: Array
    phi: Array
    command: Array
    starts: Array
    predicted_time: Array
    predicted_z: Array
    predicted_phi: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Result:
    """What recordings say about the identified model.

    Attributes
    ----------
    source
        Where the recordings are.
    logs
        Names of the recordings.
    fitted
        Names of those that the estimates were fitted to: they prove nothing.
    identified
        The estimates.
    terms
        Terms of the pole's equation, by name: gravity, coupling and friction.
    held_out
        Errors of the whole cart-pole in MuJoCo, given the command, by horizon.
    whole
        The same for starts around which no row is missing; the command of a missing row is unknown.
    pole
        Errors of the pole alone, given the motion of the cart.
    baselines
        Errors of other models, given the command, by name.
    statements
        The statements of the protocol, judged.
    speeds
        Largest abs(z') [m/s] and abs(phi') [rad/s], of any reading.
    reach, turned
        Largest abs(z) [m], and the largest range of the angle in a recording [rad].
    band
        Horizons [s], and the rms errors of position [m] and angle [rad] after them, shape (3, H).
    recorded
        A recording beside its predictions.
    survival
        What controllers would do on that cart-pole; empty if nothing was drawn, or the estimates
        are too uncertain to draw from.
    """

    source: str
    logs: tuple[str, ...]
    fitted: tuple[str, ...]
    identified: Identified
    terms: dict[str, Term]
    held_out: tuple[Errors, ...]
    whole: tuple[Errors, ...]
    pole: tuple[Errors, ...]
    baselines: dict[str, tuple[Errors, ...]]
    statements: tuple[Judged, ...]
    speeds: tuple[float, float]
    reach: float
    turned: float
    band: Array
    recorded: Recorded
    survival: tuple[Survival, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every statement that could be decided holds, and one could be."""
        found = self.statements
        return any(one.holds for one in found) and not any(one.fails for one in found)

    def __repr__(self) -> str:
        """Summarise the outcome in one line."""
        held = sum(one.holds for one in self.statements)
        return f"<{len(self.logs)} recordings: {held} of {len(self.statements)} statements hold>"
