"""Write the tables of the documentation that say what the code declares: `make docs`.

They are the criteria, the fields of a scenario's ``[imperfections]`` and ``[requirements]``, the
imperfections whose thresholds are searched, the space of random hardware and the keys of every
result file; what was identified of the measured cart-pole and how the model was judged by its
recordings; and, given a report.json, the claims.
"""

from __future__ import annotations

import ast
import inspect
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

from afl_mujoco.document.markdown import cells_as_table, rewrite
from afl_mujoco.errors import FileError
from afl_mujoco.identification.shipped import load_estimates
from afl_mujoco.scenario.imperfections import DECLARATIONS, IDEAL, IMPERFECTIONS, Imperfections
from afl_mujoco.scenario.laboratory import LABORATORY, REASONS
from afl_mujoco.scenario.requirements import BANDS, UNITS, Requirements
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.studies.identified_parts import estimates_table, nominal_table
from afl_mujoco.studies.record import load_record
from afl_mujoco.studies.registry import studies
from afl_mujoco.studies.thresholds.classes import level_text
from afl_mujoco.studies.thresholds.imperfections import COMBINED, RAIL, added
from afl_mujoco.studies.verification.criteria import CRITERIA

REQUIREMENT_UNITS = {**UNITS, **BANDS}


def tables() -> dict[tuple[str, str], str]:
    """Return each table by its page and the name of its marks."""
    return {
        ("verification.md", "criteria"): criteria_table(),
        ("notation.md", "imperfections"): fields_table(),
        ("notation.md", "requirements"): requirements_table(),
        ("robustness.md", "reference hardware"): thresholds_table(),
        ("montecarlo.md", "space"): space_table(),
        ("results.md", "results"): results_table(),
        ("hardware.md", "identified"): identified_tables(),
    }


def measured_tables(docs: Path) -> dict[tuple[str, str], str]:
    """Return the tables that a result file of a folder of documentation holds."""
    found = json.loads((docs / "results" / "hardware.json").read_text(encoding="utf-8"))
    return {
        ("hardware.md", "judged"): judged_tables(found),
        ("hardware.md", "outlook"): outlook_table(found["survival"]),
    }


def criteria_table() -> str:
    """Return every criterion."""
    header = ("check", "quantity", "unit", "limit", "why this limit", "proves", "leaves open")
    rows = [
        (c.id, c.quantity, c.unit, f"{c.limit:g}", c.reason, c.proves, c.leaves_open)
        for c in CRITERIA.values()
    ]
    return cells_as_table(header, rows)


def claims_table(report: Path) -> str:
    """Return the claims of a report."""
    found = load_record(studies()["validate"], report.parent).result
    if not found.claims:
        raise FileError(str(report), "must hold claims: run make proof on every scenario")
    rows = []
    for claim in found.claims:
        numbers = ("–" if x is None else f"{x:.4g}" for x in (claim.paper, claim.here))
        said = f"{claim.claim}; *{claim.figure}*"
        rows.append((claim.id, said, *numbers, f"**{claim.verdict}**", claim.why))
    return cells_as_table(("", "claim", "paper", "here", "verdict", "why"), rows)


def results_table() -> str:
    """Return the keys of every study's result file, with what the docstrings say of them."""
    rows = []
    for study in studies().values():
        file = f"`{study.stem}.json`, schema {study.schema}"
        said = _attributes(study.result_type)
        names = [field.name for field in fields(study.result_type)]
        for text, alike in groupby(names, key=said.__getitem__):
            rows.append((file, ", ".join(f"`{name}`" for name in alike), text))
            file = ""
    return cells_as_table(("file", "key", "what it holds"), rows)


def _attributes(kind: type) -> dict[str, str]:
    """Return what the docstring of a dataclass says of each attribute."""
    _, _, text = inspect.cleandoc(kind.__doc__ or "").partition("Attributes\n----------\n")
    found: dict[str, list[str]] = {}
    names: list[str] = []
    for line in text.splitlines():
        if line and not line.startswith(" "):
            names = line.split(", ")
        for name in names if line.startswith(" ") else ():
            found.setdefault(name, []).append(line.strip())
    return {name: " ".join(lines).removesuffix(".") for name, lines in found.items()}


