"""Rows of runs as a reader sees them: how each failed, requirements by controllers, metrics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from statistics import median
from typing import Any

import tomli_w

from afl_mujoco.report.blocks import (
    MISSING,
    Block,
    Cell,
    Figure,
    Matrix,
    Replay,
    Status,
    percent,
    short,
)
from afl_mujoco.scenario.files import scenario_to_table
from afl_mujoco.scenario.requirements import asked_of, words_of
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED, Judgement
from afl_mujoco.simulation.metrics import label_of, unit_of
from afl_mujoco.simulation.trajectory import COMPLETED, DIVERGED, FELL, LAYOUT, Layout, effort_names
from afl_mujoco.studies.shared.arrays import Array
from afl_mujoco.studies.shared.run import Run

ENDINGS = {
    FELL: "falls",
    DIVERGED: "diverges",
    CONTROLLER_FAILED: "controller fails",
    "completes": "ends early",
    "end_stops": "reaches the end stop",
}
"""How runs fail that do not miss a limit."""

NEVER = "never"  # value of a requirement to settle that a run never meets


def how(failure: str, scenario: Scenario | None = None) -> str:
    """Return how a run fails, in words, of a scenario with its limit: the same in every study."""
    if not failure or failure in ENDINGS:
        return ENDINGS.get(failure, "passes")
    if scenario is None:
        return f"misses “{words_of(failure)}”"
    return f"misses “{_asked(failure, scenario.required[failure], scenario)}”"


def _asked(requirement: str, limit: float, scenario: Scenario) -> str:
    way, _, thing = requirement.partition(".")
    words = words_of(requirement, scenario.about(thing) if way == "max" else 0.0)
    if requirement == "completes":
        return words
    return f"{words} {short(limit)} {scenario.unit_of(requirement)}".rstrip()


Moving = Mapping[str, tuple[Array, Array]]
"""Instants [s] and states by controller."""


def replay(
    name: str, scenario: Scenario, runs: Moving, endings: Mapping[str, str], first: str = ""
) -> Replay:
    """Return runs that a page replays, and how each ended."""
    early = {name: words for name, words in endings.items() if words != COMPLETED}
    return Replay(
        name=name,
        title=f"{scenario.name} as it moves",
        caption=f"In MuJoCo as deployed.{first}",
        compute=partial(_replayed, scenario, runs, early),
    )


def _replayed(*arguments: Any) -> Mapping[str, Any]:
    from afl_mujoco.simulation.drawing import replay_data  # not before MuJoCo may be imported

    return replay_data(*arguments)


def as_file(scenario: Scenario) -> str:
    """Return a scenario as its file has it, to be read and copied."""
    plant = scenario.plant
    named = {} if scenario.is_cart_pole else {"plant": plant.origin or plant.name}
    return f"```toml\n{tomli_w.dumps(scenario_to_table(scenario) | named)}```"


def grouped(runs: Sequence[Run]) -> dict[tuple[str, str], list[Run]]:
    """Return the draws of each scenario and controller, in their order."""
    found: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        found.setdefault((run.scenario, run.controller), []).append(run)
    return found


def titled(metric: str, layout: Layout = LAYOUT) -> str:
    """Return a metric with its unit."""
    unit = unit_of(metric, layout)
    label = label_of(metric, layout)
    return f"{label} [{unit}]" if unit else label


Graded = Mapping[str, Sequence[tuple[int, str]]]
"""Rows of cells, each a grade and a text, by the label of the row."""

MARKED: Mapping[int, Status] = {0: "bad", 1: "neutral"}  # status of the cells of the worst grades


def graded(
    name: str, title: str, caption: str, columns: Sequence[str], cells: Graded, words: Sequence[str]
) -> list[Block]:
    """Return cells of grades, indices into `words`, worst first, as a figure and a table."""
    grades = [[grade for grade, _ in row] for row in cells.values()]
    texts = [[text for _, text in row] for row in cells.values()]
    rows: list[list[Cell | str]] = [
        [label, *(Cell(text, MARKED.get(grade, "")) for grade, text in row)]
        for label, row in cells.items()
    ]
    draw = partial(_heat, [*cells], columns[1:], grades, texts, words)
    return [
        Figure(name=name, title=title, draw=draw),
        Matrix(caption=f"{title}. {caption}", columns=columns, rows=rows),
    ]


def _heat(*arguments: Any) -> Any:
    """Draw `report.figures.heat`, which is imported no earlier."""
    from afl_mujoco.report import figures

    return figures.heat(*arguments)


Figures = Mapping[str, Sequence[Mapping[str, float | None]]]
"""Metrics of the draws of each controller."""


def requirements_matrix(
    scenario: Scenario, draws: Mapping[str, Sequence[Run]], metrics: Figures
) -> Matrix:
    """Return values and margins, of several draws the medians, by controllers; needs below."""
    every = (run for runs in draws.values() for run in runs)
    names = dict.fromkeys(one.requirement for run in every for one in run.requirements)
    rows: list[list[Cell | str]] = []
    known, plant = asked_of(scenario.plant), scenario.plant
    for name in [key for key in known if key in names]:
        label, cells = name, list[Cell]()
        for runs in draws.values():
            judged = [one for run in runs for one in run.requirements if one.requirement == name]
            label = _asked(name, judged[0].limit, scenario) if judged else label
            cells.append(_cell(name, runs, judged))
        rows.append([label, *cells])
    rows.append(["at rest for the last second", *(_settled(runs) for runs in draws.values())])
    # what a run needs of its hardware, shown where no requirement limits it
    efforts = [x for name in plant.inputs for x in (f"max.{name}_command", f"max.{name}")]
    needed = [*(f"max.{name}" for name in plant.coordinates), *efforts]
    needs = [known[name].metric for name in needed if name not in names]
    limited = [effort_names(plant.inputs, name)[-1] for name in plant.inputs]
    for name in [*needs, *limited]:
        found = [[one.get(name) for one in some] for some in metrics.values()]
        if any(x is not None for some in found for x in some):
            medians = (short(middle(some, math.inf), 3) for some in found)
            rows.append([titled(name, Layout.of(scenario)), *medians])
    several = any(len(runs) > 1 for runs in draws.values())
    return Matrix(
        caption=f"{scenario.name}: value (margin)"
        + (", medians over the draws, and how many meet it" if several else ""),
        columns=["Requirement", *draws],
        rows=rows,
    )


def middle(values: Iterable[float | None], unknown: float) -> float | None:
    """Return the median of numbers, None taken for one that is infinite; None if it is."""
    known = [unknown if x is None else x for x in values]
    found = median(known) if known else unknown
    return found if math.isfinite(found) else None


def _settled(runs: Sequence[Run]) -> str:
    count = sum(run.settled for run in runs)
    return ("no", "yes")[count] if len(runs) == 1 else f"{count} of {len(runs)}"


def _cell(name: str, runs: Sequence[Run], judged: Sequence[Judgement]) -> Cell:
    met = sum(one.met for one in judged)
    status: Status = "good" if met == len(runs) else "bad" if not met else "neutral"
    share = "" if met in (0, len(runs)) else f" {met} of {len(runs)}"
    if name == "completes":
        early = next((run for run in runs if run.outcome != COMPLETED), None)
        if early is None:
            return Cell(f"yes{share}", status)
        times = [run.time for run in runs if run.outcome != COMPLETED and run.time is not None]
        at = f" at {short(median(times), 3)} s" if times else ""
        return Cell(f"yes{share}, else " * bool(share) + f"{ENDINGS[early.outcome]}{at}", status)
    value = middle([one.value for one in judged], math.inf)  # never comes after any time
    margin = middle([one.margin for one in judged], -math.inf)
    if value is None:
        return Cell((NEVER if any(one.graded is not None for one in judged) else MISSING) + share,
                    status)  # fmt: skip
    text = short(value, 3) + ("" if margin is None else f" ({percent(margin)})")
    limited = any(one.limited for one in judged)  # so that the margin is the drive's
    return Cell(text + " limited" * limited + share, status)


def metrics_matrix(
    metrics: Figures,
    shown: Sequence[str],
    *,
    folded: str = "",
    digits: int = 3,
    layout: Layout = LAYOUT,
) -> Matrix:
    """Return metrics by controllers; of several draws the medians, with the ranges in brackets.

    A draw without a number counts as infinite, and how many have one is said.
    """

    def spread(values: Sequence[float | None]) -> str:
        known = [value for value in values if value is not None]
        if not known:
            return MISSING
        ends = (min(known), max(known)) if len(values) > 1 and min(known) < max(known) else ()
        text = " to ".join(short(end, digits) for end in ends)
        some = f"{len(known)} of {len(values)}" if len(known) < len(values) else ""
        inside = "; ".join(filter(None, (text, some)))
        return short(middle(values, math.inf), digits) + (f" ({inside})" if inside else "")

    rows = [
        [
            titled(name, layout),
            *(spread([one.get(name) for one in some]) for some in metrics.values()),
        ]
        for name in shown
    ]
    return Matrix(caption="Metrics", columns=["Metric", *metrics], rows=rows, folded=folded)
