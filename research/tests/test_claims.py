"""C9 to C12 judge what they are given, and the shipped file is what `make claims` would write."""

import re
from dataclasses import replace

import numpy as np
import pytest

from afl_mujoco.studies.verify import claims as verdicts
from afl_mujoco.studies.verify.claims import ObjectiveScales
from research import claims
from research.gain_tuning import GainTable

SCALES = ObjectiveScales(iae_z=20.9, iae_phi=1.53, max_force=96.1)
TRIED = claims.result_of("readings")["optima"]


@pytest.mark.slow
def test_the_shipped_file_is_what_is_found() -> None:
    known, found = verdicts.shipped(), claims.judge()
    assert found.readings.near == known.readings.near
    for case, fitted in known.readings.fitted.items():
        assert found.readings.fitted[case] == pytest.approx(fitted, abs=1e-6)
    for one, other in zip(found.claims, known.claims, strict=True):
        assert (one.id, one.paper, one.verdict) == (other.id, other.paper, other.verdict)
        assert one.here == pytest.approx(other.here, rel=1e-6)
        said, before = (  # without how large a round-off was, which differs between machines
            re.findall(r"[+-]?[0-9.]+[0-9]", claim.why.partition(": by (L1)")[0])
            for claim in (one, other)
        )
        assert said == before
    assert found.random_schedules.keys() == known.random_schedules.keys()
    for name, comparison in known.random_schedules.items():
        assert found.random_schedules[name].share == comparison.share


def test_the_search_finds_the_optimum_in_the_contest() -> None:
    claim = claims.search_claim(claims.result_of("optimisers"))
    assert verdicts.shipped().claims[-1] == replace(claim, why=f"{claim.why} (make claims)")
    assert (claim.verdict, claim.here) == (verdicts.REPRODUCED, 100.0)


def test_a_comparison_counts_wins_with_an_exact_interval() -> None:
    fixed = np.array([1.0, 2.0, np.inf, 1.0, np.inf])
    found = claims.compare(fixed, np.array([0.5, 2.5, 3.0, np.inf, np.inf]))
    assert (found.schedules, found.share) == (5, 0.4)
    assert found.interval == pytest.approx((0.0527, 0.8534), abs=1e-4)  # Clopper-Pearson, 2 of 5
    assert found.quantiles["median"] == 0.0 and found.quantiles["least"] is None


@pytest.mark.parametrize(("wins", "expected"), [
    (96, verdicts.REPRODUCED), (70, verdicts.IN_PART), (52, verdicts.NOT_REPRODUCED),
])  # fmt: skip
def test_winning_as_often_as_losing_reproduces_nothing(wins: int, expected: str) -> None:
    rows = np.array([[1.0, 0.9 if k < wins else 1.1, 1.0, 0.9] for k in range(100)])
    assert claims.schedules_claim(rows)[0].verdict == expected


def test_table_1_would_be_optimal_if_it_were_ours_and_forty_rows_judge_no_fit() -> None:
    table = GainTable(claims.published_rows()[:, [4, 5, 2, 1, 0, 3, 3]], {})
    assert claims.optima_claim(table, SCALES, TRIED).verdict == verdicts.FITTED
    judged = claims.optima_claim(GainTable.shipped(), SCALES, TRIED)
    assert judged.verdict == verdicts.NONE and "0 of 40 rows" in judged.why
    best = [{"best": 40, "column_error": 0.1}]
    assert claims.optima_claim(table, SCALES, best).verdict == verdicts.EVERY
    assert claims.optima_claim(GainTable.shipped(), SCALES, best).verdict == verdicts.FITTED
    claim = claims.fit_claim()
    assert claim.verdict == verdicts.UNDETERMINED and claim.here == pytest.approx(0.3142, abs=1e-4)
    assert "columns read as Table 1 names them" in claim.why and "is ruled out" in claim.why