def fields_table() -> str:
    """Return the fields of `Imperfections`: key, unit, default, meaning."""
    said = _docstrings(Imperfections)
    rows = []
    for name, declared in DECLARATIONS.items():
        ideal = getattr(IDEAL, name)
        default = "none" if ideal is None else json.dumps(ideal)
        rows.append((f"`{name}`", declared.unit or "–", default, said[name]))
    return cells_as_table(("key", "unit", "default", "meaning"), rows)


def requirements_table() -> str:
    """Return the fields of `Requirements`: key, unit, default, meaning."""
    said = _attributes(Requirements)
    rows = []
    for field in fields(Requirements):
        default = "none" if field.default is None else json.dumps(field.default)
        unit = "–" if field.name == "completes" else REQUIREMENT_UNITS[field.name]
        rows.append((f"`{field.name}`", unit, default, said[field.name]))
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


def identified_tables() -> str:
    """Return what was identified of the shipped cart-pole: its estimates, then what they are."""
    one = load_estimates()
    steps = [one.pole, *([one.drive] if one.drive else [])]
    shown = [*(estimates_table("", step.estimates) for step in steps), nominal_table(one)]
    found = []
    for table in shown:
        rows = [tuple(cell.text for _, cell in row) for row in table.cells]
        found.append(cells_as_table([column.title for column in table.columns], rows))
    return "\n".join(found)


def judged_tables(found: Mapping[str, Any]) -> str:
    """Return how the model was judged by the shipped recordings."""
    statements = [
        (
            one["statement"],
            one["measure"],
            f"{one['value']:.3g}",
            f"{'≥' if one['at_least'] else '≤'} {one['limit']:g}",
            "validated" if not one["suspected"] else f"not validated; {one['suspected']}",
        )
        for one in found["statements"]
    ]
    errors = [
        (
            f"{one['horizon']:g}",
            f"{1e3 * alone['rms_phi']:.3g}",
            f"{alone['counts_phi']:.3g}",
            f"{1e3 * one['rms_phi']:.3g}",
            f"{100.0 * one['explained_phi']:.4g}",
            f"{1e3 * one['rms_z']:.3g}",
            f"{100.0 * one['explained_z']:.4g}",
        )
        for one, alone in zip(found["held_out"], found["pole"], strict=True)
    ]
    header = (
        "horizon [s]", "φ, cart known [mrad]", "[counts]", "φ, command known [mrad]",
        "explained [%]", "z, command known [mm]", "explained [%]",
    )  # fmt: skip
    tables = (
        cells_as_table(("statement", "measure", "measured", "limit", "verdict"), statements),
        cells_as_table(header, errors),
    )
    return "\n".join(tables)


def outlook_table(found: Sequence[Mapping[str, Any]]) -> str:
    """Return what controllers would do on the shipped cart-pole."""
    rows = [
        ("drawn cart-poles survived", *(f"{one['survived']} of {one['runs']}" for one in found)),
        *(
            (f"from [deg], {what}", *(f"{math.degrees(one['angles'][what]):.0f}" for one in found))
            for what in found[0]["angles"]
        ),
    ]
    return cells_as_table(("", *(f"`{one['controller']}`" for one in found)), rows)


def _factor(factor: float) -> str:
    """Return what a level is multiplied by, nothing for 1."""
    return "" if factor == 1.0 else f" × {factor:g}"


def space_table() -> str:
    """Return the space of random hardware: unit, range, why."""
    rows = []
    for name, unit, value in SampleSpace(LABORATORY).quantities():
        ends = value if isinstance(value, tuple) else (value,)
        text = " to ".join(f"{x:.4g}" for x in ends)
        rows.append((f"`{name}`", unit, text, REASONS[name]))
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


def main(docs: Path, report: Path | None = None) -> None:
    """Write every table of a folder of documentation, the claims too if there is a report."""
    for (page, name), table in {**tables(), **measured_tables(docs)}.items():
        rewrite(docs / page, name, table)
    if report is not None:
        rewrite(docs / "tuning.md", "claims", claims_table(report))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
