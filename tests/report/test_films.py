"""Films: inside the page where small, linked where large, with a still."""

from pathlib import Path

import pytest
from PIL import Image

from afl_mujoco.errors import FileError
from afl_mujoco.report.blocks import Film
from afl_mujoco.report.page import SMALL, show_films


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    page = tmp_path / "renders" / "validation"
    page.mkdir(parents=True)
    return page.parent, page


def film(path: Path, *, wide: bool = False, poster: Path | None = None) -> Film:
    return Film(
        title="a film", caption="It moves.", file=path, poster=poster, width=64, height=48,
        command="afl-mujoco render", wide=wide,
    )  # fmt: skip


def test_a_small_film_is_inside_the_page_and_a_large_one_linked(folders: tuple[Path, Path]) -> None:
    films, page = folders
    small, large = films / "small one.mp4", films / "large & one.mp4"
    small.write_bytes(b"film")
    large.write_bytes(bytes(SMALL + 1))
    shown = show_films([film(small), film(large)], page)
    assert shown[small].source == "data:video/mp4;base64,ZmlsbQ=="
    assert shown[small].embedded
    assert shown[large].source == "../large%20%26%20one.mp4"
    assert not shown[large].embedded
    assert shown[large].size == SMALL + 1


def test_a_poster_becomes_a_small_jpeg(folders: tuple[Path, Path]) -> None:
    films, page = folders
    still = films / "still.png"
    Image.effect_noise((1280, 720), 60.0).convert("RGB").save(still)
    one, bare = films / "a.mp4", films / "b.mp4"
    shown = show_films([film(one, poster=still), film(bare, poster=films / "no.png")], page)
    assert shown[one].poster.startswith("data:image/jpeg;base64,")
    assert len(shown[one].poster) < still.stat().st_size
    assert shown[bare].poster == ""


def test_a_poster_that_is_no_picture_is_refused(folders: tuple[Path, Path]) -> None:
    films, page = folders
    (films / "still.png").write_text("text")
    with pytest.raises(FileError, match=r"still\.png must be a picture"):
        show_films([film(films / "a.mp4", poster=films / "still.png")], page)
