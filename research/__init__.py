"""The paper's searches, and what its numbers rest on: outside the package, run by make targets."""

import os
import sys
from types import TracebackType


def _said_in_one_line(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Report a Ctrl-C during the imports of a command, before `run_command` can."""
    if issubclass(kind, KeyboardInterrupt):
        print("research: interrupted", file=sys.stderr, flush=True)
        os._exit(130)
    sys.__excepthook__(kind, error, trace)


if sys.argv[:1] == ["-m"]:  # python -m research.NAME, which imports this first
    sys.excepthook = _said_in_one_line
