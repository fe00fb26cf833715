"""Mutation testing of the suite: plant physical faults one at a time and see which check objects.

Each fault of planted_faults.toml is planted in a temporary copy of the repository, on which the
fast checks run: the verdict of `afl-mujoco validate --full`, and if that does not object, the
tests. A copy without a fault must pass both; its compiled code goes into the others, where whatever
depends on the faulty file is compiled anew.

    python tests/planted_faults.py [--only NAME ...] [--jobs 2] [--out FILE] [--list]

--out keeps what was found (docs/results/faults.json); with --only the rest of the file stays.

Exit code 0 if every fault is caught, 1 otherwise, 130 when interrupted.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from afl_mujoco.files import write_text
from afl_mujoco.studies.record import versions

REPOSITORY = Path(__file__).resolve().parent.parent
NEEDED = ("afl_mujoco", "models", "tests", "docs", "pyproject.toml", "README.md")
VERDICT = (
    *("validate", "--full", "--no-page", "step-trapezoid", "trapezoid-step-impulse"),
    *("--controllers", "adaptive", "--workers", "1"),
)
TESTS = (
    *("tests/control", "tests/plant", "tests/scenario", "tests/simulation"),
    "tests/studies/test_bisection.py",
    *("tests/studies/thresholds/test_sweep.py", "tests/studies/thresholds/test_imperfections.py"),
    *("tests/studies/monte_carlo", "--ignore=tests/studies/monte_carlo/test_study.py"),
    "tests/studies/margins/test_measured_delay.py",
)
TIME_LIMIT = 900  # [s] for one command
HEADER = ("fault", "caught by")


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One replacement in one file."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...] = ()  # likely to object: they run first

    def plant(self, root: Path) -> None:
        """Make the replacement in a copy, or raise if the text does not stand there once."""
        path = root / self.file
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        count = text.count(self.old)
        if count != 1 or self.old == self.new:
            raise ValueError(f"{self.name}: {self.old!r} stands {count} times in {self.file}")
        path.write_text(text.replace(self.old, self.new), encoding="utf-8")


SOUND = Fault(name="no fault", file="", old="", new="")


class Checks:
    """The fast checks on copies of the repository, and the processes that run them."""

    def __init__(self, scratch: Path) -> None:
        self.scratch = scratch
        self.pristine = scratch / "pristine"
        self._copy(REPOSITORY, self.pristine)
        self._running: set[subprocess.Popen[str]] = set()
        self._lock = threading.Lock()
        self._stopped = False

    def caught_by(self, fault: Fault) -> str:
        """Return what objects to the fault, or "" if nothing does."""
        if fault is SOUND:
            return self._verdict(self.pristine) or self._tests(self.pristine)
        root = Path(tempfile.mkdtemp(dir=self.scratch))
        try:
            shutil.copytree(self.pristine, root, dirs_exist_ok=True)
            fault.plant(root)
            likely = self._tests(root, fault.tests) if fault.tests else ""
            return likely or self._verdict(root) or self._tests(root)
        finally:
            shutil.rmtree(root, ignore_errors=True)

    def stop(self) -> None:
        """End the running processes and start no other."""
        with self._lock:
            self._stopped = True
            for process in self._running:
                os.killpg(process.pid, signal.SIGKILL)  # it leads a group of its own

    def _verdict(self, root: Path) -> str:
        """Return the checks of `afl-mujoco validate` that fail."""
        out = root / "renders" / "faults"
        code, said = self._run(root, "afl_mujoco", *VERDICT, "--out", str(out))
        _require_environment(said)
        report = out / "report.json"
        if not report.exists():
            return f"validate ends with an error: {_last_line(said)}"
        checks = json.loads(report.read_text(encoding="utf-8"))["checks"]
        failed = dict.fromkeys(check["id"] for check in checks if not check["passed"])
        if not failed and code != 0:
            return f"validate ends with an error: {_last_line(said)}"
        return ", ".join(failed)

    def _tests(self, root: Path, tests: Sequence[str] = TESTS) -> str:
        """Return the first test that fails."""
        quiet = ("-q", "-x", "--no-header", "-p", "no:cacheprovider")
        code, said = self._run(root, "pytest", *quiet, *tests)
        _require_environment(said)
        if code == 0:
            return ""
        failed = re.search(r"^(?:FAILED|ERROR) (?:tests/)?(\S+?)(?:\[| |$)", said, re.MULTILINE)
        return failed[1] if failed else f"pytest ends with an error: {_last_line(said)}"

    def _run(self, root: Path, module: str, *arguments: str) -> tuple[int, str]:
        """Run a Python module on a copy and return its exit code and what it said."""
        environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
        environment["PYTHONPATH"] = str(root)
        with self._lock:
            if self._stopped:
                raise InterruptedError
            process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                cwd=root,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
            self._running.add(process)
        try:
            said, _ = process.communicate(timeout=TIME_LIMIT)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            raise TimeoutError(f"{module} still ran after {TIME_LIMIT} s") from None
        finally:
            with self._lock:
                self._running.discard(process)
        return process.returncode, said

    @staticmethod
    def _copy(source: Path, target: Path) -> None:
        """Copy what the checks need, without compiled code."""
        target.mkdir(exist_ok=True)
        for name in NEEDED:
            if (source / name).is_dir():
                ignored = shutil.ignore_patterns("__pycache__")
                shutil.copytree(source / name, target / name, ignore=ignored)
            elif (source / name).exists():
                shutil.copy(source / name, target / name)


def load_faults() -> list[Fault]:
    """Return the list, or raise if it does not fit the repository."""
    table = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    faults = [Fault(**row) for row in table["fault"]]
    if len({fault.name for fault in faults}) != len(faults):
        raise ValueError("two faults have the same name")
    with tempfile.TemporaryDirectory() as folder:
        for fault in faults:
            copy = Path(folder) / fault.file
            copy.parent.mkdir(parents=True, exist_ok=True)
            if (REPOSITORY / fault.file).exists():
                shutil.copy(REPOSITORY / fault.file, copy)
            fault.plant(Path(folder))
    return faults


def run_all(faults: Sequence[Fault], jobs: int, report: Callable[[str], None]) -> dict[str, str]:
    """Return what catches each fault by its name; "" where nothing does, first the sound copy."""
    results: dict[str, str] = {}
    with tempfile.TemporaryDirectory(prefix="afl-mujoco-faults-") as scratch:
        checks = Checks(Path(scratch))
        pool = ThreadPoolExecutor(jobs)
        try:
            started = time.monotonic()
            objected = results[SOUND.name] = pool.submit(checks.caught_by, SOUND).result()
            report(f"[{time.monotonic() - started:5.0f} s] {SOUND.name}: {objected or 'passes'}")
            if objected:
                return results
            tasks = {pool.submit(checks.caught_by, fault): fault for fault in faults}
            for done, task in enumerate(as_completed(tasks), start=1):
                fault = tasks[task]
                results[fault.name] = task.result()
                elapsed = time.monotonic() - started
                said = results[fault.name] or "NOT CAUGHT"
                report(f"[{done}/{len(tasks)} {elapsed:5.0f} s] {fault.name}: {said}")
        finally:
            checks.stop()
            pool.shutdown(wait=True, cancel_futures=True)
    return {f.name: results[f.name] for f in (SOUND, *faults) if f.name in results}


def save(results: dict[str, str], path: Path) -> None:
    """Write what caught each fault; of those that were not run, what did before."""
    before = json.loads(path.read_text(encoding="utf-8"))["caught"] if path.is_file() else {}
    whole = {**before, **results}
    caught = {fault.name: whole.get(fault.name, "not run") for fault in load_faults()}
    found = {"command": "make faults", "versions": versions(), "caught": caught}
    write_text(path, json.dumps(found, indent=1, ensure_ascii=False) + "\n")


def as_text(results: dict[str, str]) -> str:
    """Return the table for a terminal."""
    rows = [HEADER, *((n, by or "NOT CAUGHT") for n, by in results.items() if n != SOUND.name)]
    width = max(len(name) for name, _ in rows)
    return "".join(f"{name:<{width}}  {by}\n" for name, by in rows)


def _last_line(text: str) -> str:
    """Return the last line that says something."""
    return next((line for line in reversed(text.splitlines()) if line.strip()), "nothing said")


def _require_environment(said: str) -> None:
    """Raise if it was the environment that objected, and no check."""
    missing = re.search(
        r"^.*(?:ModuleNotFoundError|No space left on device).*$", said, re.MULTILINE
    )
    if missing:
        raise ValueError(f"the environment is at fault: {missing[0].strip()}")


def _interrupt(*_: object) -> None:
    """Stop, once: a second signal must not disturb the tidying up after the first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def main() -> int:
    """Run the command line and return the exit code."""
    parser = argparse.ArgumentParser(description="Plant faults and see which check catches each.")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="parts of the names of faults")
    parser.add_argument("--jobs", type=int, default=2, help="how many faults at a time")
    parser.add_argument("--out", type=Path, metavar="FILE", help="put what was found into a JSON")
    parser.add_argument("--list", action="store_true", help="only check and print the list")
    options = parser.parse_args()
    faults = load_faults()
    if options.only:
        faults = [f for f in faults if any(part in f.name for part in options.only)]
    if not faults:
        parser.error("no fault has such a name")
    if options.list:
        print("\n".join(f"{fault.name}  ({fault.file})" for fault in faults))
        return 0
    results = run_all(faults, max(1, options.jobs), lambda line: print(line, flush=True))
    if results.get(SOUND.name):
        print(f"the copy without a fault does not pass: {results[SOUND.name]}")
        return 1
    missed = [fault.name for fault in faults if not results[fault.name]]
    print(f"\n{as_text(results)}\n{len(faults) - len(missed)} of {len(faults)} faults caught")
    if options.out:
        save(results, options.out)
    return 1 if missed else 0


if __name__ == "__main__":
    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print("planted_faults: interrupted", file=sys.stderr)
        sys.exit(130)
    except (ValueError, TimeoutError) as error:
        print(f"planted_faults: {error}", file=sys.stderr)
        sys.exit(1)
