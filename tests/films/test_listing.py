"""The list of films comes back as it was, and is refused where it is not understood."""

import json
from dataclasses import asdict

import pytest

from afl_mujoco.errors import FileError
from afl_mujoco.films.listing import LISTING, list_film, load_listing, sections
from afl_mujoco.report.blocks import Film
from afl_mujoco.scenario.time_steps import Deployed
from tests.messages import line
from tests.verification_result import film_entry, write_listing


def test_a_film_takes_the_place_of_one_of_its_name_and_those_gone_are_left_out(tmp_path) -> None:
    (tmp_path / "a.mp4").write_bytes(b"film")
    (tmp_path / "b.mp4").write_bytes(b"film")
    write_listing(tmp_path, film_entry("gone.mp4"), film_entry("b.mp4"), film_entry("a.mp4"))
    new = film_entry("a.mp4", title="new", deployment=Deployed(timestep=2e-3, control_period=4e-3))
    list_film(tmp_path, new)
    assert load_listing(tmp_path) == (new, film_entry("b.mp4"))


def test_a_report_shows_each_scenario_and_its_wide_films_first(tmp_path) -> None:
    write_listing(
        tmp_path, film_entry("a.mp4", deployment=Deployed(control_period=0.005)),
        film_entry("b.mp4", controllers=("adaptive", "lqr")), film_entry("c.mp4", scenario="other"),
    )  # fmt: skip
    (section,) = sections(tmp_path, set())
    assert [part.title for part in section.parts] == ["other", "step-step"]
    assert [part.folded for part in section.parts] == [True, True]
    wide, single = section.parts[1].blocks
    assert wide.wide and not single.wide and isinstance(wide, Film) and isinstance(single, Film)
    assert [wide.file.name, single.file.name] == ["b.mp4", "a.mp4"]
    assert single.caption == "As deployed: RK4 at 1 ms, force held for 5 ms."


def test_films_of_another_version_and_of_other_scenarios_are_left_out(tmp_path) -> None:
    own = {"scenario step-step": "1", "controller lqr": "2"}
    write_listing(
        tmp_path, film_entry("a.mp4", inputs=own), film_entry("c.mp4", scenario="other"),
        film_entry("b.mp4", inputs=own | {"scenario step-step": "0"}),
        film_entry("d.mp4", inputs=own | {"controller lqr": "0"}),
        film_entry("e.mp4", inputs={"scenario step-step": "1", "controller more": "5"}),
    )  # fmt: skip
    ((section,),) = (one.parts for one in sections(tmp_path, {*own.items()}))
    assert [film.file.name for film in section.blocks] == ["a.mp4", "e.mp4"]
    assert len(sections(tmp_path, set())[0].parts) == 2  # a report that is of no scenario


@pytest.mark.parametrize(("changes", "message"), [
    (None, "does not list films"), ({"width": 0}, "width must be greater than 0, got 0"),
    *((place, "must lie in its folder, but leads out of")
      for place in ({"file": "../../etc/x.mp4"}, {"poster": "/etc/x.png"})),
], ids=str)  # fmt: skip
def test_a_list_that_is_not_understood_or_leads_elsewhere_is_refused(changes, message, tmp_path):
    text = json.dumps({"schema": 1, "films": [asdict(film_entry("a.mp4")) | (changes or {})]})
    (tmp_path / LISTING).write_text(text if changes else text[:1])
    end = ["run afl-mujoco render"] if "lie" not in message else []
    with pytest.raises(FileError, match=line(..., message, ..., *end)):
        load_listing(tmp_path)
