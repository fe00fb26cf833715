"""What the commands share: exit codes, folders, names of scenarios, and the progress bar."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Collection, Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import tyro

if TYPE_CHECKING:
    from rich.progress import Progress

SUCCESS, CHECK_FAILED, BAD_INPUT, INTERRUPTED, BROKEN_PIPE = 0, 1, 2, 130, 141

FILMS, RESULTS = Path("renders"), Path("renders/validation")
"""Where films, and the results of studies with their page, are written by default."""


def separated(value: Any) -> Any:
    """Return a list of words with those that commas separate apart; anything else as it is."""
    if not (isinstance(value, tuple) and all(isinstance(word, str) for word in value)):
        return value
    return tuple(word for given in value for word in given.split(","))


@contextlib.contextmanager
def progress_bar(total: int, doing: str) -> Iterator[Callable[[str], None]]:
    """Give a callable that advances a bar by one, given what has been done."""
    with _bar() as bar:
        task = bar.add_task(doing, total=total)
        yield lambda done: bar.update(task, advance=1, description=done)


@contextlib.contextmanager
def bars() -> Iterator[Callable[[str, int], Callable[[int], None]]]:
    """Give a callable that adds a bar, by what it says and its total, and returns what sets it."""
    with _bar() as shown:

        def add(doing: str, total: int) -> Callable[[int], None]:
            task = shown.add_task(doing, total=total)
            return lambda done: shown.update(task, completed=done)

        yield add


@contextlib.contextmanager
def count_bar(total: int, doing: str) -> Iterator[Callable[[int], None]]:
    """Give a callable that sets a bar to how many are done, as sweeps count."""
    with _bar() as bar:
        task = bar.add_task(doing, total=total)
        yield lambda done: bar.update(task, completed=done)


def typed(command: str, options: Any, leave_out: Collection[str] = ()) -> str:
    """Return a command as typed into a shell, options that are not the default written out."""
    hints = get_type_hints(type(options), include_extras=True)
    names: list[str] = []
    words: list[str] = []
    for option in fields(options):
        value = getattr(options, option.name)
        if tyro.conf.Positional in getattr(hints[option.name], "__metadata__", ()):
            names += value
        elif value != option.default and option.name not in leave_out:
            name = option.name.replace("_", "-")
            words.append(f"--no-{name}" if value is False else f"--{name}")
            if not isinstance(value, bool):
                words += [str(x) for x in (value if isinstance(value, tuple) else (value,))]
    return shlex.join(["afl-mujoco", command, *names, *words])


def _bar() -> Progress:
    """Return bars on stderr, with the time left; silent when that is no terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    return Progress(console=console, disable=not console.is_terminal, transient=True)
