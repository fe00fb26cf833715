"""The claims ledger judges what it is given, and not what it would like to find."""

from __future__ import annotations

import dataclasses
import json
import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.gain_table import GainTable
from afl_mujoco.simulation.batch import ObjectiveScales
from afl_mujoco.simulation.metrics import STATES, metrics
from afl_mujoco.simulation.scoring import with_objective
from afl_mujoco.studies.verification.claims import gains, schedules
from afl_mujoco.studies.verification.claims.claim import (
    EVERY,
    FITTED,
    IN_PART,
    NONE,
    NOT_REPRODUCED,
    RANDOM,
    REPRODUCED,
    UNDETERMINED,
    verdict,
)
from afl_mujoco.studies.verification.claims.ledger import decidable, judge_claims
from afl_mujoco.studies.verification.claims.performance import (
    PUBLISHED_IMPROVEMENT,
    performance_claims,
)
from afl_mujoco.studies.verification.claims.readings import Tried, try_readings
from afl_mujoco.studies.verification.claims.search import search_claim

PAPER = np.array(list(PUBLISHED_IMPROVEMENT.values()))
TRIED = Tried(names=("one",), fitted=PAPER[None], random=np.repeat(PAPER[None], 3, axis=0))
SCALES = ObjectiveScales(iae_z=20.9, iae_phi=1.53, max_force=96.1)


def figures(objective: float | None, overshoot: float = 1.0, settling: float | None = 5.0) -> dict:
    return {
        "objective": objective,
        **{f"overshoot_{x}": overshoot for x in STATES},
        **{f"settling_2pc_{x}": settling for x in STATES},
    }


def as_published() -> dict:
    """Runs in which the paper is right in everything."""
    runs = {}
    for name, controller in product(afl.SCENARIOS, ("fixed", "adaptive")):
        cut = PUBLISHED_IMPROVEMENT.get(name.removesuffix("-impulse"), 30.0) / 100.0
        adaptive = controller == "adaptive"
        settling = (14.0 if adaptive else 15.0) if "impulse" in name else (4.0 if adaptive else 5.0)
        runs[name, controller] = figures(
            1.0 - cut if adaptive else 1.0, 0.5 if adaptive else 1.0, settling
        )
    return runs


def verdicts(runs: dict) -> dict[str, str]:
    return {claim.id: claim.verdict for claim in performance_claims(runs, TRIED)}


def test_runs_as_published_reproduce_every_claim_on_performance() -> None:
    claims = {claim.id: claim for claim in performance_claims(as_published(), TRIED)}
    assert {claim.verdict for claim in claims.values()} == {REPRODUCED, EVERY}
    assert claims["C3"].here == pytest.approx(38.03)
    assert (claims["C2"].here, claims["C7"].here, claims["C8"].here) == (5.0, 32.0, 5.0)


@pytest.mark.parametrize(
    ("objective", "expected"),
    [(0.66, EVERY), (0.75, f"{RANDOM} in 100.0 %"), (None, f"{RANDOM} in 100.0 %")],
)
def test_an_improvement_is_judged_under_every_reading(objective, expected) -> None:
    runs = as_published()
    runs["step-step", "adaptive"] = figures(objective, 0.5, 4.0)
    assert verdicts(runs)["C3"] == expected


def test_an_improvement_that_no_reading_has_holds_under_none() -> None:
    runs = as_published()
    runs["step-step", "adaptive"] = figures(0.85, 0.5, 4.0)
    far = Tried(names=("one",), fitted=TRIED.fitted + 6.0, random=TRIED.random - 6.0)
    claim = next(c for c in performance_claims(runs, far) if c.id == "C3")
    assert claim.verdict == NONE
    assert "as 0 of 1 of" in claim.why and "0.0 % of 3 readings drawn" in claim.why
    lost = replace(far, random=np.full((3, 4), -np.inf))
    assert next(c for c in performance_claims(runs, lost) if c.id == "C3").verdict == NONE
    one = replace(far, fitted=TRIED.fitted)
    claim = next(c for c in performance_claims(runs, one) if c.id == "C3")
    assert claim.verdict == FITTED and "as 1 of 1 of" in claim.why and "is no evidence" in claim.why
    assert "on the schedules of D3 with the scales of D4 it is 15.0 %" in claim.why
    half = replace(one, random=np.concatenate([TRIED.random, far.random]))
    claim = next(c for c in performance_claims(runs, half) if c.id == "C3")
    assert claim.verdict == "holds under random readings in 50.0 %"


