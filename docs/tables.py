"""Tables of what the code declares, as Markdown."""

from __future__ import annotations

import inspect
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import groupby, takewhile
from pathlib import Path
from typing import Any

from afl_mujoco.control.angle import ANGLES, slope_at
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.scenario.catalogue import LABORATORY, START
from afl_mujoco.scenario.imperfections import (
    DECLARATIONS,
    DRAWS,
    IDEAL,
    IMPERFECTIONS,
    Imperfections,
)
from afl_mujoco.scenario.requirements import Requirements, asked_of, bands_of
from afl_mujoco.scenario.sample_space import SampleSpace
from afl_mujoco.studies.shared.contract import studies
from afl_mujoco.studies.shared.robustness import COMBINED, RAIL, added
from afl_mujoco.studies.thresholds import level_text
from docs.sources import SOURCES


def tables() -> dict[str, str]:
    """Return each table by its name."""
    return {
        "angle": angle_table(),
        "imperfections": fields_table(),
        "requirements": requirements_table(),
        "reference hardware": thresholds_table(),
        "space": space_table(),
        "result files": results_table(),
        "sources": sources_table(),
    }


def cells_as_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return cells that are Markdown already as a table."""
    lines = [header, ("---",) * len(header), *rows]
    cells = [[cell.replace("|", "\\|") for cell in line] for line in lines]
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)


def printed_table(folder: Path, name: str) -> str:
    """Return the table that a script printed, whose header is underlined."""
    lines = (folder / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    under = next(k for k, line in enumerate(lines) if line.startswith("──"))
    rows = takewhile(len, (line.strip() for line in [lines[under - 1], *lines[under + 1 :]]))
    header, *cells = (re.split(r" {2,}", row) for row in rows)
    return cells_as_table(header, cells)


def angle_table() -> str:
    """Return lambda of `adaptive-angle` by the angle and the half-length."""
    lengths = (0.05, 0.2, 0.5, 1.0)
    middle = 0.5 * sum(ANGLES)
    rows = [
        (text, *(f"{slope_at(angle, length):.2f}" for length in lengths))
        for text, angle in (
            (f"up to {math.degrees(ANGLES[0]):.0f}°", ANGLES[0]),
            (f"{math.degrees(middle):.0f}°", middle),
            (f"from {math.degrees(ANGLES[1]):.0f}°", ANGLES[1]),
        )
    ]
    return cells_as_table(("abs(φ)", *(f"l = {length:g} m" for length in lengths)), rows)


def faults_table(results: Path) -> str:
    """Return which check catches each planted fault."""
    found = json.loads((results / "faults.json").read_text(encoding="utf-8"))["caught"]
    return cells_as_table(
        ("fault", "caught by"), [(name, by or "**nothing**") for name, by in found.items()]
    )


def mutants_table(results: Path) -> str:
    """Return how many mutants of each part of the code are noticed."""
    found = json.loads((results / "mutants.json").read_text(encoding="utf-8"))
    rows = []
    for area, one in [*found["areas"].items(), ("**all**", found)]:
        counts = [str(one[k]) for k in ("sampled", "equivalent", "killed", "survived")]
        low, high = one["interval"] or (0.0, 1.0)
        score = "–" if one["score"] is None else f"{100.0 * one['score']:.1f} %"
        rows.append((area, *counts, score, f"{100.0 * low:.0f} to {100.0 * high:.0f} %"))
    header = ("mutants of", "drawn", "equivalent", "noticed", "not noticed", "score", "interval")
    return f"{cells_as_table(header, rows)}\nMade by: `{found['command']}`\n"


def survivors_table(results: Path, outcome: str) -> str:
    """Return the mutants with an outcome, ``survived`` or ``equivalent``, the latter with why."""
    found = json.loads((results / "mutants.json").read_text(encoding="utf-8"))["mutants"]
    rows = [
        (f"`{one['file']}`", f"`{one['was']}`", f"`{one['now']}`", one["by"])
        for one in found
        if one["outcome"] == outcome
    ]
    return cells_as_table(("file", "line", "mutant", "why"), rows) if rows else "None.\n"


def optimisers_table(folder: Path) -> str:
    """Return the expected evaluations of each optimiser to the closest target, by plant."""
    found = json.loads((folder / "optimisers.json").read_text(encoding="utf-8"))
    shown = next(iter(found["summary"].values()))
    plants = [plant for plant, row in shown.items() if "successes" in row]
    rows = []
    for optimiser, by_plant in found["summary"].items():
        cells = []
        for plant in plants:
            runs, needed = (by_plant[plant][k][-1] for k in ("successes", "expected_running_time"))
            cells.append("–" if needed is None else f"{needed:.0f}")
            cells[-1] += "" if runs == found["runs"] else f" ({runs} of {found['runs']} runs)"
        rows.append((optimiser, *cells))
    header = (f"expected evaluations to within {found['targets'][-1]:g} of the optimum", *plants)
    return cells_as_table(header, rows)


def readings_tables(folder: Path) -> dict[str, str]:
    """Return what random readings of the paper say, the fitted ones, and Table 1 under scales."""
    found = json.loads((folder / "readings.json").read_text(encoding="utf-8"))
    cases = found["sensitivity"]["cases"]
    names = [case["case"] for case in cases]
    random = [
        (
            case["case"],
            f"{case['paper']:.2f}",
            *(f"{100.0 * case[share]:.1f}" for share in ("near", "half", "positive")),
            *(f"{case['quantiles'][k]:.1f}" for k in (0, 2, 4)),
        )
        for case in cases
    ]
    fitted = [
        (f"`{one['name']}`", *(f"{x:.1f}" for x in one["improvements"]))
        for one in found["readings"]
    ]
    optima: dict[tuple[str, ...], list[str]] = {}  # horizons by all the rest
    for one in found["optima"]:
        cells = [f"{one[key]}" for key in ("labels", "best", "as_decided")]
        cells += [f"{100.0 * one[key]:.1f}" for key in ("median_excess", "column_error")]
        optima.setdefault(tuple(cells), []).append(f"{one['horizon']:g}")
    optimal = ("optimal rows at best", "under D4", "median excess at best, %")
    shares = ("within 5 points, %", "at least half, %", "above zero, %")
    ends = ("5 % quantile, %", "median, %", "95 % quantile, %")
    return {
        "random readings": cells_as_table(("case", "paper, %", *shares, *ends), random),
        "fitted readings": cells_as_table(
            ("reading", *(f"{name}, %" for name in names)),
            [("Table 3", *(f"{case['paper']:.2f}" for case in cases)), *fitted],
        ),
        "optima": cells_as_table(
            ("K and Φ by", *optimal, "column OF, rms, %", "horizon, s"),
            [(*cells, ", ".join(horizons)) for cells, horizons in optima.items()],
        ),
    }


def sources_table() -> str:
    """Return what makes each result that the pages rest on, and how long it takes."""
    rows = [(f"`{s.file}`", f"`{s.command}`", f"{s.minutes:g}") for s in SOURCES]
    return cells_as_table(("file", "made by", "minutes on two cores"), rows)


def results_table() -> str:
    """Return the keys of every study's result file, with what the docstrings say of them."""
    rows = []
    for study in studies().values():
        file = f"`{study.stem}.json`, schema {study.schema}"
        said = _comments(study.parts.Result) | _attributes(study.parts.Result)
        names = [field.name for field in fields(study.parts.Result)]
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


