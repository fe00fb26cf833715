"""A wheel, built as a user's installer would and installed elsewhere, is complete."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PROGRAM = """
import afl_mujoco as afl
p = afl.CartPoleParameters(cart_mass=1.3, pole_mass=0.07, half_length=0.4, gravity=9.7)
print(afl.__file__, afl.CartPoleModel(p).mj_model.body_mass.sum())
"""


def python(*arguments: str | Path, **options: object) -> str:
    run = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, **options)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


@pytest.mark.slow
def test_a_wheel_installed_elsewhere_is_complete(tmp_path: Path) -> None:
    dist, installed = tmp_path / "dist", tmp_path / "elsewhere"
    python("-m", "build", "--no-isolation", "--outdir", dist, ROOT)
    (wheel,) = dist.glob("*.whl")
    python("-m", "pip", "install", "--quiet", "--no-deps", "--target", installed, wheel)
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    home, mass = python("-c", PROGRAM, cwd=tmp_path, env=environment).split()
    assert Path(home).is_relative_to(installed)
    assert float(mass) == pytest.approx(1.37, rel=1e-12)  # it finds its models
    files = [path.relative_to(ROOT) for path in ROOT.glob("afl_mujoco/**/*") if path.is_file()]
    expected = {path for path in files if "__pycache__" not in path.parts}
    expected |= {Path("afl_mujoco") / x.relative_to(ROOT) for x in ROOT.glob("models/*.xml")}
    assert [path for path in sorted(expected) if not (installed / path).is_file()] == []
    assert not (installed / "research").exists()
