"""The page says what the report says, to everyone, and nothing else happens in it."""

from __future__ import annotations

import base64
import copy
import hashlib
import itertools
import json
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from page_case import NASTY, make_curves, make_pictures, make_report

from afl_mujoco.reporting.page.inputs.films import Film
from afl_mujoco.reporting.page.inputs.report_data import require_report
from afl_mujoco.reporting.page.page import render_page
from afl_mujoco.studies.verification.criteria import CRITERIA

VOID = {"meta", "link", "img", "input", "br", "path", "circle", "use", "rect"}


class Outline(HTMLParser):
    """Elements with their attributes, and the text that a reader sees."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.raw: dict[str, list[str]] = {"style": [], "script": []}
        self.open: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        inside = self.open[-1] if self.open else ""
        (self.raw[inside] if inside in self.raw else self.texts).append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", "".join(self.texts))

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


def film(**changes: Any) -> Film:
    values: dict[str, Any] = {
        "title": "a film", "kind": "film", "scenario": "step-step", "controllers": ("adaptive",),
        "width": 64, "height": 48, "duration": 2.0, "command": "afl-mujoco render step-step",
        "deployed": "RK4 at 1 ms.",
        "name": "a.mp4", "size": 1_234_567, "source": "../a.mp4", "poster": "",
    }  # fmt: skip
    return Film(**values | changes)


def rendered(report: dict[str, Any], **more: Any) -> str:
    values = {"curves": make_curves(), "pictures": (), "films": ()} | more
    return render_page(require_report(report), **values)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    pictures = make_pictures(tmp_path_factory.mktemp("pictures"))
    return rendered(make_report(), pictures=pictures, films=(film(),), files=("report.json",))


@pytest.fixture(scope="module")
def outline(page: str) -> Outline:
    return Outline(page)


def test_the_same_inputs_give_the_same_bytes(page: str, tmp_path: Path) -> None:
    again = rendered(
        make_report(), pictures=make_pictures(tmp_path), films=(film(),), files=("report.json",)
    )
    assert again == page


def test_the_verdict_comes_first_then_five_sentences_then_the_evidence(outline: Outline) -> None:
    order = [
        "PASS all 22 checks hold", "In five sentences", "Checks Each row", "Scenarios Every",
        "Error budget Why", "Orders, energy and omissions Rests", "The paper’s claims What",
        "Decisions Where", "Reproduce The command", "Notation z",
    ]  # fmt: skip
    body = outline.text.partition("PASS all")[2]
    places = [("PASS all" + body).index(title) for title in order]
    assert places == sorted(places)
    assert outline.text.count("Evidence on: ") == 5


def test_every_check_stands_with_value_limit_reason_and_what_it_proves(outline: Outline) -> None:
    for check in make_report()["checks"]:
        assert check["quantity"] in outline.text
        assert check["reason"] in outline.text
        assert CRITERIA[check["id"]].proves in outline.text
    assert "5.8×10⁻¹² m, rad, m/s, rad/s≤ 10⁻⁹" in outline.text.replace(" ≤", "≤")
    assert "170 times below" in outline.text


def test_what_fails_is_listed_before_everything_else_and_opened(tmp_path: Path) -> None:
    outline = Outline(rendered(make_report(b3=3.4e-7)))
    text = outline.text.partition("Notation ")[2]  # behind the contents
    assert text.index("FAIL 4 of 22 checks fail") < text.index("What fails")
    assert text.index("B3: 4 of 4") < text.index("In five sentences") < text.index("Failing B3")
    assert text.index("Failing B3") < text.index("The equations A1")
    assert "34 times above" in text
    assert "yet B3 fails" in text
    assert "PASS" not in text


def test_a_value_that_is_not_finite_fails_and_is_said_to_be_none() -> None:
    assert "no finite value" in Outline(rendered(make_report(b3=None))).text


def test_every_claim_stands_with_its_numbers_verdict_and_reason(outline: Outline) -> None:
    for claim in make_report()["claims"]:
        assert f"{claim['id']}C{claim['claim'][1:]}" in outline.text.replace(
            f"{claim['id']} ", claim["id"]
        )
        assert claim["verdict"] in outline.text
    assert "38.03" in outline.text
    assert "4 reproduced2 in part4 not2 undetermined" in outline.text.replace("ed ", "ed")


def test_claims_and_sections_name_decisions_and_decisions_name_them_back(page: str) -> None:
    def links(part: str) -> set[str]:
        return set(re.findall(r'<a href="#([\w-]+)"', part))

    row = page.partition('<tr id="C8">')[2].partition("</tr>")[0]
    assert {"D2", "D3", "D6", "D7", "D9"} <= links(row)
    own = page.partition('<tr id="C1">')[2].partition("</tr>")[0]
    assert links(own) == {"D1", "D3", "D4"}  # the last two because its reason names them
    for claim in (f"C{k}" for k in range(1, 13)):
        row = page.partition(f'<tr id="{claim}">')[2].partition("</tr>")[0]
        for decision in links(row):
            entry = page.partition(f'<div id="{decision}">')[2].partition("</div>")[0]
            assert claim in links(entry), (claim, decision)
    budget = page.partition('<h2 id="budget">')[2].partition("</section>")[0]
    assert {"D3", "D6"} <= links(budget)
    assert "budget" in links(page.partition('<div id="D6">')[2].partition("</div>")[0])


def test_a_name_is_text_whatever_it_contains(page: str, outline: Outline) -> None:
    assert NASTY not in page
    assert NASTY in outline.text
    scripts = [attributes.get("type") for attributes in outline.named("script")]
    assert scripts == ["application/json", "application/json", None]
    odd = copy.deepcopy(make_report())
    for rows in ("checks", "runs", "error_budgets", "ledgers", "omissions", "studies"):
        for row in odd[rows]:
            row["controller"] = '</script><!--"><b>' if row["controller"] == "fixed" else "adaptive"
    curves = tuple(c for c in make_curves() if c.controller == "adaptive")
    hostile = Outline(rendered(odd, curves=curves))
    assert not hostile.named("b")
    assert '</script><!--"><b>' in hostile.text
    assert len(hostile.named("script")) == 3


def test_data_in_the_page_is_json_that_its_script_can_read(outline: Outline) -> None:
    *data, _ = outline.raw["script"]
    for block in data:
        found = json.loads(block)
        assert [run["controller"] for run in found["runs"]] == ["fixed", "adaptive"]


def test_the_policy_admits_the_pages_own_script_and_style_and_no_network(outline: Outline) -> None:
    policy = outline.named("meta")[1]["content"] or ""
    for name, code in (("style", outline.raw["style"][0]), ("script", outline.raw["script"][-1])):
        digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
        assert f"{name}-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none';")
    assert "http" not in policy
    assert "unsafe" not in policy
    assert not [name for name, attributes in outline.elements if "style" in attributes]


def test_nothing_is_fetched_from_elsewhere(outline: Outline) -> None:
    for _, attributes in outline.elements:
        for key in ("src", "href", "poster", "data", "action"):
            target = attributes.get(key) or ""
            assert target.startswith(("#", "data:")) or target in ("report.json", "../a.mp4", "")


def test_every_inner_link_has_a_target_and_no_id_stands_twice(outline: Outline) -> None:
    ids = Counter(attributes["id"] for _, attributes in outline.elements if "id" in attributes)
    assert [name for name, count in ids.items() if count > 1] == []
    targets = [a["href"][1:] for a in outline.named("a") if (a.get("href") or "").startswith("#")]
    assert len(targets) > 50
    assert set(targets) <= set(ids)
    for _, attributes in outline.elements:
        for key in ("aria-labelledby", "aria-describedby"):
            assert attributes.get(key, next(iter(ids))) in ids


def test_the_page_is_built_for_every_reader(outline: Outline) -> None:
    assert outline.open == []
    assert outline.named("html")[0]["lang"] == "en"
    assert all(image.get("alt") for image in outline.named("img"))
    assert all(cell.get("scope") for cell in outline.named("th"))
    assert len(outline.named("caption")) == len(outline.named("table"))
    levels = [int(tag[1]) for tag, _ in outline.elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    labels = {"aria-label", "aria-labelledby"}
    for tag, attributes in outline.elements:
        if attributes.get("role") in ("region", "group") or tag == "nav":
            assert labels & set(attributes), (tag, attributes)


def test_what_was_not_part_of_the_run_is_said_and_how_to_get_it() -> None:
    outline = Outline(rendered(make_report(full=False)))
    assert "Not part of this run: make proof" in outline.text
    assert "Not judged in this run" in outline.text
    assert "None were drawn in this run." in outline.text
    assert "There are no films here: afl-mujoco render makes them" in outline.text
    ids = {attributes.get("id") for _, attributes in outline.elements}
    targets = {a["href"][1:] for a in outline.named("a") if (a.get("href") or "").startswith("#")}
    assert targets <= ids


def test_runs_that_fell_are_shown_as_far_as_they_went() -> None:
    report = make_report()
    for run in report["runs"]:
        run["outcome"] = "fell at 1.2 s"
        run["metrics"] |= {"objective": None, "iae_z": None}
    report["error_budgets"] = []
    outline = Outline(rendered(report, curves=make_curves(fell_at=1200)))
    assert "fell at 1.2 s" in outline.text
    assert "No run was completed as deployed" in outline.text


def test_a_report_without_checks_does_not_pass() -> None:
    report = make_report() | {"checks": [], "verdict": "fail"}
    assert "FAIL 0 of 0 checks fail" in Outline(rendered(report)).text


def test_a_film_is_played_linked_or_said_to_be_missing() -> None:
    inside = film(source="data:video/mp4;base64,AAAA", title="inside")
    gone = film(size=0, name="gone.mp4", title="gone", scenario=None)
    page = rendered(make_report(), films=(film(), inside, gone))
    outline = Outline(page)
    assert [video["src"] for video in outline.named("video")] == ["../a.mp4", inside.source]
    assert "Linked: a.mp4, 1.2 MB, which must stay where it is beside this page." in outline.text
    assert "Inside this page, 1.2 MB." in outline.text
    assert "gone.mp4 is not there: afl-mujoco render step-step makes it." in outline.text


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours, as WCAG 2 defines it."""

    def luminance(colour: str) -> float:
        parts = (int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
        linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("place", [0, 1], ids=["light", "dark"])
def test_text_stands_out_from_its_ground(outline: Outline, place: int) -> None:
    blocks = re.findall(r":root \{(.*?)\}", outline.raw["style"][0], re.DOTALL)
    colours = dict(re.findall(r"--([\w-]+): (#\w{6});", blocks[place]))
    for text in ("ink", "faint", "link", "good", "bad", "part", "open"):
        for ground in ("paper", "ground", "sunk"):
            assert contrast(colours[text], colours[ground]) >= 4.5, (text, ground)
        if f"{text}-ground" in colours:
            assert contrast(colours[text], colours[f"{text}-ground"]) >= 4.5, text
    for number in range(1, 7):
        assert contrast(colours[f"series-{number}"], colours["paper"]) >= 3.0, number