def _comments(kind: type) -> dict[str, str]:
    """Return the comment above or behind each field of a dataclass, else that of the one before."""
    found, above, text = {}, [], ""
    for line in inspect.getsource(kind).splitlines():
        code, _, comment = line.partition("#")
        if field := re.match(r"    (\w+): ", code):
            text = " ".join(filter(None, [*above, comment.strip()])) or text
            found[field[1]] = text
        above = [*above, comment.strip()] if comment and not code.strip() else []
    return found


def fields_table() -> str:
    """Return the fields of `Imperfections`: key, unit, default, meaning."""
    said = _attributes(Imperfections)
    rows = []
    for name in (field.name for field in fields(Imperfections)):
        units = [one.unit for path, one in DECLARATIONS.items() if path.partition(".")[0] == name]
        unit = ", ".join(filter(None, units)) or "–"
        text = said[name].replace(f" [{unit}]", "")
        rows.append((f"`{name}`", unit, _default(getattr(IDEAL, name)), text))
    return cells_as_table(("key", "unit", "default", "meaning"), rows)


def requirements_table() -> str:
    """Return the fields of `Requirements`: key, unit and default for the cart-pole, meaning."""
    said, asked = _attributes(Requirements), asked_of(CART_POLE)
    defaults = {"bands": bands_of(CART_POLE), "ends_at": CART_POLE.ends_at}
    named = {way: [key for key in asked if key.startswith(f"{way}.")] for way in ("max", "min")}
    every = [f"max.{name}" for name in CART_POLE.coordinates]
    named |= {"target": every, "ends_at": every, "bands": every}
    rows = []
    for field in fields(Requirements):
        keys = named.get(field.name, [field.name])
        units = dict.fromkeys(asked[key].unit for key in keys if key in asked)
        unit = "–" if isinstance(field.default, bool) else ", ".join(units)
        default = _default(defaults.get(field.name, field.default))
        rows.append((f"`{field.name}`", unit, default, said[field.name].replace(f" [{unit}]", "")))
    return cells_as_table(("key", "unit", "default", "meaning"), rows)


