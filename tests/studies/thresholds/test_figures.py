"""The figures of thresholds show what the result holds."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from afl_mujoco.report.old import figures_of
from afl_mujoco.studies.thresholds import classes, figures
from afl_mujoco.studies.thresholds.sections import sections
from tests import study_results

RESULT = study_results.thresholds()
NAMES = list(study_results.SWEEPS)
THRESHOLDS, COMBINED = figures_of(sections(RESULT))


def test_every_cell_has_the_text_and_the_colour_of_its_threshold() -> None:
    (axes,) = THRESHOLDS.draw().axes
    shown = np.asarray(axes.images[0].get_array())
    texts = {tuple(np.round(t.get_position()).astype(int)): t.get_text() for t in axes.texts}
    assert len(texts) == 2 * len(NAMES)
    delay, damping, rail = (NAMES.index(name) for name in ("delay", "rail-damping", "rail"))
    assert (texts[0, delay], texts[1, delay]) == ("47", "36")
    assert texts[0, NAMES.index("control-period")] == "> 50"
    assert (texts[0, damping], texts[1, damping]) == ("7.3 ~", "11")
    assert texts[1, rail] == "> 100"  # not even the longest rail is long enough
    for row, kind in ((delay, 3), (damping, 1), (rail, 0)):
        assert tuple(shown[row, 0]) == to_rgba(figures.COLOURS[kind])
    assert [label.get_text() for label in axes.get_xticklabels()] == ["adaptive", "lqr"]
    labels = [t.get_text() for t in axes.get_yticklabels()]
    assert "transport delay  (reference: 2 ms)" in labels
    assert "2 of 12 fail at the reference level" in THRESHOLDS.alt


def test_imperfections_are_added_from_left_to_right() -> None:
    shown = np.asarray(COMBINED.draw().axes[0].images[0].get_array())
    colours = [to_rgba(colour) for colour in figures.ENDINGS.values()]
    assert [tuple(shown[0, i]) for i in (7, 8, 10)] == colours
    assert "lqr: settles throughout" in COMBINED.alt
    assert "does not settle from rail damping on" in COMBINED.alt


@pytest.mark.parametrize(
    ("name", "controller", "times"),
    [
        ("delay", "adaptive", 0.99 * 23.5),  # what was seen to hold counts
        ("force-limit", "adaptive", 5.0 / 0.99),
        ("control-period", "adaptive", 25.0),
        ("rail", "lqr", 0.0),
    ],
)
def test_what_is_tolerated_is_in_times_the_reference(name, controller, times) -> None:
    one, sweep = RESULT.imperfection(name), RESULT.sweep(name, controller)
    assert classes.tolerated(one, sweep) == pytest.approx(times)
