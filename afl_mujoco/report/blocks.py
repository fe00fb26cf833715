"""What a report is made of: numbers, Markdown, and four blocks that Markdown does not have."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MISSING = "–"  # sign for a missing number


def scientific(value: float | None, digits: int = 2) -> str:
    """Return a value with a few digits and a power of ten; 0 as it is."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{_signed(mantissa)}×10{str(int(exponent)).translate(SUPERSCRIPTS)}"


def short(value: float | None, digits: int = 4) -> str:
    """Return a value as a person writes it: plain if that is short, else scientific."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value and not 1e-3 <= abs(value) < 1e6:
        return scientific(value, min(digits, 2))
    rounded = float(f"{value:.{digits}g}")
    return _signed(f"{rounded:,.0f}".replace(",", " ") if abs(rounded) >= 1e4 else f"{rounded:g}")


def fixed(value: float | None, decimals: int) -> str:
    """Return a value with a number of decimals, for columns that are read from top to bottom."""
    if value is None or not math.isfinite(value):
        return MISSING
    return _signed(f"{value:.{decimals}f}")


def limit(value: float) -> str:
    """Return a limit: a bare power of ten if it is a small one."""
    if 0.0 < value < 1e-2:
        exponent = round(math.log10(value))
        if math.isclose(value, 10.0**exponent):
            return "10" + str(exponent).translate(SUPERSCRIPTS)
    return short(value)


def percent(share: float | None, digits: int = 2) -> str:
    """Return a share in percent."""
    if share is None or not math.isfinite(share):
        return MISSING
    return f"{short(100.0 * share, digits)} %"


def _signed(text: str) -> str:
    """Return a number's text with a proper minus sign, and none before zero."""
    return text.replace("-", "−" if text.strip("-0.") else "")


def listed(parts: Sequence[str], word: str) -> str:
    """Join parts as in a sentence, the last by ``and`` or ``or``."""
    return f" {word} ".join(filter(None, (", ".join(parts[:-1]), *parts[-1:])))


def sentence(text: str) -> str:
    """Return a text with a capital first letter."""
    return text[:1].upper() + text[1:]


Status = Literal["", "good", "neutral", "bad", "open"]
"""Status of a cell, shown as a mark and a colour; "open" means not decided."""

MARKS: Mapping[str, str] = {"": "", "good": "✓ ", "neutral": "◐ ", "bad": "✗ ", "open": "? "}
"""Mark before a cell, so that its status does not depend on colour alone."""

