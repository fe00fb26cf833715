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
    printed = run(snippet("README.md"), ROOT)
    assert "lqr passes 10 of 10 draws; adaptive passes 0 of 10 draws, else misses" in printed
    assert "; mine passes 10 of 10 draws" in printed
    assert printed.count("recovers within 3.5 s ") == 3  # a row for each


def test_the_scenario_of_the_guide_is_written_and_read_again(tmp_path: Path) -> None:
    run(snippet("docs/howto/plant.md"), tmp_path)
    scenario = afl.load_scenario(tmp_path / "my-cart-again.toml")
    assert (scenario.name, scenario.pole_mass) == ("my-cart", 0.1)
    assert len(scenario.disturbances) == 1
    assert scenario.half_length.breakpoints == (0.0, 2.0, 6.0, 8.0)
