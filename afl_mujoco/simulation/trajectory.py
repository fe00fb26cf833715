"""The result of a simulation: read-only arrays on a time grid, how it ended, where it came from."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.compiled import inlined_kernel, jitable, kernel
from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import InvalidValueError, printable, reading
from afl_mujoco.files import array_names, atomic_file, read_arrays
from afl_mujoco.loading import told_of
from afl_mujoco.plants.cartpole import CART_POLE, FALL_ANGLE
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.scenario.files import scenario_to_table
from afl_mujoco.scenario.parameters import LARGEST_STATE, labelled
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import instants

TIPPED = 1.4
"""A run that cannot go on fell if ``|phi|`` had reached this [rad], where the force diverges."""

STATE_LIMIT = LARGEST_STATE
"""A run ends as diverged when a state or a force [SI] exceeds this, or is not finite."""

COMPLETED, FELL, DIVERGED = "completed", "fell", "diverged"
OUTCOMES = (COMPLETED, FELL, DIVERGED)
"""The ways a run can end, by the status code of the compiled loops."""

_PACKAGES = ("afl_mujoco", "mujoco", "numpy", "scipy", "numba")


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
        return self.kind if self.kind == COMPLETED else f"{self.kind} at t = {self.time:.6g} s"


@dataclass(frozen=True, slots=True)
class Layout:
    """What the columns of a run are called, and where its coordinates should be."""

    coordinates: tuple[str, ...] = ("z", "phi")
    inputs: tuple[str, ...] = ("force",)
    units: Mapping[str, str] = field(default_factory=lambda: dict(CART_POLE.units))
    target: tuple[float, ...] = (0.0, 0.0)
    wraps: tuple[str, ...] = ("phi",)
    signals: Mapping[str, float] = field(default_factory=dict)  # targets that are not 0

    @classmethod
    def of(cls, scenario: Scenario) -> Layout:
        """Return the layout of the runs of a scenario."""
        p = scenario.plant
        names = tuple(p.coordinates), tuple(p.inputs)
        goals = {name: x for name in p.signals if (x := scenario.about(name))}
        return cls(*names, dict(p.units), scenario.target, tuple(p.wraps), goals)

    def about(self, name: str) -> float:
        """Return from where deviations of a coordinate or a signal are measured, else 0."""
        known = {**self.signals, **dict(zip(self.coordinates, self.target, strict=True))}
        return known.get(name, 0.0)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the state: the coordinates, then their rates."""
        return (*self.coordinates, *(f"{name}_dot" for name in self.coordinates))

    def away(self, states: Floats) -> Floats:
        """Return states as deviations of their coordinates from the target, shape (N, 2 n)."""
        found = states.copy()
        for i, (name, target) in enumerate(zip(self.coordinates, self.target, strict=True)):
            found[:, i] -= target
            if name in self.wraps:
                turns = np.rint(found[:, i] / (2.0 * math.pi))
                found[:, i] -= np.where(turns == 0.0, 0.0, 2.0 * math.pi * turns)
        return found


