"""Schedules in words, from the instants that a validation keeps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import afl_mujoco as afl
from afl_mujoco.reporting.page.schedule_text import breakpoints, push_text, schedule_text
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.scenario.schedules import piecewise_linear
from afl_mujoco.studies.verification.curves import DENSE, SPARSE


def instants(scenario: Scenario) -> NDArray[np.float64]:
    """Return instants such as `select_curves` keeps: every millisecond around a change."""
    grid = np.asarray(np.arange(round(scenario.duration / 1e-3) + 1) * 1e-3)
    kept = np.zeros(len(grid), dtype=bool)
    kept[:: round(SPARSE / 1e-3)] = True
    for start in (0.0, *scenario.breakpoints):
        kept[(grid > start - 1.5e-3) & (grid <= start + DENSE)] = True
    kept[-1] = True
    return grid[kept]


def mass_text(scenario: Scenario) -> str:
    time = instants(scenario)
    return schedule_text(time, scenario.cart_mass(time), "kg")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("nominal", "1 kg throughout"),
        ("step-step", "0.5 kg; jumps to 1 kg at 1 s; jumps to 2 kg at 3 s"),
        ("trapezoid-step", "0.5 kg; rises to 2 kg over 0 to 2 s; falls to 0.5 kg over 6 to 8 s"),
    ],
)
def test_the_papers_schedules_are_told_as_they_are(name: str, text: str) -> None:
    assert mass_text(afl.SCENARIOS[name]) == text


def test_changes_between_two_instants_are_told_at_the_next_one() -> None:
    odd = Scenario(
        name="odd",
        cart_mass=piecewise_linear((0.1507, 0.1507, 0.4003, 1.2), (0.7, 1.6, 1.6, 1.1)),
        duration=2.0,
    )
    jump, fall = "jumps to 1.6 kg at 0.151 s", "falls to 1.1 kg over 0.401 to 1.2 s"
    assert mass_text(odd) == f"0.7 kg; {jump}; {fall}"


def test_a_schedule_with_many_changes_is_told_by_its_range() -> None:
    saw = tuple(float(k % 2) + 1.0 for k in range(21))
    many = Scenario(name="saw", cart_mass=piecewise_linear(tuple(range(21)), saw), duration=20.0)
    assert mass_text(many) == "1 to 2 kg, 20 changes"


def test_a_push_is_told_with_its_size_and_times() -> None:
    struck = afl.SCENARIOS["step-step-impulse"]
    time = instants(struck)
    assert push_text(time, struck.pushes(time)) == "−10 N over 10 to 10.1 s"
    assert push_text(time, np.zeros(len(time))) == "none"


def test_breakpoints_are_where_something_changes() -> None:
    struck = afl.SCENARIOS["step-trapezoid-impulse"]
    time = instants(struck)
    curves = (struck.cart_mass(time), struck.half_length(time), struck.pushes(time))
    found = breakpoints(time, *curves)
    assert found == pytest.approx([0.0, *struck.breakpoints])
