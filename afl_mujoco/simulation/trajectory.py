"""The result of a simulation: read-only arrays on a time grid, how it ended, where it came from."""

from __future__ import annotations

import functools
import html
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import kernel
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError, printable, reading
from afl_mujoco.files import atomic_file, read_arrays
from afl_mujoco.scenario.files import scenario_to_table
from afl_mujoco.scenario.parameters import LARGEST_STATE
from afl_mujoco.scenario.sampling import instants
from afl_mujoco.scenario.scenario import Scenario

FALL_ANGLE = 0.5 * math.pi - 1e-3
"""A run ends as fallen when ``|phi|`` reaches this [rad]: the controller is singular at pi/2."""

TIPPED = 1.4
"""A run that cannot go on fell if ``|phi|`` had reached this [rad], where the force diverges."""

STATE_LIMIT = LARGEST_STATE
"""A run ends as diverged when a state or a force [SI] exceeds this, or is not finite."""

COMPLETED, FELL, DIVERGED = "completed", "fell", "diverged"
OUTCOMES = (COMPLETED, FELL, DIVERGED)
"""The ways a run can end, by the status code of the compiled loops."""

_PACKAGES = ("afl_mujoco", "mujoco", "numpy", "scipy", "numba")
_ARRAYS = ("time", "state", "force", "command", "cart_mass", "half_length")


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended.

    Attributes
    ----------
    kind
        ``"completed"``, ``"fell"`` or ``"diverged"``.
    time
        When it ended [s].
    """

    kind: str
    time: float

    def __str__(self) -> str:
        """Return the outcome as a report writes it."""
        return self.kind if self.kind == COMPLETED else f"{self.kind} at t = {self.time:.6g} s"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Trajectory:
    """A simulated run.

    Attributes
    ----------
    time
        Instants [s], shape (N,), increasing.
    state
        (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s], shape (N, 4).
    force
        Force that is exerted on the cart from each instant on [N], shape (N,): the command, after
        limit, delay, slew limit and lag of the drive.
    command
        Force that the controller asks for [N], shape (N,); equal to `force` by default.
    cart_mass, half_length
        True M [kg] and l [m], shape (N,), after the jump where there is one.
    outcome
        How the run ended; one that fell or diverged stops before the horizon.
    provenance
        Scenario, controller, simulator, settings and versions, as plain data.
    effort
        Metrics of command and force that the arrays do not show, because the force changes within a
        step; none where it does not.
    """

    time: NDArray[np.float64]
    state: NDArray[np.float64]
    force: NDArray[np.float64]
    cart_mass: NDArray[np.float64]
    half_length: NDArray[np.float64]
    outcome: Outcome
    provenance: Mapping[str, Any] = field(default_factory=dict)
    command: NDArray[np.float64] = None  # type: ignore[assignment]
    effort: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the shapes and freeze the arrays."""
        count = len(self.time)
        if self.command is None:
            object.__setattr__(self, "command", self.force)
        object.__setattr__(self, "effort", MappingProxyType(dict(self.effort)))
        for name in _ARRAYS:
            array = np.array(getattr(self, name), dtype=np.float64)
            shape = (count, 4) if name == "state" else (count,)
            if array.shape != shape:
                raise InvalidValueError(name, f"must have shape {shape}", array.shape)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @property
    def simulator(self) -> str:
        """Name of the simulator, as the report calls it."""
        return str(self.provenance.get("simulator", "unknown"))

    @property
    def control_period(self) -> float | None:
        """How long the force is held [s], as in sampled mode; None where it varies in between."""
        period: float | None = self.provenance.get("settings", {}).get("control_period")
        return period

    @property
    def metrics(self) -> dict[str, float | None]:
        """Its figures by name: integrals, peaks, settling; None where there is none.

        A held force is integrated as a staircase; its total variation begins at 0, before t = 0.
        """
        from afl_mujoco.simulation.metrics import metrics_of

        return metrics_of(self)

    def plot(self) -> Any:
        """Draw states, force, M and l over time; return the matplotlib figure."""
        from afl_mujoco.simulation.figures import draw_runs

        return draw_runs([self], self._title)

    def to_pandas(self) -> Any:
        """Return states, force, command, M and l as a pandas DataFrame, its index the time [s].

        Raises
        ------
        InvalidValueError
            If pandas is not installed.
        """
        try:
            pandas = import_module("pandas")
        except ImportError:
            raise InvalidValueError("pandas", "must be installed: pip install pandas") from None
        columns = dict(zip(("z", "phi", "z_dot", "phi_dot"), self.state.T, strict=True))
        columns |= {name: getattr(self, name) for name in _ARRAYS[2:]}
        return pandas.DataFrame(columns, index=pandas.Index(self.time, name="time"))

    @property
    def _title(self) -> str:
        """Title of the run: scenario, controller, simulator."""
        what = (self.provenance.get(name, {}).get("name") for name in ("scenario", "controller"))
        return ", ".join(name for name in (*what, self.simulator) if name)

    def __repr__(self) -> str:
        """Return what was simulated and how it ended, in one line."""
        said = f"<Trajectory: {self._title}: {self.outcome}, {len(self.time)} instants>"
        return printable(said)

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: how the run ended, and its figures in a table."""
        from afl_mujoco.simulation.metrics import LABELS, unit_of

        heads = ("metric", "value", "unit", "key of <code>metrics</code>")
        head = "".join(f"<th>{one}</th>" for one in heads)
        rows = f"<tr>{head}</tr>" + "".join(
            f"<tr><td>{LABELS[name]}</td><td>{'–' if value is None else f'{value:.5g}'}</td>"
            f"<td>{unit_of(name)}</td><td><code>{name}</code></td></tr>"
            for name, value in self.metrics.items()
        )
        title = html.escape(f"{self._title}: {self.outcome}")
        return f"<details><summary>{title}</summary><table>{rows}</table></details>"

    def save(self, path: str | Path) -> None:
        """Write the run to an npz file, whole or not at all.

        Parameters
        ----------
        path
            The file to write.

        Raises
        ------
        FileError
            If the file cannot be written.
        """
        meta = {
            "outcome": [self.outcome.kind, self.outcome.time],
            "provenance": dict(self.provenance),
            "effort": dict(self.effort),
        }
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        with atomic_file(Path(path)) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, **arrays, meta=np.array(json.dumps(meta)))

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """Read a run that `save` wrote.

        Parameters
        ----------
        path
            The file to read.

        Raises
        ------
        FileError
            If the file cannot be read or is not a saved run.
        """
        with reading(path, "is not a saved trajectory"):
            arrays: dict[str, Any] = dict(read_arrays(Path(path), ("meta", *_ARRAYS)))
            meta = json.loads(str(arrays.pop("meta")))
            kind, time = meta["outcome"]
            known = {name: meta[name] for name in ("provenance", "effort")}
            return cls(**arrays, outcome=Outcome(kind, float(time)), **known)


@kernel
def within_limits(state):
    """Return whether a state is finite and below `STATE_LIMIT`."""
    for i in range(4):
        if not abs(state[i]) < STATE_LIMIT:
            return False
    return True


@kernel
def ending_of(state):
    """Return how a run that cannot continue from `state` has ended, an index into `OUTCOMES`."""
    return 1 if abs(state[1]) > TIPPED else 2


def controller_inputs(
    scenario: Scenario, controller: Controller, times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the inputs of the controller at each of the `times`, shape (N, 7) or (N, 8).

    times: Instants [s], shape (N,).
    """
    return controller.inputs_along_run(
        scenario.cart_mass(instants(times)),
        scenario.half_length(instants(times)),
        scenario.pole_mass,
        scenario.gravity,
    )


