"""The figure and the table of the maps of attraction show what the maps hold."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from rich.console import Console

from afl_mujoco.report.old import figures_of
from afl_mujoco.report.terminal import print_sections
from afl_mujoco.simulation.attraction.grid import AttractionMap, Settling, plant_grid, state_grid
from afl_mujoco.studies.attraction import figures
from afl_mujoco.studies.attraction.comparison import Comparison
from afl_mujoco.studies.attraction.result import result_of
from afl_mujoco.studies.attraction.sections import sections

OUTCOMES = ([0, 1, 2, 0, 0], [0, 0, 0, 0, 1], [0, 0, 0, 0, 0])


def comparison(controller: str, *, plane: str = "states") -> Comparison:
    """Maps of three rows and five columns whose outcomes differ in the last column of one row."""
    columns, rows = np.linspace(-1.0, 1.0, 5), np.linspace(-2.0, 2.0, 3)
    grid = state_grid(columns, rows) if plane == "states" else plant_grid(columns + 2, rows + 3)

    def one(simulator: str, outcome: np.ndarray) -> AttractionMap:
        times = np.full(outcome.shape, 3.2)
        return AttractionMap(
            grid=grid, controller=controller, simulator=simulator, outcome=outcome,
            settings=Settling().describe() | {"timestep": 2e-3},
            time=times, peak_z=times, peak_force=times,
        )  # fmt: skip

    ode = np.array(OUTCOMES, dtype=np.uint8)
    mujoco = ode.copy()
    mujoco[1, 4] = 0
    return Comparison(one("ode", ode), one("mujoco", mujoco))


@pytest.mark.parametrize("plane", ["states", "plants"])
def test_every_grid_point_has_the_colour_of_its_outcome_where_its_coordinates_are(
    plane: str,
) -> None:
    figure = figures.draw_attraction([comparison("lqr", plane=plane), comparison("x", plane=plane)])
    panels = [axes for axes in figure.axes if axes.images]
    assert len(panels) == 6
    ode, mujoco, differ = (axes.images[0] for axes in panels[:3])
    shown = np.asarray(ode.get_array())
    assert tuple(shown[0, 1]) == to_rgba(figures.FALLEN_COLOUR)
    assert tuple(shown[0, 2]) == to_rgba(figures.UNDECIDED_COLOUR)
    assert np.ptp(shown[2], axis=0).max() == 0.0  # settled, all at the same time
    assert tuple(np.asarray(mujoco.get_array())[1, 4]) == tuple(shown[2, 4])
    assert tuple(np.asarray(differ.get_array())[1, 4]) == to_rgba(figures.BORDER_COLOUR)
    assert tuple(np.asarray(differ.get_array())[0, 0]) == to_rgba(figures.AGREE_COLOUR)
    left, right, bottom, top = ode.get_extent()
    offset = 0.0 if plane == "states" else 2.0
    assert (left, right) == (-1.25 + offset, 1.25 + offset)
    assert ode.origin == "lower"
    assert bottom < top


def test_axes_have_names_and_units_and_titles_the_numbers() -> None:
    figure = figures.draw_attraction([comparison("lqr")])
    panels = [axes for axes in figure.axes if axes.images]
    assert all("[rad]" in axes.get_xlabel() for axes in panels)
    assert "[rad/s]" in panels[0].get_ylabel()
    assert panels[0].get_ylabel().startswith("lqr")
    assert panels[0].get_title() == "equations: 80.0 % settle"
    assert panels[1].get_title() == "MuJoCo as deployed: 86.7 % settle"
    assert panels[2].get_title() == "1 differ on a border, 0 inside, of 15"
    plants = figures.draw_attraction([comparison("lqr", plane="plants")])
    assert "[kg]" in plants.axes[0].get_xlabel()
    assert "[m]" in plants.axes[0].get_ylabel()


def test_the_colours_differ_in_lightness_too() -> None:
    def lightness(colour: str) -> float:
        return float(np.dot(to_rgba(colour)[:3], (0.2126, 0.7152, 0.0722)))

    kinds = (figures.AGREE_COLOUR, figures.BORDER_COLOUR, figures.INSIDE_COLOUR)
    outcomes = (figures.FALLEN_COLOUR, figures.UNDECIDED_COLOUR)
    for colours in (kinds, outcomes):
        assert np.diff(sorted(map(lightness, colours))).min() > 0.15


def test_each_plane_has_a_figure_and_its_words_the_numbers() -> None:
    found = result_of([comparison("lqr"), comparison("lqr", plane="plants")])
    (section,) = sections(found)
    drawn = figures_of([section])
    assert [one.name for one in drawn] == ["attraction-states", "attraction-plants"]
    assert drawn[0].alt == (
        "lqr: 80.0 % settle by the equations, 86.7 % in MuJoCo, 1 grid points differ, 0 of them "
        "not on a border."
    )
    assert len([axes for axes in drawn[1].draw().axes if axes.images]) == 3


def test_the_table_has_the_shares_and_the_counts() -> None:
    text = StringIO()
    found = sections(result_of([comparison("lqr")]))
    print_sections(found, Path("out"), Console(file=text, width=140))
    rows = [line.split() for line in text.getvalue().splitlines()]
    assert ["states", "lqr", "equations", "80.00", "13.33", "6.67"] in rows
    assert ["lqr", "MuJoCo", "86.67", "6.67", "6.67", "1", "1", "0", "15"] in rows
