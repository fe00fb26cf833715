"""The checks of references and methods see what they are there to see."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from afl_mujoco.studies.verification.checks import reference_checks
from afl_mujoco.studies.verification.criteria import CRITERIA

PUBLISHED = Path(__file__).parents[3] / "docs" / "results" / "report.json"


def test_every_reference_check_holds() -> None:
    checks = reference_checks.reference_checks(reference_checks.free_swings())
    assert [check.id for check in checks] == ["A4", "A4e", "A8", "A8m", "A8x", "A10"]
    assert all(check.passed for check in checks)


def test_a10_sees_that_a_fresh_process_gives_other_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    nudged = dataclasses.replace(reference_checks._SHORT, pole_mass=0.05 * (1.0 + 1e-15))
    monkeypatch.setattr(reference_checks, "_SHORT", nudged)
    assert reference_checks.differing_runs() == 4


def test_a10_sees_a_run_that_depends_on_what_ran_before(monkeypatch: pytest.MonkeyPatch) -> None:
    ran = []

    def stateful(*arguments: object, **options: object) -> object:
        run = original(*arguments, **options)
        ran.append(run)
        return dataclasses.replace(run, force=run.force + 1e-12 * len(ran))

    original = reference_checks.simulate_ode
    monkeypatch.setattr(reference_checks, "simulate_ode", stateful)
    assert not CRITERIA["A10"].judge(reference_checks.differing_runs()).passed


def test_a8_sees_one_method_at_a_loose_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    def loose(*arguments: object, **options: object) -> object:
        return original(*arguments, **{"rtol": 1e-6, "atol": 1e-8, **options})

    original = reference_checks.simulate_ode
    monkeypatch.setattr(reference_checks, "simulate_ode", loose)
    monkeypatch.setattr("afl_mujoco.simulation.integrator.MAX_STEP", 1.0)
    assert not CRITERIA["A8"].judge(reference_checks.second_method_difference()).passed


def test_the_published_verdict_is_by_these_limits() -> None:
    published = json.loads(PUBLISHED.read_text(encoding="utf-8"))["checks"]
    assert {check["id"] for check in published} == CRITERIA.keys()
    assert [c["id"] for c in published if c["limit"] != CRITERIA[c["id"]].limit] == []
