"""What the README and the guides show in Python runs as it stands."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import afl_mujoco as afl
import afl_mujoco.studies as studies

ROOT = Path(__file__).parents[2]


def snippet(page: str, kind: str = "python") -> str:
    return (ROOT / page).read_text(encoding="utf-8").split(f"```{kind}\n")[1].split("```")[0]


def run(text: str, folder: Path) -> str:
    return subprocess.check_output([sys.executable, "-c", text], cwd=folder, text=True, timeout=300)


def verdicts(table: str) -> dict[str, str]:
    row = r"\|? (\S.+?)(?: \| | {2,})(.*[✓✗◐].*)"  # in Markdown or on a terminal
    rows = (re.match(row, line.replace("\\|", "|")) for line in table.splitlines())
    return {row[1]: re.sub(r"[^✓✗◐]", "", row[2]) for row in rows if row}


@pytest.mark.slow
def test_what_the_readme_says_is_printed_is_printed() -> None:
    found = verdicts((ROOT / "README.md").read_text(encoding="utf-8"))
    assert found["recovers within 3.5 s"] == "✓✗✓"  # lqr, adaptive, mine
    assert len(found) == 5 and verdicts(run(snippet("README.md"), ROOT)) == found


def test_the_scenario_of_the_guide_is_written_and_read_again(tmp_path: Path) -> None:
    run(snippet("docs/howto/plant.md"), tmp_path)
    scenario = afl.load_scenario(tmp_path / "my-cart-again.toml")
    assert (scenario.name, scenario.pole_mass) == ("my-cart", 0.1)
    assert len(scenario.disturbances) == 1
    assert scenario.half_length.breakpoints == (0.0, 2.0, 6.0, 8.0)


def test_the_study_of_the_guide_is_a_command(tmp_path: Path, monkeypatch, command_line) -> None:
    (tmp_path / "falling.py").write_text(snippet("docs/howto/study.md"))
    monkeypatch.setattr(studies, "__path__", [*studies.__path__, str(tmp_path)])
    code, output, errors = command_line("falling", "--no-page", "--out", "out")
    assert (code, errors) == (0, "")
    assert output.splitlines()[-1] == "1 of 2 controllers keep the pole up."
    assert (tmp_path / "out" / "falling.json").is_file()


def test_the_plant_of_the_guide_has_the_mistake_that_it_says_and_is_mended(tmp_path, command_line):
    parts = [snippet("docs/howto/own_plant.md", kind) for kind in ("xml", "text", "python")]
    mjcf, said, plant = parts
    (tmp_path / "furuta.xml").write_text(mjcf)
    (tmp_path / "furuta.py").write_text(plant)
    arguments = ("check", "furuta.py:plant", "--no-page", "--out", "checked")
    code, output, errors = command_line(*arguments)
    assert (code, output.splitlines()[-1], errors) == (1, said.strip(), "")
    mended = plant.replace("        twist * v[0]", "        2 * twist * v[0]")
    assert mended != plant
    (tmp_path / "furuta.py").write_text(mended)
    code, output, errors = command_line(*arguments)
    assert (code, errors) == (0, "")
    assert output.splitlines()[-1].startswith("PASS: furuta: MuJoCo obeys the equations at 1000")


@pytest.mark.slow
def test_the_tutorial_prints_what_its_page_shows(tmp_path: Path) -> None:
    for part in ("tutorial", "pages/tutorial"):
        shutil.copytree(ROOT / "docs" / part, tmp_path / part)
    script = shutil.copy(ROOT / "docs" / "tutorial.py", tmp_path)
    printed = run(f"import runpy; runpy.run_path({script!r}, run_name='__main__')", tmp_path)
    page = (ROOT / "docs/tutorial/index.md").read_text(encoding="utf-8")
    shown = [text.split("```")[0] for text in page.split("```text\n")[1:]]
    found = [text for text in printed.split("# %%\n") if text]
    assert len(shown) == len(found) == 4 and shown[:2] == found[:2]
    assert [*map(verdicts, shown)] == [*map(verdicts, found)]
    assert verdicts(shown[3])["|F| exerted at most 110 N"] == "✗✓"  # mine, Filtered
