"""Executors: what is refused, and what a signal leaves behind."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import pytest
from sweep_units import PATIENCE, awaited, group_lives, program

from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.sweep.executors import open_executor
from afl_mujoco.sweep.store import Store

UNITS = 200  # of the program


def open_and_close(workers: int, cluster: str | None = None) -> None:
    with open_executor(workers, cluster):
        pass


@pytest.mark.parametrize("cluster", [None, "local", "tcp://127.0.0.1:1"], ids=str)
def test_there_must_be_a_worker(cluster: str | None) -> None:
    with pytest.raises(InvalidValueError, match="workers must be at least 1, got 0"):
        open_and_close(0, cluster)


@pytest.mark.parametrize(
    "address",
    [
        *("", "127.0.0.1:8786", "tcp://127.0.0.1", "tcp://:8786", "tcp://host:99999"),
        *("tcp://host:port", "tls://host:8786", "tcp://host:8786/path", "tcp://[::1:8786", "LOCAL"),
    ],
)
def test_a_malformed_address_is_refused(address: str) -> None:
    with pytest.raises(AflMujocoError) as error:
        open_and_close(1, address)
    assert str(error.value) == f"cluster must be local or tcp://host:port, got {address!r}"


def test_without_dask_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(AflMujocoError) as error:
        open_and_close(2, "local")
    assert str(error.value) == "cluster local needs Dask: pip install afl-mujoco[cluster]"


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_leaves_the_finished_units_and_no_process(tmp_path: Path, workers: int) -> None:
    with program(tmp_path, workers, "") as process:
        awaited(lambda: len(list(tmp_path.glob("store/unit-*.json"))) >= 3)
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
        assert (process.returncode, said) == (130, "")
        awaited(lambda: not group_lives(process))
    assert 3 <= len(Store(tmp_path / "store", {}, UNITS).finished()) < UNITS


@pytest.mark.parametrize("delay", [0.1, 0.4])
def test_ctrl_c_at_any_time_of_the_start_is_silent(tmp_path: Path, delay: float) -> None:
    with program(tmp_path, 2, "") as process:
        awaited((tmp_path / "store" / "sweep.json").exists)
        time.sleep(delay)
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
        assert (process.returncode, said) == (130, "")
        awaited(lambda: not group_lives(process))


def test_workers_end_with_the_process_that_started_them(tmp_path: Path) -> None:
    with program(tmp_path, 2, "") as process:
        awaited(lambda: len(list(tmp_path.glob("store/unit-*.json"))) >= 3)
        process.kill()
        process.wait()
        awaited(lambda: not group_lives(process))
