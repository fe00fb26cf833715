"""The page of a folder: every result and every film in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from afl_mujoco.errors import FileError

if TYPE_CHECKING:
    from afl_mujoco.films.listing import Entry
    from afl_mujoco.report.blocks import Block, Section
    from afl_mujoco.studies.record import Record

TITLE = "Controllers in MuJoCo"


def require_page(folder: Path, films: Path, *, leave_out: str = "") -> None:
    """Raise if something but one study, to be replaced, could not be put into a page."""
    from afl_mujoco.files import require_no_folder
    from afl_mujoco.films.listing import load_listing
    from afl_mujoco.studies.record import PAGE, load_records

    require_no_folder(folder, (PAGE,))
    for place in {films, folder}:
        load_listing(place)
    load_records(folder, leave_out=leave_out)


def write_page(folder: Path, films: Path, ahead: Path | None = None) -> Path:
    """Write the page of a folder, completely or not at all; nothing is computed.

    The folder `ahead` has a record and figures that are to replace those of the folder: the page is
    written there.
    """
    from afl_mujoco.files import write_text
    from afl_mujoco.films.listing import load_listing
    from afl_mujoco.films.sections import sections as film_sections
    from afl_mujoco.report.page import Part, to_html
    from afl_mujoco.studies.record import PAGE, load_records

    records = load_records(folder, ahead=ahead)
    if not records:
        raise FileError(str(folder), "must hold a result: run afl-mujoco validate")
    there = [place for place in (ahead, folder) if place is not None]
    parts = [Part(record.report, record.study.name, there) for record in records]
    apart = folder.resolve() != films.resolve()  # a study films into the folder of its result
    places = [folder, films] if apart else [films]
    entries = [one for place in places for one in load_listing(place)]
    last = [
        *(film_sections(folder, "Films beside this page", "own-films") if apart else []),
        *film_sections(films),
        _reproduce(records, list(_mixed(records, entries))),
    ]
    write_text((ahead or folder) / PAGE, to_html(TITLE, parts, last, folder))
    return folder / PAGE


def _mixed(records: Sequence[Record], films: Sequence[Entry]) -> Iterator[str]:
    """Yield a warning for each scenario and controller of which there are different versions.

    Films alone are not compared: the worst cases of two controllers may have one name.
    """
    from afl_mujoco.report.markdown import code, plain
    from afl_mujoco.report.numbers import listed

    inputs = [(record.study.title, record.inputs) for record in records]
    inputs += [(entry.file, entry.inputs) for entry in films]
    for thing in dict.fromkeys(name for record in records for name in record.inputs):
        holders = [(title, digests[thing]) for title, digests in inputs if thing in digests]
        groups = {digest: [t for t, found in holders if found == digest] for _, digest in holders}
        if len(groups) > 1:
            kind, _, name = thing.partition(" ")
            those = " as in ".join(listed(titles, "and") for titles in groups.values())
            yield (
                f"**Different versions of a {kind}.** {code(name)} is not the same in "
                f"{plain(those)}: run again what is out of date."
            )


def _reproduce(records: Sequence[Record], warnings: Sequence[str]) -> Section:
    """Return the commands and versions that made each result."""
    from afl_mujoco.report.blocks import Section
    from afl_mujoco.report.markdown import code

    blocks: list[Block] = [*warnings]
    for record in records:
        data = [f for f in record.files if not f.endswith((".svg", ".png"))]
        made_by = ", ".join(f"{name} {number}" for name, number in record.versions.items())
        files = ", ".join(map(code, (f"{record.study.stem}.json", *data)))
        blocks.append(f"{code(record.command)} made {files}, with {made_by}.")
    blocks.append("The same inputs give the same bytes, with any number of workers.")
    return Section("Reproduce", "reproduce", blocks)
