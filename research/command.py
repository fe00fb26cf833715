"""The end of every command here: bad input and a Ctrl-C are one line, as in `afl-mujoco`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import NoReturn

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.pool import interrupts_noted, is_interrupt


class Parser(argparse.ArgumentParser):
    """Options of a command, of which one that is wrong is told in one line."""

    def error(self, message: str) -> NoReturn:
        """Raise what `run_command` prints."""
        raise AflMujocoError(self.prog, f"cannot take that: {message} (--help lists its options)")


def run_command(command: Callable[[], None]) -> None:
    """Run a command and exit with 0, 2 for bad input or 130 for a Ctrl-C."""
    try:
        with interrupts_noted():
            try:
                command()
            except BaseException as error:
                if is_interrupt(error):
                    raise KeyboardInterrupt from None
                raise
    except KeyboardInterrupt:
        print("research: interrupted", file=sys.stderr)
        sys.exit(130)
    except AflMujocoError as error:
        print(f"research: {error}", file=sys.stderr)
        sys.exit(2)
