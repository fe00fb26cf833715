"""What is added in one place is everywhere."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

TOY = "    stiction: NotNegative = 0.0\n"
SAID = "    stiction\n        A toy.\n"
DECLARED = """    "stiction": Declaration("N",
        (Imperfection(name="stiction", title="stiction", unit="mN", fields={"stiction": 1.0},
            scale=1e3, reference=0.1, benign=0.01, harsh=10.0),),
        why="dust",
        drawn=Draw(11, (0.0, 0.5), "swept, to dusty")),
"""

LOOK = """
from pathlib import Path
import numpy as np
from docs.tables import tables
from afl_mujoco.scenario.files import load_scenario
from afl_mujoco.scenario.catalogue import LABORATORY
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.studies.shared.robustness import COMBINED, KNOWN, added, hardware_at

Path("toy.toml").write_text("imperfections.stiction = 0.25")
scenario = load_scenario("toy.toml")
assert scenario.imperfections.stiction == 0.25
assert [*KNOWN][-2:] == ["stiction", "combined"] and added()[-1].name == "stiction"
assert hardware_at(COMBINED, 2.0)["stiction"] == 0.2
space = SampleSpace(LABORATORY)
assert space.coordinates[-1] == "stiction"
assert space.scenario_of(np.ones(space.dimension), 0, 0).imperfections.stiction == 0.5
found = tables()
assert "| `stiction` | N | 0.0 | A toy |" in found["imperfections"]
row = "| `stiction` |  | 100 mN | 10 to 10 000 mN | dust |"
assert row in found["reference hardware"].replace(chr(0x202f), " ")
assert "| `stiction` | N | 0 to 0.5 | swept, to dusty |" in found["space"]
"""


def insert(source: Path, before: str, text: str) -> None:
    first, second = source.read_text().split(before)
    source.write_text(first + text + before + second)


def test_an_imperfection_touches_one_file(tmp_path: Path) -> None:
    package = shutil.copytree(ROOT / "afl_mujoco", tmp_path / "afl_mujoco")
    source = package / "scenario" / "imperfections.py"
    insert(source, "    seed: Annotated", TOY)
    insert(source, "    seed\n        Seed of the noise", SAID)
    insert(source, '})  # fmt: skip\n"""The declaration of each number', DECLARED)
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    subprocess.run([sys.executable, "-c", LOOK], cwd=tmp_path, env=environment, check=True)
