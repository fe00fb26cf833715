"""Worker processes of this machine, replaced when one of them dies."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from multiprocessing.resource_tracker import ensure_running
from typing import Any

UNITS_PER_WORKER = 2
"""Units handed out for each worker: one under way, one at hand when it is done."""


class Processes:
    """Processes that compute units.

    Parameters
    ----------
    workers
        How many.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool = self._new_pool()

    @property
    def window(self) -> int:
        """Units that keep every worker busy."""
        return UNITS_PER_WORKER * self.workers

    def submit(self, function: Callable[[Any], Any], unit: Any, /) -> Future[Any]:
        """Have ``function(unit)`` computed, in new processes if those before have broken down.

        Parameters
        ----------
        function, unit
            As of `Executor.submit`.
        """
        with interrupts_held():
            try:
                return self._pool.submit(function, unit)
            except BrokenExecutor:
                self._pool.shutdown()
                self._pool = self._new_pool()
                return self._pool.submit(function, unit)

    def close(self) -> None:
        """End the processes when they have done what they were given."""
        self._pool.shutdown()

    def terminate(self) -> None:
        """End the processes now."""
        for process in list((self._pool._processes or {}).values()):
            process.terminate()
        self._pool.shutdown(cancel_futures=True)

    def _new_pool(self) -> ProcessPoolExecutor:
        """Return a pool that has no process yet."""
        spawn = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.workers, spawn, initializer=_end_with_parent)


@contextmanager
def open_processes(workers: int) -> Iterator[Processes]:
    """Give processes, and end them; at once if the block raises.

    Parameters
    ----------
    workers
        How many.

    Yields
    ------
    Processes
        What computes units.
    """
    processes = Processes(workers)
    try:
        yield processes
    except BaseException:
        processes.terminate()
        raise
    processes.close()


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Put off a Ctrl-C to the end of the block, and for good in what is started within.

    A terminal sends the signal to every process of a command; only this one is to answer it. What
    a worker inherits holds from its first instruction on, as a handler of its own would not.
    """
    ensure_running()  # started within the block, it would let the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """Have this worker end when the process that started it does, however that ends."""
    if (parent := multiprocessing.parent_process()) is not None:
        watch = threading.Thread(target=_exit_after, args=(parent.sentinel,), daemon=True)
        watch.start()


def _exit_after(sentinel: int) -> None:
    """Exit once the process of the sentinel has ended."""
    wait([sentinel])
    os._exit(1)