def test_a_run_that_never_settles_takes_from_c2_c7_and_c8() -> None:
    runs = as_published()
    runs["step-step", "adaptive"] = figures(0.62, 0.5, None)
    runs["step-step-impulse", "adaptive"] = figures(0.62, 0.5, None)
    found = verdicts(runs)
    assert (found["C2"], found["C7"], found["C8"]) == (IN_PART,) * 3


def test_a_share_is_judged_between_its_bounds() -> None:
    assert [verdict(x, enough=0.95, least=0.5) for x in (0.95, 0.94, 0.5)] == [
        REPRODUCED,
        IN_PART,
        NOT_REPRODUCED,
    ]


def test_a_comparison_counts_wins_with_an_exact_interval() -> None:
    fixed = np.array([1.0, 2.0, np.inf, 1.0, np.inf])
    adaptive = np.array([0.5, 2.5, 3.0, np.inf, np.inf])
    found = schedules.compare(fixed, adaptive)
    assert (found.schedules, found.share) == (5, 0.4)
    assert found.interval == pytest.approx((0.0527, 0.8534), abs=1e-4)  # Clopper-Pearson, 2 of 5
    assert found.quantiles["median"] == 0.0
    assert found.quantiles["least"] is None


def test_the_retuned_adaptive_gains_beat_the_retuned_fixed_gains_in_all_four_cases() -> None:
    for case in PUBLISHED_IMPROVEMENT:
        found = []
        for name in ("fixed-retuned", "adaptive-retuned"):
            controller, scenario = afl.CONTROLLERS[name], afl.SCENARIOS[case]
            run = afl.simulate_ode_rk4(scenario, controller, timestep=1e-3)
            scored = with_objective(metrics(scenario, controller, run), SCALES)
            found.append(scored["objective"])
        assert found[1] < found[0], case


@pytest.mark.parametrize(
    ("wins", "expected"), [(96, REPRODUCED), (70, IN_PART), (52, NOT_REPRODUCED)]
)
def test_winning_as_often_as_losing_reproduces_nothing(wins: int, expected: str) -> None:
    rows = np.array([[1.0, 0.9 if k < wins else 1.1, 1.0, 0.9] for k in range(100)])
    assert schedules.schedules_claim(rows)[0].verdict == expected


def test_if_most_runs_fell_the_median_is_said_to_be_none() -> None:
    claim, _ = schedules.schedules_claim(np.array([[1.0, np.inf, np.inf, 1.0]] * 3))
    assert "median improvement none" in claim.why


def test_a_random_schedule_is_the_same_again_and_lies_in_the_box() -> None:
    for index in range(50):
        scenario = schedules.random_scenario(0, index)
        assert scenario == schedules.random_scenario(0, index)
        assert all(0.1 <= m <= 2.0 for m in scenario.cart_mass.values)
        assert all(0.05 <= x <= 1.0 for x in scenario.half_length.values)
        assert scenario.breakpoints[-1] <= 10.0 + 1e-9
    assert schedules.random_scenario(0, 1) != schedules.random_scenario(1, 1)


def test_the_objectives_on_random_schedules_are_those_of_the_ode() -> None:
    rows = schedules.objectives_on_schedules(2, SCALES)
    for index, row in enumerate(rows):
        scenario = schedules.random_scenario(schedules.SEED, index)
        for name, found in zip(schedules.COMPARED, row, strict=True):
            run = afl.simulate_ode(scenario, afl.CONTROLLERS[name], sample_period=1e-3)
            integrals = [np.trapezoid(np.abs(run.state[:, i]), run.time) for i in (0, 1)]
            exact = integrals[0] / SCALES.iae_z + integrals[1] / SCALES.iae_phi
            exact += np.abs(run.force).max() / SCALES.max_force
            assert found == pytest.approx(exact, rel=1e-4)


