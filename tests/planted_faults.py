"""Mutation testing of the suite: plant physical faults one at a time and see which check objects.

Each fault of planted_faults.toml is planted in a temporary copy of the repository, on which checks
run until one objects: what objected the last time (docs/results/faults.json), the tests that the
list names, the verdict of `afl-mujoco validate --full`, the other tests.

--out keeps what was found (docs/results/faults.json); with --only the rest of the file stays.
"""

import argparse
import ast
import json
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from afl_mujoco.files import write_text
from afl_mujoco.studies.shared.record import versions
from tests.faulty_copies import BRIEF, REPOSITORY, TESTS, check_all, run_command_line, say

RESULT = REPOSITORY / "docs" / "results" / "faults.json"


@dataclass(frozen=True, kw_only=True)
class PlantedFault:
    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...] = ()  # likely to object: they run first

    def plant(self, root: Path) -> None:
        path = root / self.file
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        count = text.count(self.old)
        if count != 1 or self.old == self.new:
            raise ValueError(f"{self.name}: {self.old!r} stands {count} times in {self.file}")
        text = text.replace(self.old, self.new)
        if path.suffix == ".py":
            ast.parse(text)  # what is no Python is noticed by anything
        path.write_text(text, encoding="utf-8")


def load_faults() -> list[PlantedFault]:
    table = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    faults = [PlantedFault(**row) for row in table["fault"]]
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


def checks_of(before: Mapping[str, str], copies, fault: PlantedFault):
    last = before.get(fault.name, "not run")
    test, _, name = last.partition("::")
    places = [x for x in (f"tests/{test}", test) if (REPOSITORY / x).is_file()]

    def checks(root: Path):
        if name and places:
            yield copies.tests(root, [f"{places[0]}::{name}"])
        elif last not in ("", "not run"):
            yield copies.verdict(root, BRIEF)
            yield copies.verdict(root)
        yield copies.tests(root, fault.tests)
        yield copies.verdict(root)
        yield copies.tests(root, TESTS)

    return checks


def caught(path: Path) -> dict[str, str]:
    return json.loads(path.read_text(encoding="utf-8"))["caught"] if path.is_file() else {}


def save(results: Mapping[str, str], path: Path) -> None:
    whole = {**caught(path), **results}
    listed = {fault.name: whole.get(fault.name, "not run") for fault in load_faults()}
    found = {"command": "make faults", "versions": versions(), "caught": listed}
    write_text(path, json.dumps(found, indent=1, ensure_ascii=False) + "\n")


def main() -> int:
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
    before = caught(RESULT)
    found = dict.fromkeys((fault.name for fault in faults), "")
    asked = (max(1, options.jobs), TESTS, lambda *of: checks_of(before, *of))
    for fault, by in check_all(faults, *asked):
        found[fault.name] = by
    missed = [name for name, by in found.items() if not by]
    width = max(map(len, found))
    for name, by in {"": "", "fault": "caught by", **found}.items():
        say(f"{name:<{width}}  {by or 'NOT CAUGHT' * bool(name)}")
    say(f"\n{len(faults) - len(missed)} of {len(faults)} faults caught")
    if options.out:
        save(found, options.out)
    return 1 if missed else 0


if __name__ == "__main__":
    run_command_line(main, "planted_faults")
