"""What commands share: exit codes, folders, words of options, streams, and progress bars."""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO, get_type_hints

import tyro

from afl_mujoco.errors import printable

if TYPE_CHECKING:
    from afl_mujoco.studies.shared.contract import Progress

SUCCESS, CHECK_FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

FILMS, RESULTS = Path("renders"), Path("renders/validation")
"""Default folders of films, and of the results of studies with their page."""

CallLimit = Annotated[
    float | None,
    tyro.conf.arg(
        help="How long one call of a controller in Python may take [s]; 1 by default. Its first in "
        "a run may take 60, for a library to compile."
    ),
]
"""Option of a command that runs controllers."""

SECONDS = 30.0  # time between two lines of progress if there is no terminal [s]


def separated(value: Any) -> Any:
    """Return a tuple of words, split at commas; return anything else unchanged."""
    if not (isinstance(value, tuple) and all(isinstance(word, str) for word in value)):
        return value
    return tuple(word for given in value for word in given.split(","))


def numbers_apart(words: Sequence[str]) -> list[str]:
    """Return the words of a command line, with lists of numbers split at commas."""
    found: list[str] = []
    for word in words:
        parts = word.split(",")
        found += parts if len(parts) > 1 and all(map(_is_number, parts)) else [word]
    return found


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def plain_help(kind: Any) -> Any:
    """Return the dataclass of a command, with a help that omits uninformative defaults.

    These are None and nothing, whose meaning the help of the option explains, and those of
    switches.
    """
    hints = get_type_hints(kind, include_extras=True)
    for option in fields(kind):
        if option.default in (None, ()) or isinstance(option.default, bool):
            silent = tyro.conf.arg(help_behavior_hint="")
            kind.__annotations__[option.name] = Annotated[hints[option.name], silent]
    return kind


def say(*lines: object) -> None:
    """Print lines that may hold names of files and of what is in them."""
    for line in lines:
        print(printable(str(line)))


def is_positional(options: type, name: str) -> bool:
    """Return whether an option of a dataclass is given by its place."""
    hint = get_type_hints(options, include_extras=True)[name]
    return tyro.conf.Positional in getattr(hint, "__metadata__", ())


def typed(command: str, options: Any, leave_out: Collection[str] = ()) -> str:
    """Return a command as typed into a shell, with the options that are not at their default."""
    names: list[str] = []
    words: list[str] = []
    for option in fields(options):
        value = getattr(options, option.name)
        default = option.default if option.default_factory is MISSING else option.default_factory()
        if is_positional(type(options), option.name):
            names += value if isinstance(value, tuple) else [value] * (value != default)
        elif value != default and option.name not in leave_out:
            name = option.name.replace("_", "-")
            words.append(f"--no-{name}" if value is False else f"--{name}")
            if isinstance(value, Mapping):
                words += [str(x) for key, pair in value.items() for x in (key, *pair)]
            elif not isinstance(value, bool):
                words += [str(x) for x in (value if isinstance(value, tuple) else (value,))]
    return shlex.join(["afl-mujoco", command, *names, *words])


@contextlib.contextmanager
def study_progress() -> Iterator[Progress]:
    """Yield a function that shows a bar for each task, which the text before a colon names.

    Bars are on stderr; without a terminal, progress is an occasional line.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress, TaskID

    console, last = Console(stderr=True), time.monotonic()
    if not console.is_terminal:

        def tell(doing: str, done: int, total: int) -> None:
            nonlocal last
            if time.monotonic() - last >= SECONDS and done < total:
                last = time.monotonic()
                print(printable(f"{doing}: {done} of {total}"), file=console.file, flush=True)

        yield tell
        return
    with Progress(console=console, transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def show(doing: str, done: int, total: int) -> None:
            task = doing.partition(":")[0]
            if task not in tasks:
                tasks[task] = bars.add_task("", total=total)
            bars.update(tasks[task], completed=done, description=escape(printable(doing)))

        yield show


@contextlib.contextmanager
def count_bar(total: int, doing: str) -> Iterator[Callable[[int], None]]:
    """Yield a function that sets a bar to the number of parts done."""
    with study_progress() as show:
        show(doing, 0, total)
        yield lambda done: show(doing, done, total)


CLOSED = "it is closed"


class Output:
    """A standard stream to which writing never fails: a command goes on to its files and verdict.

    What its encoding lacks is escaped. If its reader has gone, as that of a pipe which closes, what
    follows is for nobody; if it is full or closed, `failure` says why. The stream is None if the
    program was started without one.
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
        return getattr(self._stream, name)
