"""The gallery: every figure that a report and its curves have the data for."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from afl_mujoco.document.style import Drawn, write_drawn
from afl_mujoco.execution.executors import Executor, compute_all, open_executor
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.studies.gain_figures import draw_shipped_gains
from afl_mujoco.studies.verification.curves import REFERENCE, Curves
from afl_mujoco.studies.verification.figures.budget import draw_budget
from afl_mujoco.studies.verification.figures.claims import draw_claims
from afl_mujoco.studies.verification.figures.energy import draw_energy
from afl_mujoco.studies.verification.figures.errors import draw_errors
from afl_mujoco.studies.verification.figures.orders import draw_orders
from afl_mujoco.studies.verification.figures.responses import draw_impulse, draw_response
from afl_mujoco.studies.verification.figures.schedules import draw_schedules

Plan = Callable[[], Drawn]

CASES: Mapping[str, str] = {
    "step-step": "Analogue of the paper's Fig. 7: M and l change by steps.",
    "step-trapezoid": "Analogue of the paper's Fig. 8: M changes by steps, l by trapezoids.",
    "trapezoid-step": "Analogue of the paper's Fig. 9: M changes by trapezoids, l by steps.",
    "trapezoid-trapezoid": "Analogue of the paper's Fig. 10: M and l change by trapezoids.",
}
"""The four cases and the figures of the paper that show them."""

STRUCK = "-impulse"
"""How the name of a case ends that is disturbed."""


def draw_all(report: Mapping[str, Any], curves: Sequence[Curves]) -> dict[str, Drawn]:
    """Draw every figure for which there are data."""
    return {name: draw() for name, draw in plans(report, curves).items()}


def write_figures(
    report: Mapping[str, Any],
    curves: Sequence[Curves],
    folder: Path,
    *,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Callable[[str], None] = lambda done: None,
) -> list[dict[str, str]]:
    """Draw every figure for which there are data and write it as SVG and PNG.

    Parameters
    ----------
    workers
        Processes to share the work among; the files do not depend on it.
    progress
        Called with the name of each figure as it is written.
    """
    planned = plans(report, curves)
    names, units = list(planned), [(draw, folder) for draw in planned.values()]
    processes = open_executor(max(1, min(workers, len(units))))
    with processes if executor is None else nullcontext(executor) as executor:
        return compute_all(_write, units, executor, lambda i: progress(names[i]))


def plans(report: Mapping[str, Any], curves: Sequence[Curves]) -> dict[str, Plan]:
    """Return what would draw each figure for which there are data, by name."""
    found: dict[str, list[Curves]] = {}
    for one in curves:
        found.setdefault(one.scenario, []).append(one)
    known = {name for name, ones in found.items() if _is_published(ones[0])}
    hold = report["settings"]["control_period"]
    cases = {name: found[name] for name in CASES if name in known}
    own = {name: ones for name, ones in found.items() if name not in known}
    struck = [found[name + STRUCK] for name in CASES if name + STRUCK in known]
    booked = _with_ledger(cases or found)
    responses: dict[str, Plan] = {
        f"response-{name}": partial(draw_response, f"response-{name}", CASES[name], ones, hold)
        for name, ones in cases.items()
    }
    for name, ones in own.items():
        file = _distinct(f"response-{name}", responses)
        responses[file] = partial(draw_response, file, f"The scenario {name}.", ones, hold)
    optional: dict[str, tuple[Any, Plan]] = {
        "schedules": (cases, partial(draw_schedules, [ones[0] for ones in cases.values()])),
        **{name: (True, plan) for name, plan in responses.items()},
        "impulse": (struck, partial(draw_impulse, struck, hold)),
        "errors": (curves, partial(draw_errors, curves)),
        "budget": (report["error_budgets"], partial(draw_budget, report["error_budgets"])),
        "orders": (_solved(report), partial(draw_orders, _solved(report))),
        "energy": (booked, partial(draw_energy, booked)),
        "claims": (report["claims"], partial(draw_claims, report["claims"], _interval(report))),
    }
    there = {name: plan for name, (data, plan) in optional.items() if data}
    return {"gain-table": draw_shipped_gains, **there}


def _write(unit: tuple[Plan, Path]) -> dict[str, str]:
    """Draw a figure and write its files."""
    draw, folder = unit
    return write_drawn(draw(), folder)


def _is_published(one: Curves) -> bool:
    """Return whether curves are of the paper's scenario of that name, not of another so named."""
    scenario = SCENARIOS.get(one.scenario)
    if scenario is None:
        return False
    here = [*one.states[REFERENCE][0], one.time[-1]]
    there = [*scenario.initial_state, scenario.duration]
    return np.allclose(here, there, rtol=0.0, atol=1e-9) and all(
        np.array_equal(mine, theirs)
        for mine, theirs in (
            (one.cart_mass, scenario.cart_mass(one.time)),
            (one.half_length, scenario.half_length(one.time)),
            (one.push, scenario.pushes(one.time)),
        )
    )


def _with_ledger(found: Mapping[str, Sequence[Curves]]) -> list[list[Curves]]:
    """Return the curves that have a ledger, of four scenarios at most."""
    booked = [[one for one in ones if one.energy] for ones in found.values()]
    return [ones for ones in booked if ones][: len(CASES)]


def _solved(report: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the studies of a report that have an order."""
    return [study for study in report["studies"] if study["order"] is not None]


def _interval(report: Mapping[str, Any]) -> list[float] | None:
    """Return the confidence interval of C9, if the report has one."""
    published = report["random_schedules"].get("published")
    return published["interval"] if published else None


def _distinct(name: str, taken: Mapping[str, Any]) -> str:
    """Return a name that suits a file and is not taken."""
    plain = re.sub(r"[^A-Za-z0-9.-]+", "-", name)[:80].strip("-")
    names = [plain, *(f"{plain}-{k}" for k in range(2, len(taken) + 3))]
    return next(name for name in names if name not in taken)
