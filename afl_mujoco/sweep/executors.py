"""Who computes: this process, processes of this machine, a Dask cluster; all take units alike."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, Protocol

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.sweep.dask_cluster import open_cluster
from afl_mujoco.sweep.processes import open_processes


class Executor(Protocol):
    """What computes units; a death of a worker is a `BrokenExecutor` on the unit's future.

    Attributes
    ----------
    window
        Units that keep every worker busy; it may change as workers come and go.
    """

    @property
    def window(self) -> int:
        """See above."""

    def submit(self, function: Callable[[Any], Any], unit: Any, /) -> Future[Any]:
        """Have ``function(unit)`` computed.

        Parameters
        ----------
        function
            A function that a worker can import by its name.
        unit
            Its argument, which can be pickled.
        """


class InProcess:
    """Computes each unit here, at once."""

    window = 1

    def submit(self, function: Callable[[Any], Any], unit: Any, /) -> Future[Any]:
        """Compute ``function(unit)``; arguments as of `Executor.submit`.

        Parameters
        ----------
        function, unit
            What to compute.
        """
        future: Future[Any] = Future()
        try:
            future.set_result(function(unit))
        except Exception as error:  # a KeyboardInterrupt is the caller's
            future.set_exception(error)
        return future


@contextmanager
def open_executor(workers: int, cluster: str | None = None) -> Iterator[Executor]:
    """Give workers, and end them; at once if the block raises, a Ctrl-C included.

    Parameters
    ----------
    workers
        Processes to share the work among; one computes in this process. A cluster with an address
        has its own.
    cluster
        None for processes of this machine, ``"local"`` for a Dask cluster on it, or the address
        ``"tcp://host:port"`` of a Dask scheduler.

    Yields
    ------
    Executor
        What computes units.

    Raises
    ------
    AflMujocoError
        If there is no such cluster, or it cannot be used.
    """
    if workers < 1:
        raise InvalidValueError("workers", "must be at least 1", workers)
    if cluster is not None:
        with open_cluster(workers, cluster) as dask:
            yield dask
    elif workers == 1:
        yield InProcess()
    else:
        with open_processes(workers) as processes:
            yield processes
