"""Figures draw what they say."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np

import afl_mujoco as afl
from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.report.style import save_figure
from afl_mujoco.simulation.figures import draw_runs
from afl_mujoco.studies.gain_figures import draw_gain_table, main

SHORT = afl.Scenario(name="short", duration=0.2)


def test_a_figure_of_two_runs_overlays_them_in_every_panel_and_shows_their_difference() -> None:
    fixed = afl.CONTROLLERS["fixed"]
    runs = [afl.simulate_mujoco(SHORT, fixed, "sampled"), afl.simulate_ode(SHORT, fixed)]
    axes = draw_runs(runs, "two runs").axes
    assert [len(axis.lines) for axis in axes] == [2] * 7 + [4]
    assert all(axis.get_ylabel() for axis in axes)
    np.testing.assert_array_equal(axes[2].lines[1].get_ydata(), runs[1].state[:, 1])
    np.testing.assert_array_equal(axes[4].lines[0].get_ydata(), runs[0].force)


def test_a_figure_of_one_run_has_no_difference_panel(tmp_path: Path) -> None:
    run = afl.simulate_ode(SHORT, afl.CONTROLLERS["fixed"])
    figure = draw_runs([run], "one run")
    assert not figure.axes[7].axison
    save_figure(figure, tmp_path / "run.png")
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    assert [p.name for p in tmp_path.iterdir()] == ["run.png"]


def test_the_gain_table_is_drawn_with_every_fit(tmp_path: Path) -> None:
    for name in ("gain_table.json", "gain_functions.json"):
        source = resources.files("afl_mujoco.control") / "data" / name
        (tmp_path / name).write_text(source.read_text())
    main(tmp_path)
    assert (tmp_path / "gain_table.png").read_bytes().startswith(b"\x89PNG")
    fits = {"one": afl.GainFunction.published(), "two": afl.GainFunction.retuned()}
    slopes = draw_gain_table(GainTable.shipped(), {**fits, "three": fits["two"]}).axes[3]
    assert [text.get_text() for text in slopes.get_legend().get_texts()][-3:] == [*fits, "three"]
    assert slopes.get_xlabel() == "half-length l [m]"
