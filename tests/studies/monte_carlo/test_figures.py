"""The figures and the tables of a campaign show what the campaign holds."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from afl_mujoco.report.old import Figure, Text, figures_of
from afl_mujoco.report.markdown import to_markdown
from afl_mujoco.report.terminal import print_sections
from afl_mujoco.scenario.laboratory import LABORATORY
from afl_mujoco.scenario.ranges import Ranges
from afl_mujoco.scenario.sample_space import SampleSpace, sample_point, sample_scenario
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED, Judgement
from afl_mujoco.studies.monte_carlo.campaign import Campaign
from afl_mujoco.studies.monte_carlo.features import FEATURES, features_of, most_separating
from afl_mujoco.studies.monte_carlo.figures import BINS, PANELS
from afl_mujoco.studies.monte_carlo.rates import Rate
from afl_mujoco.studies.monte_carlo.result import result_of
from afl_mujoco.studies.monte_carlo.sections import sections
from afl_mujoco.studies.monte_carlo.trial import Settings, Trial
from afl_mujoco.studies.monte_carlo.worst_case import NEAREST, Found
from tests import study_results

SPACE, SAMPLES = SampleSpace(LABORATORY), 60
UP = Trial(outcome="completed", end_time=20.0, settling_time=9.0, peak_z=1.234)
FALL = Judgement(requirement="completes", limit=20.0, value=2.5, left=-17.5)
DOWN = Trial(outcome="fell", end_time=2.5, requirements=(FALL,))
BROKEN = Trial(outcome=CONTROLLER_FAILED, message="controller [x] raised")


def campaign(**trials: list[Trial]) -> Campaign:
    return Campaign(space=SPACE, seed=1, settings=Settings(), trials=trials)


@pytest.fixture(scope="module")
def rubbed() -> Campaign:
    """One controller that falls where dry friction is above 0.7 N, one that never does."""
    scenarios = [sample_scenario(SPACE, i, 1) for i in range(SAMPLES)]
    stuck = [DOWN if scenario.imperfections.rail_friction > 0.7 else UP for scenario in scenarios]
    return campaign(adaptive=stuck, lqr=[UP] * SAMPLES)


def figures(found: Campaign) -> dict[str, Figure]:
    return {one.name: one for one in figures_of(sections(result_of(found, [])))}


def test_what_makes_a_controller_fail_is_the_first_feature_named(rubbed: Campaign) -> None:
    failed = [np.array([t is DOWN for t in found]) for found in rubbed.trials.values()]
    assert most_separating(features_of(SPACE, SAMPLES, 1), failed, 3)[0] == "dry friction [N]"
    assert (
        most_separating(features_of(SPACE, SAMPLES, 1), failed[1:], 2) == list(FEATURES)[:2]
    )  # nobody to ask


def test_the_bins_hold_the_failures_of_their_samples(rubbed: Campaign) -> None:
    drawn = figures(rubbed)["montecarlo-failures"]
    panels = drawn.draw().axes
    assert len(panels) == PANELS
    assert panels[0].get_xlabel() == "dry friction [N]"
    line = panels[0].containers[0].lines[0]
    x, y = line.get_data()
    values = features_of(SPACE, SAMPLES, 1)["dry friction [N]"]
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
    drawn = figures(rubbed)
    assert list(drawn) == ["montecarlo-rates", "montecarlo-failures"]
    (axis,) = drawn["montecarlo-rates"].draw().axes
    rate = rubbed.success("adaptive")
    bar, point = axis.lines[0].get_xdata(), axis.lines[1].get_xdata()
    assert bar == pytest.approx([100.0 * x for x in rate.interval])
    assert list(point) == pytest.approx([100.0 * rate.share])
    assert f"adaptive survives {100.0 * rate.share:.1f} %" in drawn["montecarlo-rates"].alt
    assert [text.get_text() for text in axis.get_yticklabels()] == ["adaptive", "lqr"]


def test_nothing_is_said_of_failures_where_there_are_none() -> None:
    assert list(figures(campaign(lqr=[UP] * 3))) == ["montecarlo-rates"]
    assert len(figures(campaign(lqr=[DOWN, UP]))) == 2
    assert len(figures(campaign(lqr=[DOWN]))) == 1  # of one sample there is nothing to compare


def test_of_features_that_order_the_samples_alike_the_simplest_is_kept() -> None:
    drawn = {"rail_damping": (0.0, 10.0), "z": (-0.1, 0.1)}
    for changes, kept in (({}, False), ({"cart_mass": (0.5, 2.0)}, True)):
        space = SampleSpace(replace(LABORATORY, ranges=Ranges(varied=drawn | changes)))
        found = features_of(space, 20, 1)
        assert ("rail damping / least cart mass [1/s]" in found) == kept
        assert any("rail" in name and "/ least" not in name for name in found)


def printed(found: Campaign, worst: list[Found]) -> str:
    stream = StringIO()
    result = result_of(found, worst, asked={"adaptive": "my:controller"})
    print_sections(sections(result), Path("out"), Console(file=stream, width=170))
    return stream.getvalue()


def test_the_tables_say_rates_pairs_and_worst_cases(rubbed: Campaign) -> None:
    nearest = Found(
        question=NEAREST, controller="adaptive", point=sample_point(SPACE, 0, 1), noise=0,
        trial=DOWN, distance=0.123, runs=77, changes={"rail_friction": 0.4, "z": -0.01},
    )  # fmt: skip
    text = printed(rubbed, [nearest])
    failed = sum(t is DOWN for t in rubbed.trials["adaptive"])
    rows = [line.split() for line in text.splitlines()]
    share = f"{float(f'{100.0 * (1.0 - failed / 60):.3g}'):g}"
    assert ["adaptive", share, "%"] in [row[:3] for row in rows]
    assert ["0", "1.23"] in [row[-2:] for row in rows]
    assert ["adaptive", "lqr", str(60 - failed), "0", str(failed), "0"] in [row[:6] for row in rows]
    assert "nearest failure   ✗ fell at 2.50 s" in text
    assert "rail_friction 0.40, z −0.01" in text
    replay = "afl-mujoco simulate out/montecarlo/adaptive/failure-"
    (line,) = (line for line in text.splitlines() if replay in line)
    assert line.endswith(".toml --controller my:controller")


def test_a_worst_case_is_measured_from_the_initial_m_and_l_only_where_they_are_drawn() -> None:
    for names, said in (
        (("cart_mass", "half_length", "z"), "itself with the initial M and l, 1 is"),
        (("half_length", "z"), "itself with the initial l, 1 is"),
        (("z",), "itself, 1 is"),
    ):
        drawn = {name: LABORATORY.ranges.varied[name] for name in names}
        space = SampleSpace(replace(LABORATORY, ranges=Ranges(varied=drawn)))
        found = Found(
            question=NEAREST, controller="lqr", point=space.reference, noise=0, trial=DOWN,
            distance=0.1, runs=7, changes={},
        )  # fmt: skip
        some = Campaign(space=space, seed=1, settings=Settings(), trials={"lqr": [DOWN]})
        text = to_markdown(sections(result_of(some, [found])))
        assert said in text
        assert ("“level 2”" in text) == (len(names) > 1)


def test_the_findings_say_rates_with_intervals_and_the_comparison(rubbed: Campaign) -> None:
    failed = sum(t is DOWN for t in rubbed.trials["adaptive"])
    text = " ".join(printed(rubbed, []).split())
    said = "On 60 random samples on a rail without end stops, with exact 95 % intervals: adaptive "
    assert said + "survives" in text and "; lqr survives 100 %" in text
    assert (
        "The adaptive controller passes 0 samples on which LQR fails, LQR "
        f"{failed} on which adaptive does (McNemar" in text
    )


def test_what_a_broken_controller_said_is_printed() -> None:
    text = printed(campaign(mine=[UP, BROKEN]), [])
    assert "mine: controller failed on sample 1: controller [x] raised" in text
    assert "McNemar" not in text  # there is nobody to compare with


def test_a_range_that_reaches_another_unit_is_remarked_on() -> None:
    result = study_results.monte_carlo()

    def said(**varied: tuple[float, float]) -> list[str]:
        scenario = replace(LABORATORY, ranges=Ranges(varied=varied))
        (section,) = sections(replace(result, space=SampleSpace(scenario), worst_cases=()))
        texts = (block.text for block in section.blocks if isinstance(block, Text))
        return [text for text in texts if text.startswith("Where everything that varies")]

    assert said(delay=(0.0, 5e-3)) == []
    (remark,) = said(delay=(0.0, 10.0))
    assert remark.endswith("it is given in seconds, not in ms or Hz.")
    (remark,) = said(half_length=(0.3, 600.0))
    assert "l reaches 600 m" in remark
