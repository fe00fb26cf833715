"""The figures and the table of the ladder show what the ladder holds."""

from __future__ import annotations

from io import StringIO

import numpy as np
import pytest
import survival_case
from matplotlib.colors import to_rgba
from rich.console import Console

from afl_mujoco.reporting.survival.ladder import figures as ladder_figures
from afl_mujoco.reporting.survival.ladder import words
from afl_mujoco.reporting.survival.ladder.table import print_ladder
from afl_mujoco.reporting.survival.margins_figures import draw_margins

LADDER = survival_case.make_ladder()
NAMES = list(survival_case.RISES)


def test_every_cell_has_the_text_and_the_colour_of_its_threshold() -> None:
    drawn = ladder_figures.draw_thresholds(LADDER)
    (axes,) = drawn.figure.axes
    shown = np.asarray(axes.images[0].get_array())
    texts = {tuple(np.round(t.get_position()).astype(int)): t.get_text() for t in axes.texts}
    assert len(texts) == 2 * len(NAMES)
    delay, damping, rail = (NAMES.index(name) for name in ("delay", "rail-damping", "rail"))
    assert (texts[0, delay], texts[1, delay]) == ("47", "36")
    assert texts[0, NAMES.index("control-period")] == "> 50"
    assert (texts[0, damping], texts[1, damping]) == ("7.3 ~", "11")
    assert texts[1, rail] == "> 100"  # not even the longest rail is long enough
    for row, kind in ((delay, 3), (damping, 1), (rail, 0)):
        assert tuple(shown[row, 0]) == to_rgba(ladder_figures.COLOURS[kind])
    assert [label.get_text() for label in axes.get_xticklabels()] == ["adaptive", "lqr"]
    assert "transport delay  (rig: 2 ms)" in [t.get_text() for t in axes.get_yticklabels()]
    assert "2 of 12 fail at the level of a typical rig" in drawn.alt


def test_what_adds_up_to_a_rig_is_told_from_left_to_right() -> None:
    drawn = ladder_figures.draw_together(LADDER)
    shown = np.asarray(drawn.figure.axes[0].images[0].get_array())
    colours = [to_rgba(colour) for colour in ladder_figures.WENT.values()]
    assert [tuple(shown[0, i]) for i in (7, 8, 10)] == colours
    assert "lqr: settles throughout" in drawn.alt
    assert "does not settle from rail damping on" in drawn.alt


@pytest.mark.parametrize(
    ("rung", "controller", "times"),
    [
        ("delay", "adaptive", 0.99 * 23.5),  # what was seen to hold counts
        ("force-limit", "adaptive", 5.0 / 0.99),
        ("control-period", "adaptive", 25.0),
        ("rail", "lqr", 0.0),
    ],
)
def test_what_is_borne_is_in_sizes_of_a_typical_rig(rung, controller, times) -> None:
    data = next(r for r in LADDER["rungs"] if r["name"] == rung)
    rise = words.rise_of(LADDER, rung, controller)
    assert words.borne(data, rise) == pytest.approx(times)


def test_the_table_has_a_row_for_each_rung() -> None:
    text = StringIO()
    print_ladder(LADDER, Console(file=text, width=120))
    rows = [" ".join(line.split()) for line in text.getvalue().splitlines()]
    assert "transport delay 2 ms 47 36" in rows
    assert "rail damping 5 N s/m ~ 7.3 11" in rows
    assert "rail to either side 1 m 3.7 > 100" in rows


def test_margins_are_drawn_over_the_plants_and_unstable_ones_left_out() -> None:
    content = survival_case.make_margins()
    delay, measured = draw_margins(content)
    panel = delay.figure.axes[0]
    values = panel.collections[0].get_array()
    assert values.shape == (3, 2)  # lengths, masses
    assert np.ma.getmaskarray(values).sum() == 1
    assert values[1, 0] == pytest.approx(30.0)
    assert "adaptive 12 ms" in delay.alt
    assert "1 comparisons on 1 plants; the largest difference is 0.5 %" in measured.alt
    nothing = {**content, "measured": []}
    assert [drawn.name for drawn in draw_margins(nothing)] == ["margins-delay"]