def test_the_law_linearises_and_a_wrong_one_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert gains.linearisation_claim().verdict == REPRODUCED
    original = gains.linearizing_force
    for least in (0.0, 50.0):  # everywhere, and only where accelerations are large

        def wrong(u, phi, *others, least=least):
            return original(u, phi, *others) * (1.0 + 1e-6 * (abs(u) > least and abs(phi) < 1.0))

        monkeypatch.setattr(gains, "linearizing_force", wrong)
        assert gains.linearisation_claim().verdict == NOT_REPRODUCED


def test_table_1_would_be_optimal_if_it_were_our_table(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = gains.published_rows()
    table = GainTable(
        np.stack(
            [rows[:, 4], rows[:, 5], rows[:, 2], rows[:, 1], rows[:, 0], *rows[:, [3, 3]].T]
        ).T,
        {},
    )
    assert gains.optima_claim(table, SCALES).verdict == FITTED
    judged = gains.optima_claim(GainTable.shipped(), SCALES)
    assert judged.verdict == NONE
    assert "0 of 40 rows" in judged.why
    found = {"optima": [{"best": 40, "column_error": 0.1}]}
    monkeypatch.setattr(gains, "shipped_study", lambda: found)
    assert gains.optima_claim(table, SCALES).verdict == EVERY
    assert gains.optima_claim(GainTable.shipped(), SCALES).verdict == FITTED


def test_the_motion_does_not_depend_on_the_mass() -> None:
    assert gains.mass_dependence() < 1e-12


def test_the_fit_cannot_be_judged_on_forty_rows() -> None:
    claim = gains.fit_claim(GainTable.shipped())
    assert claim.verdict == UNDETERMINED
    assert claim.here == pytest.approx(0.3142, abs=1e-4)
    assert "columns read as Table 1 names them" in claim.why and "is ruled out" in claim.why


def test_a_table_2_that_its_printed_rows_rule_out_holds_under_no_reading(monkeypatch) -> None:
    impossible = tuple(replace(fit, least=9.0) for fit in gains.published_fits())
    monkeypatch.setattr(gains, "published_fits", lambda: impossible)
    assert gains.fit_claim(GainTable.shipped()).verdict == NONE


def test_the_search_finds_the_optimum_in_the_shipped_contest() -> None:
    claim = search_claim()
    assert (claim.verdict, claim.here) == (REPRODUCED, 100.0)


def test_the_ledger_has_the_twelve_claims_in_order_or_none() -> None:
    evidence = schedules.objectives_on_schedules(2, SCALES), try_readings(3)
    ledger = judge_claims(as_published(), SCALES, *evidence)
    assert [claim.id for claim in ledger.claims] == [f"C{k}" for k in range(1, 13)]
    assert set(ledger.comparisons) == {"published", "retuned"}
    incomplete = {k: v for k, v in as_published().items() if k != ("nominal", "fixed")}
    assert decidable(as_published())
    assert not decidable(incomplete)


def test_a_claim_s_row_has_the_fields_of_the_report() -> None:
    assert {"id", "paper", "here", "verdict", "why"} <= set(dataclasses.asdict(search_claim()))


def test_what_is_published_of_the_gains_and_the_search_is_what_is_found() -> None:
    results = Path(__file__).parents[3] / "docs" / "results" / "report.json"
    published = {c["id"]: c for c in json.loads(results.read_text(encoding="utf-8"))["claims"]}
    table, exact = GainTable.shipped(), gains.linearisation_claim()
    assert (exact.paper, exact.verdict) == (published["C1"]["paper"], published["C1"]["verdict"])
    for claim in (gains.optima_claim(table, SCALES), gains.fit_claim(table), search_claim()):
        told = published[claim.id]
        assert (claim.paper, claim.verdict) == (told["paper"], told["verdict"])
        assert claim.here == pytest.approx(told["here"], rel=1e-2)
        said, before = (  # without how large a round-off was, which differs between machines
            re.findall(r"[+-]?[0-9.]+[0-9]", why.partition(": by (L1)")[0])
            for why in (claim.why, told["why"])
        )
        assert said == before
