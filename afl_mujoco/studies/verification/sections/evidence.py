"""Error budget, refinement studies, ledgers and omissions."""

from __future__ import annotations

from collections.abc import Sequence

from afl_mujoco.report.numbers import fixed, percent, scientific, sentence, short, size
from afl_mujoco.report.old import Block, Cell, Column, Finding, Section, Table, Text
from afl_mujoco.simulation.metrics import STATE_UNITS, SYMBOLS
from afl_mujoco.studies.verification.checks.convergence import Refinement
from afl_mujoco.studies.verification.checks.error_budget import ErrorBudget
from afl_mujoco.studies.verification.checks.explanation import Omission
from afl_mujoco.studies.verification.figures.budget import budget_figure
from afl_mujoco.studies.verification.figures.energy import energy_figure
from afl_mujoco.studies.verification.figures.orders import orders_figure
from afl_mujoco.studies.verification.result import Result
from afl_mujoco.studies.verification.sections.checks import check_link
from afl_mujoco.studies.verification.sections.decisions import rests_on

NO_BREAK = "\u00a0"

SOURCES = {
    "control_hold": "force held",
    "schedule_sampling": "M, l frozen over a step",
    "disturbance_timing": "disturbance moved to the steps",
    "integrator": "MuJoCo's integrator",
    "model_form": "model form",
}
"""Sources of the error budget in words."""

DEEDS = {
    "control_hold": "holding the force",
    "schedule_sampling": "freezing M and l over a step",
    "disturbance_timing": "moving the disturbance to the steps",
    "integrator": "MuJoCo's integrator",
    "model_form": "the form of MuJoCo's model",
}
"""The same for use in a sentence."""

MOST = 4
"""Largest number of scenarios whose ledger of energy is drawn."""

STUDIES = {
    "continuous": "continuous mode, over the step",
    "sampled": "sampled mode, over the control period",
    "schedule": "schedule frozen alone, over the step",
}
"""Refinement studies in words."""


def evidence_sections(result: Result) -> list[Section]:
    """Return the error budget, and what a full verification adds."""
    return [_budget(result), _studies(result)]


def _budget(result: Result) -> Section:
    """Return the reasons why a run as deployed differs from the ideal equations."""
    blocks: list[Block] = [
        Finding("As deployed", _deployed(result)),
        Text(
            "Why a run in MuJoCo as deployed (force held over each control period, fixed steps) "
            "differs from the ideal equations by as much as it does. Each source is switched on "
            "alone; the residual is what they leave unexplained. Every value is the largest of "
            "any state at any instant (m, rad, m/s, rad/s)."
        ),
        rests_on(result, "budget"),
    ]
    if result.error_budgets:
        blocks += [budget_figure(result.error_budgets), _budget_table(result.error_budgets)]
        blocks.append(Text(f"The residual is judged by {check_link(result, 'B5')}.", note=True))
    return Section("Error budget", "budget", blocks)


def _deployed(result: Result) -> str:
    """Say by how much the deployed run differs from the ideal one, and why."""
    budgets = result.error_budgets
    if not budgets:
        return "No case completed in every simulator, so there is no difference to explain."
    cases, run = len(result.decisive_runs), "A run as deployed"
    if len(budgets) < cases:
        run = f"Of {cases} cases {len(budgets)} completed in every simulator; a run of these"
    row = max(budgets, key=lambda budget: budget.total)
    worst = row.at_worst
    symbol, unit = SYMBOLS[worst.state], STATE_UNITS[worst.state]
    largest = max(DEEDS, key=lambda name: abs(getattr(worst, name)))
    share = getattr(worst, largest) / worst.total if worst.total else 0.0
    own = scientific(abs(worst.integrator + worst.model_form))
    left = percent(max(budget.residual_share for budget in budgets))
    period = short(1e3 * result.settings.control_period)
    return (
        f"{run}, with the force held for {period} ms, differs from the ideal one by at most "
        f"{short(row.total, 2)} ({symbol} in {unit}, {row.scenario} with {row.controller}, at "
        f"t = {short(worst.time)} s): there {DEEDS[largest]} accounts for {percent(share, 4)} of "
        f"it, and MuJoCo itself (integrator and model) for {own} {unit}; in no run is more than "
        f"{left} of the difference unexplained."
    )


