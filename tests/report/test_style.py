import re

import pytest
from matplotlib.text import Text

from afl_mujoco.control.names import NAMES
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.report.style import CONTROLLERS, colours, lay_out, new_figure, save_figure, styled


@styled()
def a_figure():
    figure = new_figure(3.0, 2.0)
    axis = figure.subplots()
    axis.semilogy([0.0, 1.0], [1e-3, 1.0])
    axis.set(xlabel="time t [s]", ylabel="z [m]")
    return figure


def test_no_two_controllers_of_a_figure_share_a_colour() -> None:
    names = (*NAMES, "adaptive-estimated", "lqr-estimated", "mine.pd", *map(str, range(20)))
    found = colours(names)
    assert list(found) == list(names)
    assert len({colour.lower() for colour in found.values()}) == len(names)
    assert {name: found[name] for name in CONTROLLERS} == CONTROLLERS


@pytest.mark.parametrize("suffix", ["svg", "png"])
def test_the_same_figure_is_the_same_bytes_without_a_date_or_a_font(tmp_path, suffix: str) -> None:
    for name in ("one", "two"):
        save_figure(a_figure(), tmp_path / f"{name}.{suffix}")
    one, two = ((tmp_path / f"{name}.{suffix}").read_bytes() for name in ("one", "two"))
    assert one == two and len(list(tmp_path.iterdir())) == 2
    assert suffix == "png" or not re.search(rb"dc:date|<text|font-family", one)


def test_another_suffix_is_refused_by_name(tmp_path) -> None:
    with pytest.raises(InvalidValueError, match=r"suffix of a figure must be \.png or \.svg"):
        save_figure(a_figure(), tmp_path / "figure.pdf")
    assert list(tmp_path.iterdir()) == []


AWKWARD = r"a$\frac$b"
"""A name that matplotlib would read as a broken formula."""


@pytest.mark.parametrize("place", ["title", "legend", "ticks", "categories", "note"])
def test_a_name_is_shown_as_it_is_and_not_read_as_a_formula(tmp_path, place: str) -> None:
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
    assert drawn and not any(text.get_parse_math() for text in drawn)
    assert "10⁻³" in [text.get_text() for text in axis.get_yticklabels()]
