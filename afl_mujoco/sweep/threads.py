"""Work shared among threads: what is compiled releases the interpreter lock."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import Empty, SimpleQueue

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
    """Have all items done by as many threads as there are marches; a single one by the caller's.

    An error, or a Ctrl-C, ends it once every thread has done the part that it is at. Of several
    errors that of the first item is raised, as a single thread would.

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
    work = _Work(parts)
    with ThreadPoolExecutor(len(marches)) as pool:
        try:
            for march in marches:
                pool.submit(work.do, march)
            for _ in marches:
                for one in iter(work.done.get, None):
                    progress(one.stop - one.start)
        finally:
            work.stop.set()
    if work.errors:
        raise work.errors[min(work.errors)]


class _Work:
    """Parts that threads take one after the other, in their order, and what became of them."""

    def __init__(self, parts: Sequence[slice]) -> None:
        self.waiting: SimpleQueue[tuple[int, slice]] = SimpleQueue()
        for numbered in enumerate(parts):
            self.waiting.put(numbered)
        self.done: SimpleQueue[slice | None] = SimpleQueue()
        self.errors: dict[int, BaseException] = {}
        self.stop = threading.Event()

    def do(self, march: March) -> None:
        """Do parts until none is left or it must stop; then say so by None."""
        with contextlib.suppress(Empty):
            while not self.stop.is_set():
                index, part = self.waiting.get_nowait()
                try:
                    march(part)
                except BaseException as error:
                    self.errors[index] = error
                    self.stop.set()
                else:
                    self.done.put(part)
        self.done.put(None)
