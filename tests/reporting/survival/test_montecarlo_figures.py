"""The figures and the tables of a campaign show what the campaign holds."""

from __future__ import annotations

from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from afl_mujoco.reporting.survival.montecarlo_figures import (
    BINS,
    PANELS,
    colours_of,
    draw_failures,
    draw_montecarlo,
)
from afl_mujoco.reporting.survival.montecarlo_table import print_montecarlo
from afl_mujoco.validation.montecarlo.campaign import Campaign
from afl_mujoco.validation.montecarlo.rates import Rate
from afl_mujoco.validation.montecarlo.space import SampleSpace, sample_scenario
from afl_mujoco.validation.montecarlo.traits import TRAITS, most_telling, traits_of
from afl_mujoco.validation.montecarlo.trial import LAW_FAILED, Settings, Trial
from afl_mujoco.validation.montecarlo.worst_case import NEAREST, Found

SPACE, SAMPLES = SampleSpace(), 60
UP = Trial(outcome="completed", end_time=20.0, settling_time=9.0, peak_z=1.234)
DOWN = Trial(outcome="fell", end_time=2.5)
BROKEN = Trial(outcome=LAW_FAILED, message="controller [x] raised")


def campaign(**trials: list[Trial]) -> Campaign:
    return Campaign(space=SPACE, seed=1, settings=Settings(), trials=trials)


@pytest.fixture(scope="module")
def rubbed() -> Campaign:
    """One law that falls where dry friction is above 0.7 N, one that never does."""
    rigs = [sample_scenario(SPACE, i, 1) for i in range(SAMPLES)]
    stuck = [DOWN if rig.realism.rail_friction > 0.7 else UP for rig in rigs]
    return campaign(adaptive=stuck, lqr=[UP] * SAMPLES)


def test_what_makes_a_law_fail_is_the_first_trait_named(rubbed: Campaign) -> None:
    failed = [np.array([t is DOWN for t in found]) for found in rubbed.trials.values()]
    assert most_telling(traits_of(rubbed), failed, 3)[0] == "dry friction [N]"
    assert most_telling(traits_of(rubbed), failed[1:], 2) == list(TRAITS)[:2]  # nobody to ask


def test_the_bins_hold_the_failures_of_their_rigs(rubbed: Campaign) -> None:
    drawn = draw_failures(rubbed)
    panels = drawn.figure.axes
    assert len(panels) == PANELS
    assert panels[0].get_xlabel() == "dry friction [N]"
    line = panels[0].containers[0].lines[0]
    x, y = line.get_data()
    values = traits_of(rubbed)["dry friction [N]"]
    bins = np.array_split(np.argsort(values), BINS)
    expected = [100.0 * np.mean(values[part] > 0.7) for part in bins]
    assert y == pytest.approx(expected)
    assert y[0] == 0.0
    assert y[-1] == 100.0
    assert (np.diff(x) > 0.0).all()
    low, high = 100.0 * np.array(Rate(0, SAMPLES // BINS).interval)
    bars = panels[0].containers[0].lines[2][0].get_segments()
    assert bars[0][:, 1] == pytest.approx([low, high])
    failed = sum(t is DOWN for t in rubbed.trials["adaptive"])
    assert f"adaptive {failed}, lqr 0, of 60" in drawn.alt


def test_the_rates_are_drawn_with_their_intervals(rubbed: Campaign) -> None:
    drawn = draw_montecarlo(rubbed)
    assert [one.name for one in drawn] == ["montecarlo-rates", "montecarlo-failures"]
    (axis,) = drawn[0].figure.axes
    rate = rubbed.survival("adaptive")
    bar, point = axis.lines[0].get_xdata(), axis.lines[1].get_xdata()
    assert bar == pytest.approx([100.0 * x for x in rate.interval])
    assert list(point) == pytest.approx([100.0 * rate.share])
    assert f"adaptive stays up on {100.0 * rate.share:.1f} %" in drawn[0].alt
    assert [text.get_text() for text in axis.get_yticklabels()] == ["adaptive", "lqr"]


def test_nothing_is_said_of_failures_where_there_are_none() -> None:
    assert [one.name for one in draw_montecarlo(campaign(lqr=[UP] * 3))] == ["montecarlo-rates"]
    assert len(draw_montecarlo(campaign(lqr=[DOWN]))) == 2


def test_every_controller_has_its_own_colour() -> None:
    names = ["adaptive", "fixed", "lqr", "pole-placement", "partial-linearization", "mine.law"]
    assert len(set(colours_of(names).values())) == len(names)


def printed(found: Campaign, worst: list[Found]) -> str:
    stream = StringIO()
    print_montecarlo(found, worst, Console(file=stream, width=140))
    return stream.getvalue()


def test_the_tables_say_rates_pairs_and_worst_cases(rubbed: Campaign) -> None:
    nearest = Found(
        question=NEAREST, controller="adaptive", scenario=sample_scenario(SPACE, 0, 1),
        trial=DOWN, distance=0.123, runs=77, changes={"rail_friction": 0.4, "z": -0.01},
    )  # fmt: skip
    text = printed(rubbed, [nearest])
    failed = sum(t is DOWN for t in rubbed.trials["adaptive"])
    rows = [line.split() for line in text.splitlines()]
    share = f"{100 * (1 - failed / 60):.1f}"
    assert ["adaptive", share, "%"] in [row[:3] for row in rows]
    assert ["0", "1.23", "m"] in [row[-3:] for row in rows]
    assert ["adaptive", "lqr", str(60 - failed), "0", str(failed), "0"] in [row[:6] for row in rows]
    assert "nearest failure   fell at 2.50 s" in text
    assert "rail_friction +0.40, z -0.01" in text


def test_what_a_broken_law_said_is_printed() -> None:
    text = printed(campaign(mine=[UP, BROKEN]), [])
    assert "mine: law failed on sample 1: controller [x] raised" in text
    assert "McNemar" not in text  # there is nobody to compare with
