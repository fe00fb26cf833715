"""Files of the user's are found where they are, taken as they are now, and no other's."""

import importlib
import json
import os
import pickle
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.loading import files_behind
from afl_mujoco.plants.plant import load_plant
from afl_mujoco.pool import open_processes
from tests.plants.plants import small


def answer(controller):
    return controller.command(0.0, np.zeros(4), np.array([1.0, 0.05, 0.5, 9.81]))


@pytest.mark.parametrize("load", [
    lambda name: answer(afl.find_controller(f"{name}:f")),
    lambda name: load_plant(f"{name}:plant").parameters["p"].value,
    lambda name: load_plant(f"{name}.py:plant").parameters["p"].value,
], ids=["controller", "plant of a module", "plant of a file"])  # fmt: skip
@pytest.mark.parametrize("before", [True, False], ids=["imported before", "new"])
@pytest.mark.parametrize("kept", [True, False], ids=["with bytecode", "without"])
def test_files_that_were_edited_are_run_again_once_with_what_imports_them(
    tmp_path, monkeypatch, load, before, kept
):
    """Edits are of one length, within a second, but of what the user imported."""
    monkeypatch.setattr(sys, "dont_write_bytecode", not kept)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "ran", ran := [], raising=False)

    def write(inner, own):
        text = f"import again_own\nX = again_own.X + {inner}\ndef f(t, x, b): return X\n"
        Path("again_inner.py").write_text(text)
        Path("again_own.py").write_text(f"import sys\nX = {own}\nsys.ran.append(X)\n")

    text = "from dataclasses import replace\nfrom afl_mujoco import Parameter\n"
    text += "from again_inner import X, f\nfrom tests.plants.plants import PENDULUM\n"
    text += "plant = replace(PENDULUM, parameters={'p': Parameter(X)}, write=lambda p: {})\n"
    Path("again_outer.py").write_text(text)
    write(0.0, 90.125)
    if before:
        importlib.import_module("again_outer")
    for inner, own in ((1.0, 10.0), (1.0, 20.0), (2.0, 20.0), (3.0, 30.0)):
        write(inner, own)
        assert [load("again_outer") for _ in range(2)] == [own + inner] * 2
    assert ran == [90.125] * before + [10.0, 20.0, 20.0, 30.0]
    Path("again_own.py").write_text("X = 40.0\nX = 1 / 0\n")
    for _ in range(2):
        with pytest.raises(InvalidValueError, match="cannot be imported: ZeroDivisionError"):
            load("again_outer")


