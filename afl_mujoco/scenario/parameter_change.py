"""What a change of M and l does to the motion, which the paper leaves open (decision D9)."""

from __future__ import annotations

from dataclasses import dataclass

from afl_mujoco.errors import UnknownNameError

QUASI_STATIC, STRETCHING_ROD = "quasi-static", "stretching-rod"
DYNAMICS = (QUASI_STATIC, STRETCHING_ROD)
"""Whether the rate of l enters the equations of motion."""

VELOCITIES, MOMENTA = "velocities", "momenta"
JUMPS = (VELOCITIES, MOMENTA)
"""What a step of M or l keeps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterChange:
    """What a change of M and l does.

    Attributes
    ----------
    dynamics
        ``"quasi-static"``: nothing; M and l are frozen at each instant, as in the paper;
        ``"stretching-rod"``: the rod stretches uniformly at the rate of l.
    jumps
        ``"velocities"``: a step keeps z_dot and phi_dot, as in the paper: mass that is added
        already moves with the body it joins. ``"momenta"``: a step keeps the momenta of z and phi:
        mass that is added starts from rest, and a rod that grows turns more slowly.

    Raises
    ------
    UnknownNameError
        If a value is not one of these.
    """

    dynamics: str = QUASI_STATIC
    jumps: str = VELOCITIES

    def __post_init__(self) -> None:
        """Validate both choices."""
        if self.dynamics not in DYNAMICS:
            raise UnknownNameError.among("dynamics", self.dynamics, DYNAMICS)
        if self.jumps not in JUMPS:
            raise UnknownNameError.among("jumps", self.jumps, JUMPS)

    @property
    def stretching(self) -> bool:
        """Whether the rate of l enters the equations of motion."""
        return self.dynamics == STRETCHING_ROD

    @property
    def keeps_momenta(self) -> bool:
        """Whether a step keeps the momenta."""
        return self.jumps == MOMENTA

    @property
    def is_the_papers(self) -> bool:
        """Whether both choices are those of the paper."""
        return not self.stretching and not self.keeps_momenta

    def describe(self) -> dict[str, str]:
        """Return the choices as plain data, for provenance."""
        return {"dynamics": self.dynamics, "jumps": self.jumps}
