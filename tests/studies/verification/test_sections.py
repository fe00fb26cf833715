"""A verification is told from its numbers, whatever was found."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from afl_mujoco.report.markdown import to_markdown
from afl_mujoco.report.old import Cell, Facts, Finding, Section, Table, Tally
from afl_mujoco.simulation.judgement import JudgedRun, Judgement
from afl_mujoco.studies.verification.criteria import CRITERIA
from afl_mujoco.studies.verification.result import Result, verdict_of
from afl_mujoco.studies.verification.sections import sections, verdict
from afl_mujoco.studies.verification.sections.checks import margin
from tests.verification_result import NASTY, make_result


def findings(result: Result) -> dict[str, str]:
    found = {
        block.lead: block.text
        for section in sections(result)
        for block in section.walk()
        if isinstance(block, Finding)
    }
    for text in found.values():
        assert text.endswith(".")
        assert text[0].isupper()
        assert ". " not in text, "more than one sentence"
    return found


def table(result: Result, caption: str) -> list[list[Cell]]:
    """Return the cells of the only table whose caption has some words."""
    (found,) = (
        block
        for section in sections(result)
        for block in section.walk()
        if isinstance(block, Table) and caption in block.caption
    )
    return [[cell for _, cell in row] for row in found.cells]


def rejudged(result: Result, value: float | None) -> Result:
    """Return a verification in which B1 of the last case has another value."""
    checks = tuple(
        replace(check, value=value, passed=False)
        if (check.id, check.scenario, check.controller) == ("B1", NASTY, "adaptive")
        else check
        for check in result.checks
    )
    return replace(result, checks=checks, verdict=verdict_of(checks))


def test_agreement_names_the_worst_difference_and_its_limit() -> None:
    told = findings(make_result())["Agreement"]
    assert "differ by at most 5.8×10⁻¹² in any state at any instant of 4 runs (limit 10⁻⁹)" in told
    assert "one model, up to round-off" in told


@pytest.mark.parametrize(
    ("value", "words"),
    [(3e-3, "they are not the same model"), (None, "do not end the same way")],
    ids=["far apart", "one fell"],
)
def test_disagreement_is_said_and_where(value: float | None, words: str) -> None:
    result = rejudged(make_result(), value)
    told = findings(result)["Agreement"]
    assert words in told
    assert f"{NASTY} with adaptive" in told
    assert "yet" not in told  # that B1 fails has just been said
    assert (verdict(result).passed, verdict(result).text) == (False, "1 of 22 checks fail")
    (failing,) = table(result, "What fails")
    assert [cell.text for cell in failing[:3]] == ["B1", NASTY, "adaptive"]


def test_the_verdict_counts_the_checks() -> None:
    assert verdict(make_result()).text == "all 22 checks hold"
    assert verdict(make_result(b3=3.4e-7)).text == "4 of 22 checks fail"
    assert not verdict(replace(make_result(), checks=(), verdict="fail")).passed


def test_a_verdict_on_two_codes_does_not_hide_that_the_pole_fell() -> None:
    fell = make_result(outcome="fell at t = 1.2 s", fell_at=1200)
    text = verdict(fell).text
    assert text.startswith("all 22 checks hold, but 4 of 4 cases did not complete (step-step with ")
    assert "fixed fell at t = 1.2 s, " in text and text.endswith("; ...)")
    result = make_result()
    runs = tuple(
        replace(run, outcome="fell at t = 1 s") if run.simulator == "mujoco sampled" else run
        for run in result.runs
    )
    assert "4 of 4 cases did not complete" in verdict(replace(result, runs=runs)).text
    lines = table(replace(result, runs=runs), "Every scenario and controller")
    assert {tuple(c.text for c in line[2:4]) for line in lines} == {
        ("completed", "fell at t = 1 s")
    }


def judged(outcome: str, left: float) -> JudgedRun:
    """What one controller made of the requirement to complete."""
    whole = Judgement(requirement="completes", limit=2.0, value=2.0 + left, left=left)
    return JudgedRun(
        scenario="step-step",
        controller="adaptive",
        outcome=outcome,
        requirements=(whole,),
        failure="" if whole.met else "fell",
        settled=whole.met,
    )


def test_the_verdict_says_both_whether_codes_agree_and_whether_requirements_are_met() -> None:
    good, fell = judged("completed", 0.0), judged("fell at t = 0.7 s", -1.3)
    result = replace(make_result(), requirements=(good,))
    assert (
        verdict(result).text
        == "all 22 checks hold; the one run completes, and nothing else is required"
    )
    assert verdict(result).passed
    assert "Requirements" not in {section.title for section in sections(result)}
    checks = result.checks
    missed = replace(result, requirements=(fell,), verdict=verdict_of(checks, requirements=(fell,)))
    assert missed.verdict == "fail"
    assert verdict(missed).text == (
        "all 22 checks hold; the one run does not complete: adaptive on step-step (fell at t = "
        "0.7 s)"
    )
    assert findings(missed)["step-step"] == "The controller `adaptive` fell at t = 0.7 s."
    (row,) = table(missed, "Requirements")
    assert [cell.text for cell in row[2:]] == [
        "runs to the end 2 s", "fell at 0.7 s", "−1.3 s (−65 %)"
    ]  # fmt: skip
    with pytest.raises(ValueError, match="verdict must be 'fail'"):
        replace(missed, verdict="pass")
    both = replace(make_result(b3=3.4e-7), requirements=(fell,))
    assert verdict(both).text.startswith("4 of 22 checks fail; the one run does not")


def test_what_a_run_that_fell_did_not_do_is_no_merit_of_it() -> None:
    fell = make_result(outcome="fell at t = 1.2 s", fell_at=1200)
    merit = next(row for row in table(fell, "step-step: in MuJoCo"))
    assert len(merit) == 4  # figure, unit, the two controllers: no change from one to the other
    (scenarios,) = (part for part in sections(fell) if part.anchor == "scenarios")
    assert scenarios.parts[0].aside == ""


def test_an_explanation_of_some_cases_says_of_how_many() -> None:
    result = make_result()
    told = findings(replace(result, error_budgets=result.error_budgets[:1]))["As deployed"]
    assert told.startswith(
        "Of 4 cases 1 completed in every simulator; a run of these, with the force"
    )


def test_every_criterion_stands_with_its_worst_value_limit_margin_and_reason() -> None:
    result = make_result(b3=3.4e-7)
    rows = {row[0].text: row for row in table(result, "criteria, 4 failing")}
    assert list(rows) == ["A1", "A3", "A5", "B1", "B2", "B3", "B5"]
    assert [cell.text for cell in rows["B1"][2:]] == [
        "5.8×10⁻¹²", "≤ 10⁻⁹", "170 times below", "holds",
    ]  # fmt: skip
    assert rows["B3"][4].text == "34 times above"
    assert (rows["B3"][5].text, rows["B3"][5].status) == ("FAILS", "bad")
    reasons = {row[0].text: row for row in table(result, "The criteria")}
    for id, row in reasons.items():
        told = [cell.text.lower() for cell in row[1:]]
        criterion = CRITERIA[id]
        wanted = (criterion.reason, criterion.proves, criterion.leaves_open)
        assert told == [text.lower() for text in wanted]
    assert len(table(result, "Every judged value")) == 4


def test_a_value_that_is_not_finite_fails_and_is_said_to_be_none() -> None:
    rows = {row[0].text: row for row in table(make_result(b3=None), "criteria, ")}
    assert [cell.text for cell in rows["B3"][2:5]] == ["none", "≤ 10⁻⁸", "no finite value"]


def test_the_outcome_stands_in_the_overview() -> None:
    fell = make_result(outcome="fell at t = 1.2 s", fell_at=1200)
    outcomes = [row[2] for row in table(fell, "Every scenario and controller")]
    assert {(cell.text, cell.status) for cell in outcomes} == {("fell at t = 1.2 s", "bad")}


def test_the_deployed_run_is_explained_by_its_largest_source() -> None:
    told = findings(make_result())["As deployed"]
    assert (
        "with the force held for 1 ms, differs from the ideal one by at most 0.014 (φ′ in" in told
    )
    assert "holding the force accounts for 100 % of it" in told
    assert "MuJoCo itself (integrator and model) for 1.6×10⁻¹⁰" in told
    assert "in no run is more than 0.052 % of the difference unexplained" in told


def test_the_claims_are_counted_and_named() -> None:
    result = make_result()
    told = findings(result)["The paper's claims"]
    assert "Of 12 claims 4 hold here (C1, C6, C7, C12), 2 hold in part (C3, C9)" in told
    assert "38 % in the paper's Table 3, is 12 to 15 % on the schedules assumed here (D3)" in told
    rows = table(result, "Claims ledger")
    assert [row[0].text for row in rows] == [claim.id for claim in result.claims]
    assert [row[4].text for row in rows] == [claim.verdict for claim in result.claims]
    (tally,) = (
        block for part in sections(result) for block in part.walk() if isinstance(block, Tally)
    )
    assert list(tally.counts.values()) == [4, 4, 2, 2]


@pytest.mark.parametrize(
    ("interval", "words"),
    [
        ((0.4725, 0.5354), "no better than a coin toss"),
        ((0.55, 0.61), "more often than not"),
        ((0.38, 0.44), "they lose more often than they win"),
    ],
)
def test_random_schedules_are_judged_by_the_whole_interval(
    interval: tuple[float, float], words: str
) -> None:
    result = make_result()
    published = replace(result.random_schedules["published"], interval=interval)
    changed = replace(result, random_schedules={"published": published})
    assert words in findings(changed)["Other schedules"]


def test_what_is_missing_is_said_and_never_guessed() -> None:
    part = make_result(full=False)
    checks = tuple(check for check in part.checks if check.id == "A1")
    bare = replace(part, checks=checks, error_budgets=())
    told = findings(bare)
    assert told["Agreement"].startswith("No run here compares MuJoCo")
    assert told["As deployed"].startswith("No case completed in every simulator")
    assert "not validation against hardware" in told["Not proved"]
    assert "make proof" in told["Not proved"]
    assert set(told) == {"Agreement", "As deployed", "Not proved"}
    text = to_markdown(sections(bare))
    assert "Not judged in this run" in text
    assert "Not part of this run: `make proof`" in text


def test_claims_and_sections_name_decisions_and_decisions_name_them_back() -> None:
    result = make_result()

    def links(text: str) -> set[str]:
        return set(re.findall(r"\]\(#([\w-]+)\)", text))

    rests = {row[0].text: links(row[1].note) for row in table(result, "Claims ledger")}
    assert {"D2", "D3", "D6", "D7", "D9"} <= rests["C8"]
    assert rests["C1"] == {"D1", "D3", "D4"}  # the last two because its reason names them
    (decisions,) = (part for part in sections(result) if part.anchor == "decisions")
    (facts,) = (block for block in decisions.blocks if isinstance(block, Facts))
    back = {fact.anchor: links(fact.text) for fact in facts.facts}
    assert list(back) == list(result.decisions)
    for claim, ids in rests.items():
        assert all(claim in back[id] for id in ids)
    assert {"budget", "scenarios"} <= back["D7"]
    assert "budget" not in back["D6"]  # no scenario of the paper was run


def test_a_scenario_stands_with_what_happens_in_it_and_its_change_by_adaptive_gains() -> None:
    (scenarios,) = (part for part in sections(make_result()) if part.anchor == "scenarios")
    own, nasty = scenarios.parts
    assert (own.title, nasty.title) == ("step-step", NASTY)
    assert own.folded and nasty.folded
    assert own.aside == "OF 0.0 % by adaptive gains"
    assert [type(block).__name__ for block in own.blocks] == [
        "Facts", "Chart", "Figure", "Table", "Table",
    ]  # fmt: skip


def test_anchors_are_unique() -> None:
    found = [
        block.anchor
        for section in sections(make_result())
        for block in (section, *section.walk())
        if isinstance(block, Section)
    ]
    assert len(found) == len(set(found))


@pytest.mark.parametrize(
    ("value", "most", "passed", "text"),
    [
        (1e-13, 1e-11, True, "100 times below"),
        (3.4e-7, 1e-8, False, "34 times above"),
        (0.0, 0.0, True, "0, as it must be"),
        (0.0, 1e-9, True, "exactly 0"),
        (1.0, 0.0, False, "must be 0"),
        (None, 1e-9, False, "no finite value"),
        (1e-9, 1e-9, True, "at the limit"),
    ],
)
def test_a_margin_says_how_far_the_limit_is(
    value: float | None, most: float, passed: bool, text: str
) -> None:
    check = replace(CRITERIA["B1"].judge(0.0), value=value, limit=most, passed=passed)
    bar, words = margin(check)
    assert words == text
    assert 0.0 <= bar.high <= 1.0
    if most:
        assert (bar.high <= bar.mark + 1e-12) is passed
