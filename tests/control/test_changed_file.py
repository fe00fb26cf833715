"""A controller's file that changes between the process that read it and its workers."""

import os
import pickle
import sys

import pytest

import afl_mujoco as afl
from afl_mujoco.control.own import load_python_controller

TEXT = "def force(time, state, belief):\n    return {}\n"


def test_a_worker_refuses_a_file_that_changed_since_it_was_read(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "changing_controller.py"
    file.write_text(TEXT.format("1.0"))
    found = load_python_controller("changing_controller:force")
    sent = pickle.dumps(found)
    again = pickle.loads(sent)
    assert again == found and again.describe() == found.describe()
    file.write_text(TEXT.format("2.0"))
    os.utime(file, (1.0, 1.0))
    monkeypatch.delitem(sys.modules, "changing_controller")  # as in a fresh process
    with pytest.raises(afl.AflMujocoError, match="must not change while it runs, but its file did"):
        pickle.loads(sent)
    assert found.describe()["source"] == again.describe()["source"]  # of what was loaded
