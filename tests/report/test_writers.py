"""The same blocks on the terminal, in Markdown and in HTML: nothing lost, everything escaped."""

import json
import re

import pytest

from afl_mujoco.report import blocks
from afl_mujoco.report import terminal as terminal_module
from afl_mujoco.report.markdown import code, plain, to_markdown
from afl_mujoco.report.page import Part, to_html
from afl_mujoco.report.style import new_figure, write_figure
from afl_mujoco.report.terminal import print_report, to_text

NASTY = "<script>alert(1)</script> [red] | a_b"


def draw():
    figure = new_figure(3.0, 2.0)
    figure.subplots().plot([0.0, 1.0])
    return figure


def matrix(folded: str = "") -> blocks.Matrix:
    return blocks.Matrix(
        caption="How far each goes",
        columns=("name", "distance [m]", "verdict"),
        rows=(
            ("first", "1.5", blocks.Cell("stays", "good")),
            (NASTY, "−2", blocks.Cell("falls", "bad")),
            ("third", "0", blocks.Cell("rests", "neutral")),
            ("fourth", "–", blocks.Cell("unclear", "open")),
        ),
        folded=folded,
    )


MOVING = {"duration": 1.5, "runs": [{"controller": NASTY, "colour": "#000000"}]}
REPLAY = blocks.Replay(name="a-run", title="A run", compute=lambda: MOVING)
LINE = blocks.Figure(name="a-line", title="A line", caption="It rises.", draw=draw)
BLOCKS: tuple[blocks.Block, ...] = (
    "It holds with `--quick` and *without*, see [there](#part).", f"Given: {plain(NASTY)}",
    "- **mass** 1 kg", matrix(), blocks.Section("Part", "part", (matrix("All rows"), LINE)),
    blocks.Section("Behind", "behind", ("in the depth", REPLAY), folded=True),
    "```sh\nafl-mujoco study 'my file.toml'\n```",
)  # fmt: skip
REPORT = blocks.Report(title="Study", headline=f"1 of 3 fails {NASTY}", passed=False, blocks=BLOCKS)


def html(folder, *others: blocks.Report) -> str:
    parts = [Part(one, f"study{k or ''}", [folder]) for k, one in enumerate((REPORT, *others))]
    last = blocks.Section("Reproduce", "reproduce", ("the command",))
    return to_html("Reports", parts, [last], folder)


WRITERS = {
    "terminal": lambda folder: to_text(BLOCKS), "Markdown": lambda folder: to_markdown(BLOCKS),
    "HTML": lambda folder: re.sub(r"<[^>]*>", "", html(folder)),
}  # fmt: skip


@pytest.mark.parametrize("writer", WRITERS)
def test_every_writer_says_texts_cells_and_commands(writer: str, tmp_path) -> None:
    said = WRITERS[writer](tmp_path)
    words = "Part|--quick|without|How far each goes|distance|−2|stays|falls|rests|unclear|mass|1 kg"
    for text in f"{words}|there|afl-mujoco study".split("|"):
        assert text in said, text
    assert "`--quick`" in said or writer != "Markdown"


def test_a_terminal_marks_a_status_without_colour_and_a_row_has_the_columns_length(capsys) -> None:
    said = to_text(BLOCKS)
    assert "✗ falls" in said and "◐ rests" in said and NASTY in said
    assert said.count("first") == 1  # the folded matrix is left out
    assert "in the depth" not in said and "A run" not in said and "#part" not in said
    print_report(REPORT)
    assert capsys.readouterr().out.splitlines()[-1] == f"FAIL: 1 of 3 fails {NASTY}"
    with pytest.raises(ValueError, match="every row of 't' must have 2 cells"):
        to_text([blocks.Matrix(caption="t", columns=("a", "b"), rows=(("x",),))])


def test_markdown_escapes_what_would_be_markup() -> None:
    said = to_markdown(BLOCKS)
    assert "<script>" not in said.replace("\\<", "")
    assert r"\<script\>alert(1)\</script\> \[red\] \| a\_b" in said
    assert "![A line. It rises.](a-line.png)" in said
    assert "| name | distance \\[m\\] | verdict |\n| --- | ---: | --- |" in said
    assert "# Part" in said and "<details><summary>All rows</summary>" in said
    assert "in the depth" in said and "A run" not in said
    assert (code("a"), code("`a`")) == ("`a`", "`` `a` ``")