@functools.cache
def _versions() -> Mapping[str, str]:
    """Return the versions that a run depends on; looking them up takes milliseconds."""
    return MappingProxyType({name: version(name) for name in _PACKAGES})


def assemble(
    scenario: Scenario,
    controller: Controller,
    simulator: str,
    settings: Mapping[str, Any],
    times: NDArray[np.float64],
    states: NDArray[np.float64],
    outcome: Outcome,
    forces: NDArray[np.float64] | None = None,
    **deployed: Any,
) -> Trajectory:
    """Put a simulator's result together.

    times: The grid [s], shape (N,).
    states: The states reached, shape (K, 4), K <= N.
    forces: Forces [N], shape (K,); by default the controller's at each state.
    """
    reached = times[: len(states)]
    if forces is None:
        forces = controller.forces(
            states, controller_inputs(scenario, controller, reached), reached
        )
    return Trajectory(
        time=reached,
        state=states,
        force=forces,
        cart_mass=scenario.cart_mass(instants(reached)),
        half_length=scenario.half_length(instants(reached)),
        outcome=outcome,
        **deployed,
        provenance={
            "simulator": simulator,
            "settings": dict(settings),
            "scenario": scenario_to_table(scenario),
            "controller": controller.describe(),
            "versions": dict(_versions()),
        },
    )
