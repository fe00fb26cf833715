"""Which studies there are: what beside this file names one."""

from __future__ import annotations

import importlib
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import afl_mujoco.studies as package
from afl_mujoco.errors import UnknownNameError
from afl_mujoco.studies.contract import Study

_STUDY = re.compile(r"^STUDY = Study\((.*?)\)$", re.S | re.M)
_GIVEN = re.compile(r"\b(name|order|stem)=\"?(\w+)")


class Listed(NamedTuple):
    """A study before it is imported: its place in the order, name, module and first line."""

    order: int
    name: str
    module: str
    summary: str
    stem: str  # beginning of its file names


def listed() -> dict[str, Listed]:
    """Return the studies by name, in the order of a report, without importing one."""
    return {one.name: one for one in _found(tuple(package.__path__))}


def studies() -> dict[str, Study]:
    """Return the studies by name, in the order of a report."""
    return {name: find_study(name) for name in listed()}


def find_study(name: str) -> Study:
    """Return a study by its name."""
    known = listed()
    if name not in known:
        raise UnknownNameError.among("study", name, known)
    study: Study = importlib.import_module(known[name].module).STUDY
    return study


@cache
def _found(paths: tuple[str, ...]) -> tuple[Listed, ...]:
    """Return the studies in some folders."""
    found = []
    for folder in map(Path, paths):
        for path in folder.glob("*.py"):
            text = path.read_text(encoding="utf-8")
            if named := _STUDY.search(text):
                module, summary = f"{package.__name__}.{path.stem}", text.splitlines()[0].strip('"')
                given: dict[str, str] = dict(_GIVEN.findall(named[1]))
                name, stem = given["name"], given.get("stem", given["name"])
                found.append(Listed(int(given["order"]), name, module, summary, stem))
    return tuple(sorted(found))
