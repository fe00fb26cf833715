"""The program in a process of its own, as a user starts it."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

COMMAND = (sys.executable, "-m", "afl_mujoco")


def run(*arguments: str, cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([*COMMAND, *arguments], cwd=cwd, env={**os.environ, **variables},
                          capture_output=True, text=True, timeout=300)  # fmt: skip
    done.stderr = without_progress(done.stderr)
    return done


def without_progress(said: str) -> str:
    return re.sub(r"^.+: \d+ of \d+\n", "", said, flags=re.MULTILINE)


def interrupt(*arguments, cwd: Path, once, after=0.0, command=COMMAND, name="afl-mujoco") -> None:
    """Start a command and press Ctrl-C some time [s] after something has come true.

    It must end as every command does then: exit code 130, one line, and nothing on stdout.
    """
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([*command, *arguments], cwd=cwd, start_new_session=True, **pipes)
    while not once():
        time.sleep(0.02)
        assert process.poll() is None, process.communicate()
    time.sleep(after)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    ended = (process.returncode, output, errors)
    assert ended == (130, "", f"{name}: interrupted\n"), ended
