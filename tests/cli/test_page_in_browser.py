"""The page in a real browser: Debian's Chromium, or CHROME_BIN, without a display.

Skipped where they are not installed; failed instead where AFL_MUJOCO_REQUIRE_BROWSER is set.
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from afl_mujoco.cli.study import write_page
from afl_mujoco.studies.shared.record import save_record
from tests import study_results
from tests.verification_result import film_entry, make_result, write_listing

pytestmark = pytest.mark.slow

CHROMIUM = Path(os.environ.get("CHROME_BIN", "/usr/bin/chromium"))
DRIVER = Path("/usr/bin/chromedriver")
OPTIONS = (
    "headless=new", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run",
    "disable-background-networking", "disable-component-update", "disable-sync",
    "disable-dev-shm-usage",
)  # fmt: skip
PATIENCE = 60.0

missing = [str(path) for path in (CHROMIUM, DRIVER) if not path.exists()]
if missing and not os.environ.get("AFL_MUJOCO_REQUIRE_BROWSER"):
    reason = "Debian's packages chromium and chromium-driver are not installed"
    pytest.skip(f"{reason}: no {', '.join(missing)}", allow_module_level=True)

from selenium import webdriver  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402
from selenium.webdriver.remote.webelement import WebElement  # noqa: E402
from selenium.webdriver.support.wait import WebDriverWait  # noqa: E402


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    films = tmp_path_factory.mktemp("rend ers & more")
    (folder := films / "validation").mkdir()
    (film := films / "gone.mp4").write_bytes(b"film")
    write_listing(films, film_entry(film.name))
    path = write_page(study_results.write_records(folder), films)
    film.unlink()
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    if missing:
        pytest.fail(f"AFL_MUJOCO_REQUIRE_BROWSER is set, but there is no {', '.join(missing)}")
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for option in OPTIONS:
        options.add_argument(f"--{option}")
    options.add_argument(f"--user-data-dir={tmp_path_factory.mktemp('profile')}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.ChromeService(executable_path=str(DRIVER))
    with webdriver.Chrome(options=options, service=service) as chromium:
        chromium.set_script_timeout(PATIENCE)
        yield chromium


@pytest.fixture
def opened(browser: webdriver.Chrome, page: Path) -> webdriver.Chrome:
    resize(browser, 1440)
    browser.get(page.as_uri())
    browser.get_log("browser")  # a film that is gone is reported on every load
    return browser


def resize(browser: webdriver.Chrome, width: int) -> None:
    metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def ask(browser: webdriver.Chrome, script: str, *arguments: Any) -> Any:
    return browser.execute_script(f"return {script}", *arguments)


def wait(browser: webdriver.Chrome, script: str, *arguments: Any) -> Any:
    return WebDriverWait(browser, PATIENCE, 0.05).until(lambda b: ask(b, script, *arguments))


def replay(browser: webdriver.Chrome) -> WebElement:
    every = browser.find_elements(By.CSS_SELECTOR, ".replay")
    found = next(x for x in every if len(x.find_elements(By.TAG_NAME, "canvas")) == 2)
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", found)
    wait(browser, "[...arguments[0].querySelectorAll('canvas')].every(c => c.dataset.frame)", found)
    return found


def time_of(browser: webdriver.Chrome, found: WebElement) -> float:
    return float(ask(browser, "arguments[0].querySelector('input').value", found))


def slide(browser: webdriver.Chrome, found: WebElement, time: float) -> None:
    browser.execute_script(
        "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))",
        found.find_element(By.TAG_NAME, "input"), time,
    )  # fmt: skip


def pictures(browser: webdriver.Chrome, found: WebElement) -> list[str]:
    shown = "[...arguments[0].querySelectorAll('canvas')].map(c => c.toDataURL())"
    return ask(browser, shown, found)


def test_every_image_loads_without_a_word_on_the_console_but_for_a_film_gone(browser, page):
    browser.get(page.as_uri())
    wait(browser, "document.readyState === 'complete'")
    replay(browser)
    wait(browser, "[...document.images].every(i => i.complete)")
    images = ask(browser, "[...document.images].map(i => [i.alt, i.naturalWidth, i.naturalHeight])")
    assert len(images) == 9  # of every study
    assert all(alt and width > 100 and height > 100 for alt, width, height in images)
    said = [entry["message"] for entry in browser.get_log("browser")]
    assert [message for message in said if "gone.mp4" not in message] == []
    assert ask(browser, "document.title").startswith("FAIL")  # of the comparison; the checks hold
    wait(browser, "!document.querySelector('video[data-name=\"gone.mp4\"]')")  # no broken player
    line = browser.find_element(By.CSS_SELECTOR, "p.missing").text
    assert line.startswith("gone.mp4 is not where this page looks for it")


@pytest.mark.parametrize("width", [390, 820, 1440])
def test_nothing_sticks_out_sideways(opened: webdriver.Chrome, width: int) -> None:
    resize(opened, width)
    opened.execute_script("document.querySelectorAll('details').forEach(d => d.open = true)")
    replay(opened)
    wait(opened, "document.documentElement.scrollWidth <= arguments[0]", width)
    beyond = (
        "[...document.querySelectorAll('main p, main h1, main h2, main dd, main li, main button')]"
        ".filter(e => e.checkVisibility() && !e.closest('.scroll, .canvas') && "
        "e.getBoundingClientRect().right > arguments[0] + 1).map(e => e.textContent)"
    )
    assert ask(opened, beyond, width) == []


def test_the_slider_moves_the_picture_of_each_controller(opened: webdriver.Chrome) -> None:
    found = replay(opened)
    start = pictures(opened, found)
    assert len(start) == 2 and time_of(opened, found) == 0.0
    slide(opened, found, 0.5)
    later = pictures(opened, found)
    assert all(one != other for one, other in zip(start, later, strict=True))
    assert later[0] != later[1]  # each has its own colour
    said = found.find_element(By.TAG_NAME, "output").text
    assert said == "t = 0.50 s · cart_mass 0.5 kg · half_length 0.4 m"
    slide(opened, found, 0.0)
    assert pictures(opened, found) == start


def test_play_plays_and_pauses_and_begins_anew_at_the_end(opened: webdriver.Chrome) -> None:
    found = replay(opened)
    button = found.find_element(By.TAG_NAME, "button")
    button.click()
    assert button.get_attribute("aria-label") == "Pause"
    wait(opened, "Number(arguments[0].querySelector('input').value) > 0.3", found)
    button.click()
    paused = time_of(opened, found)
    assert button.get_attribute("aria-label") == "Play" and 0.3 < paused < 1.9
    ask(opened, "new Promise(done => setTimeout(done, 200))")
    assert time_of(opened, found) == paused
    slide(opened, found, 2.0)
    button.click()
    wait(opened, "Number(arguments[0].querySelector('input').value) < 1", found)


def test_a_run_that_fell_stays_where_it_fell_and_says_so(opened, tmp_path) -> None:
    result = make_result(fell_at=300, outcome="fell at t = 0.3 s")
    save_record(replace(study_results.record("validate"), result=result), tmp_path)
    opened.get(write_page(tmp_path, tmp_path).as_uri())
    found = replay(opened)
    caption = found.find_element(By.TAG_NAME, "figcaption")
    assert "fell" not in caption.text
    slide(opened, found, 1.0)
    assert "fell at t = 0.3 s" in caption.text
    there = pictures(opened, found)
    slide(opened, found, 1.5)
    assert pictures(opened, found)[0] == there[0]


def test_without_script_everything_but_the_replays_is_there(opened, page) -> None:
    opened.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        opened.get(page.as_uri())
        opened.find_element(By.CSS_SELECTOR, "#scenario-1 > summary").click()
        main = opened.find_element(By.TAG_NAME, "main")
        assert "CODES AGREE 22/22" in main.text
        assert "the replay needs JavaScript" in main.text
        assert not opened.find_element(By.CSS_SELECTOR, ".replay").is_displayed()
    finally:
        opened.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
