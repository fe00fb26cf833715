"""The same blocks on the terminal, in Markdown and in HTML: nothing lost, everything escaped."""

from __future__ import annotations

import re
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from afl_mujoco.report.old import (
    Bar,
    Cell,
    Chart,
    Column,
    Command,
    Fact,
    Facts,
    Figure,
    Finding,
    Section,
    Table,
    Tag,
    Tally,
    Text,
    Verdict,
    figures_of,
)
from afl_mujoco.report.html import to_html
from afl_mujoco.report.markdown import to_markdown
from afl_mujoco.report.style import new_figure, write_figure
from afl_mujoco.report.terminal import print_sections

NASTY = "<script>alert(1)</script> [red] | a_b"


def draw():
    figure = new_figure(3.0, 2.0)
    figure.subplots().plot([0.0, 1.0])
    return figure


def table(summary: str = "") -> Table:
    return Table(
        caption="How far each goes",
        columns=(Column("name"), Column("distance", "m", number=True), Column("verdict")),
        rows=(
            ("first", "1.5", Cell("stays", "good")),
            (NASTY, "−2", Cell("falls", "bad")),
            ("third", "0", Cell("rests", "neutral", note="as *told*")),
            (
                Cell("fourth", anchor="fourth"),
                Cell("half", bar=Bar(0.0, 0.5, 0.9, point=0.4)),
                Cell("unclear", "open", link="part"),
            ),
        ),
        summary=summary,
    )


CHART = Chart(
    anchor="curve",
    title="A curve",
    quantities=(("z", "z", "position"),),
    data={"shortcuts": [{"label": "start", "from": 0.0, "to": 1.0}]},
)
LINE = Figure(name="a-line", title="A line", caption="It rises.", alt="a line", draw=draw)
SECTION = Section(
    "Study",
    "study",
    (
        Verdict(False, "1 of 3 fails", "Nothing rests on it."),
        Tally(
            "Three at a glance",
            (Tag("T1", "good", "part", "right"), Tag("T2", "open", "part", "unknown")),
        ),
        Finding("In short", "It holds with `--quick` and *without*."),
        Facts((Fact("mass", "1 kg at [Part](#part)"),)),
        Text(f"Given: {NASTY}"),
        table(),
        Section("Part", "part", (table("All rows"), LINE)),
        Section("Behind", "behind", (Text("in the depth"), CHART), folded=True, aside="beside"),
        Command("Made by", "afl-mujoco study 'my file.toml'"),
    ),
)


def terminal(section: Section) -> str:
    stream = StringIO()
    print_sections([section], Path("out"), Console(file=stream, width=140))
    return stream.getvalue()


def html(folder: Path) -> str:
    return to_html("Report", [([SECTION], folder)], folder)


@pytest.fixture
def page(tmp_path: Path) -> str:
    for figure in figures_of([SECTION]):
        write_figure(figure, tmp_path)
    return html(tmp_path)


