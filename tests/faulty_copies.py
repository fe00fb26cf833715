"""Copies of the repository with one fault each, and the fast checks on them.

What `planted_faults.py` and `mutants.py` share. A fault is planted in a temporary copy, on which
checks run one after the other until one objects: `afl-mujoco validate --full` on two scenarios, and
tests. A copy without a fault must pass them all; its compiled code goes into the others.

To compile takes minutes, to check seconds, so compiled code is kept, also from run to run, where
the fault cannot be in it. `afl_mujoco.compiled` keeps it as long as no source that it depends on
changes. In the copies it looks at the outlines of the sources instead: without the bodies of
functions that are not compiled and that do not run while the package is imported.
"""

import ast
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence, Set
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
NEEDED = "afl_mujoco research benchmarks models tests docs examples".split()
NEEDED += ["pyproject.toml", "README.md"]
BRIEF = "validate --no-page trapezoid-step-impulse --controllers adaptive --workers 1".split()
VERDICT = ("validate", "--full", "--no-page", "step-trapezoid", *BRIEF[2:])
STUDIES = ("bisection", "robustness", "thresholds", "montecarlo", "margins")
TESTS = ["tests/control", "tests/scenario", "tests/simulation"]
TESTS += ["tests/plants/test_cartpole_equations.py", "tests/test_loading.py"]
TESTS += [f"tests/studies/test_{x}.py" for x in STUDIES]
TIME_LIMIT = 900  # [s] for one command
MEMORY_LIMIT = 12 << 30  # [B] of addresses: a fault may ask for an endless array

KEPT = REPOSITORY / "renders" / "compiled"
"""Compiled code of the copy without a fault, from run to run; its stamps say what it is of."""

COMPILED = Path("afl_mujoco", "compiled.py")
LOOKS = "source.read_bytes()"
LOOKS_AT_OUTLINE = 'source.with_suffix(".outline").read_bytes()'
NOT_COMPILED = set(
    "property cached_property cache staticmethod classmethod contextmanager override".split()
)


class TimeLimitError(Exception):
    """A command ran longer than it may."""


