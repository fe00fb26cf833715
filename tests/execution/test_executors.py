"""Executors: order, bits and errors; deaths of workers; what a signal leaves behind."""

import os
import sys
import time
from pathlib import Path

import pytest

from afl_mujoco import pool
from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.pool import compute_all, in_process, open_executor
from tests.execution import units
from tests.messages import line


def computed(function, folder, workers, kept=None):
    (tried := folder / "tried").mkdir(exist_ok=True)
    with open_executor(workers) as executor:
        return compute_all(function, [(tried, i) for i in range(units.COUNT)], executor, kept=kept)


@pytest.mark.parametrize("workers", [1, 2])
def test_the_results_are_the_serial_ones_bit_for_bit(tmp_path: Path, workers: int) -> None:
    assert repr(computed(units.noted, tmp_path, workers)) == repr(units.SERIAL)
    pids = {path.name.split("-")[1] for path in (tmp_path / "tried").iterdir()}
    assert (str(os.getpid()) in pids) == (workers == 1)


def pids_of(folder: Path) -> set[str]:
    files = list((folder / "tried").iterdir())
    for file in files:
        file.unlink()
    return {file.name.split("-")[1] for file in files}


def test_kept_processes_serve_every_use_until_one_fails_and_end_with_the_block(tmp_path) -> None:
    with pool.kept_processes():
        first: set[str] = set()
        # On a busy machine one of the two may do every unit of a use, and the other appear later;
        # if they were not kept, three uses would show at least three processes.
        for _ in range(3):
            assert repr(computed(units.noted, tmp_path, 2)) == repr(units.SERIAL)
            first |= pids_of(tmp_path)
        assert len(first) <= 2
        with pytest.raises(InvalidValueError):
            computed(units.refused, tmp_path, 2)
        pids_of(tmp_path)
        assert repr(computed(units.noted, tmp_path, 2)) == repr(units.SERIAL)
        second = pids_of(tmp_path)
        assert not first & second
    for pid in first | second:
        assert not Path("/proc", pid).exists()
    computed(units.noted, tmp_path, 2)
    assert not second & pids_of(tmp_path)


def test_progress_is_called_with_each_index_as_it_is_done() -> None:
    seen: list[int] = []

    def computing(unit: int) -> int:
        assert seen == list(range(unit))
        return unit

    assert compute_all(computing, range(5), in_process, seen.append) == [0, 1, 2, 3, 4]
    assert compute_all(computing, [], in_process) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_a_unit_is_its_own_and_at_once_and_work_goes_on_with_what_is_missing(
    tmp_path, workers
) -> None:
    found, begun = {}, time.monotonic()
    with pytest.raises(InvalidValueError, match=f"unit must not be the victim, got {units.VICTIM}"):
        computed(units.refused, tmp_path, workers, found)
    assert time.monotonic() - begun < units.PATIENCE
    done = set(found)
    assert done <= set(range(units.VICTIM))
    pids_of(tmp_path)
    assert repr(computed(units.noted, tmp_path, workers, found)) == repr(units.SERIAL)
    assert set(units.tries(tmp_path / "tried")) == set(range(units.COUNT)) - done


def test_a_killed_worker_loses_nothing_and_a_unit_that_kills_all_ends_the_work(tmp_path) -> None:
    assert repr(computed(units.doomed_once, tmp_path, 2)) == repr(units.SERIAL)
    assert units.tries(tmp_path / "tried")[units.VICTIM] == 2
    said = line(f"worker process died {pool.MAX_DEATHS} times", ...)
    with pytest.raises(AflMujocoError, match=said), open_executor(2) as executor:
        compute_all(units.doomed_always, range(8), executor)


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_leaves_the_finished_units_and_no_process(tmp_path: Path, workers: int) -> None:
    file = tmp_path / "done"
    with units.program(tmp_path, workers) as process:
        units.awaited(lambda: len(units.kept(file)) >= 3)
        units.interrupt(process)
    assert 3 <= len(units.kept(file)) < 200


def test_ctrl_c_while_processes_start_is_silent_and_workers_end_with_who_started_them(tmp_path):
    with units.program(tmp_path, 2) as process:
        units.awaited((tmp_path / "done").exists)
        time.sleep(0.1)
        units.interrupt(process)
    (tmp_path / "done").unlink()
    with units.program(tmp_path, 2) as process:
        units.awaited(lambda: len(units.kept(tmp_path / "done")) >= 3)
        process.kill()
        process.wait()
        units.awaited(lambda: not units.group_lives(process))


def test_what_is_no_place_to_work_is_refused_and_without_dask_a_cluster_is_none(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    for workers, cluster, said in (
        (0, None, "workers must be at least 1, got 0"),
        (1, "a.b:1", line("cluster must be ", ..., ", got 'a.b:1'")),
        (2, "tcp://127.0.0.1:1", line(..., "needs Dask: pip install distributed")),
    ):
        with pytest.raises(AflMujocoError, match=said), open_executor(workers, cluster):
            pass
