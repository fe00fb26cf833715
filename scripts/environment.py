"""Install what lock files pin into the environment of the Python that runs this, or make them anew.

uv does it, from the PATH or else from `requirements-uv.lock`, with pip's settings of indexes and
certificates; pip where uv cannot be had.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
PINNED = ["--no-deps", "--require-hashes"]

CARRIED = {
    "index_url": ("UV_DEFAULT_INDEX", " "),
    "extra_index_url": ("UV_INDEX", " "),
    "find_links": ("UV_FIND_LINKS", ","),
    "no_index": ("UV_NO_INDEX", " "),
    "trusted_host": ("UV_INSECURE_HOST", " "),
    "cert": ("SSL_CERT_FILE", " "),
    "client_cert": ("SSL_CLIENT_CERT", " "),
    "proxy": ("ALL_PROXY", " "),
    "default_timeout": ("UV_HTTP_TIMEOUT", " "),
    "timeout": ("UV_HTTP_TIMEOUT", " "),
}
"""pip's settings, and the variable in which uv takes each, with what stands between several."""

LOCKS = {
    "requirements.lock": ["--group", "dev"],
    "requirements-docs.lock": ["--extra", "docs", "--group", "dist"],
    "requirements-cluster.lock": ["--extra", "cluster"],
    "requirements-pinocchio.lock": ["--group", "pinocchio"],
    "requirements-uv.lock": ["--group", "uv"],
}
"""What of pyproject.toml each lock resolves; the others hold what the first does not."""


IMPORTED = """
import compileall, importlib, pkgutil, re
import afl_mujoco, matplotlib.pyplot, numba, PIL, pydantic, pytest, rich
for module in pkgutil.walk_packages(afl_mujoco.__path__, "afl_mujoco."):
    importlib.import_module(module.name)
for package in matplotlib, numba, PIL, pydantic, rich:  # which import more as they are used
    compileall.compile_dir(package.__path__[0], quiet=2, workers=2, rx=re.compile("/tests?/"))
"""
"""What commands import; uv leaves it to Python to compile it, where pip compiles all there is."""


def carried() -> dict[str, str]:
    """Return the variables by which uv has pip's settings, beside those that are set already."""
    listed = subprocess.run([*PIP, "config", "list"], capture_output=True, text=True, check=False)
    found = {"UV_SYSTEM_CERTS": "1", "UV_PYTHON": sys.executable}
    for line in listed.stdout.splitlines():  # the environment's come first, and count most
        name, equals, value = line.partition("=")
        key = name.rpartition(".")[2].replace("-", "_")
        if equals and key in CARRIED:
            variable, between = CARRIED[key]
            found.setdefault(variable, between.join(ast.literal_eval(value).split()))
    return {**found, **os.environ}


def find_uv() -> str:
    """Return the path of uv; it is installed if need be, and an error says that it cannot be."""
    if there := shutil.which("uv") or shutil.which("uv", path=Path(sys.executable).parent):
        return there
    lock = ROOT / "requirements-uv.lock"
    run([*PIP, "install", "--quiet", *PINNED, "--requirement", str(lock)])
    return str(Path(sys.executable).with_name("uv"))


def run(command: list[str], env: dict[str, str] | None = None) -> None:
    """Run a command that prints only if it fails; the last line of that is the error."""
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines() or [f"exit {done.returncode}"]
        raise OSError(lines[-1].strip())


def install(arguments: list[str]) -> None:
    """Install by uv, or by pip with one line that says why."""
    try:
        best = ["--index-strategy", "unsafe-best-match"]  # all indexes alike, as pip has them
        run([find_uv(), "pip", "install", *best, *arguments], carried())
    except OSError as error:
        print(f"set-up: pip installs, which takes a minute more; uv: {error}", flush=True)
        run([*PIP, "install", "--quiet", *arguments])


def lock(name: str, upgrade: list[str]) -> None:
    """Resolve a lock anew; its versions stay unless they are to be upgraded."""
    from packaging.requirements import Requirement  # of requirements.lock

    path, first = ROOT / name, ROOT / "requirements.lock"
    header = re.findall(r"^#.*\n", path.read_text(), re.MULTILINE)
    pins = re.findall(r"^([\w.-]+==[^\\]+)", first.read_text(), re.MULTILINE)
    here = [pin for pin in map(Requirement, pins) if pin.marker is None or pin.marker.evaluate()]
    given = [
        *("--quiet", "--no-header", "--no-annotate", "--generate-hashes"),
        *("--universal", "--python-version", "3.11"),
        *("--fork-strategy", "fewest", "--index-strategy", "unsafe-best-match"),
        *(f"--no-emit-package={pin.name}" for pin in here if path != first),
        *([] if path == first else ["--constraints", str(first)]),
    ]
    asked = ["pyproject.toml", *LOCKS[name], *given, *upgrade, "--output-file", name]
    run([find_uv(), "pip", "compile", *asked], carried())
    path.write_text("".join(header) + path.read_text())


def main(asked: list[str]) -> None:
    """Install the locks that are named, or make all anew: `lock`, `lock --upgrade`."""
    os.chdir(ROOT)
    if asked[:1] == ["lock"]:
        for name in LOCKS:
            lock(name, asked[1:])
        return
    for name in asked:
        install([*PINNED, "--requirement", name])
    if "requirements.lock" in asked:
        install(["--no-deps", "--no-build-isolation", "--editable", "."])
        if sys.dont_write_bytecode:  # each run would compile all that it imports anew
            writing = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
            run([sys.executable, "-c", IMPORTED], writing)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except OSError as error:
        sys.exit(f"set-up: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
