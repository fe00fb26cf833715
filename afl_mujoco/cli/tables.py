"""Write the tables of the documentation that say what the code declares: `make docs`.

They are the fields of a scenario's ``[imperfections]``, the imperfections whose thresholds are
searched, and the space of random hardware.
"""

from __future__ import annotations

import ast
import inspect
import json
import sys
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path

from afl_mujoco.document.markdown import cells_as_table
from afl_mujoco.scenario.imperfections import DECLARATIONS, IDEAL, IMPERFECTIONS, Imperfections
from afl_mujoco.studies.monte_carlo.space import SampleSpace
from afl_mujoco.studies.thresholds.classes import level_text
from afl_mujoco.studies.thresholds.imperfections import COMBINED, RAIL, added
from afl_mujoco.studies.verification.criteria_table import rewrite


def tables() -> dict[tuple[str, str], str]:
    """Return each table by its page and the name of its marks."""
    return {
        ("notation.md", "imperfections"): fields_table(),
        ("robustness.md", "reference hardware"): thresholds_table(),
        ("montecarlo.md", "space"): space_table(),
    }


def fields_table() -> str:
    """Return the fields of `Imperfections`: key, unit, default, meaning."""
    said = _docstrings(Imperfections)
    rows = []
    for name, declared in DECLARATIONS.items():
        ideal = getattr(IDEAL, name)
        default = "none" if ideal is None else json.dumps(ideal)
        rows.append((f"`{name}`", declared.unit or "–", default, said[name]))
    return cells_as_table(("key", "unit", "default", "meaning"), rows)


def thresholds_table() -> str:
    """Return the imperfections that are swept: fields, reference level, range, why."""
    rows = []
    for declared in DECLARATIONS.values():
        for one in declared.swept:
            sets = [f"`{name}`" + _factor(x) for name, x in one.fields.items()]
            sets += [f"`{name}`" for name in one.switches]
            reference, *ends = (level_text(one, x) for x in (one.reference, one.benign, one.harsh))
            levels = (f"{reference} {one.unit}", f"{' to '.join(ends)} {one.unit}")
            rows.append((f"`{one.name}`", ", ".join(sets), *levels, declared.why))
    together = {one.name for one in added()} - {RAIL}
    left_out = ", ".join(f"`{one.name}`" for one in IMPERFECTIONS if one.name not in together)
    span = " to ".join(level_text(COMBINED, x) for x in (COMBINED.benign, COMBINED.harsh))
    rows.append(("`combined`", f"all but {left_out}", "1 ×", f"{span} ×", "scaled together"))
    return cells_as_table(("imperfection", "sets", "reference hardware", "searched", "why"), rows)


def _factor(factor: float) -> str:
    """Return what a level is multiplied by, nothing for 1."""
    return "" if factor == 1.0 else f" × {factor:g}"


def space_table() -> str:
    """Return the space of random hardware: unit, range, why."""
    rows = []
    for name, unit, value, why in SampleSpace().quantities():
        ends = value if isinstance(value, tuple) else (value,)
        text = " to ".join("none" if x is None else f"{x:.4g}" for x in ends)
        rows.append((f"`{name}`", unit, text, why))
    return cells_as_table(("field", "unit", "range", "why"), rows)


def _docstrings(kind: type) -> Mapping[str, str]:
    """Return the docstring under each field of a dataclass, on one line."""

    def found() -> Iterator[tuple[str, str]]:
        (source,) = ast.parse(inspect.getsource(kind)).body
        assert isinstance(source, ast.ClassDef)
        for one, following in pairwise(source.body):
            if isinstance(one, ast.AnnAssign) and isinstance(following, ast.Expr):
                text = ast.literal_eval(following.value)
                yield ast.unparse(one.target), " ".join(text.split()).removesuffix(".")

    return dict(found())


if __name__ == "__main__":
    for (page, name), table in tables().items():
        rewrite(Path(sys.argv[1]) / page, name, table)
