"""Each rung departs from the ideal in what it says, and in nothing else."""

from __future__ import annotations

import math
from dataclasses import fields
from itertools import chain
from pathlib import Path

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


SAID = {
    "control_period": (1e-3, "ms"), "delay": (1e-3, "ms"), "actuator_lag": (1e-3, "ms"),
    "force_limit": (1.0, "N"), "slew_rate": (1.0, "N/s"),
    "encoder_step_z": (1e-3, "mm"), "encoder_step_phi": (1.0, "rad"),
    "noise_z": (1e-3, "mm"), "noise_phi": (1e-3, "mrad"),
    "noise_z_dot": (1e-3, "mm/s"), "noise_phi_dot": (1e-3, "mrad/s"),
    "rail_damping": (1.0, "N s/m"), "hinge_damping": (1e-3, "mN m s"), "rail_friction": (1.0, "N"),
    "rail_armature": (1.0, "kg"), "hinge_armature": (1e-3, "g m²"),
    "tip_mass_share": (1e-2, "% of m"), "pole_radius": (1e-3, "mm"), "belief_delay": (1e-3, "ms"),
    "mass_error": (1e-2, "%"), "length_error": (1e-2, "%"),
    "rail_half_length": (1.0, "m to either side"),
}  # fmt: skip
"""Unit in which the documentation has each field."""


def test_the_documentation_has_the_typical_rig_of_the_code() -> None:
    page = (Path(__file__).parents[3] / "docs" / "survival.md").read_text(encoding="utf-8")
    table = page.partition("| rung | typical rig |")[2].partition("\n\n")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:3]] for line in table.splitlines()[2:]]
    said = {tuple(names.replace("`", "").split(", ")): text for names, text in rows}
    assert sorted(chain(*said)) == sorted([*NAMES, TOGETHER.name])
    for names, text in said.items():
        if names != (TOGETHER.name,):
            told = text.replace("2π/4096", f"{2.0 * math.pi / 4096.0:.2g}")
            assert told == ", ".join(dict.fromkeys(chain(*map(typical_texts, names))))


def typical_texts(name: str) -> list[str]:
    """What a rung sets on the typical rig, each number to two digits."""
    found = departures(realism_at(RUNGS[name], RUNGS[name].typical))
    numbers = {field: abs(found[field]) / SAID[field][0] for field in RUNGS[name].fields}
    return [f"{float(f'{x:.2g}'):g} {SAID[field][1]}" for field, x in numbers.items()]
