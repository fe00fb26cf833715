"""Worker processes of this machine, replaced when one of them dies."""

from __future__ import annotations

import gc
import io
import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.resource_tracker import ensure_running
from typing import Any

from afl_mujoco.errors import AflMujocoError, warning_in_one_line
from afl_mujoco.execution.executors import Executor
from afl_mujoco.execution.interrupts import interrupts_put_off

SAFE_PATH = "PYTHONSAFEPATH"

MAX_DEATHS = 4
"""Deaths of workers after which the computation is given up, because it seems to kill them."""


_idle: dict[int, ProcessPoolExecutor] | None = None
"""Pools that wait for their next use, by their number of workers; None outside `kept_processes`."""


@contextmanager
def kept_processes() -> Iterator[None]:
    """Keep worker processes from one use within the block to the next: to start them takes long."""
    global _idle
    _idle = {}
    try:
        yield
    finally:
        pools, _idle = _idle, None
        for pool in pools.values():
            pool.shutdown()


@contextmanager
def open_processes(workers: int) -> Iterator[Executor]:
    """Yield an executor on worker processes, and end them; at once if the block raises.

    Within `kept_processes` a block that does not raise leaves them to the next.
    """
    pool = (_idle or {}).pop(workers, None) or _new_pool(workers)

    def compute(function: Callable[[Any], Any], units: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        nonlocal pool
        left = dict(enumerate(units))
        for _ in range(MAX_DEATHS):
            try:
                for index, result in _computed(function, left, pool):
                    del left[index]
                    yield index, result
                return
            except BrokenProcessPool:
                pool.shutdown()
                pool = _new_pool(workers)
        rule = f"died {MAX_DEATHS} times, with {len(left)} of {len(units)} units not done"
        raise AflMujocoError("worker process", f"{rule}; is there enough memory?")

    try:
        yield compute
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        pool.shutdown(cancel_futures=True)
        raise
    if _idle is None or workers in _idle:
        pool.shutdown(cancel_futures=True)
    else:
        _idle[workers] = pool


def _new_pool(workers: int) -> ProcessPoolExecutor:
    """Return a pool that has no process yet."""
    spawn = multiprocessing.get_context("spawn")
    in_one_line = warnings.formatwarning is warning_in_one_line
    arguments = in_one_line, gc.get_threshold()
    with _safe_path():  # its locks start a process too
        return ProcessPoolExecutor(workers, spawn, initializer=_prepare, initargs=arguments)


def _computed(
    function: Callable[[Any], Any], units: dict[int, Any], pool: ProcessPoolExecutor
) -> Iterator[tuple[int, Any]]:
    """Yield index and result of each unit as it is done."""
    with interrupts_held():  # processes are started here
        futures = {pool.submit(function, unit): index for index, unit in units.items()}
    for future in as_completed(futures):
        yield futures.pop(future), future.result()


@contextmanager
def _safe_path() -> Iterator[None]:
    """Have processes started within the block import nothing from the working directory at first.

    They get the path of this process later, once Python's own modules are imported.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        del os.environ[SAFE_PATH]
        if before is not None:
            os.environ[SAFE_PATH] = before


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Put off a Ctrl-C to the end of the block, and block it for good in processes started within.

    A terminal sends the signal to every process of a command; only this one is to handle it. A mask
    that a worker inherits holds from its first instruction on, which a handler of its own would
    not. In this process the mask alone is not enough: a thread of a numerical library may take the
    signal.
    """
    with _safe_path():
        ensure_running()  # started within the block, it would let the signal through again
    with _safe_path(), interrupts_put_off():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _prepare(in_one_line: bool, collected_after: tuple[int, int, int]) -> None:
    """Have this worker warn, print and collect garbage as its parent does, and end with it."""
    gc.set_threshold(*collected_after)
    if in_one_line:
        warnings.formatwarning = warning_in_one_line
    for stream in (sys.stdout, sys.stderr):  # what a controller prints must not be its error
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    threading.Thread(target=_exit_after_parent, daemon=True).start()


def _exit_after_parent() -> None:
    """Exit once the process that started this one has ended."""
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
