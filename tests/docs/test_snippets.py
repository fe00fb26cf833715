"""What the README and the guides show in Python runs as it stands."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import afl_mujoco as afl

ROOT = Path(__file__).parents[2]


def snippet(page: str) -> str:
    """Return the first Python of a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return text.split("```python\n")[1].split("```")[0]


def run(text: str, folder: Path) -> str:
    """Return what Python prints."""
    done = subprocess.run(
        [sys.executable, "-c", text], cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_controller_of_the_readme_meets_every_requirement_of_its_rig() -> None:
    lines = [line.split() for line in run(snippet("README.md"), ROOT).splitlines()]
    mine = [line for line in lines if line[0] == "mine"]
    assert [len(mine), len(lines)] == [5, 15]
    assert all(float(left) >= 0.0 for _, _, left, *_ in mine)


def test_the_scenario_of_the_guide_is_written_and_read_again(tmp_path: Path) -> None:
    run(snippet("docs/howto/plant.md"), tmp_path)
    scenario = afl.load_scenario(tmp_path / "my-cart-again.toml")
    assert (scenario.name, scenario.pole_mass) == ("my-cart", 0.1)
    assert len(scenario.disturbances) == 1
    assert scenario.half_length.breakpoints == (0.0, 2.0, 6.0, 8.0)
