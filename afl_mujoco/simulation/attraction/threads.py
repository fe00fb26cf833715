"""Cells shared among threads: compiled marches release the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from queue import SimpleQueue

from afl_mujoco.errors import InvalidValueError

PART = 32
"""Cells that a thread takes at a time: it marches them in a second at most, and can then stop."""

March = Callable[[slice], object]
"""Marches some cells of a map; what it gives a cell must not depend on those before."""


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


def share(count: int, marches: Sequence[March], progress: Callable[[int], None]) -> None:
    """Have all cells marched, by as many threads as there are marches.

    Parameters
    ----------
    count
        Number of cells.
    marches
        One for each thread, each with memory of its own.
    progress
        Called with how many more cells are done, from the calling thread.
    """
    free: SimpleQueue[March] = SimpleQueue()
    for march in marches:
        free.put(march)

    def run(part: slice) -> int:
        march = free.get()
        try:
            march(part)
        finally:
            free.put(march)
        return int(part.stop - part.start)

    with ThreadPoolExecutor(len(marches)) as pool:
        parts = [slice(a, min(a + PART, count)) for a in range(0, count, PART)]
        futures = [pool.submit(run, part) for part in parts]
        try:
            for future in as_completed(futures):
                progress(future.result())
        except BaseException:  # a Ctrl-C as well: what has not begun is given up
            pool.shutdown(wait=False, cancel_futures=True)
            raise
