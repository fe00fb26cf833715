"""The films of a folder in a report."""

from __future__ import annotations

from pathlib import Path

from afl_mujoco.films.listing import Entry, load_listing
from afl_mujoco.report.blocks import Block, Film, Section
from afl_mujoco.report.numbers import sentence

LEDE = (
    "MuJoCo's plant as deployed, in real time. Its ghost is the ideal ODE, without "
    "imperfections; there a controller in Python is held over each control period too, and any "
    "other is continuous."
)


def sections(folder: Path, title: str = "Films", anchor: str = "films") -> list[Section]:
    """Return the films of a folder for a report, the wide ones first; nothing if there are none."""
    entries = sorted(load_listing(folder), key=lambda one: len(one.controllers) < 2)
    if not entries:
        return []
    blocks: list[Block] = [LEDE]
    scenarios = sorted({one.scenario for one in entries})
    for number, scenario in enumerate(scenarios, start=1):
        films = [_film(one, folder) for one in entries if one.scenario == scenario]
        folded = len(scenarios) > 1
        blocks.append(Section(scenario, f"{anchor}-{number}", films, folded=folded))
    return [Section(title, anchor, blocks)]


def _film(entry: Entry, folder: Path) -> Film:
    return Film(
        title=entry.title,
        caption=f"{sentence(entry.deployment.describe())}.",
        file=folder / entry.file,
        poster=folder / entry.poster,
        width=entry.width,
        height=entry.height,
        command=entry.command,
        wide=len(entry.controllers) > 1,
    )
