"""A comparison in words: who meets the requirements, what each run needed, curves over time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import cast

from afl_mujoco.document.blocks import (
    Block,
    Cell,
    Column,
    Fact,
    Facts,
    Figure,
    Finding,
    Section,
    Table,
    Text,
    Verdict,
)
from afl_mujoco.document.numbers import listed, short
from afl_mujoco.scenario.imperfections import IDEAL
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.words import belief_text, departures_text, describe
from afl_mujoco.simulation.metrics import LABELS, unit_of
from afl_mujoco.simulation.sampled.runs import ticks_of
from afl_mujoco.simulation.trajectory import COMPLETED
from afl_mujoco.studies.compare.figures import draw_responses
from afl_mujoco.studies.compare.result import ComparedRun, Result
from afl_mujoco.studies.opening import Need, Shown, opening_blocks
from afl_mujoco.studies.requirements_table import (
    by_case,
    finding,
    requirements_table,
    spread,
    tally,
)

MAIN = (
    "peak_z", "peak_phi", "max_command", "max_force", "limited_share", "iae_z", "iae_phi",
    "force_squared", "force_variation", "settling_2pc_z", "settling_2pc_phi",
)  # fmt: skip
"""Metrics that are shown; the file has all of them."""

MEETS = "Every controller meets every requirement of its scenario, as deployed in MuJoCo."
MISSES = "At least one controller misses a requirement of its scenario."


def verdict(result: Result) -> Verdict:
    """Return whether every controller meets every requirement."""
    cases = list(dict.fromkeys(r.controller for r in result.runs if r.remarks and not r.draw))
    also = f"; see what is remarked on {listed(cases, 'and')}" if cases else ""
    return Verdict(result.passed, tally(result.runs) + also, MEETS if result.passed else MISSES)


def sections(result: Result) -> list[Section]:
    """Return what a report says about a comparison."""
    parts = [_scenario(result, number, one) for number, one in enumerate(result.scenarios, 1)]
    return [Section("Controllers compared", "compare", parts)]


def judged_blocks(result: Result) -> list[Block]:
    """Return who meets the requirements of each scenario, and how much of each is left."""
    return [block for one in result.scenarios for block in _judged(result.runs_on(one), one)]


def _judged(runs: Sequence[ComparedRun], scenario: Scenario) -> list[Block]:
    """Return who meets the requirements of a scenario, with remarks and margins."""
    return [
        Finding(scenario.name, finding(runs)),
        *(
            Text(f"`{run.controller}`: {remark}")
            for run in runs
            if run.draw == 0
            for remark in run.remarks
        ),
        requirements_table(runs),
    ]


def opening(result: Result) -> list[Block]:
    """Return the system, the controllers on the first scenario, and what each run needed."""
    scenario = result.scenarios[0]
    shown = {
        name: Shown(run.time, run.state[:, 0], run.state[:, 1], run.force)
        for name, run in result.curves_on(scenario).items()
    }
    needs = [Need(run.scenario, run.controller, run.metrics, run.outcome) for run in result.runs]
    return opening_blocks("compare-opening", scenario, shown, needs)


def _deployment(result: Result, scenario: Scenario) -> str:
    """Say how the controllers were run on a scenario."""
    ticks = ticks_of(scenario, result.timestep, result.control_period)
    ideal = scenario.imperfections == IDEAL
    hardware = "ideal" if ideal else f"with {departures_text(scenario.imperfections)}"
    seed = scenario.imperfections.seed
    last = max(run.draw for run in result.runs_on(scenario))
    noise = ""
    if scenario.imperfections.drawn:
        noise = f" One draw of noise and start, seed {seed}."
        if last:
            noise = f" {last + 1} draws of noise and start, seeds {seed} to {seed + last}."
    return (
        f"As deployed in MuJoCo, {hardware}: "
        f"force held for {short(1e3 * ticks.period)} ms, physics steps of "
        f"{short(1e3 * ticks.timestep)} ms ({result.integrator}); controllers "
        f"{belief_text(scenario.belief)}.{noise}"
    )


def _scenario(result: Result, number: int, scenario: Scenario) -> Section:
    """Return what a report says about a scenario."""
    runs = result.runs_on(scenario)
    *words, table = _judged(runs, scenario)
    blocks = [*words, Text(_deployment(result, scenario)), table]
    pushes = "; grey across the panels: disturbances" if scenario.disturbances else ""
    if curves := result.curves_on(scenario):
        blocks.append(
            Figure(
                name=f"compare-{number}",
                title="Over time",
                caption="States, force and plant. Dashed: limits of the requirements; grey along "
                f"the curves: bands to come to rest in{pushes}.",
                alt=finding(runs),
                draw=partial(draw_responses, scenario, curves),
            )
        )
    blocks.append(_metrics(runs, scenario))
    facts = Facts([Fact(label, text) for label, text in describe(scenario)])
    blocks.append(Section("The scenario", f"compare-{number}-scenario", [facts], folded=True))
    return Section(scenario.name, f"compare-{number}", blocks)


def _metrics(runs: Sequence[ComparedRun], scenario: Scenario) -> Table:
    """Return metrics, a column for each controller; a required settling time replaces others."""
    required = scenario.requirements.settling_time is not None
    shown = [name for name in MAIN if not (required and name.startswith("settling_"))]
    cases = [cast("list[ComparedRun]", draws) for draws in by_case(runs)]
    rows: list[tuple[Cell | str, ...]] = [
        ("outcome", "", *(_outcome(draws) for draws in cases)),
        ("settled", "", *(_settled(draws) for draws in cases)),
    ]
    rows += [
        (
            LABELS[name],
            unit_of(name),
            *(spread([run.metrics.get(name) for run in draws]) for draws in cases),
        )
        for name in shown
    ]
    drawn = any(len(draws) > 1 for draws in cases)
    return Table(
        caption="Metrics" + "; of several draws the median, with the range in brackets" * drawn,
        columns=(
            Column("Metric"),
            Column("Unit"),
            *(Column(draws[0].controller, number=True) for draws in cases),
        ),
        rows=rows,
    )


def _outcome(draws: Sequence[ComparedRun]) -> Cell:
    """Return how some draws ended."""
    early = [run for run in draws if run.outcome != COMPLETED]
    if not early:
        return Cell(COMPLETED, "good")
    first = early[0].outcome
    return Cell(first if len(draws) == 1 else f"{len(early)} of {len(draws)}: {first}", "bad")


def _settled(draws: Sequence[ComparedRun]) -> str:
    """Return how many draws settled."""
    count = sum(run.settled for run in draws)
    return ("no", "yes")[count] if len(draws) == 1 else f"{count} of {len(draws)}"
