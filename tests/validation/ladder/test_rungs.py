"""Each rung departs from the ideal in what it says, and in nothing else."""

from __future__ import annotations

from dataclasses import fields

import pytest

from afl_mujoco.errors import UnknownNameError
from afl_mujoco.scenario.realism import IDEAL, Realism
from afl_mujoco.validation.ladder.rungs import (
    APART,
    LADDER,
    RUNGS,
    TOGETHER,
    find_rung,
    realism_at,
    rig,
)

NAMES = [rung.name for rung in LADDER]


def departures(realism: Realism) -> dict[str, object]:
    return {
        field.name: getattr(realism, field.name)
        for field in fields(Realism)
        if getattr(realism, field.name) != getattr(IDEAL, field.name)
    }


@pytest.mark.parametrize("name", NAMES)
def test_a_rung_sets_its_fields_and_leaves_the_rest_ideal(name: str) -> None:
    rung = RUNGS[name]
    found = departures(realism_at(rung, rung.typical, seed=0))
    assert found.keys() == {*rung.fields, *rung.switches}
    for field, factor in rung.fields.items():
        assert found[field] == pytest.approx(factor * rung.typical)


@pytest.mark.parametrize("name", NAMES)
def test_a_typical_rig_lies_between_benign_and_harsh(name: str) -> None:
    rung = RUNGS[name]
    low, high = sorted((rung.benign, rung.harsh))
    assert low < rung.typical < high
    assert rung.less_is_worse == (name in ("force-limit", "slew-rate", "rail"))
    realism_at(rung, rung.benign)
    realism_at(rung, rung.harsh)


def test_every_departure_that_a_scenario_can_have_is_on_a_rung() -> None:
    on_rungs = {field for rung in LADDER for field in (*rung.fields, *rung.switches)}
    there = {field.name for field in fields(Realism)} - {"seed", "velocity_filter"}
    assert on_rungs == there


def test_a_whole_rig_has_every_flaw_of_its_rungs_at_once() -> None:
    real = departures(realism_at(TOGETHER, 1.0, seed=3))
    for rung in LADDER:
        if rung.name not in APART:
            for field, factor in rung.fields.items():
                assert real[field] == pytest.approx(factor * rung.typical)
    assert real["seed"] == 3
    assert "rail_half_length" not in real


def test_a_rig_twice_as_bad_is_twice_as_bad_in_everything() -> None:
    one, two = (realism_at(TOGETHER, scale) for scale in (1.0, 2.0))
    for field in ("delay", "noise_phi", "rail_friction", "mass_error", "control_period"):
        assert getattr(two, field) == pytest.approx(2.0 * getattr(one, field))
    for field in ("force_limit", "slew_rate"):
        assert getattr(two, field) == pytest.approx(0.5 * getattr(one, field))


def test_nothing_is_harsher_than_its_rung_goes() -> None:
    worst = rig(1e6, LADDER)
    assert worst.tip_mass_share == RUNGS["tip-mass"].harsh
    assert worst.force_limit == RUNGS["force-limit"].harsh


def test_an_unknown_rung_is_named_with_those_that_there_are() -> None:
    with pytest.raises(
        UnknownNameError, match=r"^rung must be one of control-period, delay, .*'x'"
    ):
        find_rung("x")
