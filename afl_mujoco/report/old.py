"""The older blocks in the form of the new, for studies whose sections are not rewritten yet."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from afl_mujoco.report.blocks import Block as Block
from afl_mujoco.report.blocks import Cell as NewCell
from afl_mujoco.report.blocks import Chart as Chart
from afl_mujoco.report.blocks import Figure as NewFigure
from afl_mujoco.report.blocks import Film as Film
from afl_mujoco.report.blocks import Matrix
from afl_mujoco.report.blocks import Section as NewSection
from afl_mujoco.report.blocks import Status as Status


def good_or_bad(good: bool) -> Status:
    """Return "good" or "bad"."""
    return "good" if good else "bad"


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether everything that was judged holds."""

    passed: bool
    text: str
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Tag:
    """A name with a status."""

    name: str
    status: Status
    anchor: str
    meaning: str


class Tally(str):
    """Many judgements at a glance."""

    def __new__(cls, title: str, tags: Sequence[Tag]) -> Tally:
        """Return it as a paragraph."""
        found = [tag.meaning for tag in tags]
        counts = ", ".join(f"{found.count(x)} {x}" for x in dict.fromkeys(found))
        return super().__new__(cls, f"{title}: {counts}")


class Text(str):
    """A paragraph."""

    def __new__(cls, text: str, note: bool = False) -> Text:
        """Return it as a paragraph."""
        return super().__new__(cls, text)


class Finding(str):
    """A sentence of the summary."""

    def __new__(cls, lead: str, text: str, evidence: str = "") -> Finding:
        """Return it as a paragraph."""
        return super().__new__(cls, f"**{lead}.** {text}")


@dataclass(frozen=True, slots=True)
class Fact:
    """A label and its text."""

    label: str
    text: str
    anchor: str = ""


class Facts(str):
    """A list of labels, each with its text."""

    def __new__(cls, facts: Sequence[Fact]) -> Facts:
        """Return it as a list."""
        return super().__new__(cls, "\n".join(f"- **{one.label}** {one.text}" for one in facts))


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table."""

    header: str
    unit: str = ""
    number: bool = False

    @property
    def title(self) -> str:
        """Header with the unit."""
        return f"{self.header} [{self.unit}]" if self.unit else self.header


@dataclass(frozen=True, slots=True)
class Bar:
    """A stretch on a scale."""

    low: float
    high: float
    mark: float
    point: float | None = None


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table."""

    text: str
    status: Status = ""
    code: bool = False
    strong: bool = False
    note: str = ""
    anchor: str = ""
    link: str = ""
    bar: Bar | None = None


class Table(Matrix):
    """A table."""

    def __init__(
        self, *, caption: str, columns: Sequence[Column], rows: Sequence[Sequence[Any]],
        summary: str = "", stacked: bool = False,
    ) -> None:  # fmt: skip
        """Make it a matrix."""
        made = [
            [c if isinstance(c, str) else NewCell(c.text, c.status) for c in row] for row in rows
        ]
        heads = [column.title for column in columns]
        super().__init__(caption=caption, columns=heads, rows=made, folded=summary)


class Figure(NewFigure):
    """A figure."""

    def __init__(self, *, name: str, title: str, caption: str, alt: str, draw: Any) -> None:
        """Make it a figure."""
        super().__init__(name=name, title=title, caption=caption, draw=draw)


class Command(str):
    """A command."""

    def __new__(cls, lead: str, command: str | Sequence[str | PurePath]) -> Command:
        """Return it as code."""
        typed = command if isinstance(command, str) else shlex.join(map(str, command))
        return super().__new__(cls, f"```sh\n{typed}\n```")


class Section(NewSection):
    """A section."""

    def __init__(
        self, title: str, anchor: str, blocks: Sequence[Block], folded: bool = False,
        aside: str = "",
    ) -> None:  # fmt: skip
        """Make it a section."""
        super().__init__(title, anchor, blocks, folded)
