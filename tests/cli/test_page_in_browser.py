"""The page in a real browser: Debian's Chromium, or CHROME_BIN, without a display.

Skipped where they are not installed; failed instead where AFL_MUJOCO_REQUIRE_BROWSER is set.
"""

import base64
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import mediapy
import numpy as np
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
WIDTHS = (390, 820, 1440)
FRAMES, SIZE, FPS = 20, (48, 64), 10
PATIENCE = 60.0

missing = [str(path) for path in (CHROMIUM, DRIVER) if not path.exists()]
if missing and not os.environ.get("AFL_MUJOCO_REQUIRE_BROWSER"):
    reason = "Debian's packages chromium and chromium-driver are not installed"
    pytest.skip(f"{reason}: no {', '.join(missing)}", allow_module_level=True)

from selenium import webdriver  # noqa: E402
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from selenium.webdriver.remote.webelement import WebElement  # noqa: E402
from selenium.webdriver.support.wait import WebDriverWait  # noqa: E402


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with a film, and one that went away after the page was made."""
    films = tmp_path_factory.mktemp("rend ers & more")
    folder = films / "validation"
    folder.mkdir()
    mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
    frames = np.zeros((FRAMES, *SIZE, 3), dtype=np.uint8)
    for index, frame in enumerate(frames):
        frame[:, 3 * index : 3 * index + 6] = 255
    names = ("linked.mp4", "gone.mp4")
    mediapy.write_video(films / names[0], frames, fps=FPS)
    shutil.copy(films / names[0], films / names[1])
    write_listing(films, *(film_entry(name) for name in names))
    study_results.write_records(folder)
    path = write_page(folder, films)
    (films / names[1]).unlink()
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
    prefer(browser, "light")
    browser.get(page.as_uri())
    browser.get_log("browser")  # a film that is gone is reported on every load
    return browser


def resize(browser: webdriver.Chrome, width: int) -> None:
    metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def prefer(browser: webdriver.Chrome, value: str, what: str = "color-scheme") -> None:
    features = [{"name": f"prefers-{what}", "value": value}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})


def ask(browser: webdriver.Chrome, script: str, *arguments: Any) -> Any:
    return browser.execute_script(f"return {script}", *arguments)


def wait(browser: webdriver.Chrome, script: str, *arguments: Any) -> Any:
    return WebDriverWait(browser, PATIENCE, 0.05).until(lambda b: ask(b, script, *arguments))


def replay(browser: webdriver.Chrome) -> WebElement:
    """Return the first replay of two controllers, drawn."""
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
    """Return what the canvases show."""
    shown = "[...arguments[0].querySelectorAll('canvas')].map(c => c.toDataURL())"
    return ask(browser, shown, found)


def test_it_opens_without_a_word_on_the_console_but_for_the_film_that_is_gone(browser, page):
    browser.get(page.as_uri())
    wait(browser, "document.readyState === 'complete'")
    replay(browser)
    said = [entry["message"] for entry in browser.get_log("browser")]
    assert [message for message in said if "gone.mp4" not in message] == []
    assert ask(browser, "document.title").startswith("FAIL")  # of the comparison; the checks hold


def test_every_image_loads(opened: webdriver.Chrome) -> None:
    wait(opened, "[...document.images].every(i => i.complete)")
    images = ask(opened, "[...document.images].map(i => [i.alt, i.naturalWidth, i.naturalHeight])")
    assert len(images) == 9  # of every study
    assert all(alt and width > 100 and height > 100 for alt, width, height in images)


def test_a_film_plays(opened: webdriver.Chrome) -> None:
    video = opened.find_element(By.CSS_SELECTOR, "video[data-name='linked.mp4']")
    wait(opened, "arguments[0].readyState >= 1", video)
    found = [
        ask(opened, f"arguments[0].{x}", video) for x in ("duration", "videoHeight", "videoWidth")
    ]
    assert found == pytest.approx([FRAMES / FPS, *SIZE], abs=0.05)
    opened.execute_script("arguments[0].muted = true; arguments[0].play()", video)
    wait(opened, "arguments[0].currentTime > 0.1", video)
    opened.execute_script("arguments[0].pause()", video)


def test_a_film_that_is_gone_is_a_line_and_no_broken_player(opened: webdriver.Chrome) -> None:
    wait(opened, "!document.querySelector('video[data-name=\"gone.mp4\"]')")
    line = opened.find_element(By.CSS_SELECTOR, "p.missing").text
    assert line.startswith("gone.mp4 is not where this page looks for it")


def test_a_link_to_something_folded_away_opens_it(opened: webdriver.Chrome) -> None:
    folded = opened.find_element(By.ID, "scenario-2")
    assert not ask(opened, "arguments[0].open", folded)
    opened.find_element(By.CSS_SELECTOR, "nav a[href='#scenario-2']").click()
    wait(opened, "arguments[0].open && arguments[0].getBoundingClientRect().top < 300", folded)


@pytest.mark.parametrize("unfolded", [False, True], ids=["as it opens", "all unfolded"])
@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_sticks_out_sideways(opened: webdriver.Chrome, width: int, unfolded: bool) -> None:
    resize(opened, width)
    if unfolded:
        opened.execute_script("document.querySelectorAll('details').forEach(d => d.open = true)")
    replay(opened)
    wait(opened, "document.documentElement.scrollWidth <= arguments[0]", width)
    cut = ask(
        opened,
        "[...document.querySelectorAll('main p, main h1, main h2, main dd, main li, main button')]"
        ".filter(e => e.checkVisibility() && !e.closest('.scroll, .canvas') && "
        "e.getBoundingClientRect().right > arguments[0] + 1).map(e => e.textContent)",
        width,
    )
    assert cut == []


@pytest.mark.parametrize("kind", [".scroll", ".picture .canvas"])
def test_what_scrolls_sideways_has_a_shadow_where_more_is_to_come(opened, kind) -> None:
    resize(opened, 390)
    found = ask(opened, "[...document.querySelectorAll(arguments[0])].filter(e => "
        "e.scrollWidth > e.clientWidth).map(e => getComputedStyle(e).backgroundAttachment)",
        kind)  # fmt: skip
    assert found
    assert all("local" in one and "scroll" in one for one in found)
    drawn = ask(opened, "[...document.querySelectorAll('.picture img')].map(e => "
        "getComputedStyle(e).mixBlendMode)")  # fmt: skip
    assert set(drawn) == {"multiply"}  # else a white figure hides the shadow behind it


def test_the_slider_moves_the_picture_of_each_controller(opened: webdriver.Chrome) -> None:
    found = replay(opened)
    start = pictures(opened, found)
    assert len(start) == 2 and time_of(opened, found) == 0.0
    slide(opened, found, 0.5)
    later = pictures(opened, found)
    assert all(one != other for one, other in zip(start, later, strict=True))
    assert later[0] != later[1]  # each has its own colour
    said = found.find_element(By.TAG_NAME, "output").text
    assert said.startswith("t = 0.50 s") and "cart_mass" in said
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


def test_a_replay_goes_by_the_keyboard(opened: webdriver.Chrome) -> None:
    found = replay(opened)
    slider = found.find_element(By.TAG_NAME, "input")
    slider.send_keys(Keys.ARROW_RIGHT * 3 + Keys.ARROW_LEFT)
    assert time_of(opened, found) == pytest.approx(0.2)
    assert slider.get_attribute("aria-valuetext").startswith("t = 0.20 s")
    slider.send_keys(Keys.SPACE)
    wait(opened, "Number(arguments[0].value) > 0.4", slider)
    slider.send_keys(Keys.SPACE)
    button = found.find_element(By.TAG_NAME, "button")
    assert button.get_attribute("aria-label") == "Play"
    button.send_keys(Keys.SPACE)  # presses it, once
    assert button.get_attribute("aria-label") == "Pause"


def test_who_wants_little_motion_gets_pictures_a_second_apart(opened: webdriver.Chrome) -> None:
    prefer(opened, "reduce", "reduced-motion")
    found = replay(opened)
    opened.execute_script(
        "window.seen = new Set(); const slider = arguments[0].querySelector('input');"
        "window.watching = setInterval(() => window.seen.add(slider.value), 10)", found,
    )  # fmt: skip
    found.find_element(By.TAG_NAME, "button").click()
    wait(opened, "window.seen.has('2')")
    assert ask(opened, "[...window.seen].sort()") == ["0", "1", "2"]
    opened.execute_script("clearInterval(window.watching)")


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


def test_dark_is_dark_and_light_is_light_and_replays_follow(opened: webdriver.Chrome) -> None:
    def ground() -> list[float]:
        colour = ask(opened, "getComputedStyle(document.documentElement).backgroundColor")
        return [float(x) for x in colour.strip("rgba()").split(",")[:3]]

    found = replay(opened)
    light, drawn = ground(), pictures(opened, found)
    prefer(opened, "dark")
    wait(opened, "matchMedia('(prefers-color-scheme: dark)').matches")
    assert min(light) > 200.0
    assert max(ground()) < 60.0
    dark = pictures(opened, found)
    assert all(one != other for one, other in zip(drawn, dark, strict=True))
    prefer(opened, "light")
    drawn = "arguments[0].querySelector('canvas').toDataURL()"
    wait(opened, f"{drawn} !== arguments[1]", found, dark[0])


def test_the_keyboard_reaches_skip_link_contents_and_replays(opened: webdriver.Chrome) -> None:
    focus = "(e => e.getAttribute('href') || e.tagName.toLowerCase())(document.activeElement)"
    reached = []
    for _ in range(8):
        ActionChains(opened).send_keys(Keys.TAB).perform()
        reached.append(ask(opened, focus))
    assert reached[0] == "#main"
    assert {"#validate", "#checks"} <= set(reached)
    skip = opened.find_element(By.CSS_SELECTOR, ".skip")
    opened.execute_script("arguments[0].focus()", skip)
    assert ask(opened, "arguments[0].getBoundingClientRect().top >= 0", skip)
    skip.send_keys(Keys.ENTER)
    assert ask(opened, "document.activeElement.id") == "main"
    button = replay(opened).find_element(By.TAG_NAME, "button")
    opened.execute_script("arguments[0].focus()", button)
    ActionChains(opened).send_keys(Keys.TAB).perform()
    assert ask(opened, "document.activeElement.type") == "range"
    assert ask(opened, "getComputedStyle(document.activeElement).outlineStyle") != "none"


def test_contents_fold_away_on_a_small_screen(opened: webdriver.Chrome) -> None:
    resize(opened, 390)
    contents = opened.find_element(By.CSS_SELECTOR, ".contents details")
    link = contents.find_element(By.CSS_SELECTOR, "a[href='#claims']")
    wait(opened, "!arguments[0].open", contents)
    assert not link.is_displayed()
    contents.find_element(By.TAG_NAME, "summary").click()
    link.click()
    wait(opened, "!arguments[0].open", contents)
    wait(opened, "Math.abs(document.getElementById('claims').getBoundingClientRect().top) < 120")


def test_without_script_everything_but_the_replays_is_there(opened, page) -> None:
    opened.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        opened.get(page.as_uri())
        opened.find_element(By.CSS_SELECTOR, "#scenario-1 > summary").click()
        main = opened.find_element(By.TAG_NAME, "main")
        assert "CODES AGREE 22/22" in main.text
        assert "the replay needs JavaScript" in main.text
        assert not opened.find_element(By.CSS_SELECTOR, ".replay").is_displayed()
        assert opened.find_element(By.TAG_NAME, "video").is_displayed()
    finally:
        opened.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


def test_it_prints(opened: webdriver.Chrome) -> None:
    printed = opened.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69})
    document = base64.b64decode(printed["data"])
    assert document.startswith(b"%PDF")
    pages = document.count(b"/Type /Page\n") + document.count(b"/Type /Page/")
    assert 3 <= pages <= 35
    assert not ask(opened, "document.getElementById('scenario-2').open")  # folded again
