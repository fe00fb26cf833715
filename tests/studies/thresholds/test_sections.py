"""What the report says of thresholds is what the result holds."""

from __future__ import annotations

import re
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from afl_mujoco.report.old import Finding, Section, Table, Text, figures_of
from afl_mujoco.report.terminal import print_sections
from afl_mujoco.scenario.catalogue import SCENARIOS
from afl_mujoco.scenario.requirements import Requirements
from afl_mujoco.studies.bisection import BRACKETED, LOWER, UPPER
from afl_mujoco.studies.thresholds.sections import sections
from tests import study_results


def found(*arguments: Any, **changes: tuple[str, float, bool]) -> dict[str, str]:
    """Return the findings, thresholds of the adaptive controller changed: bound, level, survives
    and settles at the reference."""
    sweeps = {
        name.replace("_", "-"): (bound, level, bound, level, fine, fine)
        for name, (bound, level, fine) in changes.items()
    }
    result = study_results.thresholds(sweeps, *arguments)
    blocks = sections(result)[0].blocks
    return {block.lead: block.text for block in blocks if isinstance(block, Finding)}


def test_the_findings_say_what_holds_what_breaks_and_at_what() -> None:
    said = found()
    assert list(said) == [
        "What holds", "What breaks first", "At what threshold", "Compared with LQR",
    ]  # fmt: skip
    assert said["What holds"] == (
        "Of 4 single imperfections, each at the level of the reference hardware and on a "
        "rail without end stops, the adaptive controller survives 4 and settles under 3. Of the 4 "
        "searched to ten times that level, it survives 2 even there."
    )
    assert said["What breaks first"] == (
        "The rail: the reference of 1 m to either side is too short; 3.7 m is "
        "enough; on a rail without end stops, rail damping: at 7.3 N s/m, 1.5 times the reference, "
        "the pole falls."
    )
    assert said["At what threshold"] == (
        "The adaptive controller fails at a delay of 47 ms or a force limit of 10 N; survives a "
        "control period of 50 ms, the harshest tried; with all imperfections combined, except "
        "the end of the rail, it fails at 1.1 times the reference levels and no longer settles "
        "at 0.33 times. Thresholds are bisected to 2 % on step-step, with 4 seeds of noise."
    )
    assert said["Compared with LQR"] == (
        "The adaptive controller tolerates more than LQR under 3 of 6 imperfections "
        "that act on both, as much under 1 and less under 2; combined, it fails at 1.1 times the "
        "reference, LQR at 1.3."
    )


def test_a_rail_of_one_s_own_counts_and_a_range_that_ends_early_does_not() -> None:
    rail = replace(SCENARIOS["step-step"].imperfections, rail_half_length=2.0)
    result = study_results.thresholds()
    near = [replace(one, harsh=9.9 * one.reference) for one in result.imperfections[:1]]
    result = replace(
        result,
        scenarios=(replace(SCENARIOS["step-step"], imperfections=rail),),
        imperfections=(*near, *result.imperfections[1:]),
    )
    first = next(b.text for b in sections(result)[0].blocks if isinstance(b, Finding))
    assert first.startswith("Of 5 single imperfections, each at the level of the reference")
    assert "Of the 4 searched to ten times that level, it survives 1 even there" in first


@pytest.mark.parametrize(
    ("fine", "settles", "said"),
    [
        (True, True, "survives"),
        (True, False, "survives but does not settle"),
        (False, False, "fails"),
    ],
)
def test_a_single_imperfection_is_not_counted(fine: bool, settles: bool, said: str) -> None:
    sweep = (BRACKETED, 0.1, BRACKETED, 0.1, fine, settles)
    blocks = sections(study_results.thresholds({"delay": sweep}, ("delay",)))[0].blocks
    first = next(b.text for b in blocks if isinstance(b, Finding))
    assert first == (
        "Transport delay at the level of the reference hardware and on a rail without end stops: "
        f"the adaptive controller {said}."
    )


def test_a_worse_number_is_a_worse_sentence() -> None:
    said = found(delay=(BRACKETED, 0.001, False))
    assert "survives 3 and settles" in said["What holds"]
    assert "transport delay: at 1 ms, 0.5 times" in said["What breaks first"]


def test_a_rail_that_suffices_is_not_what_breaks_first() -> None:
    said = found(rail=(BRACKETED, 0.2, True))
    assert said["What breaks first"].startswith("Rail damping: at 7.3 N s/m, 1.5 times")
    said = found(rail=(UPPER, 100.0, False))
    assert said["What breaks first"].startswith(
        "The rail: the reference of 1 m to either side is too short; on a rail without end stops, "
    )