def test_an_edit_reaches_every_controller_that_imports_it_and_no_worker(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inner = tmp_path / "edited_within" / "inner.py"
    inner.parent.mkdir()
    for name in ("one", "two"):
        text = "from .inner import K\ndef f(t, x, b): return K\n"
        (inner.parent / f"{name}.py").write_text(text)
    (inner.parent / "__init__.py").touch()
    for k in (1.0, 2.0, 3.0):
        inner.write_text(f"K = {k}\n")
        monkeypatch.chdir(tmp_path if k == 1.0 else "/")
        both = [afl.find_controller(f"edited_within.{name}:f") for name in ("one", "two")]
        assert [answer(one) for one in both] == [k, k]
    inner.write_text("K = 4.0\n")
    with pytest.raises(InvalidValueError, match="must not change while it runs"):
        with open_processes(1) as compute:  # refused by the worker, which lives on
            list(compute(repr, both))
    inner.unlink()
    with pytest.raises(InvalidValueError, match="needs a module: No module named 'edited_within"):
        afl.find_controller("edited_within.one:f")


def test_a_module_may_name_its_own_controller_while_it_is_imported(module):
    text = "import afl_mujoco as afl\ndef f(t, x, b): return 1.0\nRUNS = globals().get('RUNS', 0)"
    module("named_within", f"{text} + 1\nFOUND = afl.find_controller('named_within:f')\n")
    found = afl.find_controller("named_within:f")
    assert answer(found) == 1.0 and sys.modules["named_within"].RUNS == 1


def test_a_file_is_that_of_the_working_directory_also_after_another(tmp_path, monkeypatch):
    for place, number in (("a", 1.0), ("b", 22.0), ("b", 333.0), ("a", 1.0)):
        (tmp_path / place).mkdir(exist_ok=True)
        monkeypatch.chdir(tmp_path / place)
        Path("placed.py").write_text(f"def f(t, x, b): return {number}\n")
        assert answer(afl.find_controller("placed:f")) == number
    first = sys.modules["placed"]
    shutil.rmtree(tmp_path / "a")
    monkeypatch.chdir(tmp_path / "b")
    found = afl.find_controller("placed:f")
    assert answer(found) == 333.0
    assert found.describe()["function"] == "placed.f"
    assert answer(pickle.loads(pickle.dumps(found))) == 333.0
    assert importlib.import_module("placed") is first  # to whom it is another's


@pytest.mark.parametrize("spec", ["below_{}/ctl.py:f", "below_{}.ctl:f"])
def test_a_file_in_a_folder_of_the_name_of_another_is_refused(spec, tmp_path, monkeypatch):
    spec = spec.format(len(spec))
    for place in ("a", "b"):
        folder = tmp_path / place / spec[: spec.index("ctl") - 1]
        folder.mkdir(parents=True)
        (folder / "ctl.py").write_text("import json, time\ndef f(t, x, b): return 1.0\n")
        for installed in ("json", "time"):
            (tmp_path / place / f"{installed}.py").write_text("def broken(:\n")  # not imported
        monkeypatch.chdir(tmp_path / place)
        if place == "a":
            afl.find_controller(spec)
    with pytest.raises(InvalidValueError, match=f"import of .*ctl must be of {tmp_path}/b/"):
        afl.find_controller(spec)


@pytest.mark.parametrize("spec", ["m_file:f", "./m_file.py:f", "sub/m_file.py:f"])
def test_a_file_names_the_module_that_it_is(spec, module, tmp_path):
    (tmp_path / "sub").mkdir()
    for place in ("m_file", "sub/m_file"):
        (tmp_path / f"{place}.py").write_text("def f(t, x, b): return 3.0\n")
    found = afl.find_controller(spec)
    assert found.name == ("sub.m_file.f" if "sub" in spec else "m_file.f")
    assert answer(found) == 3.0
    assert pickle.loads(pickle.dumps(found)).name == found.name


@pytest.mark.parametrize("first", ["controller", "plant"])
def test_a_module_beside_a_file_is_never_taken_from_another_folder(first, module, tmp_path):
    folders, name = {"controller": tmp_path, "plant": tmp_path / "plants"}, f"helps_{first}"
    folders["plant"].mkdir()
    for kind, folder in folders.items():
        (folder / f"{name}.py").write_text("LENGTH = 0.5\n")
        (folder / f"{kind}_{name}.py").write_text(f"def length():\n    import {name}\n")
    module(f"used_{name}", f"from controller_{name} import length\ndef f(t, x, b): return 0.0\n")
    loads = {
        "controller": lambda: afl.find_controller(f"used_{name}:f"),
        "plant": lambda: small(folders["plant"], ("def write", f"import plant_{name}\ndef write")),
    }
    loads.pop(first)()
    importlib.import_module(name)  # as a call would
    ((second, load),) = loads.items()
    mine, other = (re.escape(f"{folders[one]}/{name}.py") for one in (second, first))
    said = f"import of {name} must be of {mine}: give one of the two another name, got {other}$"
    with pytest.raises(InvalidValueError, match=said):
        load()


def test_the_file_of_a_plant_takes_no_other_module_s_name(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "of_two.py").write_text("HERE = True\n")
    folder = tmp_path / "below"
    folder.mkdir()
    small(folder)
    for name in ("of_two", "json"):
        (folder / "small.py").rename(folder / f"{name}.py")
        assert load_plant(f"{name}.py:plant", folder).name == "small"
        (folder / f"{name}.py").rename(folder / "small.py")
    assert importlib.import_module("json") is json and importlib.import_module("of_two").HERE


def test_a_worker_refuses_a_file_that_changed_since_it_was_read(module, tmp_path):
    module("changing", "def force(time, state, belief):\n    return 1.0\n")
    found = afl.find_controller("changing:force")
    again = pickle.loads(sent := pickle.dumps(found))
    assert again == found and again.describe() == found.describe()
    module("changing", "def force(t, x, belief):\n    return 2.0\n")  # as in a fresh process
    os.utime(tmp_path / "changing.py", (1.0, 1.0))
    with pytest.raises(InvalidValueError, match="must not change while it runs, but its file or"):
        pickle.loads(sent)
    assert found.describe()["source"] == again.describe()["source"]  # of what was loaded


def test_our_own_files_are_no_user_s_wherever_they_are():
    assert files_behind(Path(afl.__file__).parent.parent, ["afl_mujoco"]) == {}
