"""The command line: parses arguments, calls the packages below, turns errors into exit codes."""

from afl_mujoco.cli.main import main

__all__ = ["main"]