WRITERS: dict[str, Callable[[Path], str]] = {
    "terminal": lambda folder: terminal(SECTION),
    "Markdown": lambda folder: to_markdown([SECTION]),
    "HTML": lambda folder: re.sub(r"<[^>]*>", "", html(folder)),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_every_writer_says_titles_findings_cells_and_commands(writer: str, tmp_path: Path) -> None:
    said = WRITERS[writer](tmp_path)
    for text in (
        "Study", "Part", "In short", "--quick", "without", "How far each goes", "distance", "−2",
        "stays", "falls", "rests", "All rows", "A line", "FAIL", "1 of 3 fails", "unclear",
        "Three at a glance", "right", "unknown", "mass", "1 kg at Part",
    ):  # fmt: skip
        assert text in said, text
    assert "afl-mujoco study" in said
    assert "`--quick`" in said or writer != "Markdown"


def test_a_terminal_marks_a_status_without_colour_and_prints_names_as_they_are() -> None:
    said = terminal(SECTION)
    assert "✗ falls" in said and "◐ rests" in said
    assert NASTY in said
    assert said.count("first") == 1  # the folded table is left out
    assert "[All rows: 4 rows, not shown here]" in said


def test_what_is_folded_or_moves_is_for_a_page(page: str) -> None:
    assert "in the depth" not in terminal(SECTION)
    assert "A curve" not in to_markdown([SECTION]) + terminal(SECTION)
    assert "in the depth" in to_markdown([SECTION])
    assert '<details class="folded" id="behind">' in page and "beside" in page
    assert '<script type="application/json" id="curve-curves">' in page
    assert 'data-from="0.0" data-to="1.0"' in page


def test_a_cell_has_its_note_anchor_link_and_bar(page: str) -> None:
    assert 'id="fourth"' in page and 'class="bar "' in page
    assert "as <em>told</em>" in page
    assert "rests<br>as *told*" in to_markdown([SECTION])
    assert "as told" not in terminal(SECTION)


def test_a_row_does_not_repeat_the_name_of_the_row_above_on_the_terminal() -> None:
    twice = Table(caption="t", columns=(Column("a"), Column("b")), rows=(("x", "1"), ("x", "2")))
    assert terminal(Section("s", "s", (twice,))).count("x") == 1


def test_markdown_escapes_what_would_be_markup() -> None:
    said = to_markdown([SECTION])
    assert "<script>" not in said.replace("\\<", "")
    assert r"\<script\>alert(1)\</script\> \[red\] \| a\_b" in said
    assert "![a line](a-line.png)" in said
    assert "| name | distance \\[m\\] | verdict |\n| --- | ---: | --- |" in said
    assert "## Part" in said and "<details><summary>All rows</summary>" in said


def test_a_page_holds_all_it_needs_and_escapes_what_it_is_given(page: str) -> None:
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)" in page
    assert '<img src="data:image/svg+xml;base64,' in page
    assert re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', page) == []
    assert page.count("<script>") == 1
    assert "Content-Security-Policy" in page
    assert '<h2 id="study">' in page and '<h3 id="part">' in page
    assert 'href="#study"' in page
    assert 'class="tag bad"' in page and 'class="tag part"' in page
    assert "<em>without</em>" in page and "<code>--quick</code>" in page


def test_a_figure_without_its_files_is_said_to_be_missing(tmp_path: Path) -> None:
    assert "The figure “A line” is missing" in html(tmp_path)


WIDE = Table(
    caption="Wide",
    columns=(
        Column("Scenario"),
        Column("Controller"),
        Column("Outcome"),
        *(Column(f"B{k}", number=True) for k in range(8)),
    ),
    rows=[
        (scenario, controller, "fell at t = 1.26 s", *(f"{k}.0×10⁻¹²" for k in range(8)))
        for scenario in ("step-step", "a-very-long-name-of-a-scenario")
        for controller in ("adaptive", "lqr")
    ],
)


@pytest.mark.parametrize("width", [80, 104, 300])
def test_a_table_that_is_too_wide_goes_on_below_with_no_column_lost_and_no_number_broken(
    width: int,
) -> None:
    out = StringIO()
    console = Console(file=out, width=width, highlight=False)
    print_sections([Section("Part", "part", (WIDE,))], Path(), console)
    lines = out.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    text = out.getvalue()
    for column in WIDE.columns:
        assert column.header in text
    for k in range(8):
        assert text.count(f"{k}.0×10⁻¹²") == 4
    assert text.count("fell at") == 4
    parts = text.count("Scenario")
    assert (parts > 1) == ("(continued)" in text) == (width < 150)
    assert text.count("lqr") == 2 * parts  # what names a row stands in every part


def test_no_name_steers_the_terminal() -> None:
    raw = "x\x1b]0;mine\x07\x9b2J\u202e"
    blocks = (
        Verdict(False, raw, raw), Tally(raw, (Tag("T1", "good", "part", raw),)), Finding(raw, raw),
        Facts((Fact(raw, raw),)), Text(f"`{raw}`"), Command(raw, raw),
        Table(caption=raw, columns=(Column(raw), Column("b")), rows=((raw, raw), (raw, "c"))),
        Table(caption=raw, columns=(Column("a"),), rows=((raw,),), summary=raw),
        Figure(name="a", title=raw, caption=raw, alt=raw, draw=draw),
        Section(raw, "part", (Text(raw),)),
    )  # fmt: skip
    said = terminal(Section(raw, "raw", blocks))
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e]", said)
    assert said.count(r"\x1b]0;mine\x07\x9b2J\u202e") >= 15