def _budget_table(budgets: Sequence[ErrorBudget]) -> Table:
    """Return one row for each run as deployed."""
    return Table(
        summary=f"Error budget of {len(budgets)} runs",
        caption="Error budget of the run as deployed, the largest source of each in bold",
        columns=(
            Column("Scenario"),
            Column("Controller"),
            Column("Total", number=True),
            Column("Where"),
            *(Column(sentence(words), number=True) for words in SOURCES.values()),
            Column("Residual", number=True),
            Column("Residual of total", number=True),
        ),
        rows=[_budget_row(row) for row in budgets],
    )


def _budget_row(row: ErrorBudget) -> tuple[Cell | str, ...]:
    """Return one run, its largest source in bold."""
    worst, largest = row.at_worst, max(getattr(row, name) for name in SOURCES)
    symbol = SYMBOLS[worst.state]
    return (
        row.scenario,
        row.controller,
        scientific(row.total),
        f"{symbol}, {short(worst.time)} s".replace(" ", NO_BREAK),
        *(
            Cell(
                scientific(getattr(row, name)),
                strong=bool(largest) and getattr(row, name) == largest,
            )
            for name in SOURCES
        ),
        scientific(row.residual),
        percent(row.residual_share),
    )


def _studies(result: Result) -> Section:
    """Return what a full verification adds, and what remains open."""
    blocks: list[Block] = [Finding("Not proved", _not_proved(result.omissions))]
    if result.studies or result.ledgers or result.omissions:
        blocks.append(rests_on(result, "studies"))
    else:
        said = (
            "Not part of this run: `make proof` (`afl-mujoco validate --full`) adds observed "
            "orders, ledgers of energy and momentum, and the effect of what the paper omits."
        )
        blocks.append(Text(said))
    if result.studies:
        blocks.append(_orders(result.studies))
    if result.ledgers:
        blocks.append(_ledger(result))
    if result.omissions:
        blocks.append(_omissions(result))
    return Section("Orders, energy and omissions", "studies", blocks)


def _not_proved(omissions: Sequence[Omission]) -> str:
    """Say what the report does not show."""
    text = (
        "This is verification by an independent code, not validation against hardware, which "
        "`afl-mujoco hardware` does for one measured cart-pole: neither side here has friction, "
        "delay, noise or force limits"
    )
    if not omissions:
        return (
            f"{text}; `make proof` measures what freezing M and l at each instant, as the paper "
            "does, leaves out (D9)."
        )
    found = [x for row in omissions for x in (row.stretching_rod, row.momenta_kept)]
    most = max((x for x in found if x is not None), default=None)
    return (
        f"{text}; what the paper leaves out by freezing M and l at each instant (D9) would change "
        f"a state by up to {short(most, 2)} (m, rad, m/s or rad/s)."
    )


def _orders(rows: Sequence[Refinement]) -> Section:
    """Return the refinement studies by what they refine, with the range of orders observed."""
    names = dict.fromkeys(row.study for row in rows)
    groups = {name: [row for row in rows if row.study == name] for name in names}
    observed = Table(
        caption="Orders observed over four step sizes",
        columns=(
            Column("Study"),
            Column("Expected", number=True),
            Column("Observed", number=True),
            Column("Runs", number=True),
        ),
        rows=[
            (
                STUDIES.get(name, name),
                short(group[0].expected),
                _range([row.order for row in group if row.order is not None]),
                str(len(group)),
            )
            for name, group in groups.items()
        ],
    )
    text = Text(
        "When the step is halved, the error must fall as the order of the method predicts: by a "
        "factor of 16 for order 4, 4 for order 2, 2 for order 1. An error that does not fall "
        "would be a difference between the models."
    )
    errors = [_errors(STUDIES.get(name, name), group) for name, group in groups.items()]
    solved = [row for row in rows if row.order is not None]
    drawn = [orders_figure(solved)] if solved else []
    return Section("Observed orders", "orders", (text, observed, *drawn, *errors))


