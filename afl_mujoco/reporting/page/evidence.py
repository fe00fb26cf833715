"""Error budget, refinement studies, ledgers and omissions as sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from afl_mujoco.document.blocks import Block, Cell, Column, Section, Table, Text
from afl_mujoco.document.numbers import fixed, percent, scientific, sentence, short, size
from afl_mujoco.document.pictures import Picture
from afl_mujoco.reporting.page.checks import criterion_rows
from afl_mujoco.reporting.page.decisions import section_decisions
from afl_mujoco.reporting.page.inputs.report_data import Row
from afl_mujoco.reporting.page.summary import SOURCES, STATES

QUANTILES = ("5%", "25%", "median", "75%", "95%")
"""Percentiles of the improvement over random schedules that the page gives."""

NO_BREAK = "\u00a0"

STUDIES = {
    "continuous": "continuous mode, over the step",
    "sampled": "sampled mode, over the control period",
    "schedule": "schedule frozen alone, over the step",
}
"""Refinement studies in words."""

Pictures = Mapping[str, Sequence[Picture]]


def evidence_sections(report: Row, pictures: Pictures) -> list[Section]:
    """Return the error budget, and what a full validation adds, with the pictures of each."""
    return [_budget(report, pictures), _studies(report, pictures)]


def _budget(report: Row, pictures: Pictures) -> Section:
    """Return why a run as deployed differs from the ideal equations."""
    blocks: list[Block] = [
        Text(
            "Why a run in MuJoCo as deployed (force held over each control period, fixed steps) "
            "differs from the ideal equations by as much as it does. Each source is switched on "
            "alone; what they leave is the residual. Every figure is the largest of any state at "
            "any instant (m, rad, m/s, rad/s); the largest source of a row is set in bold."
        ),
        *_rests_on(report, "budget"),
    ]
    if report["error_budgets"]:
        blocks += [*pictures.get("#budget", ()), _budget_table(report["error_budgets"])]
        blocks.append(Text(f"The residual is judged by {_check(report, 'B5')}.", note=True))
    else:
        said = "No run was completed as deployed, so there is nothing to explain."
        blocks.append(Text(said, note=True))
    return Section("Error budget", "budget", blocks)


def _budget_table(budgets: Sequence[Row]) -> Table:
    """Return one row for each run as deployed."""
    return Table(
        caption="Error budget of the run as deployed",
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


def _budget_row(row: Row) -> tuple[Cell | str, ...]:
    """Return one run, its largest source in bold."""
    worst, largest = row["at_worst"], max(row[name] for name in SOURCES)
    symbol = STATES.get(worst["state"], (worst["state"],))[0]
    return (
        row["scenario"],
        row["controller"],
        scientific(row["total"]),
        f"{symbol}, {short(worst['time'])} s".replace(" ", NO_BREAK),
        *(
            Cell(scientific(row[name]), strong=bool(largest) and row[name] == largest)
            for name in SOURCES
        ),
        scientific(row["residual"]),
        percent(row["residual_share"]),
    )


def _studies(report: Row, pictures: Pictures) -> Section:
    """Return what a full validation adds."""
    title, anchor = "Orders, energy and omissions", "studies"
    if not (report["studies"] or report["ledgers"] or report["omissions"]):
        said = (
            "Not part of this run: `make proof` (`afl-mujoco validate --full`) adds observed "
            "orders, ledgers of energy and momentum, and the effect of what the paper neglects."
        )
        return Section(title, anchor, (Text(said, note=True),))
    blocks: list[Block] = [*_rests_on(report, anchor), *pictures.get("#studies", ())]
    if report["studies"]:
        blocks.append(_orders(report["studies"]))
    if report["ledgers"]:
        blocks.append(_ledger(report["ledgers"]))
    if report["omissions"]:
        blocks.append(_omissions(report))
    return Section(title, anchor, blocks)


def _orders(rows: Sequence[Row]) -> Section:
    """Return the refinement studies by what they refine, with the range of orders observed."""
    names = dict.fromkeys(row["study"] for row in rows)
    groups = {name: [row for row in rows if row["study"] == name] for name in names}
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
                short(group[0]["expected"]),
                _range([row["order"] for row in group if row["order"] is not None]),
                str(len(group)),
            )
            for name, group in groups.items()
        ],
    )
    text = Text(
        "Halve the step, and the error must fall as the method promises: by 16 for order 4, by 4 "
        "for order 2, by 2 for order 1. An error that stays would be a difference of the models."
    )
    errors = [_errors(STUDIES.get(name, name), group) for name, group in groups.items()]
    return Section("Observed orders", "orders", (text, observed, *errors))


def _range(orders: Sequence[float]) -> str:
    """Return between what orders lie."""
    low, high = (fixed(f(orders, default=None), 3) for f in (min, max))
    return low if low == high else f"{low} to {high}"


def _errors(name: str, rows: Sequence[Row]) -> Table:
    """Return every error of a refinement study."""
    return Table(
        summary=f"Every error at every step: {name}",
        caption=f"{sentence(name)}: largest error of any state",
        columns=(
            Column("Scenario"),
            Column("Controller"),
            *(Column(f"{short(1e3 * step)} ms", number=True) for step in rows[0]["steps"]),
            Column("Order", number=True),
        ),
        rows=[
            (
                row["scenario"],
                row["controller"],
                *(scientific(error) for error in row["errors"]),
                fixed(row["order"], 3),
            )
            for row in rows
        ],
    )


def _ledger(rows: Sequence[Row]) -> Section:
    """Return the ledgers of energy and momentum."""
    text = Text(
        "What MuJoCo’s energy and momentum gained, less the work and impulse of the forces and "
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
        caption="Ledger at the end of each run; the residual is the largest along it",
        columns=(Column("Scenario"), Column("Controller"), *columns),
        rows=[
            (row["scenario"], row["controller"], *(write(row[key]) for _, key, _, write in parts))
            for row in rows
        ],
    )
    return Section("Energy and momentum", "ledger", (text, table))


def _omissions(report: Row) -> Section:
    """Return the effect of what the paper neglects."""
    frozen = "[D9](#D9)" if "D9" in report["decisions"] else "D9"
    text = Text(
        f"The paper freezes M and l in its equations at each instant ({frozen}). A rod that "
        "really stretches feels terms in l′; at steps something must be assumed, and the paper "
        f"keeps the velocities. Both simulators agree on these runs too ({_check(report, 'B7')}): "
        "how much they change is a property of the paper’s model, not of a code."
    )
    table = Table(
        caption="Largest change of any state (SI)",
        columns=(
            Column("Scenario"),
            Column("Controller"),
            Column("Terms in l′", number=True),
            Column("Momenta kept at steps", number=True),
        ),
        rows=[
            (
                row["scenario"],
                row["controller"],
                size(row["stretching_rod"]),
                size(row["momenta_kept"]),
            )
            for row in report["omissions"]
        ],
    )
    return Section("What the paper’s frozen parameters leave out", "omissions", (text, table))


def _check(report: Row, id: str) -> str:
    """Return a link to a check, if the run has it."""
    judged = {row.id for row in criterion_rows(report["checks"])}
    return f"[{id}](#check-{id})" if id in judged else id


def _rests_on(report: Row, anchor: str) -> list[Text]:
    """Return the decisions that a section rests on."""
    ids = section_decisions(report["decisions"])[anchor]
    links = ", ".join(f"[{id}](#{id})" for id in ids)
    return [Text(f"Rests on {links}.", note=True)] if ids else []
