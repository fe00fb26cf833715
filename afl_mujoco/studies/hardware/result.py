"""What recordings say of the identified model."""

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
        The estimate, and its interval of 95 %.
    expected
        What the equations demand; None where they leave it open.
    unit, title
        Of it.
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
        As of the protocol.
    value
        What was measured; None where these recordings cannot tell.
    at_least
        Whether the value must reach the limit; else it must not exceed it.
    suspected
        What is behind a value that does not hold; empty for one that does.
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
        """Whether the statement does; what cannot be told does not."""
        if self.value is None:
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Survival:
    """A controller on the identified cart-pole.

    Attributes
    ----------
    controller
        Its name.
    angles
        Largest angle of the start from which, and from every smaller one that was tried, it ends
        upright without meeting the end of its rail [rad], by what is changed; 0 if from none.
    runs, survived
        On cart-poles drawn from the estimates, the pole leaning a little.
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
        Of the recording.
    time, z, phi, command
        Its readings as states [s, m, rad], NaN where there is none, and its command, shape (N,).
    starts
        Instants of the starts [s], shape (S,).
    predicted_time, predicted_z, predicted_phi
        From each start on, shape (S, n).
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
    """What recordings say of the identified model.

    Attributes
    ----------
    source
        Where the recordings are.
    logs
        Their names.
    fitted
        Those of them that the estimates were fitted to: they prove nothing.
    identified
        The estimates.
    terms
        Of the equations of the pole, by name: gravity, coupling, and its friction.
    held_out
        Errors of the whole in MuJoCo, the command known, by horizon.
    whole
        The same of starts about which no row is missing: of a row that is, the command is unknown.
    pole
        Errors of the pole alone, the motion of the cart known.
    baselines
        Errors of other models, the command known, by name.
    statements
        Of the protocol.
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
    film
        Whether a film is made.
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
    film: bool = False

    @property
    def passed(self) -> bool:
        """Whether every statement holds."""
        return all(one.holds for one in self.statements)

    def __repr__(self) -> str:
        """Say how it came out, in a line."""
        held = sum(one.holds for one in self.statements)
        return f"<{len(self.logs)} recordings: {held} of {len(self.statements)} statements hold>"
