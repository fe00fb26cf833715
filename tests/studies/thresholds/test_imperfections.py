"""Each imperfection departs from the ideal in what it says, and in nothing else."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path

import pytest

from afl_mujoco.errors import UnknownNameError
from afl_mujoco.scenario.belief import ERRORS
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.imperfections import IMPERFECTIONS, Imperfections
from afl_mujoco.studies.thresholds.imperfections import (
    BY_NAME,
    COMBINED,
    RAIL,
    added,
    combined,
    find_imperfection,
    hardware_at,
)

PUBLISHED = Path(__file__).parents[3] / "docs" / "results" / "thresholds.json"
NAMES = [one.name for one in IMPERFECTIONS]


@pytest.mark.parametrize("name", NAMES)
def test_an_imperfection_sets_its_fields_and_leaves_the_rest_ideal(name: str) -> None:
    one = BY_NAME[name]
    found = hardware_at(one, one.reference)
    assert found.keys() == {*one.fields, *one.switches, "seed"}
    for field, factor in one.fields.items():
        assert found[field] == pytest.approx(factor * one.reference)


@pytest.mark.parametrize("name", NAMES)
def test_the_reference_lies_between_benign_and_harsh(name: str) -> None:
    one = BY_NAME[name]
    low, high = sorted((one.benign, one.harsh))
    assert low < one.reference < high
    assert one.less_is_worse == (name in ("force-limit", "slew-rate", "rail"))
    for level in (one.benign, one.harsh):
        SCENARIOS["nominal"].changed(**hardware_at(one, level))


def test_every_departure_that_a_scenario_can_have_is_an_imperfection() -> None:
    set_ = {field for one in IMPERFECTIONS for field in (*one.fields, *one.switches)}
    there = {*(field.name for field in fields(Imperfections)), *ERRORS}
    # a filter that does harm only with others, and a friction that is seen where it is identified
    # and what is assumed of m and g
    known = {"seed", "velocity_filter", "hinge_friction", "pole_mass_error", "gravity_error"}
    assert set_ == there - known


def test_all_combined_has_every_imperfection_at_once() -> None:
    real = hardware_at(COMBINED, 1.0, seed=3)
    left_out = {one.name for one in IMPERFECTIONS} - {one.name for one in added()}
    assert left_out == {"mass-under", "length-under"}  # which contradict mass-over, length-over
    for one in added():
        if one.name != RAIL:
            for field, factor in one.fields.items():
                assert real[field] == pytest.approx(factor * one.reference)
    assert real["seed"] == 3
    assert "rail_half_length" not in real


def test_a_combination_twice_as_bad_is_twice_as_bad_in_everything() -> None:
    single, double = (hardware_at(COMBINED, scale) for scale in (1.0, 2.0))
    for field in ("delay", "noise_phi", "rail_friction", "cart_mass_error", "control_period"):
        assert double[field] == pytest.approx(2.0 * single[field])
    for field in ("force_limit", "slew_rate"):
        assert double[field] == pytest.approx(0.5 * single[field])


def test_nothing_is_harsher_than_its_imperfection_goes() -> None:
    worst = combined(1e6, IMPERFECTIONS)
    assert worst["tip_mass_share"] == BY_NAME["tip-mass"].harsh
    assert worst["force_limit"] == BY_NAME["force-limit"].harsh


def test_an_unknown_imperfection_is_named_with_those_that_there_are() -> None:
    with pytest.raises(
        UnknownNameError, match=r"^imperfection must be one of control-period, delay, .*'x'"
    ):
        find_imperfection("x")


def test_the_published_thresholds_are_of_these_levels_and_units() -> None:
    published = json.loads(PUBLISHED.read_text(encoding="utf-8"))["imperfections"]
    declared = {one.name: one for one in (*IMPERFECTIONS, COMBINED)}
    assert [one["name"] for one in published if one["name"] not in declared] == []
    for one in published:
        here = asdict(declared[one["name"]])
        assert one == json.loads(json.dumps({key: here[key] for key in one})), one["name"]


@pytest.mark.parametrize("name", NAMES)
def test_a_level_is_shown_in_the_unit_that_is_named(name: str) -> None:
    one = BY_NAME[name]
    thousandth = one.unit.startswith("g") or (one.unit[0] == "m" and one.unit[1:2].isalpha())
    assert one.scale == (1e2 if one.unit == "%" else 1e3 if thousandth else 1.0)
