"""The comparison of two maps of attraction: hand-made maps, a planted fault, the files."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import FileError, InvalidValueError
from afl_mujoco.simulation.attraction.grid import (
    FALLEN,
    SETTLED,
    UNDECIDED,
    AttractionMap,
    axis,
    plant_grid,
    state_grid,
)
from afl_mujoco.simulation.attraction.mujoco_map import map_in_mujoco
from afl_mujoco.simulation.attraction.ode_map import map_by_ode
from afl_mujoco.studies.attraction.comparison import (
    AGREE,
    INSIDE,
    ON_BORDER,
    Comparison,
    on_border,
)
from afl_mujoco.studies.attraction.result import result_of
from afl_mujoco.studies.record import Record, load_record, save_record
from afl_mujoco.studies.registry import find_study

LETTERS = {".": SETTLED, "#": FALLEN, "?": UNDECIDED}


def drawn(simulator: str, *rows: str, controller: str = "lqr") -> AttractionMap:
    """A map as it is drawn, the first row the lowest."""
    outcome = np.array([[LETTERS[letter] for letter in row] for row in rows], dtype=np.uint8)
    nothing = np.zeros(outcome.shape)
    return AttractionMap(
        grid=state_grid(np.arange(len(rows[0])) / 10.0, np.arange(len(rows)) / 10.0),
        controller=controller,
        simulator=simulator,
        outcome=outcome,
        time=nothing + 1.5,
        peak_z=nothing,
        peak_force=nothing,
        settings={"horizon": 20.0},
    )


def test_a_grid_point_is_on_the_border_if_one_of_its_eight_neighbours_has_another_outcome() -> None:
    found = drawn("ode", ".....", ".....", ".....", "....#").outcome
    border = [".....", ".....", "...xx", "...xx"]
    assert on_border(found).tolist() == [[letter == "x" for letter in row] for row in border]


def test_a_difference_wider_than_a_grid_point_is_inside_and_one_on_the_edge_on_the_border() -> None:
    ode = drawn("ode", "..#####", "..#####", "..#####", "..#####")
    one_off = drawn("mujoco", "...####", "..#####", "..#####", "..#####")
    kinds = Comparison(ode, one_off).disagreement()
    assert np.argwhere(kinds != AGREE).tolist() == [[0, 2]]
    assert kinds[0, 2] == ON_BORDER
    shifted = drawn("mujoco", *[".......", "......."] * 2)
    kinds = Comparison(ode, shifted).disagreement()
    assert kinds.tolist() == [[AGREE, AGREE, ON_BORDER] + 4 * [INSIDE]] * 4


def test_the_transitions_count_every_pair_of_outcomes() -> None:
    comparison = Comparison(drawn("ode", "..?", "##?"), drawn("mujoco", ".#?", "##."))
    counts = [[1, 1, 0], [0, 2, 0], [1, 0, 1]]  # from settled, fallen, undecided
    assert comparison.transitions().tolist() == counts
    found = result_of([comparison]).maps[0].disagreement
    assert found.differ == found.on_border + found.inside == 2
    assert found.ode_to_mujoco["settled"] == {"settled": 1, "fallen": 1, "undecided": 0}


def test_maps_of_another_grid_or_controller_are_not_compared() -> None:
    with pytest.raises(
        InvalidValueError, match=r"^starts of the grid points must be those of both"
    ):
        Comparison(drawn("ode", ".."), drawn("mujoco", "..."))
    with pytest.raises(InvalidValueError, match=r"^controller must be 'lqr' in both maps, got 'f"):
        Comparison(drawn("ode", ".."), drawn("mujoco", "..", controller="fixed"))


@pytest.mark.slow
def test_a_rod_of_twice_the_length_disagrees_inside_where_the_sound_engine_does_not() -> None:
    grid = state_grid(axis("a", -1.55, 1.55, 15), axis("r", -10.0, 10.0, 15))
    controller = afl.CONTROLLERS["lqr"]
    ode = map_by_ode(grid, controller)
    sound = Comparison(ode, map_in_mujoco(grid, controller, threads=2))
    assert (sound.disagreement() != AGREE).sum() <= 2
    longer = dataclasses.replace(grid, plants=grid.plants * [1.0, 2.0])
    planted = dataclasses.replace(map_in_mujoco(longer, controller, threads=2), grid=grid)
    faulty = Comparison(ode, planted)
    assert (faulty.disagreement() == INSIDE).sum() > 10
    assert (faulty.disagreement() == ON_BORDER).sum() > 40


@pytest.fixture
def small() -> Comparison:
    grid, controller = plant_grid([0.3, 1.0], [0.1, 0.2, 0.5]), afl.CONTROLLERS["adaptive"]
    return Comparison(map_by_ode(grid, controller), map_in_mujoco(grid, controller))


def test_what_is_saved_comes_back(small: Comparison, tmp_path: Path) -> None:
    study = find_study("attraction")
    save_record(Record(study=study, result=result_of([small]), command="x"), tmp_path)
    assert (tmp_path / "attraction.npz").is_file()
    (pair,) = load_record(study, tmp_path).result.maps
    again = pair.comparison
    for side in ("ode", "mujoco"):
        a, b = getattr(small, side), getattr(again, side)
        for key in ("outcome", "time", "peak_z", "peak_force"):
            np.testing.assert_array_equal(getattr(a, key), getattr(b, key))
            assert getattr(a, key).dtype == getattr(b, key).dtype
        for key in ("columns", "rows", "starts", "plants"):
            np.testing.assert_array_equal(getattr(a.grid, key), getattr(b.grid, key))
        assert (a.settings, a.simulator, a.grid.plane) == (b.settings, side, "plants")
    assert sum(pair.ode.shares.values()) == pytest.approx(1.0)
    assert pair.mujoco.settings["timestep"] == 2e-3


def test_an_npz_that_is_cut_off_is_named_in_one_line(small: Comparison, tmp_path: Path) -> None:
    study = find_study("attraction")
    save_record(Record(study=study, result=result_of([small]), command="x"), tmp_path)
    path = tmp_path / "attraction.npz"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(FileError, match=r"is not a result of .*: run afl-mujoco attraction$"):
        load_record(study, tmp_path)
    path.unlink()
    with pytest.raises(FileError, match=r"must be the name of an array of the npz"):
        load_record(study, tmp_path)
