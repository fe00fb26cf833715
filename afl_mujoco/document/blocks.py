"""What a report consists of: sections that hold text, findings, tables, figures and commands."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, ClassVar, Literal, TypeAlias

from afl_mujoco.document.pictures import Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

Status = Literal["", "good", "neutral", "bad"]
"""How a cell is to be taken: shown as a tag where it is not empty."""


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph; its markup is `` `code` ``, ``*emphasis*`` and ``[a link](#anchor)``.

    A note stands back behind the text.
    """

    kind: ClassVar[str] = "text"

    text: str
    note: bool = False


@dataclass(frozen=True, slots=True)
class Finding:
    """A sentence of the summary; a page repeats it at its top.

    Attributes
    ----------
    lead
        What it is about, in a few words.
    text
        The sentence, with the markup of `Text`.
    """

    kind: ClassVar[str] = "finding"

    lead: str
    text: str


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table; one of numbers is aligned to the right."""

    header: str
    unit: str = ""
    number: bool = False

    @property
    def title(self) -> str:
        """Header with the unit."""
        return f"{self.header} [{self.unit}]" if self.unit else self.header


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table, its text taken literally."""

    text: str
    status: Status = ""
    code: bool = False
    strong: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table whose first column names its rows.

    Attributes
    ----------
    caption
        What it shows.
    columns
        From left to right.
    rows
        One cell for each column; a string is a cell without status.
    summary
        If not empty, the page folds the table behind this line, and the terminal leaves it out.
    """

    kind: ClassVar[str] = "table"

    caption: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell | str]]
    summary: str = ""

    @property
    def cells(self) -> Iterator[list[tuple[Column, Cell]]]:
        """Rows with their columns."""
        for row in self.rows:
            cells = [Cell(cell) if isinstance(cell, str) else cell for cell in row]
            yield list(zip(self.columns, cells, strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A figure, drawn when its files are written.

    Attributes
    ----------
    name
        Of its files, without suffix.
    title, caption
        A heading; what is drawn.
    alt
        What one sees, with numbers, for those who do not see it.
    draw
        Draws it with matplotlib.
    """

    kind: ClassVar[str] = "figure"

    name: str
    title: str
    caption: str
    alt: str
    draw: Callable[[], Drawing]

    @property
    def files(self) -> dict[str, str]:
        """Names of its files by their format."""
        return {suffix: f"{self.name}.{suffix}" for suffix in ("svg", "png")}


@dataclass(frozen=True, slots=True)
class Command:
    """A command, and what it does in a few words.

    Attributes
    ----------
    lead
        What it does.
    command
        As typed into a shell, or its words: a path among them is of a file beside the report's
        results.
    """

    kind: ClassVar[str] = "command"

    lead: str
    command: str | Sequence[str | PurePath]

    def typed(self, folder: PurePath) -> str:
        """Return it as typed into a shell, the results in `folder`."""
        if isinstance(self.command, str):
            return self.command
        words = [str(folder / w) if isinstance(w, PurePath) else w for w in self.command]
        return shlex.join(words)


@dataclass(frozen=True, slots=True)
class Section:
    """A titled part of a report.

    Attributes
    ----------
    title
        Its heading.
    anchor
        What links within the report point to.
    blocks
        What it holds, further sections included.
    """

    kind: ClassVar[str] = "section"

    title: str
    anchor: str
    blocks: Sequence[Block]

    def walk(self) -> Iterator[Block]:
        """Return its blocks and those of the sections in it, in their order."""
        for block in self.blocks:
            yield block
            if isinstance(block, Section):
                yield from block.walk()


Block: TypeAlias = Text | Finding | Table | Figure | Picture | Command | Section


def figures_of(sections: Sequence[Section]) -> list[Figure]:
    """Return the figures of sections, in their order."""
    return [b for section in sections for b in section.walk() if isinstance(b, Figure)]