class Copies:
    """Copies of the repository, and the processes that run checks on them."""

    def __init__(self, scratch: Path) -> None:
        self.scratch = scratch
        self.pristine = scratch / "pristine"
        _copy(REPOSITORY, self.pristine)
        self._ran = ran_at_import(self.pristine)
        packages = (self.pristine / name for name in ("afl_mujoco", "research", "tests"))
        for source in (file for package in packages for file in package.rglob("*.py")):
            self._write_outline(self.pristine, source.relative_to(self.pristine))
        compiled = self.pristine / COMPILED
        text = compiled.read_text(encoding="utf-8")
        if text.count(LOOKS) != 1:
            raise ValueError(f"{LOOKS!r} must stand once in {COMPILED}")
        compiled.write_text(text.replace(LOOKS, LOOKS_AT_OUTLINE), encoding="utf-8")
        if KEPT.is_dir():
            shutil.copytree(KEPT, self.pristine, dirs_exist_ok=True)
        self._running: set[subprocess.Popen[str]] = set()
        self._lock = threading.Lock()
        self._stopped = False

    def objection(self, fault, checks) -> str:
        """Return the first objection of some checks to a fault, "" if nothing objects."""
        root = Path(tempfile.mkdtemp(dir=self.scratch))
        try:
            shutil.copytree(self.pristine, root, dirs_exist_ok=True, copy_function=_link_compiled)
            fault.plant(root)
            if fault.file.endswith(".py"):
                self._write_outline(root, Path(fault.file))
            return next(filter(None, checks(root)), "")
        finally:
            shutil.rmtree(root, ignore_errors=True)

    def keep_compiled(self) -> None:
        shutil.rmtree(KEPT, ignore_errors=True)
        for pattern in ("*.nbi", "*.nbc"):
            for path in (self.pristine / "afl_mujoco").rglob(pattern):
                kept = KEPT / path.relative_to(self.pristine)
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, kept)

    def stop(self) -> None:
        with self._lock:
            self._stopped = True
            for process in self._running:
                os.killpg(process.pid, signal.SIGKILL)  # it leads a group of its own

    def verdict(self, root: Path, command: Sequence[str] = VERDICT) -> str:
        out = root / "renders" / "faults"
        code, said = self._run(root, TIME_LIMIT, "afl_mujoco", *command, "--out", str(out))
        report = out / "report.json"
        if not report.exists():
            return f"validate ends with an error: {_last_line(said)}"
        checks = json.loads(report.read_text(encoding="utf-8"))["checks"]
        failed = dict.fromkeys(check["id"] for check in checks if not check["passed"])
        return ", ".join(failed) or ("a requirement of a scenario" if code else "")

    def tests(self, root: Path, tests: Sequence[str], limit: float = TIME_LIMIT) -> str:
        if not tests:
            return ""
        quiet = ("-q", "-x", "--no-header", "-p", "no:cacheprovider")
        code, said = self._run(root, limit, "pytest", *quiet, *tests)
        if code == 0 or "ERROR: not found:" in said:  # a test that is gone notices nothing
            return ""
        failed = re.search(r"^(?:FAILED|ERROR) (?:tests/)?(\S+?)(?:\[| |$)", said, re.MULTILINE)
        return failed[1] if failed else f"pytest ends with an error: {_last_line(said)}"

    def _run(self, root: Path, limit: float, module: str, *arguments: str) -> tuple[int, str]:
        environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = str(root)
        with self._lock:
            if self._stopped:
                raise InterruptedError
            process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments], cwd=root, env=environment, text=True,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
            self._running.add(process)
        try:
            resource.prlimit(process.pid, resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
            said, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            raise TimeLimitError(f"{module} still ran after {limit:g} s") from None
        finally:
            with self._lock:
                self._running.discard(process)
        if missing := re.search(r".*(?:ModuleNotFoundError|No space left on device).*", said):
            raise ValueError(f"the environment is at fault: {missing[0].strip()}")
        return process.returncode, said

    def _write_outline(self, root: Path, file: Path) -> None:
        kept = text = (root / file).read_text(encoding="utf-8")
        with suppress(SyntaxError):
            kept = outline(text, self._ran.get(str(file), set()))
        (root / file).with_suffix(".outline").write_text(kept, encoding="utf-8")


def outline(text: str, ran: Set[int]) -> str:
    """Return a source with its lines, but no body of a function that cannot be in compiled code.

    A function stays if it is decorated by anything that may compile it, holds another function that
    is, or begins on one of the lines of those that `ran` at import.
    """
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        inner = (one for one in ast.walk(node) if isinstance(one, ast.FunctionDef))
        if isinstance(node, ast.FunctionDef) and not any(_may_run(one, ran) for one in inner):
            first, last = node.body[0].lineno, node.end_lineno or node.lineno
            if first > node.lineno:  # a body on lines of its own
                lines[first - 1 : last] = [""] * (last - first + 1)
    return "\n".join(lines)


def _may_run(function: ast.FunctionDef, ran: Set[int]) -> bool:
    made_by = [getattr(one, "func", one) for one in function.decorator_list]
    names = {getattr(one, "attr", getattr(one, "id", "")) for one in made_by}
    return min(one.lineno for one in (function, *made_by)) in ran or not names <= NOT_COMPILED


IMPORT_ALL = """
import importlib, json, pkgutil, sys
ran = set()
def note(frame, event, argument):
    if event == "call":
        ran.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))
sys.setprofile(note)
import afl_mujoco
for one in pkgutil.walk_packages(afl_mujoco.__path__, "afl_mujoco."):
    if not one.name.endswith("__main__"):
        importlib.import_module(one.name)
sys.setprofile(None)
print(json.dumps(sorted(ran)))
"""


def ran_at_import(root: Path) -> dict[str, set[int]]:
    """Return the lines on which the functions begin that run while a copy is imported, by file."""
    command, environment = [sys.executable, "-c", IMPORT_ALL], {**os.environ, "PYTHONPATH": "."}
    said = subprocess.check_output(command, cwd=root, env=environment, text=True)
    found: dict[str, set[int]] = {}
    for name, line in json.loads(said):
        found.setdefault(os.path.relpath(os.path.join(root, name), root), set()).add(line)
    return found


def say(line: str) -> None:
    print(line, flush=True)


def check_all(faults, jobs, tests, checks):
    """Yield each fault with what objects to it, as they come, after a copy without a fault."""
    with tempfile.TemporaryDirectory(prefix="afl-mujoco-faults-") as scratch:
        copies = Copies(Path(scratch))
        pool = ThreadPoolExecutor(jobs)
        try:
            started = time.monotonic()
            objected = copies.tests(copies.pristine, [*tests, f"--numprocesses={jobs}"])
            if objected := objected or copies.verdict(copies.pristine):
                raise ValueError(f"the copy without a fault does not pass: {objected}")
            copies.keep_compiled()
            say(f"[{time.monotonic() - started:5.0f} s] no fault: passes")
            tasks = {pool.submit(copies.objection, one, checks(copies, one)): one for one in faults}
            for done, task in enumerate(as_completed(tasks), start=1):
                said = task.result() or "NOT CAUGHT"
                elapsed = time.monotonic() - started
                say(f"[{done}/{len(tasks)} {elapsed:5.0f} s] {tasks[task].name}: {said}")
                yield tasks[task], task.result()
        finally:
            copies.stop()
            pool.shutdown(wait=True, cancel_futures=True)


def files_of(tests: Sequence[str]) -> list[str]:
    paths = [REPOSITORY / name for name in tests]
    every = [sorted(path.rglob("test_*.py")) if path.is_dir() else [path] for path in paths]
    return [str(file.relative_to(REPOSITORY)) for files in every for file in files]


def run_command_line(main: Callable[[], int], name: str) -> None:
    def interrupt(*_: object) -> None:
        """Stop, once: a second signal must not disturb the tidying up after the first."""
        for one in (signal.SIGINT, signal.SIGTERM):
            signal.signal(one, signal.SIG_IGN)
        raise KeyboardInterrupt

    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, interrupt)
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr)
        sys.exit(130)
    except (ValueError, TimeLimitError) as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(1)


def _copy(source: Path, target: Path) -> None:
    target.mkdir(exist_ok=True)
    for name in NEEDED:
        if (source / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__", "_build", "generated")
            shutil.copytree(source / name, target / name, ignore=ignored)
        elif (source / name).exists():
            shutil.copy(source / name, target / name)


def _link_compiled(source: str, target: str) -> None:
    """Copy a file; compiled code, which is only ever replaced as a whole, is linked."""
    if f"{os.sep}__pycache__{os.sep}" in source:
        os.link(source, target)
    else:
        shutil.copy2(source, target)


def _last_line(text: str) -> str:
    return next((line for line in reversed(text.splitlines()) if line.strip()), "nothing said")
