"""What the report says of margins is what the result holds."""

from __future__ import annotations

from dataclasses import fields, replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from afl_mujoco.report.old import Finding, Text, figures_of
from afl_mujoco.report.terminal import print_sections
from afl_mujoco.studies.margins.figures import draw_delay_margins
from afl_mujoco.studies.margins.sections import sections
from afl_mujoco.studies.margins.small_motions import SmallMotions
from tests import study_results

RESULT = study_results.margins()


def over_plants(masses: int, lengths: int):
    """Return the result on its last masses and lengths only, without measured delays."""
    margins = {}
    for name, both in RESULT.margins.items():
        loops = {}
        for kind in ("continuous", "sampled"):
            grid = getattr(both, kind)
            cut = {
                field.name: tuple(row[-lengths:] for row in getattr(grid, field.name)[-masses:])
                for field in fields(grid)
            }
            loops[kind] = replace(grid, **cut)
        margins[name] = replace(both, **loops)
    return replace(
        RESULT,
        cart_masses=RESULT.cart_masses[-masses:],
        half_lengths=RESULT.half_lengths[-lengths:],
        margins=margins,
        measured=(),
    )


def printed(result) -> list[list[str]]:
    stream = StringIO()
    print_sections(sections(result), Path("out"), Console(file=stream, width=160))
    return [line.split() for line in stream.getvalue().splitlines()]


def test_each_loop_has_its_own_count_of_unstable_plants() -> None:
    rows = printed(RESULT)
    first = next(row for row in rows if row[:2] == ["adaptive", "continuous"])
    second = next(row for row in rows if row[:2] == ["held", "1"])
    assert first[2] == "0"
    assert second[3:5] == ["✗", "1"]


def test_the_worst_margin_is_of_stable_plants_and_what_is_infinite_is_shown() -> None:
    row = next(row for row in printed(RESULT) if row[:2] == ["held", "1"])
    assert row[5:10] == ["0.60", "16.6", "0.4", "0.40", "12.00"]
    assert row[10:] == ["0.1", "kg,", "0.05", "m"]
    infinite = study_results.margins(gain_increase=None)
    assert next(row for row in printed(infinite) if row[:1] == ["held"])[6] == "∞"


def test_the_finding_says_where_the_loop_is_unstable() -> None:
    (section,) = sections(RESULT)
    (finding,) = (block for block in section.blocks if isinstance(block, Finding))
    assert "adaptive is unstable on 1 of 6 plants; lqr is unstable on 1" in finding.text


def test_measured_delays_are_compared_where_both_exist() -> None:
    (section,) = sections(RESULT)
    (said,) = (block.text for block in section.blocks if isinstance(block, Text))
    assert "A margin and a measured delay exist for 1 of 2 plants and controllers" in said
    assert "at most 0.5 %" in said and "1 agree within 5 %" in said
    _, measured = figures_of([section])
    assert "1 comparisons on 1 plants; the largest difference is 0.5 %" in measured.alt
    assert measured.draw().axes
    (alone,) = sections(replace(RESULT, measured=()))
    assert [figure.name for figure in figures_of([alone])] == ["margins-delay"]


def test_margins_are_drawn_over_the_plants_and_unstable_ones_left_out() -> None:
    delay, _ = figures_of(sections(RESULT))
    values = delay.draw().axes[0].collections[0].get_array()
    assert values.shape == (3, 2)  # lengths, masses
    assert np.ma.getmaskarray(values).sum() == 1
    assert values[1, 0] == pytest.approx(30.0)
    assert "adaptive 12 ms" in delay.alt


def test_an_infinite_margin_is_not_drawn_as_an_unstable_plant() -> None:
    held = RESULT.grid("adaptive", sampled=True)
    endless = replace(held, delay=((None, 0.03, 0.1), held.delay[1]))
    both = replace(RESULT.margins["adaptive"], sampled=endless)
    drawn = draw_delay_margins(replace(RESULT, margins={"adaptive": both}))
    values = drawn.axes[0].collections[0].get_array()
    assert np.ma.getmaskarray(values).sum() == 1  # the unstable plant
    assert values[0, 0] == values.max()


@pytest.mark.parametrize(("masses", "lengths"), [(2, 1), (1, 3)])
def test_margins_over_m_or_l_alone_are_lines_with_crosses_where_unstable(
    masses: int, lengths: int
) -> None:
    result = over_plants(masses, lengths)
    (delay,) = figures_of(sections(result))
    axes = delay.draw().axes[0]
    grid = result.grid("adaptive", sampled=True)
    margins = [x for row in grid.delay for x in row]
    assert axes.get_xlabel()[:4] == ("cart" if masses > 1 else "half")
    line, crosses = axes.lines[:2]
    np.testing.assert_array_equal(
        line.get_ydata(), [np.nan if x is None else 1e3 * x for x in margins]
    )
    assert line.get_marker() == "o"
    assert len(crosses.get_xdata()) == margins.count(None) == 1
    assert "Crosses at 0: unstable" in delay.caption and "Red" not in delay.caption


def test_margins_of_one_plant_are_in_the_table_alone() -> None:
    assert list(figures_of(sections(over_plants(1, 1)))) == []


def test_what_is_measured_by_small_motions_has_its_worst_plant_and_its_reason() -> None:
    def motion(name: str, decays: bool = True, **found: float | None) -> SmallMotions:
        return SmallMotions(controller=name, cart_mass=1.0, half_length=0.5, decays=decays, **found)

    result = replace(
        RESULT,
        margins={},
        measured=(),
        not_linear={"mine": "has a memory", "wild": "must be smooth", "biased": "pushes"},
        small_motions=(
            motion("mine", gain_decrease=0.25, gain_increase=8.0, delay=0.02),
            motion("mine", gain_decrease=0.5, gain_increase=None, delay=0.0),
            motion("wild", decays=False),
            motion("wild", gain_decrease=None, gain_increase=None, delay=None),
        ),
    )
    rows = {row[0]: row[1:] for row in printed(result) if row and row[0] in result.not_linear}
    assert rows["mine"][:9] == ["0", "of", "2", "0.50", "8.0", "<", "0.1", "has", "a"]
    assert rows["wild"][:10] == ["✗", "1", "of", "2", "<", "0.01", ">", "100", ">", "1000"]
    assert rows["biased"] == ["–"] * 4 + ["pushes"]
    (section,) = sections(result)
    (finding,) = (block for block in section.blocks if isinstance(block, Finding))
    assert "those of wild do not decay on 1 of 2 plants; none for biased" in finding.text
    assert list(figures_of([section])) == []
