"""Figures draw what they say, for the data that there are."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from mpl_toolkits.mplot3d import Axes3D

import afl_mujoco as afl
from afl_mujoco.report.old import Figure, figures_of
from afl_mujoco.report.style import styled
from afl_mujoco.studies.record import save_record
from afl_mujoco.studies.verification.curves import Curves
from afl_mujoco.studies.verification.figures.claims import claims_figure
from afl_mujoco.studies.verification.figures.errors import BINS, difference, envelope
from afl_mujoco.studies.verification.figures.responses import impulse_figure
from afl_mujoco.studies.verification.result import Result
from afl_mujoco.studies.verification.sections import sections
from tests.study_results import record
from tests.verification_result import OWN, make_claim, make_curves, make_result

PUBLISHED = [afl.SCENARIOS[name] for name in ("step-step", "trapezoid-step", "step-step-impulse")]
EVERY = [
    "report-errors", "report-schedules", "report-impulse", "report-response-step-step",
    "report-response-trapezoid-step", "report-budget", "report-orders", "report-energy",
    "report-claims",
]  # fmt: skip


def figures(result: Result) -> dict[str, Figure]:
    """Return the figures of a verification by name."""
    return {figure.name: figure for figure in figures_of(sections(result))}


@pytest.fixture(scope="module")
def result() -> Result:
    return make_result(PUBLISHED)


@pytest.fixture(scope="module")
def found(result: Result) -> dict[str, Figure]:
    return figures(result)


@pytest.fixture(scope="module")
def drawn(found: Mapping[str, Figure]) -> dict[str, Drawing]:
    with styled():
        return {name: figure.draw() for name, figure in found.items()}


def test_every_figure_stands_in_the_order_of_reading(found: dict[str, Figure]) -> None:
    assert list(found) == EVERY


def test_every_figure_says_what_it_is_and_what_one_sees(found: dict[str, Figure]) -> None:
    for one in found.values():
        assert one.title
        assert one.caption.endswith(".")
        assert re.search(r"\d", one.alt)
        assert "nan" not in one.alt + one.caption
    fig7 = found["report-response-step-step"]
    assert fig7.caption.startswith("Analogue of the paper's Fig. 7: M and l change by steps.")
    assert fig7.title == "step-step"
    assert "differ from the solid ones by at most 1.0 × 10⁻² in any state" in fig7.alt
    claims = found["report-claims"].alt
    assert "C3 (improvement of the objective (O1) [%]): paper 38, here 15.4." in claims


def labels_of(axis: Axes, which: str) -> list[str]:
    """Labels of an axis and of those that share it."""
    shared = getattr(axis, f"get_shared_{which}_axes")().get_siblings(axis)
    return [getattr(one, f"get_{which}label")() for one in shared]


def is_categorical(axis: Axes, which: str) -> bool:
    ticks = getattr(axis, f"get_{which}ticklabels")()
    return all(re.search("[a-z]{2}", tick.get_text()) for tick in ticks if tick.get_text())


def test_every_axis_has_its_unit(drawn: dict[str, Drawing]) -> None:
    for name, one in drawn.items():
        for axis in one.axes:
            if isinstance(axis, Axes3D):
                assert all("[" in text for text in (axis.get_title(), *labels_of(axis, "x")))
            elif axis.axison:
                for which in "xy":
                    unit = any("[" in label for label in labels_of(axis, which))
                    assert unit or is_categorical(axis, which), (name, which, axis.get_title())


def test_no_panel_is_empty(drawn: dict[str, Drawing]) -> None:
    for name, one in drawn.items():
        for axis in one.axes:
            assert axis.lines or axis.collections or axis.patches, name


def test_a_response_draws_mujoco_solid_and_the_ode_dashed_over_it(
    drawn: dict[str, Drawing], result: Result
) -> None:
    angle = drawn["report-response-step-step"].axes[4]
    assert angle.get_ylabel() == "φ [rad]"
    styles = [line.is_dashed() for line in angle.lines]
    assert styles == [False, False, True, True]
    curves = result.curves_of("step-step")
    for line, one, run in zip(
        angle.lines, curves * 2, ["mujoco sampled"] * 2 + ["ode"] * 2, strict=True
    ):
        shown = len(line.get_xdata())
        np.testing.assert_array_equal(line.get_ydata(), one.states[run][:shown, 1])


def test_the_impulse_is_drawn_for_disturbed_scenarios_alone(
    drawn: dict[str, Drawing], found: dict[str, Figure]
) -> None:
    axes = drawn["report-impulse"].axes
    assert [axis.get_title() for axis in axes if axis.get_title()] == ["step-step-impulse"]
    caption = found["report-impulse"].caption
    assert "Fig. 11: step-step-impulse, disturbed by a force of -10 N on the cart" in caption


@pytest.fixture(scope="module")
def curves(result: Result) -> list[Curves]:
    return list(result.curves.values())


def test_the_envelope_keeps_the_largest_value_and_few_points(curves: list[Curves]) -> None:
    time, values = difference(curves[0], "mujoco exact")
    thinned = envelope(time, values)
    assert thinned[1].max() == values.max()
    assert np.all(np.diff(thinned[0]) > 0.0)
    assert len(thinned[0]) <= BINS
    assert set(thinned[1].tolist()) <= set(values.tolist())


def test_the_errors_are_drawn_up_to_the_largest(
    drawn: dict[str, Drawing], curves: list[Curves]
) -> None:
    first = drawn["report-errors"].axes[0]
    for line, mode in zip(
        first.lines, ("mujoco sampled", "mujoco continuous", "mujoco exact"), strict=False
    ):
        assert max(line.get_ydata()) == difference(curves[0], mode)[1].max()
    limits = {text.get_text() for text in first.texts}
    assert limits == {"B1", "B2"}


def test_the_waterfall_is_of_the_worst_run_and_ends_at_its_total(
    drawn: dict[str, Drawing], result: Result
) -> None:
    falls, dots = drawn["report-budget"].axes
    worst = result.error_budgets[-1]
    assert falls.get_title() == "step-step-impulse, adaptive, t = 0.005 s"
    *parts, total = falls.patches
    assert sum(bar.get_width() for bar in parts) == pytest.approx(total.get_width(), rel=1e-12)
    assert total.get_width() == worst.at_worst.total
    assert len(dots.get_yticklabels()) == len(result.error_budgets)


def test_numbers_beyond_the_usual_stay_inside_their_axes() -> None:
    claims = [replace(make_claim(3), here=-118.4)]
    low, high = claims_figure(claims, None).draw().axes[1].get_xlim()
    assert low < -118.4
    assert high > 100.0


def test_a_figure_without_data_is_left_out(result: Result) -> None:
    bare = replace(result, error_budgets=(), studies=(), claims=(), ledgers=())
    missing = {"report-budget", "report-orders", "report-claims", "report-energy"}
    assert list(figures(bare)) == [name for name in EVERY if name not in missing]


def test_a_study_without_an_order_is_not_drawn(result: Result) -> None:
    unknown = replace(result.studies[0], errors=(None, 1.0, 0.5, 0.2), order=None)
    assert "report-orders" not in figures(replace(result, studies=(unknown,)))
    both = figures(replace(result, studies=(unknown, result.studies[1])))
    assert "free swing: 1.00" in both["report-orders"].alt


def test_a_scenario_of_one_s_own_is_drawn_as_such_even_under_a_name_of_the_paper() -> None:
    twins = [OWN, *(replace(OWN, name=name) for name in ("a b", "a: b", "..a"))]
    own = figures(make_result(twins))
    names = [name for name in own if "response" in name]
    assert names == [
        "report-response-1-step-step", "report-response-2-a-b", "report-response-3-a-b",
        "report-response-4--a",
    ]  # fmt: skip
    assert own["report-response-1-step-step"].caption.startswith("Controllers: fixed, adaptive.")
    assert not {"report-schedules", "report-impulse"} & set(own)


def test_a_run_that_fell_is_drawn_as_far_as_it_went() -> None:
    fallen = figures(make_result([OWN], fell_at=300))
    caption = fallen["report-response-1-step-step"].caption
    assert caption.endswith("The run with adaptive ends at t = 0.299 s.")
    assert max(fallen["report-errors"].draw().axes[0].lines[0].get_xdata()) <= 0.299


def test_a_run_that_fell_before_the_disturbance_is_said_to_have_fallen() -> None:
    early = make_curves(afl.SCENARIOS["step-step-impulse"], fell_at=50)
    assert "fell before the disturbance" in impulse_figure([[early]], 1e-3).alt


def test_the_schedules_are_drawn_corner_by_corner(drawn: dict[str, Drawing]) -> None:
    (mass,) = drawn["report-schedules"].axes[0].lines
    assert mass.get_xdata().tolist() == [0.0, 1.0, 1.0, 3.0, 3.0, 10.0]
    assert mass.get_ydata().tolist() == [0.5, 0.5, 1.0, 1.0, 2.0, 2.0]


@pytest.mark.slow
def test_figures_are_the_same_files_from_any_number_of_workers(tmp_path: Path) -> None:
    one = replace(record("validate"), result=make_result([OWN], full=False))
    done: list[tuple[int, int]] = []
    for workers in (1, 2):
        folder = tmp_path / str(workers)
        folder.mkdir()
        save_record(one, folder, workers=workers, progress=lambda _, k, n: done.append((k, n)))
    assert done == [(k, 4) for k in (1, 2, 3, 4)] * 2
    names = sorted(path.name for path in (tmp_path / "1").iterdir())
    assert sorted(path.name for path in (tmp_path / "2").iterdir()) == names
    for name in names:
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes(), name
