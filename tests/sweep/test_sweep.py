"""Sweeps: order, bits and progress; what is kept, what is run again; deaths of workers."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import pytest
from sweep_units import (
    PATIENCE,
    VICTIM,
    doomed_always,
    doomed_once,
    hashed,
    killer,
    noted,
    refused,
    tries,
)

from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.sweep.executors import Executor, InProcess, open_executor
from afl_mujoco.sweep.sweep import MAX_TRIES, run_sweep

COUNT = 12
SERIAL = [{**hashed(i), "edges": [-0.0, float("inf"), None, "φ"]} for i in range(COUNT)]


def sweep(
    function: Callable[[Any], Any], folder: Path, workers: int = 1, **options: Any
) -> list[Any]:
    """A sweep whose units leave their marks in the folder ``tried``."""
    (tried := folder / "tried").mkdir(exist_ok=True)
    units = [(tried, i) for i in range(COUNT)]
    executor = open_executor(workers)
    return run_sweep(function, units, executor=executor, **{"fingerprint": {}, **options})


# Order and bits


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("stored", [False, True], ids=["kept", "stored"])
def test_the_results_are_the_serial_ones_bit_for_bit(
    tmp_path: Path, workers: int, stored: bool
) -> None:
    store = tmp_path / "store" if stored else None
    assert repr(sweep(noted, tmp_path, workers, store=store)) == repr(SERIAL)
    pids = {path.name.split("-")[1] for path in (tmp_path / "tried").iterdir()}
    assert (str(os.getpid()) in pids) == (workers == 1)
    assert repr(sweep(noted, tmp_path, workers, store=store)) == repr(SERIAL)
    assert set(tries(tmp_path / "tried").values()) == {1 if stored else 2}


@pytest.mark.parametrize("units", [0, 1, 2], ids=str)
def test_there_may_be_fewer_units_than_workers(units: int) -> None:
    assert run_sweep(abs, range(-units, 0), executor=open_executor(4), fingerprint={}) == [
        *range(units, 0, -1)
    ]


def test_progress_tells_how_many_units_are_finished(tmp_path: Path) -> None:
    told: list[int] = []
    sweep(noted, tmp_path, 2, store=tmp_path / "store", progress=told.append)
    assert told == [*range(COUNT + 1)]
    for index in (2, 7):
        (tmp_path / "store" / f"unit-{index:04d}.json").unlink()
    told.clear()
    sweep(noted, tmp_path, store=tmp_path / "store", progress=told.append)
    assert told == [COUNT - 2, COUNT - 1, COUNT]


def test_no_more_units_are_handed_out_than_keep_the_workers_busy() -> None:
    class Counted(InProcess):
        window, open, most = 3, 0, 0

        def submit(self, function: Any, unit: Any, /) -> Any:
            self.open += 1
            self.most = max(self.most, self.open)
            return super().submit(function, unit)

    counted = Counted()

    def taken(_: int) -> None:
        counted.open -= 1

    counted.open = 1  # the first call of `progress` takes one away
    run_sweep(abs, range(50), executor=nullcontext(counted), fingerprint={}, progress=taken)
    assert counted.most == 3


def test_a_result_that_is_no_plain_data_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="the result of unit 0 must be plain data"):
        run_sweep(complex, [1.0], executor=open_executor(1), fingerprint={})


# What is kept


class Stop(Exception):
    """Raised by the tests."""


def stop_at(count: int, error: type[BaseException]) -> Callable[[int], None]:
    def progress(finished: int) -> None:
        if finished == count:
            raise error

    return progress


@pytest.mark.parametrize("error", [KeyboardInterrupt, Stop])
@pytest.mark.parametrize("workers", [1, 2])
def test_a_sweep_that_was_broken_off_runs_only_what_is_missing(
    tmp_path: Path, workers: int, error: type[BaseException]
) -> None:
    store = tmp_path / "store"
    with pytest.raises(error):
        sweep(noted, tmp_path, workers, store=store, progress=stop_at(5, error))
    kept = {int(path.stem[-4:]) for path in store.glob("unit-*.json")}
    assert len(kept) == 5
    for path in (tmp_path / "tried").iterdir():
        path.unlink()
    assert repr(sweep(noted, tmp_path, workers, store=store)) == repr(SERIAL)
    assert set(tries(tmp_path / "tried")) == set(range(COUNT)) - kept


def test_nobody_is_called_if_the_store_has_every_result(tmp_path: Path) -> None:
    sweep(noted, tmp_path, store=tmp_path)

    def nobody() -> AbstractContextManager[Executor]:
        return open_executor(1, "tcp://127.0.0.1:1")

    options: Any = {"executor": nobody(), "store": tmp_path, "fingerprint": {}}
    assert repr(run_sweep(noted, range(COUNT), **options)) == repr(SERIAL)


def test_a_store_of_another_sweep_is_refused_before_anything_is_run(tmp_path: Path) -> None:
    sweep(noted, tmp_path, store=tmp_path / "store", fingerprint={"seed": 1})
    with pytest.raises(AflMujocoError, match="seed is 1 there and 2 here"):
        sweep(noted, tmp_path, store=tmp_path / "store", fingerprint={"seed": 2})
    assert set(tries(tmp_path / "tried").values()) == {1}


def test_a_deleted_unit_is_computed_again(tmp_path: Path) -> None:
    store = tmp_path / "store"
    sweep(noted, tmp_path, store=store)
    (store / "unit-0007.json").write_text("{")
    with pytest.raises(AflMujocoError, match=r"unit-0007\.json .*; delete it"):
        sweep(noted, tmp_path, store=store)
    (store / "unit-0007.json").unlink()
    assert repr(sweep(noted, tmp_path, store=store)) == repr(SERIAL)
    assert tries(tmp_path / "tried") == {i: 2 if i == 7 else 1 for i in range(COUNT)}


# What the function raises


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_the_function_ends_the_sweep_and_what_is_finished_stays(
    tmp_path: Path, workers: int
) -> None:
    store = tmp_path / "store"
    begun = time.monotonic()
    with pytest.raises(InvalidValueError, match=f"unit must not be the victim, got {VICTIM}"):
        sweep(refused, tmp_path, workers, store=store)
    assert time.monotonic() - begun < PATIENCE
    kept = {int(path.stem[-4:]) for path in store.glob("unit-*.json")}
    assert kept == set(range(VICTIM))


# Deaths of workers


def test_a_killed_process_loses_nothing(tmp_path: Path) -> None:
    progress = killer(tmp_path / "tried")
    results = sweep(doomed_once, tmp_path, 2, store=tmp_path / "store", progress=progress)
    assert repr(results) == repr(SERIAL)
    assert tries(tmp_path / "tried")[VICTIM] == 2


def test_a_unit_that_kills_every_worker_is_named_and_takes_no_other_with_it() -> None:
    told: list[int] = []
    with pytest.raises(AflMujocoError) as error:
        executor = open_executor(2)
        run_sweep(doomed_always, range(8), executor=executor, fingerprint={}, progress=told.append)
    says = f"unit {VICTIM} lost its worker each of the {MAX_TRIES} times that it was tried"
    assert str(error.value) == says


# What it knows


def test_importing_the_sweep_imports_neither_dask_nor_numerics() -> None:
    heavy = {"distributed", "dask", "mujoco", "numba", "scipy"}
    program = "import sys, afl_mujoco.sweep.sweep; print(*sys.modules)"
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert heavy.isdisjoint(run.stdout.split())
