"""A sweep on a real Dask cluster of this machine.

Optional: `make cluster` installs Dask and runs this. Without it the tests are skipped, or fail
where AFL_MUJOCO_REQUIRE_CLUSTER is set.
"""

from __future__ import annotations

import importlib.metadata
import logging
import multiprocessing
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sweep_units import (
    PATIENCE,
    VICTIM,
    awaited,
    doomed_once,
    group_lives,
    hashed,
    killer,
    noted,
    program,
    refused,
    tries,
)

from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.sweep import dask_cluster
from afl_mujoco.sweep.executors import open_executor
from afl_mujoco.sweep.sweep import run_sweep

try:
    import distributed
except ImportError as error:
    reason = f"Dask, which runs clusters, is not installed ({error}): run `make cluster`"
    if os.environ.get("AFL_MUJOCO_REQUIRE_CLUSTER"):
        pytest.fail(f"AFL_MUJOCO_REQUIRE_CLUSTER is set, but {reason}", pytrace=False)
    pytest.skip(reason, allow_module_level=True)

COUNT = 12
SOON = 10.0  # [s] in which a cluster that cannot be used is told
SERIAL = run_sweep(hashed, range(COUNT), executor=open_executor(1), fingerprint={})


def sweep(function: Any, folder: Path, cluster: str, **options: Any) -> list[Any]:
    (tried := folder / "tried").mkdir(exist_ok=True)
    units = [(tried, i) for i in range(COUNT)]
    return run_sweep(function, units, executor=open_executor(2, cluster), fingerprint={}, **options)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A cluster that somebody else has started; a death is the sweep's to answer."""
    with started(2, allowed_failures=0) as running:
        yield running


def started(workers: int, allowed_failures: int = 3) -> Any:
    """A cluster that gives a unit up after some deaths."""
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0", "allowed_failures": allowed_failures},
        silence_logs=logging.CRITICAL,
    )


def test_a_local_cluster_gives_the_serial_results_though_a_worker_is_killed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    before = set(multiprocessing.active_children())
    progress = killer(tmp_path / "tried")
    results = sweep(doomed_once, tmp_path, "local", store=tmp_path / "store", progress=progress)
    assert repr(results) == repr(SERIAL)
    assert tries(tmp_path / "tried")[VICTIM] == 2
    assert "OMP_NUM_THREADS" not in os.environ
    assert caplog.messages == []
    assert set(multiprocessing.active_children()) <= before


def test_a_cluster_with_an_address_gives_the_serial_results_though_a_worker_is_killed(
    tmp_path: Path, cluster: Any
) -> None:
    progress = killer(tmp_path / "tried")
    results = sweep(doomed_once, tmp_path, cluster.scheduler_address, progress=progress)
    assert repr(results) == repr(SERIAL)
    assert tries(tmp_path / "tried")[VICTIM] == 2


def test_equal_units_are_each_computed(tmp_path: Path, cluster: Any) -> None:
    executor = open_executor(1, cluster.scheduler_address)
    run_sweep(noted, [(tmp_path, 3)] * 5, executor=executor, fingerprint={})
    assert tries(tmp_path) == {3: 5}


def test_an_error_of_the_function_ends_the_sweep_and_what_is_finished_stays(
    tmp_path: Path,
) -> None:
    store = tmp_path / "store"
    begun = time.monotonic()
    with pytest.raises(InvalidValueError, match=f"unit must not be the victim, got {VICTIM}"):
        sweep(refused, tmp_path, "local", store=store)
    assert time.monotonic() - begun < PATIENCE
    assert {int(path.stem[-4:]) for path in store.glob("unit-*.json")} == set(range(VICTIM))


def test_a_scheduler_that_goes_away_is_told(caplog: pytest.LogCaptureFixture) -> None:
    cluster = started(1)
    address = cluster.scheduler_address
    caplog.clear()
    with open_executor(1, address) as executor:
        future = executor.submit(time.sleep, 0.5)
        cluster.close()
        with pytest.raises(AflMujocoError) as error:
            future.result(PATIENCE)
        assert str(error.value) == f"cluster {address} has lost its scheduler"
        with pytest.raises(AflMujocoError, match="has lost its scheduler"):
            assert executor.window
    assert caplog.messages == []


# What cannot be used


def listener(behaviour: str) -> tuple[socket.socket, str]:
    """A server that is no scheduler, and its address."""
    server = socket.create_server(("127.0.0.1", 0))
    address = f"tcp://127.0.0.1:{server.getsockname()[1]}"

    def serve() -> None:
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            with connection:
                if behaviour == "web":
                    connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
                elif behaviour == "silent":
                    time.sleep(SOON)

    if behaviour == "nobody":
        server.close()
    else:
        threading.Thread(target=serve, daemon=True).start()
    return server, address


@pytest.mark.parametrize("behaviour", ["nobody", "web", "silent"])
def test_an_address_of_no_scheduler_is_told_in_one_line_and_soon(
    tmp_path: Path, behaviour: str
) -> None:
    server, address = listener(behaviour)
    begun = time.monotonic()
    with server, program(tmp_path, 1, address) as process:
        said, _ = process.communicate(timeout=PATIENCE)
    assert time.monotonic() - begun < SOON
    nobody = "cannot be reached: connection refused"
    problem = nobody if behaviour == "nobody" else "is no Dask scheduler"
    assert (process.returncode, said) == (2, f"cluster {address} {problem}\n")


def test_the_address_of_a_worker_is_refused(cluster: Any) -> None:
    address = cluster.workers[0].worker_address
    with pytest.raises(AflMujocoError, match="is no Dask scheduler"), open_executor(1, address):
        pass


def test_a_cluster_without_workers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "TIMEOUT", 1.0)
    with (
        started(0) as empty,
        pytest.raises(AflMujocoError, match="has no workers"),
        open_executor(1, empty.scheduler_address),
    ):
        pass


def test_a_cluster_with_another_version_of_the_package_is_refused(
    monkeypatch: pytest.MonkeyPatch, cluster: Any
) -> None:
    here = importlib.metadata.version("afl_mujoco")
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "99")
    with (
        pytest.raises(AflMujocoError, match=f"must have afl_mujoco 99 installed, got {here}"),
        open_executor(1, cluster.scheduler_address),
    ):
        pass


# Signals


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGKILL], ids=["ctrl-c", "kill"])
def test_a_signal_leaves_the_finished_units_and_no_process(
    tmp_path: Path, kind: signal.Signals
) -> None:
    with program(tmp_path, 2, "local") as process:
        awaited(lambda: len(list(tmp_path.glob("store/unit-*.json"))) >= 3)
        (os.killpg if kind == signal.SIGINT else os.kill)(process.pid, kind)
        said, _ = process.communicate(timeout=PATIENCE)
        if kind == signal.SIGINT:
            assert (process.returncode, said) == (130, "")
        awaited(lambda: not group_lives(process))


def test_ctrl_c_while_a_cluster_starts_is_silent(tmp_path: Path) -> None:
    with program(tmp_path, 2, "local") as process:
        awaited((tmp_path / "store" / "sweep.json").exists)
        time.sleep(0.5)
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
        assert (process.returncode, said) == (130, "")
        awaited(lambda: not group_lives(process))
