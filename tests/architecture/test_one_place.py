"""What is added in one place is everywhere."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

TOY = '''
    stiction: float = _declared(
        0.0, _not_negative, "N",
        Imperfection(name="stiction", title="stiction", unit="mN", fields={"stiction": 1.0},
            scale=1e3, reference=0.1, benign=0.01, harsh=10.0),
        why="dust",
        drawn=Draw(11, (0.0, 0.5), "swept, to dusty", "stiction [mN]", 1e3),
    )
    """A toy."""
    seed: int ='''

LOOK = """
from pathlib import Path
import numpy as np
from afl_mujoco.cli.tables import tables
from afl_mujoco.scenario.files import load_scenario
from afl_mujoco.studies.monte_carlo.features import FEATURES
from afl_mujoco.studies.monte_carlo.space import SampleSpace
from afl_mujoco.studies.thresholds.imperfections import COMBINED, added, imperfections_at
from afl_mujoco.studies.thresholds.sweep import names_of

Path("toy.toml").write_text("imperfections.stiction = 0.25")
scenario = load_scenario("toy.toml")
assert scenario.imperfections.stiction == 0.25
assert FEATURES["stiction [mN]"](scenario) == 250.0
assert names_of(())[-2:] == ("stiction", "combined") and added()[-1].name == "stiction"
assert imperfections_at(COMBINED, 2.0).stiction == 0.2
space = SampleSpace()
assert space.coordinates[-1] == "stiction"
assert space.scenario_of(np.ones(space.dimension), 0, 0).imperfections.stiction == 0.5
found = tables()
assert "| `stiction` | N | 0.0 | A toy |" in found["notation.md", "imperfections"]
row = "| `stiction` | `stiction` | 100 mN | 10 to 10 000 mN | dust |"
assert row in found["robustness.md", "reference hardware"].replace(chr(0x202f), " ")
assert "| `stiction` | N | 0 to 0.5 | swept, to dusty |" in found["montecarlo.md", "space"]
"""


def test_an_imperfection_is_declared_once(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "afl_mujoco", tmp_path / "afl_mujoco")
    source = tmp_path / "afl_mujoco" / "scenario" / "imperfections.py"
    before, after = source.read_text().split("\n    seed: int =")
    source.write_text(before + TOY + after)
    run = subprocess.run(
        [sys.executable, "-c", LOOK],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
