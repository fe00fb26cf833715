"""The page says what the report says, to everyone, and nothing else happens in it."""

import base64
import hashlib
import itertools
import json
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from afl_mujoco.cli.study import _reproduce, inputs_of, require_page, write_page
from afl_mujoco.control.names import PAPER
from afl_mujoco.errors import FileError
from afl_mujoco.studies.estimation import CASES
from afl_mujoco.studies.shared.contract import find_study
from afl_mujoco.studies.shared.record import PAGE, save_record
from tests import study_results
from tests.verification_result import NASTY, film_entry, make_result, write_listing

VOID = {"meta", "link", "img", "input", "br", "path", "circle", "use", "rect"}


class Outline(HTMLParser):
    """Elements with their attributes, and the text that a reader sees."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements, self.texts, self.open = [], [], []
        self.raw = {"style": [], "script": []}
        self.feed(page)
        self.close()
        self.text = re.sub(r"\s+", " ", "".join(self.texts)).strip()

    def handle_starttag(self, tag: str, attributes) -> None:
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        self.raw.get(self.open[-1] if self.open else "", self.texts).append(data)

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


def made(folder) -> str:
    return write_page(folder, folder).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("renders")
    for name in ("a.mp4", "large.mp4"):
        (folder / name).write_bytes(bytes(1_000))
    names = ("a.mp4", "large.mp4", "gone.mp4")
    write_listing(folder, *(film_entry(name, title=f"{name} {NASTY}") for name in names))
    return study_results.write_records(folder)


@pytest.fixture(scope="module")
def page(folder) -> str:
    return made(folder)


@pytest.fixture(scope="module")
def outline(page: str) -> Outline:
    return Outline(page)


def test_the_same_files_give_the_same_bytes_with_headlines_and_commands(page, folder, outline):
    assert made(folder) == page
    text = outline.text
    for name in study_results.RESULTS:
        report = study_results.record(name).report
        assert f"afl-mujoco {name} --made-up" in text
        headline = " ".join(f"{report.word} {report.headline}".split())
        assert text.index(headline) < text.index("Reproduce afl-mujoco")


def test_a_verification_that_fails_says_so_first_and_without_one_there_is_no_verdict(tmp_path):
    failed = replace(study_results.record("validate"), result=make_result(b3=3.4e-7))
    save_record(failed, tmp_path, figures=False)
    text = Outline(made(tmp_path)).text
    assert text.startswith("FAIL: ") and "PASS" not in text
    (other := tmp_path / "other").mkdir()
    save_record(study_results.record("margins"), other, figures=False)
    text = Outline(made(other)).text
    assert text.startswith("Stability margins") and "PASS" not in text and "FAIL" not in text


def test_a_record_says_which_scenarios_and_controllers_it_is_of() -> None:
    for name, options, scenarios, controllers in (
        ("validate", {"scenarios": ("nominal",)}, ["nominal"], PAPER),
        ("compare", {}, ["step-step"], ["adaptive", "lqr"]),
        ("montecarlo", {}, ["laboratory"], ["adaptive", "lqr"]),
        ("margins", {"scenario": "laboratory", "controllers": ("lqr",)}, ["laboratory"], ["lqr"]),
        ("estimation", {"controller": "adaptive-retuned"}, CASES, ["adaptive-retuned"]),
    ):
        study = find_study(name)
        found = inputs_of(study.parts.prepare(study.parts.Options(**options)))
        things = [f"scenario {one}" for one in scenarios]
        assert [*found] == things + [f"controller {one}" for one in controllers]


def test_results_of_two_versions_of_a_scenario_are_named() -> None:
    both = [replace(study_results.record(name), inputs={"scenario a": name})
            for name in ("validate", "margins")]  # fmt: skip
    first, *_ = _reproduce(both).blocks
    assert first == "**scenario a is not the same in report.json and margins.json.**"
    assert len(_reproduce(both).blocks) == len(_reproduce([both[0], both[0]]).blocks) + 1


def test_a_folder_without_a_result_and_one_with_a_broken_one_are_refused(tmp_path) -> None:
    with pytest.raises(FileError, match="must hold a result: run afl-mujoco validate"):
        write_page(tmp_path, tmp_path)
    (tmp_path / "report.json").write_text("{}")
    for refuse in (write_page, require_page):
        with pytest.raises(FileError, match=r"report\.json is not a result of afl-mujoco validate"):
            refuse(tmp_path, tmp_path)
    require_page(tmp_path, tmp_path, leave_out="validate")  # it will be replaced
    (tmp_path / PAGE).mkdir()
    with pytest.raises(FileError, match=r"report\.html must be a file, but is a folder"):
        require_page(tmp_path, tmp_path, leave_out="validate")


def test_a_name_is_text_whatever_it_contains_and_data_is_json_for_the_script(page, outline) -> None:
    assert NASTY not in page and NASTY in outline.text
    *data, script = [attributes.get("type") for attributes in outline.named("script")]
    assert (*set(data), script) == ("application/json", None)
    *data, _ = outline.raw["script"]
    found = [[run["controller"] for run in json.loads(block)["runs"]] for block in data]
    assert found == [["lqr"], ["fixed", "adaptive"], ["fixed", "adaptive"]]


def test_the_policy_admits_the_pages_own_code_and_nothing_comes_from_elsewhere(outline) -> None:
    policy = outline.named("meta")[1]["content"] or ""
    for name, code in (("style", outline.raw["style"][0]), ("script", outline.raw["script"][-1])):
        digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
        assert f"{name}-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none';") and "http" not in policy
    assert "unsafe" not in policy
    assert not [name for name, attributes in outline.elements if "style" in attributes]
    for _, attributes in outline.elements:
        for key in ("src", "href", "poster", "data", "action"):
            target = attributes.get(key) or ""
            assert target.startswith(("#", "data:")) or target in ("a.mp4", "large.mp4", "")


def test_every_inner_link_has_a_target_no_id_stands_twice_and_a_lost_film_is_named(outline) -> None:
    assert [video["src"] for video in outline.named("video")] == ["a.mp4", "large.mp4"]
    assert "Linked: large.mp4, which must stay where it is beside" in outline.text
    assert "gone.mp4 is not there: afl-mujoco render gone.mp4 makes it." in outline.text
    ids = Counter(attributes["id"] for _, attributes in outline.elements if "id" in attributes)
    assert [name for name, count in ids.items() if count > 1] == []
    targets = [a["href"][1:] for a in outline.named("a") if (a.get("href") or "").startswith("#")]
    assert set(targets) <= set(ids)
    for _, attributes in outline.elements:
        for key in ("aria-labelledby", "aria-describedby"):
            assert attributes.get(key, next(iter(ids))) in ids


def test_the_page_is_built_for_every_reader(outline: Outline) -> None:
    assert outline.open == [] and outline.named("html")[0]["lang"] == "en"
    assert all(image.get("alt") for image in outline.named("img"))
    assert all(cell.get("scope") for cell in outline.named("th"))
    assert len(outline.named("caption")) == len(outline.named("table"))
    levels = [int(tag[1]) for tag, _ in outline.elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    for tag, attributes in outline.elements:
        if attributes.get("role") in ("region", "group") or tag == "nav":
            assert {"aria-label", "aria-labelledby"} & set(attributes), (tag, attributes)


@pytest.mark.parametrize("link", ["a.mp4", "margins-delay.svg", "sub"])
def test_no_link_puts_a_file_from_outside_into_the_page(refuses, tmp_path, link) -> None:
    secret, folder = tmp_path / "secret", tmp_path / "out"
    for path in (secret, folder):
        path.mkdir()
    (secret / "a.mp4").write_bytes(b"of nobody else")
    save_record(study_results.record("margins"), folder)
    inside = "sub/a.mp4" if link == "sub" else "a.mp4"
    write_listing(folder, replace(film_entry("a.mp4"), file=inside, poster="a.png"))
    (folder / link).unlink(missing_ok=True)
    (folder / link).symlink_to(secret if link == "sub" else secret / "a.mp4")
    named = inside if link == "sub" else link
    said = f"out/{named} must lie in its folder, but leads out of it, got {secret}"
    assert said in refuses("report", "out", "--films", "out")


@pytest.mark.parametrize("command", [("report", "out"), ("margins", "nominal")])
def test_films_that_are_asked_for_must_be_there(refuses, tmp_path, command) -> None:
    (tmp_path / "out").mkdir()
    save_record(study_results.record("margins"), tmp_path / "out")
    said = "films gone must be a folder that is there: run afl-mujoco render"
    assert said in refuses(*command, "--films", "gone")