def _range(orders: Sequence[float]) -> str:
    """Return the range of orders in words."""
    low, high = (fixed(f(orders, default=None), 3) for f in (min, max))
    return low if low == high else f"{low} to {high}"


def _errors(name: str, rows: Sequence[Refinement]) -> Table:
    """Return every error of a refinement study."""
    return Table(
        summary=f"Every error at every step: {name}",
        caption=f"{sentence(name)}: largest error of any state",
        columns=(
            Column("Scenario"),
            Column("Controller"),
            *(Column(f"{short(1e3 * step)} ms", number=True) for step in rows[0].steps),
            Column("Order", number=True),
        ),
        rows=[
            (
                row.scenario,
                row.controller,
                *(scientific(error) for error in row.errors),
                fixed(row.order, 3),
            )
            for row in rows
        ],
    )


def _ledger(result: Result) -> Section:
    """Return the ledgers of energy and momentum."""
    booked = [[c for c in result.curves_of(s.name) if c.energy] for s in result.scenarios]
    text = Text(
        "The energy and momentum gained in MuJoCo, minus the work and impulse of the forces and "
        "what each change of M and l adds by the analytic equations, must vanish."
    )
    parts = (
        ("Work", "work", "J", short),
        ("Ramps", "energy_of_ramps", "J", short),
        ("Jumps", "energy_of_jumps", "J", short),
        ("Residual", "energy_residual", "J", scientific),
        ("Impulse", "impulse", "N s", short),
        ("Ramps", "momentum_of_ramps", "N s", short),
        ("Jumps", "momentum_of_jumps", "N s", short),
        ("Residual", "momentum_residual", "N s", scientific),
    )
    columns = [Column(title, unit, number=True) for title, _, unit, _ in parts]
    table = Table(
        summary=f"Ledgers of {len(result.ledgers)} runs",
        caption="Ledger at the end of each run; the residual is the largest along it",
        columns=(Column("Scenario"), Column("Controller"), *columns),
        rows=[
            (
                row.scenario,
                row.controller,
                *(write(getattr(row, key)) for _, key, _, write in parts),
            )
            for row in result.ledgers
        ],
    )
    drawn = energy_figure([curves for curves in booked if curves][:MOST])
    return Section("Energy and momentum", "ledger", (text, drawn, table))


def _omissions(result: Result) -> Section:
    """Return the effect of what the paper neglects."""
    frozen = "[D9](#D9)" if "D9" in result.decisions else "D9"
    text = Text(
        f"The paper freezes M and l in its equations at each instant ({frozen}). A rod that "
        "really stretches has additional terms in l′; at steps an assumption is needed, and the "
        "paper keeps the velocities. Both simulators agree on these runs too "
        f"({check_link(result, 'B7')}), so the size of the change is a property of the paper’s "
        "model, not of a code."
    )
    table = Table(
        summary=f"Effect in {len(result.omissions)} runs",
        caption="Largest change of any state (SI)",
        columns=(
            Column("Scenario"),
            Column("Controller"),
            Column("Terms in l′", number=True),
            Column("Momenta kept at steps", number=True),
        ),
        rows=[
            (
                row.scenario,
                row.controller,
                size(row.stretching_rod),
                size(row.momenta_kept),
            )
            for row in result.omissions
        ],
    )
    return Section("What the paper’s frozen parameters leave out", "omissions", (text, table))
