"""``python -m afl_mujoco`` is ``afl-mujoco``."""

import gc
import sys

COLLECTED_AFTER = (200_000, 100, 1000)
"""Thresholds of the garbage collector: half a million objects of the imports are never garbage,
and searching them takes a tenth of a short command's time."""


def main() -> int:
    """Run the command line; report an interrupt during its import in one line too."""
    gc.set_threshold(*COLLECTED_AFTER)
    try:
        from afl_mujoco.cli import main as run

        return run()
    except KeyboardInterrupt:
        print("afl-mujoco: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
