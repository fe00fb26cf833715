"""Figures are written whole, in one style, and are the same bytes each time."""

from __future__ import annotations

import itertools
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from afl_mujoco.control.names import NAMES
from afl_mujoco.errors import FileError, InvalidValueError
from afl_mujoco.report.style import (
    CONTROLLERS,
    colours,
    decade_above,
    in_words,
    lay_out,
    new_figure,
    quietest_on_top,
    save_figure,
    styled,
)


@styled()
def a_figure() -> Figure:
    figure = new_figure(3.0, 2.0)
    axis = figure.subplots()
    axis.semilogy([0.0, 1.0], [1e-3, 1.0])
    axis.set(xlabel="time t [s]", ylabel="z [m]")
    axis.axhline(0.1, color="black")
    return figure


def test_no_two_controllers_of_a_figure_share_a_colour() -> None:
    names = (*NAMES, "adaptive-estimated", "lqr-estimated", "mine.pd", *map(str, range(20)))
    found = colours(names)
    assert list(found) == list(names)
    assert len({colour.lower() for colour in found.values()}) == len(names)
    assert {name: found[name] for name in CONTROLLERS} == CONTROLLERS


@pytest.mark.parametrize("suffix", ["svg", "png"])
def test_the_same_figure_is_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    for name in ("one", "two"):
        save_figure(a_figure(), tmp_path / f"{name}.{suffix}")
    one, two = ((tmp_path / f"{name}.{suffix}").read_bytes() for name in ("one", "two"))
    assert one == two
    assert len(list(tmp_path.iterdir())) == 2


def test_an_svg_has_no_date_and_needs_no_font(tmp_path: Path) -> None:
    save_figure(a_figure(), tmp_path / "figure.svg")
    text = (tmp_path / "figure.svg").read_text(encoding="utf-8")
    assert "dc:date" not in text
    assert "<text" not in text
    assert "font-family" not in text


def test_a_dated_svg_would_differ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    with styled():
        a_figure().savefig(tmp_path / "figure.svg")
    assert "dc:date" in (tmp_path / "figure.svg").read_text(encoding="utf-8")


def test_a_figure_laid_out_is_as_one_laid_out_when_saved(tmp_path: Path) -> None:
    laid = a_figure()
    lay_out(laid)
    lay_out(laid)
    assert laid.get_layout_engine() is None
    place = laid.axes[0].get_position()
    save_figure(laid, tmp_path / "laid.png")
    other = a_figure()
    save_figure(other, tmp_path / "other.png")
    assert laid.axes[0].get_position().bounds == place.bounds
    assert other.axes[0].get_position().bounds == pytest.approx(place.bounds, abs=0.01)


def test_another_suffix_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match=r"suffix of a figure must be \.png or \.svg"):
        save_figure(a_figure(), tmp_path / "figure.pdf")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_an_error_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        save_figure(a_figure(), tmp_path / "nowhere" / "figure.svg")


def test_the_style_is_left_behind() -> None:
    before = matplotlib.rcParams["svg.hashsalt"]
    a_figure()
    assert matplotlib.rcParams["svg.hashsalt"] == before


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.0, "0"),
        (0.0348, "0.0348"),
        (-2.59e-10, "−2.6 × 10⁻¹⁰"),
        (999.9, "1.0 × 10³"),
        (-12.3456, "−12.3"),
    ],
)
def test_numbers_are_said_as_in_print(value: float, words: str) -> None:
    assert in_words(value) == words


def test_an_axis_ends_at_the_decade_above() -> None:
    assert [decade_above(x) for x in (0.5, 1.0, 1.1, 3e-7)] == pytest.approx([1.0, 1.0, 10.0, 1e-6])


AWKWARD = r"a$\frac$b"
"""A name that matplotlib would read as a broken formula."""


@pytest.mark.parametrize("place", ["title", "legend", "ticks", "categories", "note"])
def test_a_name_is_shown_as_it_is_and_not_read_as_a_formula(tmp_path: Path, place: str) -> None:
    with styled():
        figure = new_figure(3.0, 2.0)
        axis = figure.subplots()
        axis.semilogy([AWKWARD] if place == "categories" else [0.0], [1e-3], label=AWKWARD)
        if place == "title":
            figure.suptitle(AWKWARD)
        if place == "legend":
            axis.legend()
        if place == "ticks":
            axis.set_xticks([0.0], [AWKWARD])
        if place == "note":
            axis.annotate(AWKWARD, (0.0, 1e-3))
    save_figure(figure, tmp_path / "saved.png")
    lay_out(figure)
    drawn = figure.findobj(lambda one: isinstance(one, Text) and one.get_text() == AWKWARD)
    assert drawn
    assert not any(text.get_parse_math() for text in drawn)
    assert "10⁻³" in [text.get_text() for text in axis.get_yticklabels()]


def test_a_logarithmic_axis_of_less_than_a_decade_has_labels_between_the_powers() -> None:
    with styled():
        figure = new_figure(3.0, 2.0)
        axis = figure.subplots()
        axis.semilogy([0.0, 1.0], [1.5e-3, 4.5e-3])
        figure.draw_without_rendering()
    shown = [text.get_text() for text in axis.yaxis.get_minorticklabels()]
    assert {"2 × 10⁻³", "3 × 10⁻³", "4 × 10⁻³"} <= set(shown)


def test_long_labels_of_ticks_do_not_touch() -> None:
    with styled():
        figure = new_figure(3.0, 2.0)
        axes = figure.subplots()
        axes.plot([-0.00045, 0.0], [0.0, 1.0])
    before = [text.get_text() for text in axes.get_xticklabels()]
    lay_out(figure)
    shown = [text for text in axes.get_xticklabels() if text.get_text()]
    boxes = [text.get_window_extent() for text in shown]
    assert 2 <= len(shown) < len(before)
    assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))


def test_a_curve_that_chatters_lies_under_the_others() -> None:
    noisy, calm = np.array([1.0, -1.0, 1.0, np.nan]), np.array([5.0, 4.0, 3.0, 2.0])
    layer = quietest_on_top({"noisy": noisy, "calm": calm})
    assert 2.0 <= layer["noisy"] < layer["calm"] < 2.5  # between grid and limits
