"""``python -m afl_mujoco`` is ``afl-mujoco``."""

import gc
import os
import signal
import sys
import threading
from typing import Any

COLLECTED_AFTER = (200_000, 100, 1000)
"""Thresholds of the garbage collector: half a million objects of the imports are never garbage,
and searching them takes a tenth of a short command's time."""


def main() -> int:
    """Run the command line; report an interrupt during its import in one line too."""
    gc.set_threshold(*COLLECTED_AFTER)
    sys.unraisablehook = _interrupt_again
    _open_missing_streams()
    try:
        from afl_mujoco.cli import main as run

        code = run()
    except KeyboardInterrupt:
        print("afl-mujoco: interrupted", file=sys.stderr)
        code = 130
    if code == 130:  # what a library was making complains as it goes, half made
        sys.unraisablehook = lambda lost: None
    return code


def _open_missing_streams() -> None:
    """Open the null device in place of standard streams that are closed.

    Else the next file that is opened would take the number of one, and get what is printed there.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # has the lowest free number


def _interrupt_again(lost: Any) -> None:
    """Repeat a Ctrl-C that came where Python drops exceptions, as in a library's destructor."""
    if not isinstance(lost.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    main_thread = threading.main_thread().ident
    threading.Timer(0.01, signal.pthread_kill, (main_thread, signal.SIGINT)).start()


if __name__ == "__main__":
    sys.exit(main())
