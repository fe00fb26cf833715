"""The films of a folder in a report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from afl_mujoco.films.listing import Entry, load_listing
from afl_mujoco.films.plan import SINGLE
from afl_mujoco.films.replay import IDEAL_ODE
from afl_mujoco.report.numbers import sentence
from afl_mujoco.report.old import Block, Film, Section, Text


def sections(folder: Path, title: str = "Films", anchor: str = "films") -> list[Section]:
    """Return the films of a folder for a report; nothing if there are none."""
    entries = load_listing(folder)
    if not entries:
        return []
    scenarios = dict.fromkeys(entry.scenario for entry in entries if entry.scenario)
    blocks: list[Block] = [
        Text(
            "MuJoCo's cart-pole as deployed, in real time. Its ghost is the ideal ODE, without "
            "imperfections, unless the caption of a film says otherwise; there a controller in "
            "Python is held over each control period too, and any other is continuous."
        )
    ]
    blocks += _films([entry for entry in entries if not entry.scenario], folder)
    blocks += [
        Section(
            scenario,
            f"{anchor}-{number}",
            _films([entry for entry in entries if entry.scenario == scenario], folder),
            folded=True,
        )
        for number, scenario in enumerate(scenarios, start=1)
    ]
    return [Section(title, anchor, blocks)]


def _films(entries: Sequence[Entry], folder: Path) -> list[Film]:
    """Return films, the wide ones first."""
    found = [
        Film(
            title=entry.title,
            caption=f"{sentence(entry.deployment.describe())}{_ghost(entry)}.",
            file=folder / entry.file,
            poster=folder / entry.poster,
            width=entry.width,
            height=entry.height,
            command=entry.command,
            wide=entry.kind != SINGLE,
        )
        for entry in entries
    ]
    return sorted(found, key=lambda film: not film.wide)


def _ghost(entry: Entry) -> str:
    """Say what the ghost of a film is, if it is not the ideal ODE."""
    return "" if entry.ghost == IDEAL_ODE else f"; the ghost is {entry.ghost}"
