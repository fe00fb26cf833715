"""The page's part on robustness, and its findings at the top, from made-up results."""

from __future__ import annotations

import html
import re
from pathlib import Path

import pytest
import study_results
from page_case import NASTY, make_curves, make_report

from afl_mujoco.reporting.page.page import render_page


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study_results.write_records(tmp_path_factory.mktemp("robustness"))


def render(folder: Path) -> str:
    sections = study_results.sections_of(folder)
    return render_page(make_report(), make_curves(), (), (), sections=sections, results=folder)


def plain(page: str) -> str:
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]*>", "", page)))


def test_the_page_shows_every_study_and_escapes_what_it_is_given(folder: Path) -> None:
    page = render(folder)
    assert page == render(folder)
    for name in study_results.RESULTS:
        assert f'id="{name}"' in page
        assert f'href="#{name}"' in page
        assert f"afl-mujoco {name} --made-up" in page
    assert NASTY not in page
    anchors = re.findall(r'id="([^"]+)"', page)
    assert len(anchors) == len(set(anchors))
    assert page.count("data:image/svg+xml") > 7  # the figures, and the icon


def test_the_findings_come_first_with_links_to_their_sections(folder: Path) -> None:
    page = render(folder)
    top = page[page.index('id="findings"') : page.index('id="summary"')]
    leads = re.findall(r"<strong>(.*?)\.</strong>", top)
    assert leads[0] == "What holds" and "On random hardware" in leads
    links = re.findall(r'class="more" href="#(\w+)"', top)
    assert set(links) == set(study_results.RESULTS)
    assert "Does it survive real physics?" in plain(page)


def test_a_page_without_studies_says_how_to_make_them() -> None:
    text = plain(render_page(make_report(), make_curves(), (), ()))
    assert "No study of robustness is here. make robustness runs them." in text
    assert "Does it survive real physics?" not in text


def test_a_figure_that_went_away_is_said_to_be_missing(folder: Path, tmp_path: Path) -> None:
    sections = study_results.sections_of(folder)
    page = render_page(make_report(), make_curves(), (), (), sections=sections, results=tmp_path)
    assert "is missing: its files are not there" in plain(page)
