"""The end of every command here: bad input and a Ctrl-C are one line, as in `afl-mujoco`."""

from __future__ import annotations

import sys
from collections.abc import Callable

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.pool import interrupts_noted, is_interrupt


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
