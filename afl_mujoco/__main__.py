"""``python -m afl_mujoco`` is ``afl-mujoco``."""

import sys

from afl_mujoco.cli import main

if __name__ == "__main__":
    sys.exit(main())
