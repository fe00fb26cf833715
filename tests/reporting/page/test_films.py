"""Films: inside the page where small, linked where large, refused where not understood."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from page_case import film_entry, write_listing
from PIL import Image

from afl_mujoco.errors import FileError
from afl_mujoco.reporting.page.inputs.films import SMALL, load_films


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Folders of the films and of the page."""
    page = tmp_path / "renders" / "validation"
    page.mkdir(parents=True)
    return page.parent, page


def test_without_a_list_there_are_no_films(folders: tuple[Path, Path]) -> None:
    assert load_films(*folders) == ()
    assert load_films(folders[0] / "nowhere", folders[1]) == ()


def test_a_small_film_is_inside_the_page_and_a_large_one_linked(
    folders: tuple[Path, Path],
) -> None:
    films, page = folders
    (films / "small one.mp4").write_bytes(b"film")
    (films / "large & one.mp4").write_bytes(bytes(SMALL + 1))
    write_listing(films, film_entry("small one.mp4"), film_entry("large & one.mp4"))
    small, large = load_films(films, page)
    assert small.source == "data:video/mp4;base64,ZmlsbQ=="
    assert small.embedded
    assert large.source == "../large%20%26%20one.mp4"
    assert not large.embedded
    assert (large.size, large.width, large.height, large.duration) == (SMALL + 1, 64, 48, 2.0)


def test_where_there_is_no_room_showcase_and_comparisons_come_first(
    folders: tuple[Path, Path],
) -> None:
    films, page = folders
    kinds = ("film", "comparison", "showcase", "film")
    for number in range(4):
        (films / f"{number}.mp4").write_bytes(bytes(900))
    entries = [film_entry(f"{number}.mp4", kind=kind) for number, kind in enumerate(kinds)]
    write_listing(films, *entries)
    found = load_films(films, page, room=3000)
    assert [film.name for film in found] == ["0.mp4", "1.mp4", "2.mp4", "3.mp4"]
    assert [film.embedded for film in found] == [False, True, True, False]


def test_a_film_that_is_not_there_is_kept_with_what_makes_it(folders: tuple[Path, Path]) -> None:
    films, page = folders
    write_listing(
        films, film_entry("gone.mp4", scenario="my case"), film_entry("x.mp4", command="c")
    )
    gone, other = load_films(films, page)
    assert gone.size == 0
    assert gone.command == "afl-mujoco render 'my case'"
    assert other.command == "c"


def test_a_film_says_how_the_law_was_deployed(folders: tuple[Path, Path]) -> None:
    films, page = folders
    settings = {"timestep": 0.001, "control_period": None, "integrator": "RK4"}
    held = settings | {"control_period": 0.005}
    write_listing(
        films, film_entry("a.mp4", deployment=settings), film_entry("b.mp4", deployment=held)
    )
    said = [film.deployed for film in load_films(films, page)]
    assert said == ["RK4 at 1 ms, force held for 1 ms.", "RK4 at 1 ms, force held for 5 ms."]


def test_a_poster_becomes_a_small_jpeg(folders: tuple[Path, Path]) -> None:
    films, page = folders
    Image.effect_noise((1280, 720), 60.0).convert("RGB").save(films / "still.png")
    write_listing(
        films, film_entry("a.mp4", poster="still.png"), film_entry("b.mp4", poster="no.png")
    )
    shown, bare = load_films(films, page)
    assert shown.poster.startswith("data:image/jpeg;base64,")
    assert len(shown.poster) < (films / "still.png").stat().st_size
    assert bare.poster == ""


BAD = {
    "no JSON": ("{", "does not list films"),
    "another schema": (json.dumps({"schema": 2, "films": []}), "schema must be 1, got 2"),
    "no list": (json.dumps({"schema": 1}), "'films' is missing"),
    "a list of texts": (json.dumps({"schema": 1, "films": ["a.mp4"]}), "does not list films"),
    "no title": (
        json.dumps({"schema": 1, "films": [film_entry("a.mp4", title=None)]}),
        "title must be a text, got None",
    ),
    "no size": (
        json.dumps({"schema": 1, "films": [film_entry("a.mp4", width=0)]}),
        "width must be a positive number, got 0",
    ),
    "a file elsewhere": (
        json.dumps({"schema": 1, "films": [film_entry("../../etc/x.mp4")]}),
        "file must lie beside films.json, got '../../etc/x.mp4'",
    ),
    "a poster elsewhere": (
        json.dumps({"schema": 1, "films": [film_entry("a.mp4", poster="/etc/x.png")]}),
        "file must lie beside films.json, got '/etc/x.png'",
    ),
    "no film": (
        json.dumps({"schema": 1, "films": [film_entry("a.exe")]}),
        "file must end in .mp4, got 'a.exe'",
    ),
    "a scenario that is a number": (
        json.dumps({"schema": 1, "films": [film_entry("a.mp4", scenario=3)]}),
        "scenario must be a text or null, got 3",
    ),
}


@pytest.mark.parametrize("case", BAD, ids=str)
def test_a_list_that_is_not_understood_is_refused_in_one_line(
    folders: tuple[Path, Path], case: str
) -> None:
    text, message = BAD[case]
    (folders[0] / "films.json").write_text(text)
    with pytest.raises(FileError) as refusal:
        load_films(*folders)
    said = str(refusal.value)
    assert "films.json" in said
    assert message in said
    assert said.endswith("run afl-mujoco render")
    assert "\n" not in said


def test_a_poster_that_is_no_picture_is_refused(folders: tuple[Path, Path]) -> None:
    (folders[0] / "still.png").write_text("text")
    write_listing(folders[0], film_entry("a.mp4", poster="still.png"))
    with pytest.raises(FileError, match=r"still\.png must be a picture"):
        load_films(*folders)
