"""Control performance of a run (Tier C): integrals, peaks, settling."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from afl_mujoco.control.controller import Controller
from afl_mujoco.plants.plant import Floats
from afl_mujoco.scenario.parameters import from_target, symbol
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.time_steps import instants
from afl_mujoco.simulation.trajectory import COMPLETED, LAYOUT, Layout, Trajectory, effort_names

Metrics = dict[str, float | None]
"""Figures by name; ``None`` where a run has no such figure (never settled, never completed,
not finite, or its controller has no boundary layer)."""

BANDS = {"2pc": 0.02, "5pc": 0.05}  # settling bands as a share of the peak of the state

_LABELS: Mapping[str, str] = {
    "objective": "objective OF",
    "saturated_share": "share of time outside the boundary layer",
    "end_time": "end",
}
"""Names in a report of the metrics that the cart-pole alone has, or every run once."""

_OF_INPUT = ("largest command of {}", "max |{}| exerted", "∫{}² dt", "total variation of {}",
             "share of time at the limit of {}")  # fmt: skip
"""Names of those of an input, in the order of `effort_names`."""

_OF_STATE = {
    "iae_": ("∫|{}| dt", "{} s"),
    "itae_": ("∫t|{}| dt", "{} s^2"),
    "peak_": ("max |{}|", "{}"),
    "least_": ("least {}", "{}"),
    "overshoot_": ("overshoot of {}", "{}"),
    # not "settling": that is what a requirement asks for, by its own bands
    "settling_2pc_": ("|{}| stays below 2 % of its peak from", "s"),
    "settling_5pc_": ("|{}| stays below 5 % of its peak from", "s"),
}
"""Label and unit of the metrics of a state, by the beginning of their names."""


def _parsed(key: str) -> tuple[str, str]:
    start = next((one for one in _OF_STATE if key.startswith(one)), "")
    return start, key.removeprefix(start)


def _efforts(layout: Layout) -> dict[str, tuple[str, str]]:
    """Return what each metric of an input is in words, and of which one it is."""
    return {
        metric: (words, one)
        for one in layout.inputs
        for metric, words in zip(effort_names(layout.inputs, one), _OF_INPUT, strict=True)
    }


def label_of(key: str, layout: Layout = LAYOUT) -> str:
    """Return the name of a metric in a report."""
    if key in _LABELS:
        return _LABELS[key]
    words, one = _efforts(layout).get(key, ("", ""))
    if words:
        return words.format("F" if one == "force" else symbol(one))
    start, name = _parsed(key)
    if not start:
        return key.replace("_", " ")
    away = 0.0 if start == "least_" else layout.about(name)  # all others are of deviations
    return _OF_STATE[start][0].format(from_target(name, away))


def unit_of(key: str, layout: Layout = LAYOUT) -> str:
    """Return the unit of a metric as a report writes it; nothing for a pure number."""
    _, own = _efforts(layout).get(key, ("", ""))
    if own:
        unit = "" if key.endswith("_share") else layout.units.get(own, "")
        return (f"{unit}^2 s" if unit and key.endswith("_squared") else unit).replace("^2", "²")
    if key == "end_time":
        return "s"
    start, name = _parsed(key)
    unit = layout.units.get(name, "")
    return _OF_STATE[start][1].format(unit).replace("^2", "²") if start else ""


def metric_names(layout: Layout = LAYOUT) -> tuple[str, ...]:
    """Return the metrics of a plant in the order in which tables have them."""
    per_input = [effort_names(layout.inputs, name) for name in layout.inputs]
    return (
        "objective",
        *(f"iae_{name}" for name in layout.coordinates),
        *(f"itae_{name}" for name in layout.coordinates),
        *(one[k] for k in (0, 1, 4, 2, 3) for one in per_input),
        "saturated_share",
        *(f"peak_{name}" for name in layout.states),
        *(f"overshoot_{name}" for name in layout.states),
        *(f"settling_{band}_{name}" for band in BANDS for name in layout.states),
        "end_time",
    )


def in_order(names: Iterable[str]) -> list[str]:
    """Return metrics of any plant in the order of tables, whatever is not of the cart-pole last."""
    given = dict.fromkeys(names)
    known = [name for name in metric_names() if name in given]
    return [*known, *(name for name in given if name not in known)]


def metrics(scenario: Scenario, controller: Controller, run: Trajectory) -> Metrics:
    """Return every metric of a run except the objective, which needs `with_objective`."""
    if not scenario.is_cart_pole:
        return metrics_of(run)
    times, values = instants(run.time), scenario.values
    if run.simulator.endswith("sampled"):  # as the controller is told the parameters
        late = scenario.imperfections.parameter_delay
        times, values = instants(np.maximum(run.time - late, 0.0)), scenario.told_values
    inputs = controller.inputs_for(values(times))
    ratio, share = controller.saturation_ratio(run.state, inputs), None
    if ratio is not None:  # of the time in which the switching term is saturated
        saturated = (np.abs(ratio) >= 1.0).astype(float)
        share = integral(saturated, run.time) / float(max(run.time[-1], 1e-300))
    return metrics_of(run) | {"saturated_share": _known(share)}


def metrics_of(run: Trajectory) -> Metrics:
    """Return the metrics that need the run alone, without its controller."""
    time, away, layout = run.time, run.away, run.layout
    completed, states = run.outcome.kind == COMPLETED, dict(zip(layout.states, away.T, strict=True))
    coordinates = tuple(zip(layout.coordinates, away.T, strict=False))
    figures: Metrics = {f"iae_{name}": integral(np.abs(x), time) for name, x in coordinates}
    figures |= {f"itae_{name}": integral(time * np.abs(x), time) for name, x in coordinates}
    integrals = [*figures]
    squares = integral if run.control_period is None else _staircase
    for name, force, command in zip(layout.inputs, run.inputs.T, run.commands.T, strict=True):
        names = effort_names(layout.inputs, name)
        integrals.append(names[2])
        # at rest before t = 0
        variation = float(np.abs(np.diff(force, prepend=0.0)).sum())
        largest = (float(np.abs(command).max()), float(np.abs(force).max()))
        values = (*largest, squares(force**2, time), variation, 0.0)
        figures |= dict(zip(names, values, strict=True))
    figures |= {"end_time": run.outcome.time, **run.effort}
    signals = {name: x - layout.about(name) for name, x in run.signals.items()}
    figures |= {f"peak_{x}": float(np.abs(y).max()) for x, y in (states | signals).items()}
    figures |= {f"least_{name}": float(x.min()) for name, x in run.signals.items()}
    for name, x in states.items():
        figures[f"overshoot_{name}"] = _overshoot(x)
        for label, share in BANDS.items():
            settled = _settling_time(time, x, share) if completed else None
            figures[f"settling_{label}_{name}"] = settled
    if not completed:  # an integral over part of the horizon cannot be compared
        figures |= dict.fromkeys(integrals)
    return {name: _known(value) for name, value in figures.items()}


def _known(value: float | None) -> float | None:
    """Return a figure, None if not finite: outside its domain a controller has no force."""
    return value if value is not None and math.isfinite(value) else None


def integral(values: Floats, time: Floats) -> float:
    """Return the integral over time by the trapezoidal rule."""
    return float(np.trapezoid(values, time))


def _staircase(values: Floats, time: Floats) -> float:
    return float(values[:-1] @ np.diff(time))


def _overshoot(x: Floats) -> float:
    """Return how far a state passes its target 0, or leaves it if it starts there."""
    start = x[0]
    return float(max(0.0, (-np.sign(start) * x).max())) if start else float(np.abs(x).max())


def _settling_time(time: Floats, x: Floats, share: float) -> float | None:
    """Return when the state enters the band around 0 for good; None if it ends outside."""
    outside = np.flatnonzero(np.abs(x) > share * np.abs(x).max())
    if not len(outside):
        return 0.0
    return float(time[outside[-1] + 1]) if outside[-1] + 1 < len(time) else None
