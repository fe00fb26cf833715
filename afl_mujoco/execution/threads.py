"""Work shared among threads: compiled code releases the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue

from afl_mujoco.errors import InvalidValueError

PART = 32
"""Items that a thread takes at a time: at most a second of work, after which it can stop."""

Task = Callable[[slice], object]
"""Processes some of the items; the result of one must not depend on those before."""


def require_threads(threads: int) -> int:
    """Return a number of threads, or raise if it is less than 1."""
    if threads < 1:
        raise InvalidValueError("threads", "must be at least 1", threads)
    return threads


def share(
    count: int,
    tasks: Sequence[Task],
    progress: Callable[[int], None] = lambda items: None,
    *,
    part: int = PART,
) -> None:
    """Process all items with one thread per task; a single task runs in the thread of the caller.

    Each task has its own memory and processes one part at a time. `progress` is called from the
    calling thread with the number of items just done. An error or a Ctrl-C stops the work once
    every thread has done its current part; of several errors, that of the first item is raised.
    """
    parts = [range(first, min(first + part, count)) for first in range(0, count, part)]
    if len(tasks) == 1:
        for items in parts:
            tasks[0](slice(items.start, items.stop))
            progress(len(items))
        return
    free: SimpleQueue[Task] = SimpleQueue()
    for task in tasks:
        free.put(task)

    def do(items: range) -> int:
        task = free.get()
        try:
            task(slice(items.start, items.stop))
        finally:
            free.put(task)
        return len(items)

    with ThreadPoolExecutor(len(tasks)) as pool:
        try:
            futures = [pool.submit(do, items) for items in parts]
            for future in futures:  # in their order, for the first error
                progress(future.result())
        finally:
            pool.shutdown(cancel_futures=True)
