"""Executors of many units: this process, processes of this machine, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeAlias, TypeVar

from afl_mujoco.errors import require_count

Unit = TypeVar("Unit")
Result = TypeVar("Result")

Executor: TypeAlias = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[int, Any]]]
"""Yields index and result of a function for each unit as it is done, or raises a unit's error.

A worker imports the function by its name; units and results are pickled.
"""


def in_process(
    function: Callable[[Unit], Result], units: Sequence[Unit]
) -> Iterator[tuple[int, Result]]:
    """Compute one unit after the other, here."""
    return enumerate(map(function, units))


MOST_WORKERS = 1024


def require_workers(workers: object) -> None:
    """Raise unless there can be so many workers."""
    require_count("workers", workers, 1, MOST_WORKERS)


@contextmanager
def open_executor(workers: int, cluster: str | None = None) -> Iterator[Executor]:
    """Yield an executor, and end its workers: at once if the block raises, a Ctrl-C included.

    One worker is this process, more are processes of this machine; `cluster`, the address
    ``"tcp://host:port"`` of a Dask scheduler, replaces them by the workers of that cluster.
    """
    require_workers(workers)
    if cluster is not None:
        from afl_mujoco.execution.dask_cluster import open_cluster

        with open_cluster(cluster) as compute:
            yield compute
    elif workers == 1:
        yield in_process
    else:
        from afl_mujoco.execution.processes import open_processes

        with open_processes(workers) as compute:
            yield compute


def compute_all(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    executor: Executor,
    progress: Callable[[int], None] = lambda index: None,
    kept: dict[int, Result] | None = None,
) -> list[Result]:
    """Return the results of all units, in their order, whichever is done first.

    `progress` is called with the index of each unit as it is done. Units in `kept` are done
    already; what is done is in it at once, also if an error or a Ctrl-C ends the rest.
    """
    results: dict[int, Result] = {} if kept is None else kept
    for index in results:
        progress(index)
    missing = [index for index in range(len(units)) if index not in results]
    for place, result in executor(function, [units[index] for index in missing]):
        results[missing[place]] = result
        progress(missing[place])
    return [results[index] for index in range(len(units))]
