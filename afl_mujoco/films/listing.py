"""The list of the films of a folder, films.json, and its section of a report."""

from __future__ import annotations

from collections.abc import Collection, Container
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import PositiveInt

from afl_mujoco.files import inside, read_json, write_json
from afl_mujoco.report.blocks import Block, Film, Section, sentence
from afl_mujoco.scenario.time_steps import Deployed

LISTING = "films.json"  # file beside the films that says what they show
MARK = "made by afl_mujoco"  # comment in the metadata of every film
REMOVE = "remove it"  # how to fix a broken list that blocks new films


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A film in the list; its file and poster lie beside it, its inputs are from `digests`."""

    file: str
    poster: str
    title: str
    scenario: str
    controllers: tuple[str, ...]
    width: PositiveInt
    height: PositiveInt
    deployment: Deployed
    command: str
    inputs: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """The films of a folder."""

    schema: int = 2
    films: tuple[Entry, ...]


def load_listing(
    folder: Path, then: str = "remove it, and run afl-mujoco render"
) -> tuple[Entry, ...]:
    """Return the films of a folder, none if it has no list; `then` says how to fix a broken one."""
    path = folder / LISTING
    if not path.is_file():
        return ()
    films = read_json(path, Listing, "does not list films", then).films
    for name in (name for film in films for name in (film.file, film.poster)):
        inside(folder, name)  # a page must not show what is not of its folder
    return films


def list_film(folder: Path, entry: Entry) -> None:
    """List a film of a folder in place of one of the same name, and drop those that are gone."""
    kept = [
        other
        for other in load_listing(folder, REMOVE)
        if other.file != entry.file and (folder / other.file).is_file()
    ]
    films = tuple(sorted((*kept, entry), key=lambda one: one.file))
    write_json(folder / LISTING, Listing(films=films))


LEDE = (
    "MuJoCo's plant as deployed, in real time. Its ghost is the loop without imperfections, by the "
    "plant's own equations where they can say what happens; there a controller in Python is held "
    "over each control period too, and any other is continuous."
)


def sections(
    folder: Path, inputs: Collection[tuple[str, str]], commands: Container[str] | None = None
) -> list[Section]:
    """Return the films of a folder for a report, the wide ones first; nothing if there are none.

    Only those of the scenarios that the report is of, by the digests that are its `inputs`, and of
    no other version of its controllers; those that some commands made, if these are given.
    """
    every, names = load_listing(folder), {name for name, _ in inputs}
    kept = [
        one for one in every
        if (commands is None or one.command in commands)
        and all(pair in inputs for pair in one.inputs.items() if pair[0] in names)
        and (f"scenario {one.scenario}" in names or not names)
    ]  # fmt: skip
    if not kept:
        return []
    entries = sorted(kept, key=lambda one: len(one.controllers) < 2)
    blocks: list[Block] = [LEDE]
    scenarios = sorted({one.scenario for one in entries})
    for number, scenario in enumerate(scenarios, start=1):
        films = [
            Film(
                title=one.title,
                caption=f"{sentence(one.deployment.describe())}.",
                file=folder / one.file,
                poster=folder / one.poster,
                width=one.width,
                height=one.height,
                command=one.command,
                wide=len(one.controllers) > 1,
            )
            for one in entries
            if one.scenario == scenario
        ]
        blocks.append(Section(scenario, f"films-{number}", films, folded=len(scenarios) > 1))
    return [Section("Films", "films", blocks)]