def test_a_page_holds_all_it_needs_and_what_it_is_given_escaped_without_script(tmp_path) -> None:
    for figure in blocks.figures_of(BLOCKS):
        write_figure(figure, tmp_path)
    (tmp_path / "a-run.replay.json").write_text(json.dumps(MOVING), encoding="utf-8")
    page = html(tmp_path)
    assert "<script>alert" not in page and "&lt;script&gt;alert(1)" in page
    assert '<img src="data:image/svg+xml;base64,' in page
    assert re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', page) == []
    assert page.count("<script>") == 1 and "Content-Security-Policy" in page
    assert "<h1>Study</h1>" in page and '<h2 id="part">' in page
    assert '<a href="#part">there</a>' in page
    assert 'class="tag bad"' in page and 'class="tag part"' in page
    assert "<em>without</em>" in page and "<code>--quick</code>" in page
    assert '<details class="folded" id="behind">' in page
    assert '<script type="application/json" id="a-run-rows">' in page and 'max="1.5"' in page
    assert "A run: the replay needs JavaScript." in page and "<title>FAIL: Study</title>" in page
    evil = "<img src=x onerror=alert(1)> [x](javascript:alert(1)) ![y](https://elsewhere/y.png)"
    said = html(tmp_path, blocks.Report(title="b", headline="c", blocks=(evil,)))
    assert "<img src=x" not in said and 'href="javascript' not in said
    assert 'src="https:' not in said


def test_a_page_of_several_reports_has_a_heading_for_each_and_a_failure_counts(tmp_path) -> None:
    said = html(tmp_path, blocks.Report(title="Good", headline="all hold", passed=True, blocks=()))
    assert "<h1>Reports</h1>" in said and "<title>FAIL: Reports</title>" in said
    for title in ("Study", "Good"):
        assert re.search(rf"<h2 [^>]*>{title}</h2>", said)
    assert "The figure “A line” is missing" in said and "The replay “A run” is missing" in said


NAMES = "step-step", "a-very-long-name-of-a-scenario"
PAIRS = [(s, c) for s in NAMES for c in ("adaptive", "lqr")]
WIDE = blocks.Matrix(
    caption="Wide",
    columns=("Scenario", "Controller", "Outcome", *(f"B{k}" for k in range(8))),
    rows=[(*pair, "fell at t = 1.26 s", *(f"{k}.0×10⁻¹²" for k in range(8))) for pair in PAIRS],
)


@pytest.mark.parametrize("width", [80, 104, 300])
def test_a_table_that_is_too_wide_goes_on_below_with_nothing_lost_or_broken(width, monkeypatch):
    monkeypatch.setattr(terminal_module, "WIDTH", width)
    text = to_text([WIDE])
    assert max(map(len, text.splitlines())) <= width
    assert all(column in text for column in WIDE.columns)
    assert all(text.count(f"{k}.0×10⁻¹²") == 4 for k in range(8)) and text.count("fell at") == 4
    parts = text.count("Scenario")
    assert (parts > 1) == (width < 150)
    assert text.count("lqr") == 2 * parts  # what names a row stands in every part


def test_no_name_steers_the_terminal(capsys) -> None:
    raw = "x\x1b]0;mine\x07\x9b2J\u202e"
    table = blocks.Matrix(caption=raw, columns=(raw, "b"), rows=((raw, raw),))
    shown = (raw, f"```sh\n{raw}\n```", table, blocks.Section(raw, "part", (raw,)))
    print_report(blocks.Report(headline=raw, blocks=shown))
    said = to_text(shown) + capsys.readouterr().out
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e]", said)
    assert said.count("]0;mine") >= 14


def test_a_column_that_has_nothing_in_any_row_is_left_out() -> None:
    rows = [("a", "–", "1", ""), ("b", "", "–", "–")]
    some = blocks.Matrix(caption="", columns=("name", "none", "some", "empty"), rows=rows).filled
    assert (some.columns, some.rows) == (["name", "some"], [["a", "1"], ["b", "–"]])
