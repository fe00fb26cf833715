"""The command line: reads arguments, calls the floors below, turns errors into exit codes."""

from afl_mujoco.cli.main import main

__all__ = ["main"]
