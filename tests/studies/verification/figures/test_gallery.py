"""The gallery has every figure that there are data for, each with its words, units and files."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d import Axes3D

import afl_mujoco as afl
from afl_mujoco.document.style import Drawn
from afl_mujoco.studies.cases import Settings
from afl_mujoco.studies.verification.campaign import Report
from afl_mujoco.studies.verification.case import judge
from afl_mujoco.studies.verification.curves import Curves
from afl_mujoco.studies.verification.figures import gallery
from afl_mujoco.studies.verification.figures.errors import BINS, difference, envelope
from afl_mujoco.studies.verification.figures.gallery import draw_all, plans, write_figures
from afl_mujoco.studies.verification.figures.schedules import last_change

EVERY = [
    "gain-table", "schedules", "response-step-step", "response-trapezoid-step", "impulse",
    "errors", "budget", "orders", "energy", "claims",
]  # fmt: skip
Curved = tuple[Curves, ...]
Data = dict[str, Any]


@pytest.fixture(scope="module")
def drawn(report: Data, curves: Curved) -> dict[str, Drawn]:
    return draw_all(report, curves)


def test_every_figure_is_drawn_in_the_order_of_reading(drawn: dict[str, Drawn]) -> None:
    assert list(drawn) == EVERY
    assert [one.name for one in drawn.values()] == EVERY


def test_every_figure_says_what_it_is_and_what_one_sees(drawn: dict[str, Drawn]) -> None:
    for one in drawn.values():
        assert one.title
        assert one.caption.endswith(".")
        assert re.search(r"\d", one.alt)
        assert "nan" not in one.alt + one.caption
    fig7 = drawn["response-step-step"]
    assert fig7.caption.startswith("Analogue of the paper's Fig. 7: M and l change by steps.")
    assert fig7.title == "step-step"
    assert "differ from the solid ones by at most 0.01 in any state" in fig7.alt
    assert "C3 (improvement [%]): paper 38, here −118." in drawn["claims"].alt


def labels_of(axis: Axes, which: str) -> list[str]:
    """Labels of an axis and of those that share it."""
    shared = getattr(axis, f"get_shared_{which}_axes")().get_siblings(axis)
    return [getattr(one, f"get_{which}label")() for one in shared]


def is_categorical(axis: Axes, which: str) -> bool:
    ticks = getattr(axis, f"get_{which}ticklabels")()
    return all(re.search("[a-z]{2}", tick.get_text()) for tick in ticks if tick.get_text())


def test_every_axis_has_its_unit(drawn: dict[str, Drawn]) -> None:
    for name, one in drawn.items():
        for axis in one.figure.axes:
            if isinstance(axis, Axes3D):
                assert all("[" in text for text in (axis.get_title(), *labels_of(axis, "x")))
            elif axis.axison:
                for which in "xy":
                    unit = any("[" in label for label in labels_of(axis, which))
                    assert unit or is_categorical(axis, which), (name, which, axis.get_title())


def test_an_axis_without_a_unit_is_noticed(report: Data, curves: Curved) -> None:
    figure = plans(report, curves)["response-step-step"]().figure
    figure.axes[2].set_ylabel("z")
    with pytest.raises(AssertionError, match="response-step-step"):
        test_every_axis_has_its_unit({"response-step-step": Drawn(
            name="", title="", caption="", alt="", figure=figure
        )})  # fmt: skip


def test_no_panel_is_empty(drawn: dict[str, Drawn]) -> None:
    for name, one in drawn.items():
        for axis in one.figure.axes:
            assert axis.lines or axis.collections or axis.patches, name


def test_a_response_draws_mujoco_solid_and_the_ode_dashed_over_it(
    drawn: dict[str, Drawn], curves: Curved
) -> None:
    angle = drawn["response-step-step"].figure.axes[4]
    assert angle.get_ylabel() == "φ [rad]"
    styles = [line.is_dashed() for line in angle.lines]
    assert styles == [False, False, True, True]
    for line, one, run in zip(
        angle.lines, curves[:2] * 2, ["mujoco sampled"] * 2 + ["ode"] * 2, strict=True
    ):
        shown = len(line.get_xdata())
        np.testing.assert_array_equal(line.get_ydata(), one.states[run][:shown, 1])


def test_the_impulse_is_drawn_for_struck_cases_alone(drawn: dict[str, Drawn]) -> None:
    axes = drawn["impulse"].figure.axes
    assert [axis.get_title() for axis in axes if axis.get_title()] == ["step-step-impulse"]
    assert "a force of -10 N on the cart for 0.1 s at t = 10 s" in drawn["impulse"].caption


def test_the_envelope_keeps_the_largest_value_and_few_points(curves: Curved) -> None:
    time, values = difference(curves[0], "mujoco exact")
    thinned = envelope(time, values)
    assert thinned[1].max() == values.max()
    assert np.all(np.diff(thinned[0]) > 0.0)
    assert len(thinned[0]) <= BINS
    assert set(thinned[1].tolist()) <= set(values.tolist())


def test_the_errors_are_drawn_up_to_the_largest(drawn: dict[str, Drawn], curves: Curved) -> None:
    first = drawn["errors"].figure.axes[0]
    for line, mode in zip(
        first.lines, ("mujoco sampled", "mujoco continuous", "mujoco exact"), strict=False
    ):
        assert max(line.get_ydata()) == difference(curves[0], mode)[1].max()
    limits = {text.get_text() for text in first.texts}
    assert limits == {"B1", "B2"}


def test_the_waterfall_is_of_the_worst_run_and_ends_at_its_total(
    drawn: dict[str, Drawn], report: Data
) -> None:
    falls, dots = drawn["budget"].figure.axes
    worst = report["error_budgets"][-1]
    assert falls.get_title() == "step-step-impulse, adaptive, t = 0.005 s"
    *parts, total = falls.patches
    assert sum(bar.get_width() for bar in parts) == pytest.approx(total.get_width(), rel=1e-12)
    assert total.get_width() == worst["at_worst"]["total"]
    assert len(dots.get_yticklabels()) == len(report["error_budgets"])


def test_numbers_beyond_the_usual_stay_inside_their_axes(drawn: dict[str, Drawn]) -> None:
    low, high = drawn["claims"].figure.axes[1].get_xlim()
    assert low < -118.4
    assert high > 100.0


@pytest.mark.parametrize(
    ("key", "missing"),
    [
        ("error_budgets", "budget"),
        ("studies", "orders"),
        ("claims", "claims"),
    ],
)
def test_a_figure_without_data_is_left_out(
    report: Data, curves: Curved, key: str, missing: str
) -> None:
    assert list(plans({**report, key: []}, curves)) == [name for name in EVERY if name != missing]


def test_figures_of_curves_that_are_not_there_are_left_out(report: Data, curves: Curved) -> None:
    quick = [dataclasses.replace(one, energy={}) for one in curves[:2]]
    left = {"response-trapezoid-step", "impulse", "energy"}
    assert list(plans(report, quick)) == [name for name in EVERY if name not in left]
    none = {**report, "error_budgets": [], "studies": [], "claims": []}
    assert list(plans(none, [])) == ["gain-table"]


def test_a_study_without_an_order_is_not_drawn(report: Data, curves: Curved) -> None:
    unknown = {**report["studies"][0], "errors": [None, 1.0, 0.5, 0.2], "order": None}
    assert "orders" not in plans({**report, "studies": [unknown]}, curves)
    both = {**report, "studies": [unknown, report["studies"][1]]}
    assert "free swing: 1.00" in plans(both, curves)["orders"]().alt


def test_a_scenario_of_one_s_own_is_drawn_as_such_even_under_a_name_of_the_paper(
    report: Data, curves: Curved
) -> None:
    heavier = dataclasses.replace(curves[0], cart_mass=2.0 * curves[0].cart_mass)
    twins = [dataclasses.replace(heavier, scenario=name) for name in ("a b", "a: b", "../a")]
    names = list(plans(report, [heavier, *twins]))
    assert names[1:5] == [
        "response-step-step", "response-a-b", "response-a-b-2", "response-..-a",
    ]  # fmt: skip
    own = plans(report, [heavier])["response-step-step"]()
    assert own.caption.startswith("The scenario step-step.")
    assert "schedules" not in names


def test_a_run_that_fell_is_drawn_as_far_as_it_went(report: Data, curves: Curved) -> None:
    runs = {name: states[:300] for name, states in curves[0].states.items()}
    forces = {name: force[:300] for name, force in curves[0].forces.items()}
    fallen = dataclasses.replace(
        curves[0], states={**curves[0].states, "mujoco sampled": runs["mujoco sampled"]},
        forces={**curves[0].forces, "mujoco sampled": forces["mujoco sampled"]},
    )  # fmt: skip
    figures = plans({**report, "error_budgets": []}, [fallen, curves[1]])
    ended = curves[0].time[299]
    caption = figures["response-step-step"]().caption
    assert caption.endswith(f"The run with fixed gains ends at t = {ended:.3g} s.")
    assert max(figures["errors"]().figure.axes[0].lines[0].get_xdata()) <= ended


def test_a_run_that_fell_before_the_disturbance_is_said_to_have_fallen(
    report: Data, curves: Curved
) -> None:
    struck = next(one for one in curves if one.scenario.endswith("-impulse"))
    early = dataclasses.replace(
        struck, states={**struck.states, "mujoco sampled": struck.states["mujoco sampled"][:50]},
        forces={**struck.forces, "mujoco sampled": struck.forces["mujoco sampled"][:50]},
    )  # fmt: skip
    assert "fell before the disturbance" in plans(report, [early])["impulse"]().alt


def test_the_last_change_of_a_plant_is_found(curves: Curved) -> None:
    assert last_change(curves[0]) == pytest.approx(3.0)
    assert last_change(curves[2]) == pytest.approx(8.0)


def test_the_files_are_those_listed_and_repeat_bit_for_bit(
    report: Data, curves: Curved, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = plans(report, curves)
    few = {name: every[name] for name in ("schedules", "budget", "claims")}
    monkeypatch.setattr(gallery, "plans", lambda *_: few)
    (tmp_path / "once").mkdir()
    (tmp_path / "again").mkdir()
    done: list[str] = []
    listed = write_figures(report, curves, tmp_path / "once", progress=done.append)
    assert write_figures(report, curves, tmp_path / "again", workers=2) == listed
    assert done == [entry["name"] for entry in listed] == list(few)
    files = sorted(name for entry in listed for name in (entry["svg"], entry["png"]))
    assert sorted(path.name for path in (tmp_path / "once").iterdir()) == files
    for name in files:
        once, again = (tmp_path / folder / name for folder in ("once", "again"))
        assert once.read_bytes() == again.read_bytes(), name
    assert all(set(e) == {"name", "title", "caption", "alt", "svg", "png"} for e in listed)


def test_the_report_of_a_campaign_is_drawn_from_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = afl.Scenario(name="short", duration=0.3, cart_mass=afl.staircase((0.1,), (0.5, 1.0)))
    judged = judge((scenario, afl.CONTROLLERS["adaptive"], Settings()))
    report = Report(
        checks=judged.checks,
        runs=judged.runs,
        explanations=(judged.explanation,),
        curves=(judged.curves,),
    )
    data = json.loads(json.dumps(report.to_dict()))
    assert list(plans(data, report.curves)) == ["gain-table", "response-short", "errors", "budget"]
    monkeypatch.setattr(gallery, "draw_shipped_gains", plans(data, report.curves)["budget"])
    for name, one in draw_all(data, report.curves).items():
        assert one.figure.axes, name
