"""Work shared among threads: what is compiled releases the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from queue import SimpleQueue

from afl_mujoco.errors import InvalidValueError

PART = 32
"""Items that a thread takes at a time: a second of work at most, after which it can stop."""

March = Callable[[slice], object]
"""Does some of the items; what it does to one must not depend on those before."""


def require_threads(threads: int) -> int:
    """Return a number of threads, or raise if there is none.

    Parameters
    ----------
    threads
        How many.
    """
    if threads < 1:
        raise InvalidValueError("threads", "must be at least 1", threads)
    return threads


def share(
    count: int,
    marches: Sequence[March],
    progress: Callable[[int], None] = lambda items: None,
    *,
    part: int = PART,
) -> None:
    """Have all items done, by as many threads as there are marches; one is the caller's.

    Parameters
    ----------
    count
        Number of items.
    marches
        One for each thread, each with memory of its own.
    progress
        Called with how many more items are done, from the calling thread.
    part
        Items that a thread takes at a time.
    """
    parts = [slice(a, min(a + part, count)) for a in range(0, count, part)]
    if len(marches) == 1:
        for one in parts:
            marches[0](one)
            progress(one.stop - one.start)
        return
    free: SimpleQueue[March] = SimpleQueue()
    for march in marches:
        free.put(march)

    def run(one: slice) -> int:
        march = free.get()
        try:
            march(one)
        finally:
            free.put(march)
        return int(one.stop - one.start)

    with ThreadPoolExecutor(len(marches)) as pool:
        futures = [pool.submit(run, one) for one in parts]
        try:
            for future in as_completed(futures):
                progress(future.result())
        except BaseException:  # a Ctrl-C as well: what has not begun is given up
            pool.shutdown(wait=False, cancel_futures=True)
            raise
