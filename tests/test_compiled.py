"""The cache of compiled code: stale exactly when a source that it depends on has changed."""

import subprocess
import sys
from pathlib import Path

import pytest
from numba.core import caching

from afl_mujoco import compiled
from afl_mujoco.errors import AflMujocoWarning

PACKAGE = Path(compiled.__file__).parent
LOOP = "simulation.sampled.loop"


def file_of(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")).with_suffix(".py")


@pytest.mark.parametrize("module", [LOOP, "simulation.ode_fixed_step", "control.controller"])
def test_the_stamp_covers_every_file_that_python_itself_imports(module):
    shown = "print(*(m.__file__ for n, m in sys.modules.items() if n.startswith('afl_mujoco.')))"
    command = [sys.executable, "-c", f"import sys, afl_mujoco.{module}; {shown}"]
    loaded = subprocess.check_output(command, text=True).split()
    always = {PACKAGE / "simulation/gym_env/registration.py"}  # imported with the package itself
    missing = {Path(file) for file in loaded} - compiled._needed(file_of(module)) - always
    assert {file.name for file in missing} <= {"__init__.py"}


def test_an_edit_far_away_leaves_compiled_code_but_not_one_of_an_equation(tmp_path, monkeypatch):
    def stamp(edited: str) -> str:
        for cached in (compiled._needed, compiled._fingerprint):
            cached.cache_clear()
        read = Path.read_bytes
        monkeypatch.setattr(Path, "read_bytes", lambda x: read(x) + b"#" * (x == PACKAGE / edited))
        found = compiled._fingerprint(file_of(LOOP))
        monkeypatch.undo()
        compiled._fingerprint.cache_clear()
        return found

    untouched = stamp("no-such-file.py")
    assert stamp("cli/main.py") == untouched and stamp("control/law.py") != untouched


def test_where_no_cache_can_be_written_code_is_compiled_and_one_line_says_so(monkeypatch):
    def refuse(self):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(caching._CacheLocator, "ensure_cache_path", refuse)
    compiled._warn_of_no_cache.cache_clear()

    with pytest.warns(AflMujocoWarning, match="no folder .* NUMBA_CACHE_DIR") as said:
        functions = [compiled.kernel(lambda x: 2.0 * x), compiled.kernel(lambda x: 3.0 * x)]
    assert len(said) == 1 and [function(2.0) for function in functions] == [4.0, 6.0]
