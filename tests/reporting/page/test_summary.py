"""Five sentences, whatever was found."""

from __future__ import annotations

from typing import Any

import pytest
from page_case import NASTY, make_report

from afl_mujoco.reporting.page.summary import five_sentences


def told(report: dict[str, Any]) -> list[str]:
    sentences = five_sentences(report)
    assert len(sentences) == 5
    for sentence in sentences:
        assert sentence.text.endswith(".")
        assert sentence.text[0].isupper()
        assert ". " not in sentence.text.replace("C1.", ""), "more than one sentence"
    return [sentence.text for sentence in sentences]


def test_agreement_names_the_worst_difference_and_its_limit() -> None:
    first, *_ = told(make_report())
    assert "differ by at most 5.8×10⁻¹² in any state at any instant of 4 runs (limit 10⁻⁹)" in first
    assert "one model, up to round-off" in first


@pytest.mark.parametrize(
    ("value", "words"),
    [(3e-3, "they are not the same model"), (None, "do not end the same way")],
    ids=["far apart", "one fell"],
)
def test_disagreement_is_said_first_and_where(value: float | None, words: str) -> None:
    report = make_report()
    (worst,) = (
        c for c in report["checks"] if (c["id"], c["scenario"], c["controller"]) ==
        ("B1", NASTY, "adaptive")
    )  # fmt: skip
    worst |= {"value": value, "passed": False}
    first, *_ = told(report)
    assert words in first
    assert f"{NASTY} with adaptive gains" in first
    assert first.endswith("yet B1 fails.")


def test_the_deployed_run_is_explained_by_its_largest_source() -> None:
    _, second, *_ = told(make_report())
    assert "its force held for 1 ms, strays from the ideal one by at most 0.035 (φ′ in" in second
    assert "holding the force makes 100 % of it" in second
    assert "MuJoCo itself (integrator and model) 4.1×10⁻¹⁰" in second
    assert "in no run is more than 0.052 % left unexplained" in second


def test_the_claims_are_counted_and_named() -> None:
    third = told(make_report())[2]
    assert "Of 12 claims 4 hold here (C1, C6, C7, C12), 2 hold in part (C3, C9)" in third
    assert "38 % in the paper's Table 3, is 12 to 15 % on the schedules assumed here (D3)" in third


@pytest.mark.parametrize(
    ("interval", "words"),
    [
        ([0.4725, 0.5354], "no better than a coin toss"),
        ([0.55, 0.61], "more often than not"),
        ([0.38, 0.44], "they lose more often than they win"),
    ],
)
def test_random_schedules_are_judged_by_the_whole_interval(
    interval: list[float], words: str
) -> None:
    report = make_report()
    report["random_schedules"]["published"]["interval"] = interval
    assert words in told(report)[3]


def test_what_is_missing_is_said_and_never_guessed() -> None:
    report = make_report(full=False) | {"error_budgets": []}
    report["checks"] = [check for check in report["checks"] if check["id"] == "A1"]
    first, second, third, fourth, fifth = told(report)
    assert first.startswith("No run here compares MuJoCo")
    assert second.startswith("No run was completed as deployed")
    assert third.startswith("They are not judged here")
    assert fourth.startswith("No random schedules were drawn")
    assert "not validation against hardware" in fifth
    assert "make proof" in fifth