def test_what_no_level_defeats_and_what_the_mildest_does() -> None:
    names = ("delay", "control_period", "force_limit", "rail_damping", "rail", "combined")
    said = found(**dict.fromkeys(names, (LOWER, 1.0, True)))
    assert said["What breaks first"] == "Nothing, within the ranges that were tried."
    assert "survives a delay of 1000 ms" in said["At what threshold"]
    assert "it survives up to more than 1 times" in said["At what threshold"]
    said = found(**dict.fromkeys(names, (UPPER, 0.01, False)))
    assert said["What breaks first"].startswith("Everything that was tried")


@pytest.mark.parametrize("kept", [("combined",), ("rail",), ("delay",), ("rail", "combined")])
def test_a_study_of_few_imperfections_has_sentences_too(kept: tuple[str, ...]) -> None:
    assert all(text.endswith(".") for text in found(kept).values())


def rows(blocks: list[Section]) -> list[str]:
    text = StringIO()
    print_sections(blocks, Path("out"), Console(file=text, width=140))
    return [" ".join(line.split()) for line in text.getvalue().splitlines()]


def test_the_table_has_a_row_for_each_imperfection() -> None:
    printed = rows(sections(study_results.thresholds()))
    assert "transport delay ms 2 47 36" in printed
    assert "rail damping N s/m 5 ◐ 7.3 ◐ 11" in printed  # twice the reference: little to spare
    assert "rail to either side m 1 ✗ 3.7 ✗ > 100" in printed


def test_the_least_margin_is_beside_the_threshold_of_the_delay() -> None:
    printed = rows(sections(study_results.thresholds()))
    assert "adaptive 32.3 0.5 kg, 0.2 m 47 1.46" in printed
    assert "lqr 0.0 0.5 kg, 0.2 m 36 –" in printed


def test_the_details_say_how_each_controller_fails() -> None:
    blocks = sections(study_results.thresholds())[0].blocks
    (table,) = (b for b in blocks if getattr(b, "summary", "").startswith("Every imperfection"))
    cells = {(row[0], row[2]): row for row in table.rows}
    damping = cells["rail damping", "adaptive"]
    assert damping[4] == "fell at 1.25 s"
    assert (damping[6].text, damping[6].status) == ("does not settle", "neutral")
    assert cells["transport delay", "lqr"][6].text == "settles in 6.6 s"
    assert cells["rail to either side", "lqr"][3].status == "bad"


def required() -> list[Section]:
    scenario = replace(SCENARIOS["step-step"], requirements=Requirements(max_position=1.0))
    result = study_results.thresholds({}, ("delay", "control-period", "rail"))
    return sections(replace(result, scenarios=(scenario,)))


def test_with_requirements_it_says_that_they_are_met_and_not_what_settles() -> None:
    blocks = required()[0].blocks
    said = [b.text for b in blocks if isinstance(b, Finding | Text)]
    assert "On step-step the requirements are: runs to the end and |z| at most 1 m." in said
    titles = [[b.caption, *(c.header for c in b.columns)] for b in blocks if isinstance(b, Table)]
    pictures = [[b.title, b.caption, b.alt] for b in figures_of(required())]
    shown = " ".join([*said, *(text for texts in (*titles, *pictures) for text in texts)])
    assert shown.count("no longer meets its requirements") == 3
    assert not re.search("surviv|settle", shown)


def test_the_table_explains_only_the_marks_that_it_has() -> None:
    def caption(**changes: tuple[str, float, bool]) -> str:
        sweeps = {n: (b, x, b, x, fine, fine) for n, (b, x, fine) in changes.items()}
        blocks = sections(study_results.thresholds(sweeps, tuple(changes)))[0].blocks
        return next(b.caption for b in blocks if isinstance(b, Table) and not b.summary)

    assert "✗" in caption(delay=(BRACKETED, 0.001, False))
    assert not {*"✗◐"} & {*caption(delay=(BRACKETED, 0.1, True))}


def test_an_imperfection_of_several_keys_names_them() -> None:
    result = study_results.thresholds({}, ("delay",))
    noise = replace(result.imperfections[0], fields={"noise_phi": 2.0, "noise_z": 0.2})
    text = " ".join(rows(sections(replace(result, imperfections=(noise,)))))
    assert "Transport delay: noise_phi, with noise_z 0.1 times as much (in SI)." in text