LAYOUT = Layout()  # that of the cart-pole


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Trajectory:
    """A simulated run.

    Attributes
    ----------
    time
        Instants [s], shape (N,), increasing.
    state
        Coordinates and rates; of the cart-pole (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s], shape
        (N, 2 n).
    input
        What the drives exert from each instant on [N], shape (N,), or (N, k) of several inputs: the
        command, after limit, delay, slew limit and lag of a drive. Of the cart-pole also `force`.
    command
        What the controller asks for [N], in the shape of `input`, and equal to it by default.
    parameters
        True parameters of the plant by name, each of shape (N,), after a jump where there is one.
        Those of the cart-pole are attributes too, `cart_mass` [kg] and `half_length` [m].
    signals
        The signals of the plant by name, each of shape (N,).
    outcome
        How the run ended; one that fell or diverged stops before the horizon.
    provenance
        Scenario, controller, simulator, settings and versions, as plain data.
    effort
        Metrics of commands and inputs that the arrays do not show, because inputs change within a
        step; none where they do not.
    layout
        Names, units and targets of the columns.
    """

    time: NDArray[np.float64]
    state: NDArray[np.float64]
    input: NDArray[np.float64]
    parameters: Mapping[str, NDArray[np.float64]]
    outcome: Outcome
    signals: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    command: NDArray[np.float64] = None  # type: ignore[assignment]
    effort: Mapping[str, float] = field(default_factory=dict)
    layout: Layout = field(default_factory=Layout)

    def __post_init__(self) -> None:
        count, k = len(self.time), len(self.layout.inputs)
        if self.command is None:
            object.__setattr__(self, "command", self.input)
        object.__setattr__(self, "effort", MappingProxyType(dict(self.effort)))
        shapes: dict[str, tuple[int, ...]] = {"time": (count,)}
        shapes["state"] = (count, len(self.layout.states))
        shapes["input"] = shapes["command"] = (count,) if k == 1 else (count, k)
        for name, shape in shapes.items():
            object.__setattr__(self, name, _frozen(name, getattr(self, name), shape))
        for name in ("parameters", "signals"):
            table = {key: _frozen(key, x, (count,)) for key, x in getattr(self, name).items()}
            object.__setattr__(self, name, MappingProxyType(table))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @property
    def force(self) -> NDArray[np.float64]:
        """The force on the cart [N], shape (N,); of another plant, its inputs."""
        return self.input

    @property
    def cart_mass(self) -> NDArray[np.float64]:
        """The cart's true mass M [kg], shape (N,)."""
        return self._of_cart_pole("cart_mass")

    @property
    def half_length(self) -> NDArray[np.float64]:
        """The pole's true half-length l [m], shape (N,)."""
        return self._of_cart_pole("half_length")

    def _of_cart_pole(self, name: str) -> NDArray[np.float64]:
        if name not in self.parameters:
            known = ", ".join(self.parameters) or "none"
            raise AttributeError(f"this plant has no parameter {name}; parameters: {known}")
        return self.parameters[name]

    @property
    def inputs(self) -> NDArray[np.float64]:
        """What the drives exert, shape (N, k) also of one input."""
        return self.input.reshape(len(self.time), -1)

    @property
    def commands(self) -> NDArray[np.float64]:
        """What the controller asks for, shape (N, k) also of one input."""
        return self.command.reshape(len(self.time), -1)

    @property
    def away(self) -> NDArray[np.float64]:
        """States, their coordinates as deviations from the target, shape (N, 2 n)."""
        return self.layout.away(self.state)

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
        """Draw states, inputs and parameters over time; return the matplotlib figure."""
        from afl_mujoco.report.figures import SKY, TIME, new_figure, styled

        with styled():
            shown = _panels(self)
            rows = -(-len(shown) // 2)
            figure = new_figure(11.0, 2.5 * rows)
            axes = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
            for axis, (label, curve, pale) in zip(axes, shown, strict=False):
                axis.plot(self.time, curve, label=self.simulator, color=SKY, linewidth=2.6)
                if pale is not None:
                    axis.plot(self.time, pale, color=SKY, linewidth=0.6, alpha=0.5)
                axis.set_ylabel(label)
            for axis in axes:
                axis.margins(x=0.01)
            for axis in axes[-2:]:
                axis.set_xlabel(TIME)
            axes[0].legend()
            for axis in axes[len(shown) :]:
                axis.axis("off")
                axes[-3].tick_params(labelbottom=True)
                axes[-3].set_xlabel(TIME)
            figure.suptitle(self._title)
            return figure

    def to_pandas(self) -> Any:
        """Return states, inputs, commands and parameters as a pandas DataFrame, its index time [s].

        Raises
        ------
        InvalidValueError
            If pandas is not installed.
        """
        try:
            pandas = import_module("pandas")
        except ImportError:
            raise InvalidValueError("pandas", "must be installed: pip install pandas") from None
        inputs = self.layout.inputs
        names = ["command"] if len(inputs) == 1 else [f"{name}_command" for name in inputs]
        columns = dict(zip(self.layout.states, self.state.T, strict=True))
        columns |= dict(zip((*inputs, *names), (*self.inputs.T, *self.commands.T), strict=True))
        columns |= {**self.parameters, **self.signals}
        return pandas.DataFrame(columns, index=pandas.Index(self.time, name="time"))

    @property
    def _title(self) -> str:
        """Title of the run: scenario, controller, simulator."""
        what = (self.provenance.get(name, {}).get("name") for name in ("scenario", "controller"))
        return ", ".join(name for name in (*what, self.simulator) if name)

    def __repr__(self) -> str:
        return printable(f"<Trajectory: {self._title}: {self.outcome}, {len(self.time)} instants>")

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
            "layout": asdict(self.layout),
        }
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        for kind in ("parameters", "signals"):
            arrays |= {f"{kind}.{name}": x for name, x in getattr(self, kind).items()}
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
            tables: dict[str, dict[str, Any]] = {"parameters": {}, "signals": {}}
            named = [x for x in array_names(Path(path)) if x.partition(".")[0] in tables]
            whole: dict[str, Any] = dict(read_arrays(Path(path), ("meta", *_ARRAYS, *named)))
            meta = json.loads(str(whole.pop("meta")))
            kind, time = meta["outcome"]
            for key in named:
                table, _, name = key.partition(".")
                tables[table][name] = whole.pop(key)
            whole |= {**tables, "provenance": meta["provenance"], "effort": meta["effort"]}
            layout: Any = meta["layout"].items()
            layout = {x: tuple(y) if isinstance(y, list) else y for x, y in layout}
            return cls(**whole, outcome=Outcome(kind, float(time)), layout=Layout(**layout))


