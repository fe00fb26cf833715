"""``python -m afl_mujoco`` is ``afl-mujoco``."""

import sys


def main() -> int:
    """Run the command line; report an interrupt during its import in one line too."""
    try:
        from afl_mujoco.cli import main as run

        return run()
    except KeyboardInterrupt:
        print("afl-mujoco: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
