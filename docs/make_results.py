"""Make the results anew that the pages rest on: `make results`.

    python docs/make_results.py [NAME ...] [--cheap] [--check] [--list]

With --check no result is kept: the numbers of the pages are compared with those of the new results,
and the exit code is 1 where one has moved by more than ``numbers.toml`` allows, or where an example
prints another line.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from difflib import unified_diff
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from afl_mujoco.studies.shared.record import versions
from docs.content import DOCS, RESULTS, Content
from docs.sources import MADE, ROOT, SOURCES, Source


def make(source: Source, folder: Path) -> None:
    """Make a result in a folder.

    Raises
    ------
    SystemExit
        If what makes it fails, and nothing is replaced.
    """
    if source.script:
        _write_output(source, folder)
        return
    old = [(MADE / source.file).with_suffix(suffix) for suffix in (".json", ".npz")]
    for path in old:
        path.unlink(missing_ok=True)
    words = ["afl_mujoco", source.name, *source.words, "--no-page"]
    if source.research:
        words = [f"research.{source.name}"]
    ended = subprocess.run([sys.executable, "-m", *words, "--out", str(MADE)], cwd=ROOT)
    new = [path for path in old if path.is_file()]
    if ended.returncode not in (0, 1) or old[0] not in new:  # 1: it judges, and not all holds
        raise SystemExit(f"make_results: {source.name} ended with {ended.returncode}")
    for path in old:
        (folder / path.name).unlink(missing_ok=True)
    for path in new:
        shutil.copy(path, folder / path.name)


def _write_output(source: Source, folder: Path) -> None:
    """Write what a script prints, and keep what it draws."""
    environment = {**os.environ, "COLUMNS": "100", "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        [sys.executable, *source.command.split()[1:]],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    if ended.returncode:
        raise SystemExit(f"make_results: {source.name} ended with {ended.returncode}")
    made_by = ", ".join(f"{name} {number}" for name, number in versions().items())
    text = f"$ {source.command}\n{ended.stdout.strip()}\n\n{made_by}, {os.cpu_count()} cores\n"
    (folder / source.file).write_text(text, encoding="utf-8")
    picture = ROOT / "renders" / f"{source.name}.png"
    if folder == RESULTS and picture.is_file():
        shutil.copy(picture, DOCS / "img")


def moved(before: Content, now: Content, names: Sequence[str]) -> list[str]:
    """Return the numbers of some results that have moved by more than their uncertainty."""
    return [
        f"{group}.{name} was {was}, is {now.numbers[group][name]}"
        for group in names
        for name, was in before.numbers.get(group, {}).items()
        if was.moved_to(now.numbers[group][name])
    ]


def other_lines(source: Source, folder: Path) -> list[str]:
    """Return how an example prints otherwise than is kept; the last line has the versions."""
    was, now = (
        (place / source.file).read_text(encoding="utf-8").splitlines()[:-1]
        for place in (RESULTS, folder)
    )
    return list(unified_diff(was, now, source.file, "now", n=0, lineterm=""))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    names = [source.name for source in SOURCES]
    parser = argparse.ArgumentParser(description="Make the results anew that the pages rest on.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which of {', '.join(names)}")
    parser.add_argument("--cheap", action="store_true", help="those that take minutes only")
    parser.add_argument("--check", action="store_true", help="compare, and keep nothing")
    parser.add_argument("--list", action="store_true", help="print them, and how long they take")
    options = parser.parse_args(arguments)
    if unknown := set(options.names) - set(names):
        parser.error(f"no result is called {', '.join(sorted(unknown))}")
    chosen = [
        source
        for source in SOURCES
        if (source.cheap or not options.cheap)
        and source.name in (options.names or names)
        and not (options.check and source.timed)
    ]
    if not chosen:
        parser.error("nothing is left to do: output is not compared, and not all is cheap")
    if options.list:
        print("\n".join(f"{s.name:<28}{s.minutes:>5g} minutes on two cores" for s in chosen))
        return 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) if options.check else RESULTS
        for source in chosen:
            started = time.monotonic()
            make(source, folder)
            print(f"{source.name}: {(time.monotonic() - started) / 60.0:.1f} minutes", flush=True)
        if not options.check:
            return 0
        compared, before = [source.name for source in chosen], Content()
        found = moved(before, Content(folder), compared)
        found += [line for one in chosen if one.script for line in other_lines(one, folder)]
    how_many = sum(len(before.numbers.get(name, {})) for name in compared)
    print("\n".join(found) or f"none of {how_many} numbers moved by more than its uncertainty")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
