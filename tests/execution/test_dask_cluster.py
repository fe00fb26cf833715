"""Work on a real Dask cluster of this machine.

Optional: `make cluster` installs Dask and runs this. Without it the tests are skipped, or fail
where AFL_MUJOCO_REQUIRE_CLUSTER is set.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from afl_mujoco import pool as dask_cluster
from afl_mujoco.control.catalogue import find_controller
from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.pool import compute_all, open_executor
from tests.execution import units
from tests.messages import line

try:
    import distributed
except ImportError as error:
    reason = f"Dask, which runs clusters, is not installed ({error}): run `make cluster`"
    if os.environ.get("AFL_MUJOCO_REQUIRE_CLUSTER"):
        pytest.fail(f"AFL_MUJOCO_REQUIRE_CLUSTER is set, but {reason}", pytrace=False)
    pytest.skip(reason, allow_module_level=True)


def started(workers: int) -> Any:
    return distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"}, silence_logs=100,
    )  # fmt: skip


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with started(2) as cluster:
        yield cluster.scheduler_address


def computed(function: Any, folder: Path, address: str) -> list[Any]:
    with open_executor(1, address) as executor:
        return compute_all(function, [(folder, i) for i in range(units.COUNT)], executor)


def test_the_results_are_the_serial_ones_though_a_worker_is_killed(tmp_path, address, caplog):
    assert repr(computed(units.doomed_once, tmp_path, address)) == repr(units.SERIAL)
    assert units.tries(tmp_path)[units.VICTIM] == 2
    assert caplog.messages == []


def test_an_error_of_a_unit_is_its_own_and_ends_the_work_at_once(tmp_path: Path) -> None:
    begun, said = time.monotonic(), f"unit must not be the victim, got {units.VICTIM}"
    with started(2) as cluster, pytest.raises(InvalidValueError, match=said):
        computed(units.refused, tmp_path, cluster.scheduler_address)
    assert time.monotonic() - begun < units.PATIENCE


def test_a_unit_that_kills_every_worker_ends_the_work_in_one_line(address: str) -> None:
    said = line(f"cluster {address} lost a worker each", ...)
    with pytest.raises(AflMujocoError, match=said), open_executor(1, address) as executor:
        compute_all(units.doomed_always, range(8), executor)


def test_ctrl_c_leaves_the_finished_units(tmp_path: Path, address: str) -> None:
    with units.program(tmp_path, 1, address) as process:
        units.awaited(lambda: len(units.kept(tmp_path / "done")) >= 3)
        units.interrupt(process)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "tcp://127.0.0.1:99999"])
def test_an_address_of_no_scheduler_is_refused_in_one_line_and_soon(tmp_path, address) -> None:
    begun = time.monotonic()
    with units.program(tmp_path, 1, address) as process:
        said, _ = process.communicate(timeout=units.PATIENCE)
    assert time.monotonic() - begun < 15.0 and process.returncode == 2
    assert said.startswith(f"cluster {address} cannot be used: ") and said.count("\n") == 1, said


def test_a_cluster_with_another_version_of_the_package_is_refused(monkeypatch, address, tmp_path):
    said = f"must have afl_mujoco 99 installed, got {dask_cluster.VERSION}"
    monkeypatch.setattr(dask_cluster, "VERSION", "99")
    with pytest.raises(AflMujocoError, match=said):
        computed(units.noted, tmp_path, address)


def test_a_scheduler_that_goes_away_is_named(caplog: pytest.LogCaptureFixture) -> None:
    cluster = started(1)
    address = cluster.scheduler_address
    caplog.clear()
    said = line(f"cluster {address} has lost its scheduler")
    with pytest.raises(AflMujocoError, match=said), open_executor(1, address) as executor:
        compute_all(time.sleep, [0.0, 5.0], executor, lambda _: cluster.close())
    assert caplog.messages == []


def test_a_module_that_only_this_process_has_is_named_with_the_worker(
    tmp_path, address, monkeypatch
):
    (tmp_path / "only_here.py").write_text("def force(t, state, belief): return 0.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    controller = find_controller("only_here:force")
    said = line("worker tcp://", ..., "must be able to import what it computes", ...)
    with pytest.raises(AflMujocoError, match=said) as error, open_executor(1, address) as executor:
        compute_all(repr, [controller], executor)
    for part in ("controller 'only_here:force'", "No module named 'only_here'"):
        assert part in str(error.value)
