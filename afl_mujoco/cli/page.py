"""The page of a folder: every result and every film in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from afl_mujoco.errors import FileError

if TYPE_CHECKING:
    from afl_mujoco.document.blocks import Block, Section
    from afl_mujoco.films.listing import Entry
    from afl_mujoco.studies.record import Record

TITLE = "Cart-pole controllers in MuJoCo"
LEDE = (
    "A cart-pole whose mass and length can change while it moves: the runs, the findings, and the "
    "commands that repeat them."
)

NOTATION = {
    "z, z′": "position and velocity of the cart, m and m/s",
    "φ, φ′": "angle of the pole from upright and its rate, rad and rad/s; at negative φ the pole "
    "leans toward +z",
    "M, m, l": "mass of the cart and of the pole, kg; half-length, from pivot to centre of mass, m "
    "(decision D1)",
    "F": "force of the controller on the cart, N",
    "K, λ, Φ": "switching gain, slope of the sliding surface, width of the boundary layer",
    "OF": "the paper's objective: ∫|z| dt, ∫|φ| dt and max |F|, each divided by its value for the "
    "fixed gains on the nominal plant, added (D4)",
    "ideal equations": "“ode”: the paper's equations, integrated by DOP853 to 12 digits, restarted "
    "at every breakpoint",
    "exact mode": "MuJoCo's dynamics with the same integrator: only the model can differ",
    "continuous mode": "MuJoCo with RK4 at a fixed step, controller and schedule in every stage",
    "sampled mode": "MuJoCo as deployed: the force is held over each control period, M and l are "
    "those at the middle of each step",
    "fixed, adaptive": "the paper's constant gains, and its gains as functions of M and l; "
    "“-retuned” ones were found here, “-nominal” ones assume M = 1 kg, l = 0.5 m (D7)",
    "overshoot": "how far a state goes beyond zero",
}
"""Meaning of symbols and words."""


def require_page(folder: Path, films: Path, *, leave_out: str = "") -> None:
    """Raise if something could not be put into a page, before anything slow.

    Parameters
    ----------
    leave_out
        Study whose result will be replaced.
    """
    from afl_mujoco.files import require_no_folder
    from afl_mujoco.films.listing import load_listing
    from afl_mujoco.studies.record import PAGE, load_records

    require_no_folder(folder, (PAGE,))
    for place in {films, folder}:
        load_listing(place)
    load_records(folder, leave_out=leave_out)


def write_page(folder: Path, films: Path, ahead: Path | None = None) -> Path:
    """Write the page of a folder, completely or not at all; nothing is computed.

    Parameters
    ----------
    ahead
        Folder of a record and figures that are to replace those of the folder: the page is written
        there.
    """
    from afl_mujoco.document.html import to_html
    from afl_mujoco.files import write_text
    from afl_mujoco.films.listing import load_listing
    from afl_mujoco.films.sections import sections as film_sections
    from afl_mujoco.studies.record import PAGE, load_records

    records = load_records(folder, ahead=ahead)
    if not records:
        raise FileError(str(folder), "must hold a result: run afl-mujoco validate")
    found = [section for record in records for section in record.sections]
    apart = folder.resolve() != films.resolve()  # a study films into the folder of its result
    places = [folder, films] if apart else [films]
    entries = [entry for place in places for entry in load_listing(place)]
    parts = [
        ([_overview(records, found, _mixed(records, entries))], folder),
        (found, folder),
        (film_sections(films), films),
        ([_not_run(records), _reproduce(records), _notation()], folder),
    ]
    if apart:
        parts.insert(1, (film_sections(folder, "Films beside this page", "own-films"), folder))
    verdicts = [record.verdict for record in records if record.verdict]
    verdict = min(verdicts, key=lambda one: one.passed, default=None)  # a failure counts
    text = to_html(TITLE, parts, folder, lede=LEDE, verdict=verdict, ahead=ahead)
    write_text((ahead or folder) / PAGE, text)
    return folder / PAGE


def _mixed(records: Sequence[Record], films: Sequence[Entry]) -> list[Block]:
    """Return a warning for each scenario and controller of which there are different versions.

    Films alone are not compared: the worst cases of two controllers may have one name.
    """
    from afl_mujoco.document.blocks import Finding
    from afl_mujoco.document.numbers import listed

    inputs = [(record.study.title, record.inputs) for record in records]
    inputs += [(entry.file, entry.inputs) for entry in films]
    blocks: list[Block] = []
    for thing in dict.fromkeys(name for record in records for name in record.inputs):
        holders = [(title, digests[thing]) for title, digests in inputs if thing in digests]
        groups = {digest: [t for t, found in holders if found == digest] for _, digest in holders}
        if len(groups) > 1:
            kind, _, name = thing.partition(" ")
            those = " as in ".join(listed(titles, "and") for titles in groups.values())
            text = (
                f"The {kind} `{name}` is not the same in {those}: its file was changed, or another "
                "has the same name. Run again what is out of date."
            )
            blocks.append(Finding(f"Different versions of a {kind}", text, "reproduce"))
    return blocks


def _overview(
    records: Sequence[Record], sections: Sequence[Section], warnings: Sequence[Block]
) -> Section:
    """Return the verdicts, what was run, the tallies and the findings of all sections."""
    from afl_mujoco.document.blocks import Finding, Section, Tally

    verdicts = [record.verdict for record in records if record.verdict]
    tallies = [b for section in sections for b in section.walk() if isinstance(b, Tally)]
    findings = [
        replace(block, evidence=holder.anchor)
        for section in sections
        for holder in (section, *(b for b in section.walk() if isinstance(b, Section)))
        for block in holder.blocks
        if isinstance(block, Finding)
    ]
    title = "Verdict and findings" if verdicts else "Findings"
    shown = [block for record in records for block in record.opening]
    return Section(title, "findings", (*verdicts, *warnings, *shown, *tallies, *findings))


def _not_run(records: Sequence[Record]) -> Section:
    """Return the studies that are not in the folder, a line each."""
    from afl_mujoco.document.blocks import Cell, Column, Section, Table, Text
    from afl_mujoco.studies.registry import studies

    run = {record.study.name for record in records}
    missing = [one for one in studies().values() if one.name not in run]
    table = Table(
        caption="Studies without a result in this folder, and the commands that make one",
        columns=(Column("Study"), Column("Command")),
        rows=[(one.title, Cell(one.command, code=True)) for one in missing],
    )
    blocks = [table] if missing else [Text("Every study has a result on this page.")]
    return Section("Not run", "not-run", blocks)


def _reproduce(records: Sequence[Record]) -> Section:
    """Return the commands and versions that made each result."""
    from afl_mujoco.document.blocks import Cell, Column, Section, Table, Text

    packages = dict.fromkeys(name for record in records for name in record.versions)
    text = Text(
        "The commands that made the numbers on this page; the same inputs give the same bytes, "
        "with any number of workers. `afl-mujoco report` makes the page itself from the files "
        "beside it, without computing anything."
    )
    commands = Table(
        caption="Commands",
        columns=(Column("Result"), Column("Command"), Column("Files beside this page")),
        rows=[
            (
                record.study.title,
                Cell(record.command, code=True),
                ", ".join((f"{record.study.stem}.json", *_data(record))),
            )
            for record in records
        ],
        stacked=True,
    )
    versions = Table(
        caption="Versions",
        columns=(Column("Package"), *(Column(record.study.title) for record in records)),
        rows=[(name, *(record.versions.get(name, "–") for record in records)) for name in packages],
    )
    return Section("Reproduce", "reproduce", (text, commands, versions))


def _data(record: Record) -> list[str]:
    """Return the files of a record except its figures."""
    return [name for name in record.files if not name.endswith((".svg", ".png"))]


def _notation() -> Section:
    """Return what the symbols and words mean."""
    from afl_mujoco.document.blocks import Fact, Facts, Section, Text

    return Section(
        "Notation",
        "notation",
        (
            Facts([Fact(label, text) for label, text in NOTATION.items()]),
            Text("Nothing on this page is fetched from a network.", note=True),
        ),
    )