def _default(value: Any) -> str:
    """Return a default as a file has it."""
    if isinstance(value, Mapping) and value:
        return f"{{ {', '.join(f'{name} = {x:g}' for name, x in value.items())} }}"
    return "none" if value is None or value == {} else json.dumps(value)


def thresholds_table() -> str:
    """Return the imperfections that are swept: fields, reference level, range, why."""
    rows = []
    for declared in DECLARATIONS.values():
        for one in declared.swept:
            sets = [f"`{name}`" + _factor(x) for name, x in one.fields.items() if name != one.name]
            sets += [f"`{name}`" for name in one.switches if name != one.name]
            reference, *ends = (level_text(one, x) for x in (one.reference, one.benign, one.harsh))
            levels = (f"{reference} {one.unit}", f"{' to '.join(ends)} {one.unit}")
            rows.append((f"`{one.name}`", ", ".join(sets), *levels, declared.why))
    together = {one.name for one in added()} - {RAIL}
    left_out = ", ".join(f"`{one.name}`" for one in IMPERFECTIONS if one.name not in together)
    span = " to ".join(level_text(COMBINED, x) for x in (COMBINED.benign, COMBINED.harsh))
    rows.append(("`combined`", f"all but {left_out}", "1 ×", f"{span} ×", "scaled together"))
    return cells_as_table(
        ("imperfection", "sets, if not itself", "reference hardware", "searched", "why"), rows
    )


def _factor(factor: float) -> str:
    """Return what a level is multiplied by, nothing for 1."""
    return "" if factor == 1.0 else f" × {factor:g}"


def space_table() -> str:
    """Return the space of random hardware: unit, range, why."""
    rows = []
    reasons = {
        **{name: one.why for name, one in (*START.items(), *DRAWS.items())},
        "cart_mass": "the paper's box",
        "half_length": "the paper's box",
        "last change of M and l": "in the first half of the run, as in the paper",
        "duration": "the paper's horizon",
    }
    units = {name: one.unit for name, one in DECLARATIONS.items()} | CART_POLE.units
    changing = SampleSpace(LABORATORY).last_change
    times = {"last change of M and l": changing, "duration": LABORATORY.duration}
    for name, value in (LABORATORY.ranges | times).items():
        ends = value if isinstance(value, tuple) else (value,)
        text = " to ".join(f"{x:.4g}" for x in ends)
        shown = name if name in times else f"`{name}`"
        rows.append((shown, units.get(name, "s"), text, reasons[name]))
    return cells_as_table(("field", "unit", "range", "why"), rows)
