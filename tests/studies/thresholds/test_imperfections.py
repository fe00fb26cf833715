"""Each imperfection departs from the ideal in what it says, and in nothing else."""

from __future__ import annotations

import math
from dataclasses import fields
from itertools import chain
from pathlib import Path

import pytest

from afl_mujoco.errors import UnknownNameError
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from afl_mujoco.studies.thresholds.imperfections import (
    APART,
    BY_NAME,
    COMBINED,
    IMPERFECTIONS,
    combined,
    find_imperfection,
    imperfections_at,
)

NAMES = [one.name for one in IMPERFECTIONS]


def departures(imperfections: Imperfections) -> dict[str, object]:
    return {
        field.name: getattr(imperfections, field.name)
        for field in fields(Imperfections)
        if getattr(imperfections, field.name) != getattr(IDEAL, field.name)
    }


@pytest.mark.parametrize("name", NAMES)
def test_an_imperfection_sets_its_fields_and_leaves_the_rest_ideal(name: str) -> None:
    one = BY_NAME[name]
    found = departures(imperfections_at(one, one.reference, seed=0))
    assert found.keys() == {*one.fields, *one.switches}
    for field, factor in one.fields.items():
        assert found[field] == pytest.approx(factor * one.reference)


@pytest.mark.parametrize("name", NAMES)
def test_the_reference_lies_between_benign_and_harsh(name: str) -> None:
    one = BY_NAME[name]
    low, high = sorted((one.benign, one.harsh))
    assert low < one.reference < high
    assert one.less_is_worse == (name in ("force-limit", "slew-rate", "rail"))
    imperfections_at(one, one.benign)
    imperfections_at(one, one.harsh)


def test_every_departure_that_a_scenario_can_have_is_an_imperfection() -> None:
    set_ = {field for one in IMPERFECTIONS for field in (*one.fields, *one.switches)}
    there = {field.name for field in fields(Imperfections)} - {"seed", "velocity_filter"}
    assert set_ == there


def test_all_combined_has_every_imperfection_at_once() -> None:
    real = departures(imperfections_at(COMBINED, 1.0, seed=3))
    for one in IMPERFECTIONS:
        if one.name not in APART:
            for field, factor in one.fields.items():
                assert real[field] == pytest.approx(factor * one.reference)
    assert real["seed"] == 3
    assert "rail_half_length" not in real


def test_a_combination_twice_as_bad_is_twice_as_bad_in_everything() -> None:
    single, double = (imperfections_at(COMBINED, scale) for scale in (1.0, 2.0))
    for field in ("delay", "noise_phi", "rail_friction", "mass_error", "control_period"):
        assert getattr(double, field) == pytest.approx(2.0 * getattr(single, field))
    for field in ("force_limit", "slew_rate"):
        assert getattr(double, field) == pytest.approx(0.5 * getattr(single, field))


def test_nothing_is_harsher_than_its_imperfection_goes() -> None:
    worst = combined(1e6, IMPERFECTIONS)
    assert worst.tip_mass_share == BY_NAME["tip-mass"].harsh
    assert worst.force_limit == BY_NAME["force-limit"].harsh


def test_an_unknown_imperfection_is_named_with_those_that_there_are() -> None:
    with pytest.raises(
        UnknownNameError, match=r"^imperfection must be one of control-period, delay, .*'x'"
    ):
        find_imperfection("x")


SAID = {
    "control_period": (1e-3, "ms"), "delay": (1e-3, "ms"), "actuator_lag": (1e-3, "ms"),
    "force_limit": (1.0, "N"), "slew_rate": (1.0, "N/s"),
    "encoder_step_z": (1e-3, "mm"), "encoder_step_phi": (1.0, "rad"),
    "noise_z": (1e-3, "mm"), "noise_phi": (1e-3, "mrad"),
    "noise_z_dot": (1e-3, "mm/s"), "noise_phi_dot": (1e-3, "mrad/s"),
    "rail_damping": (1.0, "N s/m"), "hinge_damping": (1e-3, "mN m s"), "rail_friction": (1.0, "N"),
    "rail_armature": (1.0, "kg"), "hinge_armature": (1e-3, "g m²"),
    "tip_mass_share": (1e-2, "% of m"), "pole_radius": (1e-3, "mm"),
    "parameter_delay": (1e-3, "ms"),
    "mass_error": (1e-2, "%"), "length_error": (1e-2, "%"),
    "rail_half_length": (1.0, "m to either side"),
}  # fmt: skip
"""Unit in which the documentation has each field."""


def test_the_documentation_has_the_reference_levels_of_the_code() -> None:
    page = (Path(__file__).parents[3] / "docs" / "robustness.md").read_text(encoding="utf-8")
    table = page.partition("| imperfection | reference hardware |")[2].partition("\n\n")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:3]] for line in table.splitlines()[2:]]
    said = {tuple(names.replace("`", "").split(", ")): text for names, text in rows}
    assert sorted(chain(*said)) == sorted([*NAMES, COMBINED.name])
    for names, text in said.items():
        if names != (COMBINED.name,):
            shown = text.replace("2π/4096", f"{2.0 * math.pi / 4096.0:.2g}")
            assert shown == ", ".join(dict.fromkeys(chain(*map(reference_texts, names))))


def reference_texts(name: str) -> list[str]:
    """What an imperfection sets at its reference level, each number to two digits."""
    found = departures(imperfections_at(BY_NAME[name], BY_NAME[name].reference))
    numbers = {field: abs(found[field]) / SAID[field][0] for field in BY_NAME[name].fields}
    return [f"{float(f'{x:.2g}'):g} {SAID[field][1]}" for field, x in numbers.items()]
