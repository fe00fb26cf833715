"""A comparison in words: who meets the requirements, what each run needed, curves over time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

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
    good_or_bad,
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
from afl_mujoco.studies.requirements_table import finding, requirements_table, tally

MAIN = (
    "peak_z", "peak_phi", "max_command", "max_force", "limited_share", "iae_z", "iae_phi",
    "force_squared", "force_variation", "settling_2pc_z", "settling_2pc_phi",
)  # fmt: skip
"""Metrics that are shown; the file has all of them."""

MEETS = "Every controller meets every requirement of its scenario, as deployed in MuJoCo."
MISSES = "At least one controller misses a requirement of its scenario."


def verdict(result: Result) -> Verdict:
    """Return whether every controller meets every requirement."""
    cases = list(dict.fromkeys(run.controller for run in result.runs if run.remarks))
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
        *(Text(f"`{run.controller}`: {remark}") for run in runs for remark in run.remarks),
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
    noise = f" One draw of the noise, seed {seed}." if scenario.imperfections.noisy else ""
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
    rows: list[tuple[Cell | str, ...]] = [
        (
            "outcome",
            "",
            *(Cell(run.outcome, good_or_bad(run.outcome == COMPLETED)) for run in runs),
        )
    ]
    rows += [
        (
            LABELS[name],
            unit_of(name),
            *(short(run.metrics.get(name)) for run in runs),
        )
        for name in shown
    ]
    return Table(
        caption="Metrics",
        columns=(
            Column("Metric"),
            Column("Unit"),
            *(Column(run.controller, number=True) for run in runs),
        ),
        rows=rows,
    )
