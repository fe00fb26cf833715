"""The folder of a validation: its figures with their list, and the page made from what is there."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from afl_mujoco.document.blocks import Section
from afl_mujoco.document.pictures import Picture, load_picture
from afl_mujoco.errors import FileError, reading
from afl_mujoco.execution.executors import Executor
from afl_mujoco.files import output_folder, write_text
from afl_mujoco.reporting.page.inputs.films import Film
from afl_mujoco.reporting.page.inputs.report_data import AGAIN, Row, load_report
from afl_mujoco.reporting.page.page import render_page
from afl_mujoco.studies.verification.curves import REFERENCE, Curves, load_curves
from afl_mujoco.studies.verification.figures.gallery import plans, write_figures

REPORT, CURVES, PAGE = "report.json", "curves.npz", "report.html"
FIGURES, LISTING = "figures", "figures.json"
LINKED = ("report.json", "report.md", "junit.xml", "curves.npz", "figures/figures.json")
"""Files of the folder that the page links to, where they are there."""

PLACES = {
    "schedules": "#scenarios",
    "impulse": "#scenarios",
    "errors": "#checks",
    "budget": "#budget",
    "orders": "#studies",
    "energy": "#studies",
    "claims": "#claims",
    "gain-table": "#gains",
}
"""Section of each figure by name; the others belong to the scenario of their title."""


def figure_count(report: Row, curves: Sequence[Curves]) -> int:
    """Return how many figures `write_gallery` draws."""
    return len(plans(report, curves))


def write_gallery(
    folder: Path,
    report: Row,
    curves: Sequence[Curves],
    *,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Callable[[str], None] = lambda done: None,
) -> Path:
    """Draw every figure and list them, with what they were drawn from.

    Parameters
    ----------
    workers
        Processes to share the work among; the files do not depend on it.
    progress
        Called with the name of each figure as it is written.
    """
    place = output_folder(folder / FIGURES)
    figures = write_figures(
        report, curves, place, workers=workers, executor=executor, progress=progress
    )
    listing = {"schema": 1, "drawn_from": _fingerprints(folder), "figures": figures}
    write_text(place / LISTING, json.dumps(listing, indent=1, ensure_ascii=False) + "\n")
    return place / LISTING


def forget_page(folder: Path) -> None:
    """Remove the page and the list of figures of a validation that went before.

    Parameters
    ----------
    folder
        Where a new one is about to be written: beside its report an old page would mislead.
    """
    for path in (folder / PAGE, folder / FIGURES / LISTING):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise FileError.cannot_be("written", path, error) from None


def write_page(
    folder: Path,
    films: Sequence[Film] = (),
    sections: Sequence[Section] = (),
    results: Path = Path(),
) -> Path:
    """Write report.html from the files of a folder, whole or not at all; nothing is computed."""
    report = load_report(folder / REPORT)
    curves = _curves(folder / CURVES, report)
    pictures = load_pictures(folder, [run["scenario"] for run in report["runs"]])
    there = [name for name in LINKED if (folder / name).is_file()]
    text = render_page(
        report, curves, pictures, films, sections=sections, results=results, files=there
    )
    write_text(folder / PAGE, text)
    return folder / PAGE


def load_pictures(folder: Path, scenarios: Iterable[str]) -> tuple[Picture, ...]:
    """Return the figures of a folder; none where none were drawn."""
    listing = folder / FIGURES / LISTING
    if not listing.exists():
        return ()
    known = set(scenarios)
    with reading(listing, "does not list figures", AGAIN):
        data = json.loads(listing.read_text(encoding="utf-8"))
        if data["drawn_from"] != _fingerprints(folder):
            raise ValueError(f"its figures must be drawn from {REPORT} and {CURVES} as they are")
        return tuple(
            load_picture(entry, listing.parent, _place(entry, known)) for entry in data["figures"]
        )


def _place(entry: Mapping[str, Any], scenarios: set[str]) -> str:
    """Return where a figure belongs."""
    place = PLACES.get(entry["name"])
    return place or (entry["title"] if entry["title"] in scenarios else "#scenarios")


def _curves(path: Path, report: Row) -> tuple[Curves, ...]:
    """Read the curves, which must be those of the report's runs."""
    try:
        curves = load_curves(path)
    except FileError as error:
        raise FileError(error.thing, f"{error.rule}: {AGAIN}") from None
    here = {(one.scenario, one.controller) for one in curves}
    wanted = {(run["scenario"], run["controller"]) for run in report["runs"]}
    drawable = all(len(one.states.get(REFERENCE, ())) for one in curves)
    if here != wanted or not drawable:
        raise FileError(str(path), f"must hold the runs of {REPORT} beside it: {AGAIN}")
    return curves


def _fingerprints(folder: Path) -> dict[str, str]:
    """Return what tells report and curves from any others."""
    return {
        name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in (REPORT, CURVES)
    }
