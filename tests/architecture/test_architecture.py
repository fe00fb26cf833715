"""The rules of the house that no linter knows."""

import ast
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from importlib.metadata import version
from pathlib import Path

import mujoco
import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "afl_mujoco"


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CONTRACTS = {one["id"]: one["name"] for one in PROJECT["tool"]["importlinter"]["contracts"]}
EQUATIONS = "afl_mujoco.plants.cartpole_equations"
INDEX = re.compile(  # a letter of each in brackets, lest this file match itself
    r"pyp[i]\.org|python[h]osted|index[-]url|find[-]links|trusted[-]host|/simple[/]|file[:]//"
)
MODEL_FIELDS = {field for field in dir(mujoco.MjModel) if "_" in field[1:-1]}
MODEL_FIELDS |= {"opt", "vis", "stat", "qpos0", "qpos_spring"}
WRITERS = [PACKAGE / "simulation" / "mujoco_model.py", PACKAGE / "plants" / "writer.py"]


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize(("asked", "heavy"), [
    ("import afl_mujoco", {"dm_control", "matplotlib", "mujoco", "numba", "scipy"}),
    ("from afl_mujoco.cli.main import commands_for; [*commands_for('')]",
     {"matplotlib", "mujoco", "numba", "numpy", "pydantic", "scipy"}),
], ids=["the package", "the list of commands"])  # fmt: skip
def test_what_every_user_waits_for_imports_nothing_heavy_and_is_quick(asked, heavy) -> None:
    program, started = f"{asked}; import sys; print(*sys.modules)", time.perf_counter()
    loaded = subprocess.check_output([sys.executable, "-c", program], cwd=ROOT, text=True).split()
    assert time.perf_counter() - started < 5.0  # half a second on a quiet machine
    assert heavy.isdisjoint(loaded)


def model_writes(code: str):
    for node in ast.walk(ast.parse(code)):
        if not isinstance(getattr(node, "ctx", None), ast.Store | ast.Del):
            continue
        target = node
        while isinstance(target, ast.Attribute | ast.Subscript):
            if isinstance(target, ast.Attribute) and target.attr in MODEL_FIELDS:
                yield f"line {target.lineno}: {ast.unparse(node)}"
                break
            target = target.value


def test_nobody_but_the_writers_writes_to_a_model() -> None:
    for source in (one for one in PACKAGE.rglob("*.py") if one not in WRITERS):
        assert list(model_writes(source.read_text())) == [], source
    for line in (
        "model.body_mass[1] = 2.0", "model.body_inertia[1, :] *= 2.0", "self.mj_model.opt = x",
        "model.opt.timestep, b = 1e-3, 2", "physics.named.model.site_pos['tip', 'z'] = 1.0",
    ):  # fmt: skip
        assert list(model_writes(line)) != [], line


def test_no_committed_file_names_a_package_index() -> None:
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    run = subprocess.run(listing, cwd=ROOT, capture_output=True, text=True)
    if run.returncode:
        pytest.skip("not a git checkout")
    files = [path for name in run.stdout.split("\0") if (path := ROOT / name).is_file()]
    texts = {path: path.read_text() for path in files if b"\0" not in path.read_bytes()}
    assert [relative(path) for path, text in texts.items() if INDEX.search(text)] == []


@pytest.mark.parametrize("lock", sorted(ROOT.glob("requirements*.lock")), ids=relative)
def test_a_lock_pins_versions_and_their_archives_and_says_nothing_else(lock: Path) -> None:
    pin = r"[a-z0-9-]+==[A-Za-z0-9.!+]+( ; [\w\s().'=!<>]+)?( --hash=sha256:[0-9a-f]{64})+"
    lines = re.sub(r" \\\n +", " ", lock.read_text()).splitlines()
    odd = [line for line in lines if not line.startswith("#") and not re.fullmatch(pin, line)]
    assert odd == []


def test_what_is_installed_is_what_pyproject_allows() -> None:
    for line in PROJECT["project"]["dependencies"] + PROJECT["dependency-groups"]["dev"]:
        asked = Requirement(line)
        if asked.marker is None or asked.marker.evaluate():
            assert asked.specifier.contains(version(asked.name), prereleases=True), line


def test_a_commit_has_a_subject_of_at_most_72_characters() -> None:
    for main in ("origin/main", "main"):
        asked = ["git", "log", "--no-merges", "--format=%s", f"{main}..HEAD"]
        run = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True)
        if run.returncode == 0:
            assert [subject for subject in run.stdout.splitlines() if len(subject) > 72] == []
            break


def broken_contracts(folder: Path) -> set[str]:
    command = [Path(sys.executable).with_name("lint-imports"), "--no-cache", "--no-logo"]
    environment = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1"}
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    broken = set(re.findall(r"^(.+) BROKEN", run.stdout, re.MULTILINE))
    assert run.returncode == bool(broken), run.stdout + run.stderr
    return broken


@pytest.fixture
def package_copy(tmp_path: Path) -> Path:
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    ignore = shutil.ignore_patterns("__pycache__")
    for name in ("afl_mujoco", "research"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=ignore)
    return tmp_path


def test_the_import_contracts_hold(package_copy: Path) -> None:
    assert broken_contracts(package_copy) == set()


@pytest.mark.parametrize(("contract", "module", "planted"), [
    ("floors", "plants/cartpole_equations", "afl_mujoco.control"),
    ("research", "cli/main", "research.batch"),
    ("engine-side", "simulation/mujoco_model", "afl_mujoco.simulation.ode"),
    ("engine-side", "simulation/trajectory", EQUATIONS),  # indirectly
    ("engine-side", "simulation/gym_env/environment", EQUATIONS),
    ("analytic-side", "plants/cartpole_equations", "mujoco"),
    ("analytic-side", "../research/batch", "mujoco"), ("analytic-side", "plants/tree", "mujoco"),
    ("analytic-side", "plants/suspects", "mujoco"), ("belief", "control/__init__", EQUATIONS),
    ("search", "../research/genetic", "afl_mujoco.scenario"), ("tree", "plants/tree", EQUATIONS),
    ("writer", "plants/writer", "afl_mujoco.plants.equations"),
])  # fmt: skip
def test_a_planted_import_breaks_its_contract(package_copy, contract, module, planted) -> None:
    source = package_copy / "afl_mujoco" / f"{module}.py"
    source.write_text(f"{source.read_text()}\nimport {planted}\n")
    broken = {contract, "engine-side"} if contract == "writer" else {contract}  # it has the writer
    assert broken_contracts(package_copy) == {CONTRACTS[one] for one in broken}


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
    package = shutil.copytree(PACKAGE, tmp_path / "afl_mujoco")
    shutil.copytree(ROOT / "models", tmp_path / "models")
    source = package / "scenario" / "imperfections.py"
    insert(source, "    seed: Annotated", TOY)
    insert(source, "    seed\n        Seed of the noise", SAID)
    insert(source, '})  # fmt: skip\n"""The declaration of each number', DECLARED)
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    subprocess.run([sys.executable, "-c", LOOK], cwd=tmp_path, env=environment, check=True)
