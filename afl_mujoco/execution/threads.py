"""Work shared among threads: what is compiled releases the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue

from afl_mujoco.errors import InvalidValueError

PART = 32
"""Items that a thread takes at a time: a second of work at most, after which it can stop."""

Task = Callable[[slice], object]
"""Does some of the items; what it does to one must not depend on those before."""


def require_threads(threads: int) -> int:
    """Return a number of threads, or raise if there is none."""
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
    """Have all items done by as many threads as there are tasks; a single one by the caller's.

    Each task has memory of its own and does one part at a time. `progress` is called with how many
    more items are done, from the calling thread. An error, or a Ctrl-C, ends it once every thread
    has done the part that it is at; of several errors that of the first item is raised.
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
