"""Standard output and error that do not end a command, however a shell has left them."""

from __future__ import annotations

import contextlib
import io
import os
from typing import Any, TextIO

CLOSED = "it is closed"


class Output:
    """A standard stream to which writing never fails: a command goes on to its files and verdict.

    What its encoding lacks is escaped. If its reader has gone, as that of a pipe which closes, what
    follows is for nobody; if it is full or closed, `failure` says why.

    Parameters
    ----------
    stream
        The stream; None if the program was started without one.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self.failure: str | None = None
        self._stream: Any = io.StringIO() if stream is None else stream
        self._missing, self._ended = stream is None, False

    def write(self, text: str) -> int:
        """Write a text, as far as the stream takes it."""
        if self._missing:
            self.failure = CLOSED
        else:
            self._try(self._write, text)
        return len(text)

    def flush(self) -> None:
        """Pass on what is buffered, as far as the stream takes it."""
        self._try(self._stream.flush)

    def _write(self, text: str) -> None:
        """Write a text, with what the encoding lacks escaped."""
        try:
            self._stream.write(text)
        except UnicodeEncodeError as error:
            known = text.encode(error.encoding, "backslashreplace")
            self._stream.write(known.decode(error.encoding))

    def _try(self, deed: Any, *arguments: str) -> None:
        """Do something with the stream, unless it has failed, and note if it does."""
        if self._ended:
            return
        try:
            deed(*arguments)
        except (OSError, ValueError) as error:  # ValueError: Python's own object is closed
            if not isinstance(error, BrokenPipeError):
                self.failure = (getattr(error, "strerror", None) or CLOSED).lower()
            self._ended = True
            with contextlib.suppress(OSError, ValueError):  # of a stream that is no file
                # Python would complain at its end that it cannot write what is still buffered.
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    def __getattr__(self, name: str) -> Any:
        """Return what else a stream has, as its encoding."""
        return getattr(self._stream, name)
