"""What the pages hold that nobody types: tables, numbers, results, help texts.

A page of ``pages/`` is a Jinja template. ``{{ table("imperfections") }}`` is what the code
declares, ``{{ thresholds.delay_adaptive }}`` a number of ``numbers.toml``,
``{{ sections("margins") }}`` what a study says of its result in ``results/``,
``{{ output("bench_batch") }}`` what a script printed, ``{{ printed("tutorial", 2) }}`` what a
block of a page did, ``{{ code("examples/quickstart.py") }}`` a
file, ``{{ help("compare") }}`` the help of a command, ``{{ part("findings") }}`` a page of
``pages/parts``, which README.md has too. A link that begins with a slash is from this folder. An
unknown name is an error.

    python -m docs.content

writes the pages, the parts of README.md, and the figures that they show. All of these are
committed, so that they can be read where the repository is.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import shutil
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from posixpath import normpath
from typing import Any
from unittest import mock

import jinja2
from PIL import Image

import afl_mujoco
from afl_mujoco.cli.main import OTHERS, main
from afl_mujoco.errors import FileError
from afl_mujoco.report.blocks import (
    Block,
    Figure,
    Replay,
    Section,
    drawn_of,
    plain,
    short,
    to_markdown,
)
from afl_mujoco.report.figures import save_figure, styled
from afl_mujoco.report.page import replay_html
from afl_mujoco.studies.shared.contract import studies
from afl_mujoco.studies.shared.record import Record, load_record
from docs import tutorial
from docs.tables import (
    faults_table,
    mutants_table,
    optimisers_table,
    printed_table,
    readings_tables,
    survivors_table,
    tables,
)

DOCS = Path(__file__).parent
PAGES = DOCS / "pages"
README = DOCS.parent / "README.md"
RESULTS = DOCS / "results"
SHIPPED = Path(afl_mujoco.__file__).parent / "control" / "data"
"""Results that come with the package."""

FIGURES = "figures"
"""Folder of the figures that the pages show, beside this file."""

COLOURS = 128
"""Of a picture: a third of the bytes, and no difference to see."""

GALLERY = {
    "thresholds": "/explanation/robustness.md",
    "attraction": "/explanation/robustness.md",
    "margins": "/explanation/robustness.md",
    "montecarlo": "/explanation/random_hardware.md",
    "estimation": "/explanation/estimation.md",
    "hardware": "/explanation/hardware.md",
}
"""Studies whose figures the gallery shows, and the page that explains them."""

KINDS = {".py": "python", ".toml": "toml"}
"""Languages of files that pages show."""

PARTS = ("abstract", "start", "plant", "findings")
"""What README.md has of the site, each between its marks."""


def sweep(found: Any, imperfection: str, controller: str) -> Any:
    """Return what thresholds found of a controller under an imperfection."""
    asked = (imperfection, controller)
    return next(s for s in found.sweeps if (s.imperfection, s.controller) == asked)


def estimate(found: Any, name: str) -> Any:
    """Return an estimate of a step of an identification, or of what it comes to."""
    among = found.estimates if hasattr(found, "estimates") else found.physical
    return next(one for one in among if one.name == name)


def ceil_to(x: float, digits: int = 2) -> float:
    """Round away from zero to significant digits: the safe side of a level that is needed."""
    return _to(math.ceil, x, digits)


def _to(rounded: Callable[[float], int], x: float, digits: int) -> float:
    """Round to significant digits; a trace of round-off is no reason for another digit."""
    scale = 10.0 ** (digits - 1 - math.floor(math.log10(abs(x))))
    return math.copysign(rounded(round(abs(x) * scale, 9)) / scale, x)


NAMES = {
    "float": float,
    "len": len,
    "max": max,
    "min": min,
    "sum": sum,
    "next": next,
    "sweep": sweep,
    "estimate": estimate,
    "ceil_to": ceil_to,
    "math": math,
}
"""What an expression of ``numbers.toml`` may call."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """A number of the pages.

    Attributes
    ----------
    value
        As it is in the result.
    shown
        As the pages show it.
    within
        Relative change that is no news.
    """

    value: float
    shown: str
    within: float

    def __str__(self) -> str:
        """Return it as it is shown."""
        return self.shown

    def moved_to(self, other: Number) -> bool:
        """Return whether another value is news."""
        least = min(abs(self.value), abs(other.value))  # so that 10 means eleven times at most
        return abs(other.value - self.value) > self.within * least


class Content:
    """What pages are made of.

    Parameters
    ----------
    results
        Folder of the results.
    """

    def __init__(self, results: Path = RESULTS) -> None:
        self.results = results

    @cached_property
    def records(self) -> dict[str, Record]:
        """The results of studies, by the name of the study."""
        there = (s for s in studies().values() if (self.results / f"{s.stem}.json").is_file())
        return {study.name: load_record(study, self.results) for study in there}

    @cached_property
    def numbers(self) -> dict[str, dict[str, Number]]:
        """The numbers of ``numbers.toml`` whose results are there, by result and name."""
        declared = tomllib.loads((DOCS / "numbers.toml").read_text(encoding="utf-8"))
        found = {}
        for group, entries in declared.items():
            if (result := self._result(group)) is not None:
                found[group] = {name: _number(one, result) for name, one in entries.items()}
        return found

    def _result(self, group: str) -> Any:
        """Return the result that a group of numbers is from, None if it is not there."""
        if group in self.records:
            return self.records[group].result
        for folder in (self.results, SHIPPED):
            if (path := folder / f"{group}.json").is_file():
                return json.loads(path.read_text(encoding="utf-8"))
        path = self.results / f"{group}.txt"
        return path.read_text(encoding="utf-8") if path.is_file() else None

    @cached_property
    def _tables(self) -> dict[str, str]:
        """The tables, by name."""
        return {
            **tables(),
            "faults": faults_table(self.results),
            "mutants": mutants_table(self.results),
            "surviving mutants": survivors_table(self.results, "survived"),
            "equivalent mutants": survivors_table(self.results, "equivalent"),
            "optimisers": optimisers_table(self.results),
            "quickstart": printed_table(self.results, "quickstart"),
            **readings_tables(self.results),
        }

    def table(self, name: str) -> str:
        """Return a table."""
        return self._tables[name]

    def sections(self, study: str, *anchors: str, level: int = 2) -> str:
        """Return what a study shows of its result, or what is in the sections asked for.

        Of a section that is asked for, the page has the heading; sections in it are left out.
        """
        found = self._blocks(study)
        if anchors:
            known = {section.anchor: section.blocks for section in _all_of(found)}
            blocks = (block for anchor in anchors for block in known[anchor])
            found = [block for block in blocks if not isinstance(block, Section)]
        return to_markdown(list(_on_the_site(found)), level)

    def _blocks(self, study: str) -> Sequence[Block]:
        """Return the headline and the blocks of a study."""
        if study not in self.records:
            raise FileError(f"{self.results / study}", "must be there: run make results")
        shown = self.records[study].report
        return [plain(shown.headline), *shown.blocks]

    def output(self, name: str) -> str:
        """Return what a script printed."""
        text = (self.results / f"{name}.txt").read_text(encoding="utf-8")
        return f"```text\n{text}```"

    def printed(self, name: str, block: int) -> str:
        """Return what a block of a page printed when it was run."""
        text = (self.results / f"{name}.txt").read_text(encoding="utf-8")
        return f"```text\n{text.split(tutorial.MARK)[block].strip()}\n```"

    def part(self, name: str) -> str:
        """Return a part that the README has too."""
        return self.render((PAGES / "parts" / f"{name}.md").read_text(encoding="utf-8")).rstrip()

    def replay(self, scenario: str) -> str:
        """Return the replay of a scenario of the paper, as a page of the site has it."""
        title = f"{scenario} as it moves"
        every = [one for one in drawn_of(self._blocks("validate")) if isinstance(one, Replay)]
        shown = next(one for one in every if one.title == title)
        return f"```{{raw}} html\n{replay_html(shown)}```"

    def _figures(self, study: str) -> list[Figure]:
        return [one for one in drawn_of(self._blocks(study)) if isinstance(one, Figure)]

    def figures(self) -> Iterator[Figure]:
        """Yield the figures of every result."""
        for study in self.records:
            yield from self._figures(study)

    def gallery(self) -> list[tuple[str, str]]:
        """Return the figures of the gallery, and the page that explains each."""
        return [
            (to_markdown(list(_on_the_site([figure]))), page)
            for study, page in GALLERY.items()
            for figure in self._figures(study)
        ]

    def pages(self) -> dict[Path, str]:
        """Return every page that is made of a template, README.md too, by its path."""
        found = {README: _from(readme(self, README.read_text(encoding="utf-8")), "docs/")}
        for page in sorted(PAGES.rglob("*.md")):
            name = page.relative_to(PAGES)
            if name.parts[0] != "parts":
                text = self.render(page.read_text(encoding="utf-8"))
                made = f"<!-- Made by `make docs` of docs/pages/{name}: change that. -->\n\n"
                found[DOCS / name] = _from(made + text, "../" * (len(name.parts) - 1))
                if page == tutorial.PAGE:
                    found[DOCS / "tutorial" / "tutorial.ipynb"] = tutorial.notebook(text)
        return found

    def render(self, text: str) -> str:
        """Return a text with what it asks for."""
        context = {
            **self.numbers,
            "table": self.table,
            "sections": self.sections,
            "output": self.output,
            "printed": self.printed,
            "code": code,
            "help": help_of,
            "commands": commands,
            "part": self.part,
            "films": films,
            "gallery": self.gallery,
        }
        environment = jinja2.Environment(
            undefined=jinja2.StrictUndefined, keep_trailing_newline=True, trim_blocks=True
        )
        return environment.from_string(text).render(context)


def _from(text: str, there: str) -> str:
    """Return a text whose links that begin with a slash are by the way from its page to here."""
    return re.sub(r"\]\(/([^)]*)\)", lambda link: f"]({normpath(there + link[1])})", text)


def _number(declared: Mapping[str, Any], result: Any) -> Number:
    """Return a number that is declared, of a result; without a format, as a report shows it."""
    value = eval(declared["value"], {"__builtins__": {}, **NAMES, "r": result})  # our own file
    shown = declared["format"].format(value) if "format" in declared else short(value, 2)
    return Number(value=float(value), shown=shown, within=declared["within"])


def _all_of(found: Sequence[Block]) -> Iterator[Section]:
    """Yield sections and what they hold of sections."""
    for block in found:
        if isinstance(block, Section):
            yield block
            yield from _all_of(block.blocks)


def _on_the_site(found: Sequence[Block]) -> Iterator[Any]:
    """Yield blocks whose figures are where a build draws them."""
    for block in found:
        if isinstance(block, Section):
            yield replace(block, blocks=tuple(_on_the_site(block.blocks)))
        elif isinstance(block, Figure):
            yield replace(block, name=f"/{FIGURES}/{block.name}")
        else:
            yield block


def commands() -> list[str]:
    """Return the names of every command, the studies first."""
    return [*studies(), *OTHERS]


def help_of(command: str = "") -> str:
    """Return the help of a command, or the list of all."""
    if command not in ["", *commands()]:
        raise KeyError(f"no command {command!r}")
    with (
        contextlib.redirect_stdout(io.StringIO()) as printed,
        mock.patch.dict(os.environ, COLUMNS="88"),
    ):
        main([*command.split(), "--help"])
    lines = printed.getvalue().splitlines()
    return "\n".join(textwrap.fill(x, 88) if x and not x.startswith(" ") else x for x in lines)


def code(name: str) -> str:
    """Return a file of the repository as it is."""
    text = (DOCS.parent / name).read_text(encoding="utf-8").strip()
    return f"```{KINDS[Path(name).suffix]}\n{text}\n```"


def shown_in(pages: Iterable[str]) -> set[str]:
    """Return the names of the figures that pages show."""
    return {name for text in pages for name in re.findall(rf"\b{FIGURES}/([\w-]+)\.png\)", text)}


def draw(content: Content, names: set[str]) -> None:
    """Draw the figures of the results and of `research` that have one of some names, no others."""
    from research.figures import draw_contest, draw_gain_table, draw_sensitivity, fits_of
    from research.gain_tuning import GainTable
    from research.optimisers import load_result

    readings, functions = (
        json.loads(file.read_text(encoding="utf-8"))
        for file in (RESULTS / "readings.json", SHIPPED / "gain_functions.json")
    )
    contest = load_result(RESULTS / "optimisers.json")
    found = {figure.name: figure.draw for figure in content.figures()} | {
        "optimisers": lambda: draw_contest(contest),
        "gain_table": lambda: draw_gain_table(GainTable.shipped(), fits_of(functions)),
        "readings": lambda: draw_sensitivity(readings["sensitivity"]["cases"]),
    }
    shutil.rmtree(DOCS / FIGURES, ignore_errors=True)
    (DOCS / FIGURES).mkdir()
    for name in sorted(names):
        path = DOCS / FIGURES / f"{name}.png"
        with styled():
            save_figure(found[name](), path)
        Image.open(path).convert("RGB").quantize(COLOURS).save(path, optimize=True)


def films() -> list[tuple[str, str]]:
    """Return the films of the gallery: name and what it shows."""
    listed = tomllib.loads((DOCS / "_static" / "films" / "films.toml").read_text(encoding="utf-8"))
    return list(listed.items())


def rewrite(text: str, name: str, part: str) -> str:
    """Return a text with a part between its marks, comments of HTML."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"README.md must hold the marks of {name}, one after the other")
    return f"{before}{begin}{part}\n{end}{after}"


def readme(content: Content, text: str) -> str:
    """Return the text of README.md with its parts as they are now."""
    for name in PARTS:
        text = rewrite(text, name, content.part(name))
    return text


def write() -> None:
    """Write every page that is made of a template, and the figures that they show."""
    content = Content()
    pages = content.pages()
    for path, text in pages.items():
        path.write_text(text, encoding="utf-8")
    draw(content, shown_in(pages.values()))


if __name__ == "__main__":
    write()