REPLAY = ".replay.json"  # ending of the file of a replay
NUMBERS = "0123456789−-<>+–±"  # beginnings of what is aligned as a number


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a matrix, its text taken literally."""

    text: str
    status: Status = ""

    @property
    def marked(self) -> str:
        """Its text behind the mark of its status."""
        return MARKS[self.status] + self.text


@dataclass(frozen=True, slots=True, kw_only=True)
class Matrix:
    """A table whose first column names its rows; pages fold it if `folded`, terminals drop it."""

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell | str]]
    folded: str = ""

    @property
    def cells(self) -> list[list[Cell]]:
        """Rows of cells, each as long as there are columns."""
        rows = [[Cell(x) if isinstance(x, str) else x for x in row] for row in self.rows]
        if any(len(row) != len(self.columns) for row in rows):
            raise ValueError(f"every row of {self.caption!r} must have {len(self.columns)} cells")
        return rows

    @property
    def filled(self) -> Matrix:
        """The same without columns that have nothing in any row."""
        columns = zip(*self.cells, strict=True)
        shown = [any(cell.text not in ("", MISSING) for cell in column) for column in columns]
        rows = [[*compress(row, shown)] for row in self.rows]
        return replace(self, columns=[*compress(self.columns, shown)], rows=rows)

    @property
    def numbers(self) -> list[bool]:
        """For each column whether it holds numbers, which are aligned to the right."""
        columns = list(zip(*self.cells, strict=True)) or [()] * len(self.columns)
        return [
            k > 0 and all(cell.text[:1] in NUMBERS for cell in column)
            for k, column in enumerate(columns)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A figure, drawn when its files are written; title and caption stand in for it too."""

    name: str  # of its files, without suffix
    title: str
    caption: str = ""
    draw: Callable[[], Drawing]

    @property
    def files(self) -> dict[str, str]:
        """Names of its files by their format."""
        return {suffix: f"{self.name}.{suffix}" for suffix in ("svg", "png")}

    @property
    def alt(self) -> str:
        """Text in its place."""
        return f"{self.title}. {self.caption}".strip()


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """Runs that move on a page, with a slider of time; computed when its file is written."""

    name: str  # of its file, without suffix
    title: str
    caption: str = ""
    compute: Callable[[], Mapping[str, Any]]  # what the page's script draws

    @property
    def files(self) -> dict[str, str]:
        """Name of its file by its format."""
        return {"json": f"{self.name}{REPLAY}"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """A film, inside the page if it is small, linked otherwise."""

    title: str
    caption: str
    file: Path  # an MP4
    poster: Path | None  # a still
    width: int  # [px]
    height: int
    command: str  # that makes it
    wide: bool = False  # needs the whole width of a page


@dataclass(frozen=True, slots=True)
class Section:
    """A titled part; a folded one is behind its heading in a page, and not on a terminal."""

    title: str
    anchor: str
    blocks: Sequence[Block]
    folded: bool = False

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


Block: TypeAlias = str | Matrix | Figure | Film | Replay | Section
"""A string is Markdown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a study shows: one headline, and blocks; whether what it judges holds, if it judges."""

    headline: str
    blocks: Sequence[Block]
    passed: bool | None = None
    title: str = ""  # by default that of the study
    verdict: str = ""  # of several that are judged, where some pass and some fail

    @property
    def word(self) -> str:
        """Pass or fail, or how many pass; nothing if it judges nothing."""
        return self.verdict or {True: "PASS", False: "FAIL", None: ""}[self.passed]

    @property
    def status(self) -> Status:
        """Status of the word."""
        status: dict[bool | None, Status] = {True: "good", False: "bad", None: ""}
        return "neutral" if self.verdict else status[self.passed]


def drawn_of(blocks: Sequence[Block]) -> list[Figure | Replay]:
    """Return the figures and replays of blocks, in order."""
    return [block for block in Section("", "", blocks).walk() if isinstance(block, Figure | Replay)]


def without_figures(blocks: Sequence[Block]) -> list[Block]:
    """Return blocks without figures and replays, where these are not drawn."""
    return [
        replace(one, blocks=without_figures(one.blocks)) if isinstance(one, Section) else one
        for one in blocks
        if not isinstance(one, Figure | Replay)
    ]


_SPECIAL = re.compile(r"([\\`*_{}\[\]<>|])")


def to_markdown(found: Sequence[Block], level: int = 1) -> str:
    """Return blocks as Markdown, with headings from a level on; pictures are linked."""
    return "\n\n".join(_parts(found, level)) + "\n"


def _parts(found: Sequence[Block], level: int) -> Iterator[str]:
    for block in found:
        if isinstance(block, str):
            yield block
        elif isinstance(block, Section):
            yield f"{'#' * level} {plain(block.title)}"
            yield from _parts(block.blocks, level + 1)
        elif isinstance(block, Matrix):
            yield _table(block)
        elif isinstance(block, Figure):
            picture = f"![{plain(block.alt)}]({block.files['png'].replace(' ', '%20')})"
            yield f"{picture}\n\n**{plain(block.title)}.** {plain(block.caption)}".rstrip()
        elif isinstance(block, Film):
            said = f"**{plain(block.title)}.** {plain(block.caption)}"
            yield f"{said} {code(block.command)} makes it."
        elif not isinstance(block, Replay):  # it needs a page's script
            raise TypeError(block)


def _table(matrix: Matrix) -> str:
    """Return a matrix under its caption, folded where the page folds it."""
    sides = ("---:" if number else "---" for number in matrix.numbers)
    rows = [[plain(cell.marked).replace("\n", " ") for cell in row] for row in matrix.cells]
    lines = [[plain(header) for header in matrix.columns], [*sides], *rows]
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    text = f"*{plain(matrix.caption)}*\n\n{table}" if matrix.caption else table
    if not matrix.folded:
        return text
    return f"<details><summary>{plain(matrix.folded)}</summary>\n\n{text}\n\n</details>"


def code(text: str) -> str:
    """Return text as code, even if it has backticks."""
    return f"`{text}`" if "`" not in text else f"`` {text} ``"


def plain(text: str) -> str:
    """Return text that is taken literally."""
    return _SPECIAL.sub(r"\\\1", text)
