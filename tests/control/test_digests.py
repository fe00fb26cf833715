"""A digest is that of what a name stands for, whatever the name."""

import dataclasses
import importlib
import sys
from pathlib import Path

import pytest

import afl_mujoco as afl
from afl_mujoco.control.catalogue import digests

LAW = "def mine(time, state, belief):\n    return {gain} * state[1]\n"


def test_a_digest_changes_with_any_value_of_a_scenario_and_with_nothing_else() -> None:
    one = afl.Scenario(name="rig", initial_state=(0.0, 0.1, 0.0, 0.0))
    changes = (
        {"duration": 9.0},
        {"schedule": {"cart_mass": 2.0}},
        {"imperfections": afl.Imperfections(delay=0.01)},
        {"requirements": afl.Requirements(max={"z": 1.0})},
        {"disturbances": (afl.Impulse(momentum=1.0, time=1.0),)},
    )
    found = [digests([dataclasses.replace(one, **change)], []) for change in ({}, *changes)]
    assert {name for digest in found for name in digest} == {"scenario rig"}
    assert len({digest["scenario rig"] for digest in found}) == len(found)
    assert digests([dataclasses.replace(one)], []) == found[0]


def test_a_digest_changes_with_the_file_of_a_controller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    found = []
    for gain in (-40, -40, -50):
        (tmp_path / "digested_law.py").write_text(LAW.format(gain=gain))
        sys.modules.pop("digested_law", None)
        importlib.invalidate_caches()
        names = ("digested_law:mine", "lqr", "lqr-estimated")
        found.append(digests([], [afl.find_controller(name) for name in names]))
    first, again, edited = found
    mine = "controller digested_law.mine"
    assert list(first) == [mine, "controller lqr", "controller lqr-estimated"] and again == first
    assert [name for name in first if edited[name] != first[name]] == [mine]
