"""Which studies there are: every package beside this file that has a module ``study``."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from functools import cache

import afl_mujoco.studies as packages
from afl_mujoco.errors import UnknownNameError
from afl_mujoco.studies.contract import Study


def studies() -> dict[str, Study]:
    """Return the studies by name, in the order of a report."""
    return {study.name: study for study in _found(tuple(packages.__path__))}


def find_study(name: str) -> Study:
    """Return a study by its name."""
    known = studies()
    if name not in known:
        raise UnknownNameError.among("study", name, known)
    return known[name]


@cache
def _found(paths: tuple[str, ...]) -> tuple[Study, ...]:
    """Return the studies in some folders."""
    names = [f"{packages.__name__}.{m.name}.study" for m in pkgutil.iter_modules(paths) if m.ispkg]
    found = [importlib.import_module(n).STUDY for n in names if importlib.util.find_spec(n)]
    return tuple(sorted(found, key=lambda study: (study.order, study.name)))
