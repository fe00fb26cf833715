"""The same blocks on the terminal, in Markdown and in HTML: nothing lost, everything escaped."""

import json
import re
from itertools import product

import pytest
from matplotlib.text import Text

from afl_mujoco.control.names import NAMES
from afl_mujoco.report import blocks, figures
from afl_mujoco.report import terminal as terminal_module
from afl_mujoco.report.blocks import code, limit, plain, scientific, short, to_markdown
from afl_mujoco.report.figures import new_figure, save_figure, styled
from afl_mujoco.report.page import to_html
from afl_mujoco.report.terminal import print_report, to_text

NASTY = "<script>alert(1)</script> [red] | a_b"


def draw():
    figure = new_figure(3.0, 2.0)
    figure.subplots().plot([0.0, 1.0])
    return figure


def matrix(folded: str = "") -> blocks.Matrix:
    said = [("stays", "good"), ("falls", "bad"), ("rests", "neutral"), ("unclear", "open")]
    cells, named = [blocks.Cell(*x) for x in said], ("first", NASTY, "third", "fourth")
    rows = [*zip(named, ("1.5", "−2", "0", "–"), cells, strict=True)]
    columns = ("name", "distance [m]", "verdict")
    return blocks.Matrix(caption="How far each goes", columns=columns, rows=rows, folded=folded)


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
    reports = {f"study{k or ''}": one for k, one in enumerate((REPORT, *others))}
    last = blocks.Section("Reproduce", "reproduce", ("the command",))
    return to_html("Reports", reports, folder, [last], {path.name for path in folder.iterdir()})


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


def test_a_page_holds_what_it_is_given_escaped_without_script(tmp_path) -> None:
    figures.write_figure(LINE, tmp_path)
    (tmp_path / "a-run.replay.json").write_text(json.dumps(MOVING), encoding="utf-8")
    page = html(tmp_path)
    assert "<script>alert" not in page and "&lt;script&gt;alert(1)" in page
    evil = "<img src=x onerror=alert(1)> [x](javascript:alert(1)) ![y](https://elsewhere/y.png)"
    said = html(tmp_path, blocks.Report(title="b", headline="c", blocks=(evil,)))
    assert "<img src=x" not in said and 'href="javascript' not in said and 'src="https:' not in said


def test_a_page_of_several_reports_has_a_heading_for_each_and_a_failure_counts(tmp_path) -> None:
    said = html(tmp_path, blocks.Report(title="Good", headline="all hold", passed=True, blocks=()))
    assert "<h1>Reports</h1>" in said and "<title>FAIL: Reports</title>" in said
    assert ">FAIL: 1 of 2 parts</span>" in said
    for title in ("Study", "Good"):
        assert re.search(rf"<h2 [^>]*>{title}</h2>", said)
    assert "The figure “A line” is missing" in said and "The replay “A run” is missing" in said


@pytest.mark.parametrize("width", [80, 104, 300])
def test_a_table_that_is_too_wide_goes_on_below_with_nothing_lost_or_broken(width, monkeypatch):
    monkeypatch.setattr(terminal_module, "WIDTH", width)
    columns = ("Scenario", "Controller", "Outcome", *(f"B{k}" for k in range(8)))
    pairs = product(("step-step", "a-very-long-name-of-a-scenario"), ("adaptive", "lqr"))
    rest = ("fell at t = 1.26 s", *(f"{k}.0×10⁻¹²" for k in range(8)))
    wide = blocks.Matrix(caption="Wide", columns=columns, rows=[(*pair, *rest) for pair in pairs])
    text = to_text([wide])
    assert max(map(len, text.splitlines())) <= width
    assert all(column in text for column in columns)
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


@pytest.mark.parametrize(("write", "value", "text"), [
    *((scientific, *pair) for pair in [
        (5.84e-12, "5.8×10⁻¹²"), (-0.0, "0"), (None, "–"), (-1.1e-16, "−1.1×10⁻¹⁶"),
    ]),
    *((short, *pair) for pair in [
        (3.0, "3"), (-1.84265, "−1.843"), (9999.6, "10 000"), (0.00099, "9.9×10⁻⁴"),
    ]),
    *((limit, *pair) for pair in [
        (1e-9, "10⁻⁹"), (1e-11, "10⁻¹¹"), (0.0, "0"), (0.05, "0.05"), (2e-9, "2.0×10⁻⁹"),
    ]),
], ids=lambda x: getattr(x, "__name__", str(x)))  # fmt: skip
def test_numbers_have_few_digits_powers_of_ten_and_a_proper_minus(write, value, text) -> None:
    assert write(value) == text


def test_no_two_controllers_of_a_figure_share_a_colour() -> None:
    names = (*NAMES, "adaptive-estimated", "lqr-estimated", "mine.pd", *map(str, range(20)))
    found = figures.colours(names)
    assert list(found) == list(names)
    assert len({colour.lower() for colour in found.values()}) == len(names)
    assert {name: found[name] for name in figures.CONTROLLERS} == figures.CONTROLLERS


@pytest.mark.parametrize("suffix", ["svg", "png"])
@styled()
def test_the_same_figure_is_the_same_bytes_without_a_date_or_a_font(tmp_path, suffix: str) -> None:
    for name in ("one", "two"):
        figure = draw()
        figure.axes[0].set(xlabel="time t [s]", ylabel="z [m]")
        save_figure(figure, tmp_path / f"{name}.{suffix}")
    one, two = ((tmp_path / f"{name}.{suffix}").read_bytes() for name in ("one", "two"))
    assert one == two and len(list(tmp_path.iterdir())) == 2
    assert suffix == "png" or not re.search(rb"dc:date|<text|font-family", one)


def test_a_name_is_shown_as_it_is_and_not_read_as_a_formula(tmp_path) -> None:
    name = r"a$\frac$b"
    with styled():
        figure = new_figure(3.0, 2.0)
        axis = figure.subplots()
        axis.plot([name], [1e-3], label=name)
        figure.suptitle(name)
        axis.legend()
        axis.annotate(name, (0.0, 1e-3))
    save_figure(figure, tmp_path / "saved.png")
    figures.lay_out(figure)
    drawn = figure.findobj(lambda one: isinstance(one, Text) and one.get_text() == name)
    assert len(drawn) >= 4 and not any(text.get_parse_math() for text in drawn)