_ARRAYS = ("time", "state", "input", "command")


def _frozen(name: str, values: Any, shape: tuple[int, ...]) -> Floats:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise InvalidValueError(name, f"must have shape {shape}", array.shape)
    array.flags.writeable = False
    return array


@jitable
def deviation(x, target, wraps):
    """Return how far a coordinate is from its target, modulo 2 pi where it wraps."""
    away = x - target
    if wraps and abs(away) > math.pi:
        away -= 2.0 * math.pi * np.rint(away / (2.0 * math.pi))
    return away


@inlined_kernel
def within_limits(state):
    """Return whether a state is finite and below `STATE_LIMIT`."""
    for i in range(len(state)):
        if not abs(state[i]) < STATE_LIMIT:
            return False
    return True


class Criterion(NamedTuple):
    """When a run ends before its horizon."""

    target: Floats  # where the coordinates should be, shape (n,)
    wraps: NDArray[np.bool_]  # whether a deviation from it is taken modulo 2 pi, shape (n,)
    ends: Floats  # deviations that end a run as fallen, inf for none, shape (n,)
    tipped: Floats  # beyond these, a run that cannot go on fell, shape (n,)


def criterion_of(scenario: Scenario) -> Criterion:
    """Return when a run of a scenario ends before its horizon."""
    plant, names = scenario.plant, scenario.plant.coordinates
    ends = np.array([scenario.ends_at.get(name, math.inf) for name in names])
    return Criterion(
        target=np.array(scenario.target),
        wraps=np.array([name in plant.wraps for name in names]),
        ends=ends,
        tipped=TIPPED / FALL_ANGLE * ends,
    )


@kernel
def ending_of(criterion, state):
    """Return how a run that cannot continue from `state` has ended, an index into `OUTCOMES`."""
    for i in range(len(criterion.tipped)):
        if abs(deviation(state[i], criterion.target[i], criterion.wraps[i])) > criterion.tipped[i]:
            return 1
    return 2


@kernel
def has_ended(criterion, state):
    """Return whether a coordinate is as far from its target as ends a run."""
    for i in range(len(criterion.ends)):
        if abs(deviation(state[i], criterion.target[i], criterion.wraps[i])) >= criterion.ends[i]:
            return True
    return False


def controller_inputs(scenario: Scenario, controller: Controller, times: Floats) -> Floats:
    """Return the inputs of the controller at times [s], shape (N, numbers)."""
    return controller.inputs_for(scenario.values(instants(times)))


