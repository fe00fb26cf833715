"""The gain table on a real Dask cluster, one of whose workers is killed on the way."""

from __future__ import annotations

import multiprocessing
import os
import signal
from pathlib import Path

import pytest

from afl_mujoco.sweep.executors import open_executor
from afl_mujoco.sweep.sweep import run_sweep
from afl_mujoco.tuning.gain_table import pair_searches, search_pair, table_provenance
from afl_mujoco.tuning.settings import GeneticSettings

try:
    import distributed  # noqa: F401
except ImportError as error:
    reason = f"Dask, which runs clusters, is not installed ({error}): run `make cluster`"
    if os.environ.get("AFL_MUJOCO_REQUIRE_CLUSTER"):
        pytest.fail(f"AFL_MUJOCO_REQUIRE_CLUSTER is set, but {reason}", pytrace=False)
    pytest.skip(reason, allow_module_level=True)

SETTINGS = GeneticSettings(population_size=60, generations=400)
GRID = (0.5, 1.0, 2.0), (0.4, 0.8)


def test_the_table_is_the_serial_one_though_a_worker_is_killed(tmp_path: Path) -> None:
    units = pair_searches(*GRID, SETTINGS, seed=7)
    serial = [search_pair(unit) for unit in units]
    before = set(multiprocessing.active_children())
    killed: list[int] = []

    def kill_one(finished: int) -> None:
        if finished and not killed:
            victim = min(set(multiprocessing.active_children()) - before, key=lambda p: p.pid)
            os.kill(victim.pid, signal.SIGKILL)
            killed.append(victim.pid)

    (tmp_path / "checkpoints").mkdir()
    table = run_sweep(
        search_pair,
        pair_searches(*GRID, SETTINGS, seed=7, checkpoints=tmp_path / "checkpoints"),
        executor=open_executor(2, "local"),
        store=tmp_path / "store",
        fingerprint=table_provenance(units),
        progress=kill_one,
    )
    assert len(killed) == 1
    assert table == serial
