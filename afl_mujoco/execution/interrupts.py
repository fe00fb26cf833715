"""A Ctrl-C: noted, told from other errors, put off."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_came: list[int] = []
"""The Ctrl-C's since the outermost `interrupts_noted` began."""


@contextmanager
def interrupts_noted() -> Iterator[None]:
    """Note each Ctrl-C of the block, so that `is_interrupt` knows what a library made of one.

    A library may turn it into an error of its own without a trace, as ctypes does under PyOpenGL.
    """
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return

    def note(number: int, frame: FrameType | None) -> None:
        _came.append(number)
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _came.clear()


def is_interrupt(error: BaseException | None) -> bool:
    """Return whether a Ctrl-C caused an error, as while a library is loaded."""
    if _came:
        return True
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


@contextmanager
def interrupts_put_off() -> Iterator[None]:
    """Put off a Ctrl-C to the end of the block, where it is raised even if the block raises."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda n, _: came.append(n))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler or signal.SIG_DFL)
        if came:
            signal.raise_signal(signal.SIGINT)