def signals_of(plant: Plant, states: Floats, values: Floats) -> dict[str, Floats]:
    """Return the signals of a plant along states and parameters, each of shape (N,)."""
    n, found = len(plant.coordinates), {}

    def each(name: str, rows: NDArray[np.intp]) -> Floats:
        several = []
        for k in rows:
            x, p = states[k], plant.named(values[k])
            with told_of(f"signal {name!r}", given=p):
                several.append(plant.signals[name](x[:n], x[n:], p))
        try:
            return np.array(several, dtype=np.float64).reshape(len(rows))
        except (TypeError, ValueError):
            raise InvalidValueError(f"signal {name!r}", "must be one number") from None

    every = np.arange(len(states))
    some = np.unique(np.linspace(0, len(states) - 1, 9).astype(np.intp))
    for name, signal in plant.signals.items():
        whole, expected = None, each(name, some)
        with suppress(Exception), np.errstate(all="ignore"):  # a function of numbers alone
            q, v = np.split(states.T.copy(), 2)
            whole = np.asarray(signal(q, v, plant.named(values)), dtype=np.float64)
        if whole is not None and whole.shape == every.shape:
            slack = 1e-13 * float(np.abs(expected[np.isfinite(expected)]).max(initial=0.0))
            if np.allclose(whole[some], expected, rtol=1e-13, atol=slack, equal_nan=True):
                found[name] = whole
                continue
        found[name] = each(name, every)
    for name, along in found.items():
        if (lost := np.flatnonzero(np.isnan(along))).size and np.isfinite(states[lost[0]]).all():
            where = dict(zip(plant.states, states[lost[0]].tolist(), strict=True))
            rule = "must be a number along a run"
            raise InvalidValueError(f"signal {name!r}", rule, f"nan at {where}")
    return found


@functools.cache
def _versions() -> Mapping[str, str]:
    return MappingProxyType({name: version(name) for name in _PACKAGES})


def effort_names(inputs: Sequence[str], name: str) -> tuple[str, str, str, str, str]:
    """Return the metrics of an input: largest command and force, square, variation, limit."""
    own = "" if len(inputs) == 1 else f"{name}_"
    most = "max_command" if not own else f"max_{name}_command"
    return most, f"max_{name}", f"{name}_squared", f"{name}_variation", f"{own}limited_share"


def assemble(
    scenario: Scenario,
    controller: Controller,
    simulator: str,
    settings: Mapping[str, Any],
    times: Floats,
    states: Floats,
    outcome: Outcome,
    inputs: Floats | None = None,
    **deployed: Any,
) -> Trajectory:
    """Put a simulator's result together; inputs are the controller's, within limits, by default."""
    reached, plant = times[: len(states)], scenario.plant
    if inputs is None:
        given = controller_inputs(scenario, controller, reached)
        inputs = controller.forces(states, given, reached)
    if "command" not in deployed:
        low, high = plant.limits.T
        asked = inputs.reshape(len(reached), -1)
        beyond = np.isfinite(asked) & ((asked <= low) | (asked >= high))
        shares = np.trapezoid(1.0 * beyond, reached, axis=0) / max(outcome.time, 1e-300)
        effort = {effort_names(plant.inputs, x)[-1]: float(y)
                  for x, y in zip(plant.inputs, shares, strict=True)}  # fmt: skip
        deployed = {**deployed, "command": inputs, "effort": effort}
        inputs = np.clip(asked, low, high).reshape(inputs.shape)
    values = scenario.values(instants(reached))
    provenance = {
        "simulator": simulator,
        "settings": dict(settings),
        "scenario": scenario_to_table(scenario),
        "controller": controller.describe(),
        "versions": dict(_versions()),
    }
    return Trajectory(
        time=reached,
        state=states,
        input=inputs,
        parameters=dict(zip(plant.parameters, values.T, strict=True)),
        signals=signals_of(plant, states, values),
        outcome=outcome,
        layout=Layout.of(scenario),
        provenance=provenance,
        **deployed,
    )


_Panel = tuple[str, Floats, Floats | None]


def _panels(run: Trajectory) -> list[_Panel]:
    """Return label, curve and a pale curve of each panel: each coordinate beside its rate."""
    layout, n = run.layout, len(run.layout.coordinates)
    found: list[_Panel] = []

    def label(name: str) -> str:
        return labelled(name, layout.units.get(name, ""))

    for i, name in enumerate(layout.coordinates):
        for column, state in ((i, name), (n + i, f"{name}_dot")):
            found.append((label(state), run.state[:, column], None))
    for name, force, command in zip(layout.inputs, run.inputs.T, run.commands.T, strict=True):
        differs = bool((force != command).any())
        told = label(name) + " (thin: command)" * differs
        found.append((told, force, command if differs else None))
    found += [(name, values, None) for name, values in run.signals.items()]
    return [*found, *((label(name), x, None) for name, x in run.parameters.items() if np.ptp(x))]
