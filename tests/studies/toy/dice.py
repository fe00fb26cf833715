"""Throw dice and count the eyes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from afl_mujoco.report.blocks import Cell, Figure, Matrix, Report
from afl_mujoco.studies.shared.arrays import Array
from afl_mujoco.studies.shared.contract import Progress, ScenarioNames, Study, silent


@dataclass(frozen=True, kw_only=True)
class Options:
    """Throw dice and count the eyes.

    Example: afl-mujoco dice --throws 10
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name; they only give their names."""
    throws: int = 20
    """How many throws."""
    quick: bool = False
    """Two throws."""


@dataclass(frozen=True, kw_only=True)
class Request:
    scenarios: tuple[Any, ...]
    throws: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    scenarios: tuple[str, ...]
    eyes: Array


def prepare(options: Options) -> Request:
    """Raise at what breaks a rule."""
    from afl_mujoco.errors import InvalidValueError
    from afl_mujoco.scenario.files import find_scenario

    if options.throws < 1:
        raise InvalidValueError("throws", "must be at least 1", options.throws)
    scenarios = tuple(find_scenario(name) for name in options.scenarios)
    return Request(scenarios=scenarios, throws=2 if options.quick else options.throws)


def run(request: Request, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Throw them."""
    import numpy as np

    eyes = np.random.default_rng(1).integers(1, 7, request.throws)
    progress("throwing", request.throws, request.throws)
    return Result(scenarios=tuple(one.name for one in request.scenarios), eyes=eyes)


def report(result: Result) -> Report:
    """Return what is shown of the dice."""
    from afl_mujoco.report.figures import new_figure

    def draw() -> Any:
        figure = new_figure(3.0, 2.0)
        figure.subplots().plot(result.eyes)
        return figure

    rows = [(str(i), Cell(str(x), "good" if x == 6 else "")) for i, x in enumerate(result.eyes)]
    every = Matrix(caption="Every throw", columns=("Throw", "Eyes"), rows=rows)
    figure = Figure(name="dice", title=f"{len(result.eyes)} throws", draw=draw)
    headline = f"The mean is {result.eyes.mean():.2f}."
    return Report(headline=headline, blocks=("*Fair* dice.", every, figure))


STUDY = Study(module=__name__, name="dice", title="Dice", order=99, schema=1)
