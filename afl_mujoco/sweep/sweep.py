"""A sweep: one function of many units, each computed once, whatever is killed in between."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, TypeVar

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.sweep.executors import Executor
from afl_mujoco.sweep.store import Store, plain

Unit = TypeVar("Unit")
Result = TypeVar("Result")

MAX_TRIES = 4
"""Times that a unit may be tried whose worker dies: once and three times more."""

SUSPECT = 2
"""Deaths after which a unit is tried alone, lest it take others with it."""


def run_sweep(
    function: Callable[[Unit], Any],
    units: Sequence[Unit],
    *,
    executor: AbstractContextManager[Executor],
    store: Path | None = None,
    fingerprint: Mapping[str, Any],
    progress: Callable[[int], None] = lambda finished: None,
) -> list[Any]:
    """Compute a function of every unit; the results do not depend on who computes them.

    Parameters
    ----------
    function
        A function that a worker can import by its name. It returns plain data: what JSON can hold.
    units
        Its arguments, which can be pickled.
    executor
        From `open_executor`; not opened if the store has every result.
    store
        Folder that keeps each result as soon as it is there. A sweep that was broken off goes on
        from what it holds.
    fingerprint
        Whatever the results depend on (settings, seeds, versions), as plain data. A store of a
        sweep with another is refused.
    progress
        Called with how many units are finished: at first with those of the store, then after each.

    Returns
    -------
    list
        The results in the order of the units, as JSON gives them back: a tuple as a list.

    Raises
    ------
    AflMujocoError
        If the store holds something else, a worker dies again and again, or a result is no plain
        data.
    Exception
        What the function raises; the other units are given up, those finished are in the store.
    """
    kept = None if store is None else Store(store, fingerprint, len(units))
    results = {} if kept is None else kept.finished()
    progress(len(results))
    missing = [index for index in range(len(units)) if index not in results]
    if missing:
        with executor as workers:
            for index, result in compute(function, units, missing, workers):
                results[index] = plain(f"the result of unit {index}", result)
                if kept is not None:
                    kept.keep(index, results[index])
                progress(len(results))
    return [results[index] for index in range(len(units))]


def compute(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    indices: Iterable[int],
    executor: Executor,
) -> Iterator[tuple[int, Result]]:
    """Give the results of some units as they come, with their indices.

    Parameters
    ----------
    function, units
        As of `run_sweep`; a result need only be picklable.
    indices
        Of the units to compute.
    executor
        What computes them. No more of them are handed to it at a time than keep it busy; those
        under way when a worker dies are handed to it again.

    Yields
    ------
    tuple
        Index and result.

    Raises
    ------
    AflMujocoError
        If the worker of a unit dies each time.
    Exception
        What the function raises, after the results that are there.
    """
    waiting = deque(indices)
    under_way: dict[Future[Result], int] = {}
    deaths: Counter[int] = Counter()
    while waiting or under_way:
        while waiting and _may_start(waiting[0], under_way.values(), deaths, executor):
            index = waiting.popleft()
            under_way[executor.submit(function, units[index])] = index
        done, _ = wait(under_way, return_when=FIRST_COMPLETED)
        died, failures = [], []
        for future in sorted(done, key=under_way.__getitem__):
            index = under_way.pop(future)
            if (error := future.exception()) is None:
                yield index, future.result()
            elif isinstance(error, BrokenExecutor):
                died.append(index)
            else:
                failures.append(error)
        if failures:
            raise failures[0]
        deaths.update(died)
        for index in died:
            if deaths[index] == MAX_TRIES:
                rule = f"lost its worker each of the {MAX_TRIES} times that it was tried"
                raise AflMujocoError(f"unit {index}", rule)
        waiting.extendleft(reversed(died))


def compute_all(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    executor: Executor,
    progress: Callable[[int], None] = lambda index: None,
) -> list[Result]:
    """Return the results of all units, in their order.

    Parameters
    ----------
    function, units, executor
        As of `compute`.
    progress
        Called with the index of each unit as it is done.
    """
    results = {}
    for index, result in compute(function, units, range(len(units)), executor):
        results[index] = result
        progress(index)
    return [results[index] for index in range(len(units))]


def _may_start(
    index: int, under_way: Collection[int], deaths: Mapping[int, int], executor: Executor
) -> bool:
    """Return whether a unit may be handed out beside those under way."""
    if not under_way:
        return True
    if any(deaths[i] >= SUSPECT for i in (index, *under_way)):
        return False
    return len(under_way) < executor.window
