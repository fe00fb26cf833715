import pytest
from PIL import Image

from afl_mujoco.errors import FileError
from afl_mujoco.report.blocks import Film
from afl_mujoco.report.page import SMALL, show_films


@pytest.fixture
def folders(tmp_path):
    page = tmp_path / "renders" / "validation"
    page.mkdir(parents=True)
    return page.parent, page


def film(path, *, wide: bool = False, poster=None) -> Film:
    return Film(
        title="a film", caption="It moves.", file=path, poster=poster, width=64, height=48,
        command="afl-mujoco render", wide=wide,
    )  # fmt: skip


def test_small_films_are_inside_the_page_large_ones_linked_posters_small(folders) -> None:
    films, page = folders
    small, large = films / "small one.mp4", films / "large & one.mp4"
    small.write_bytes(b"film")
    large.write_bytes(bytes(SMALL + 1))
    shown = show_films([film(small), film(large)], page)
    assert shown[small].source == "data:video/mp4;base64,ZmlsbQ==" and shown[small].embedded
    assert shown[large].source == "../large%20%26%20one.mp4" and not shown[large].embedded
    assert shown[large].size == SMALL + 1
    films, page = folders
    still = films / "still.png"
    Image.effect_noise((1280, 720), 60.0).convert("RGB").save(still)
    one, bare = films / "a.mp4", films / "b.mp4"
    shown = show_films([film(one, poster=still), film(bare, poster=films / "no.png")], page)
    assert shown[one].poster.startswith("data:image/jpeg;base64,")
    assert len(shown[one].poster) < still.stat().st_size and shown[bare].poster == ""
    still.write_text("text")
    with pytest.raises(FileError, match=r"still\.png must be a picture"):
        show_films([film(one, poster=still)], page)
