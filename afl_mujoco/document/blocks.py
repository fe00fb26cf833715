"""The blocks of a report: sections of text, findings, tables, figures, charts and films."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

Status = Literal["", "good", "neutral", "bad", "open"]
"""Status of a cell, shown as a tag unless it is empty; "open" means not decided."""


def good_or_bad(good: bool) -> Status:
    """Return "good" or "bad"."""
    return "good" if good else "bad"


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether everything that was judged holds.

    Attributes
    ----------
    passed
        Whether it does.
    text
        How much was judged, and how much fails.
    meaning
        What may be concluded, and what may not.
    """

    kind: ClassVar[str] = "verdict"

    passed: bool
    text: str
    meaning: str = ""

    @property
    def word(self) -> str:
        """Pass or fail."""
        return "PASS" if self.passed else "FAIL"


@dataclass(frozen=True, slots=True)
class Tag:
    """A name with a status; the full text is at its anchor."""

    name: str
    status: Status
    anchor: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Tally:
    """Many judgements at a glance."""

    kind: ClassVar[str] = "tally"

    title: str
    tags: Sequence[Tag]

    @property
    def counts(self) -> dict[tuple[Status, str], int]:
        """Number of tags of each status and meaning."""
        found = [(tag.status, tag.meaning) for tag in self.tags]
        return {one: found.count(one) for one in dict.fromkeys(found)}


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph; its markup is `` `code` ``, ``*emphasis*`` and ``[a link](#anchor)``.

    A note is less prominent than other text.
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
    evidence
        Anchor of the evidence for it, if that is elsewhere.
    """

    kind: ClassVar[str] = "finding"

    lead: str
    text: str
    evidence: str = ""


@dataclass(frozen=True, slots=True)
class Fact:
    """A label and its text, with the markup of `Text`."""

    label: str
    text: str
    anchor: str = ""


@dataclass(frozen=True, slots=True)
class Facts:
    """A list of labels, each with its text."""

    kind: ClassVar[str] = "facts"

    facts: Sequence[Fact]


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table; columns of numbers are aligned to the right."""

    header: str
    unit: str = ""
    number: bool = False

    @property
    def title(self) -> str:
        """Header with the unit."""
        return f"{self.header} [{self.unit}]" if self.unit else self.header


@dataclass(frozen=True, slots=True)
class Bar:
    """A stretch on a scale from 0 to 1, with a mark and, if given, a point."""

    low: float
    high: float
    mark: float
    point: float | None = None


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table, its text taken literally.

    Attributes
    ----------
    text
        Its text.
    status, code, strong
        Style of the text.
    note
        Text below it, with the markup of `Text`; a terminal leaves it out.
    anchor, link
        Anchor that links to the cell use; anchor to which the cell links.
    bar
        Bar that a page draws above the text.
    """

    text: str
    status: Status = ""
    code: bool = False
    strong: bool = False
    note: str = ""
    anchor: str = ""
    link: str = ""
    bar: Bar | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table whose first column names its rows.

    Attributes
    ----------
    caption
        What it shows.
    columns
        Columns from left to right.
    rows
        One cell for each column; a string is a cell without status.
    summary
        If not empty, the page folds the table behind this line, and the terminal leaves it out.
    stacked
        Whether a narrow page stacks the cells of a row: for cells with much text.
    """

    kind: ClassVar[str] = "table"

    caption: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell | str]]
    summary: str = ""
    stacked: bool = False

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
        Name of its files, without suffix.
    title, caption
        A heading, and a description of what is drawn.
    alt
        Description with numbers, for readers who cannot see it.
    draw
        Function that draws it with matplotlib.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Curves that a page draws and that a reader can zoom into.

    Attributes
    ----------
    anchor
        Anchor of the chart, unique in the report.
    title
        A heading.
    quantities
        Key, symbol and name of the quantities that can be shown.
    data
        The data that the page's script draws.
    """

    kind: ClassVar[str] = "chart"

    anchor: str
    title: str
    quantities: Sequence[tuple[str, str, str]]
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """A film, inside the page if it is small, linked otherwise.

    Attributes
    ----------
    title, caption
        What it shows, and how it was made.
    file
        The film, an MP4.
    poster
        A still; None if there is none.
    width, height
        Size of a frame [px].
    command
        The command that makes it.
    wide
        Whether it needs the whole width of a page.
    """

    kind: ClassVar[str] = "film"

    title: str
    caption: str
    file: Path
    poster: Path | None
    width: int
    height: int
    command: str
    wide: bool = False


@dataclass(frozen=True, slots=True)
class Command:
    """A command, and what it does in a few words.

    Attributes
    ----------
    lead
        What it does.
    command
        As typed into a shell, or its words: a path among them is that of a file beside the
        report's results.
    """

    kind: ClassVar[str] = "command"

    lead: str
    command: str | Sequence[str | PurePath]

    def typed(self, folder: PurePath) -> str:
        """Return it as typed into a shell, with the results in `folder`."""
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
        Target of links within the report.
    blocks
        Its blocks, further sections included.
    folded
        Whether the page folds it behind its heading and the terminal leaves it out.
    aside
        Text beside the heading.
    """

    kind: ClassVar[str] = "section"

    title: str
    anchor: str
    blocks: Sequence[Block]
    folded: bool = False
    aside: str = ""

    @property
    def parts(self) -> list[Section]:
        """The sections directly in it."""
        return [block for block in self.blocks if isinstance(block, Section)]

    def walk(self) -> Iterator[Block]:
        """Return its blocks and those of the sections in it, in order."""
        for block in self.blocks:
            yield block
            if isinstance(block, Section):
                yield from block.walk()


Block: TypeAlias = (
    Verdict | Tally | Text | Finding | Facts | Table | Figure | Chart | Film | Command | Section
)


def figures_of(sections: Sequence[Section]) -> list[Figure]:
    """Return the figures of sections, in order."""
    return [b for section in sections for b in section.walk() if isinstance(b, Figure)]


def without_figures(section: Section) -> Section:
    """Return a section without its figures, where these are not drawn."""
    kept = (block for block in section.blocks if not isinstance(block, Figure))
    bare = [without_figures(block) if isinstance(block, Section) else block for block in kept]
    return replace(section, blocks=bare)
