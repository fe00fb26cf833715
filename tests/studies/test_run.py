import math
from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.plants.cartpole import CART_POLE, FALL_ANGLE
from afl_mujoco.simulation.judgement import CONTROLLER_FAILED, Judgement
from afl_mujoco.studies.shared.run import Run, columns_of, run_all, run_of
from afl_mujoco.studies.shared.tables import middle, requirements_matrix

LQR, NOMINAL = afl.CONTROLLERS["lqr"], afl.SCENARIOS["nominal"]
NEAR = afl.Scenario(name="near", duration=3.0, initial_state=(0.0, 0.2, 0.0, 0.0))
UNDONE = Judgement(requirement="completes", limit=20.0, value=15.0, margin=-0.25)


def made(outcome: str = "completed", time: float = 20.0, **values) -> Run:
    early = outcome not in ("completed", CONTROLLER_FAILED)
    given = {"peak_phi": 0.1, "iae_phi": 0.1} | values.pop("metrics", {})
    missed = [one for one in values.get("requirements", ()) if not one.met]
    return Run(
        scenario="case", controller="lqr", outcome=outcome, settled=True, time=time,
        failure=outcome if outcome != "completed" else missed[0].requirement if missed else "",
        metrics=dict.fromkeys(columns_of(CART_POLE)) | given,
        **{"requirements": (UNDONE,) * early} | values,
    )  # fmt: skip


def limited(*margins: float, **values) -> Run:
    pairs = zip(("max.z", "max.force"), margins, strict=False)
    found = [Judgement(name, limit=2.0, value=2.0 - 2.0 * x, margin=x) for name, x in pairs]
    return made(requirements=tuple(found), **values)


def test_severity_is_what_its_words_say_and_ranks_early_falls_first() -> None:
    order = [made(), made(metrics={"peak_phi": 1.5, "iae_phi": 20.0}), made("fell", 19.0),
             made("diverged", 0.5), made(CONTROLLER_FAILED)]  # fmt: skip
    severities = [run.severity(NOMINAL) for run in order]
    assert severities == sorted(set(severities)) and severities[1] < 1.0 < severities[2]
    survivor = made(metrics={"peak_phi": 1.2, "iae_phi": 8.0})
    assert survivor.severity(NOMINAL) == pytest.approx(0.5 * (1.2 + 0.4) / FALL_ANGLE)
    assert made("fell", 15.0).severity(NOMINAL) == pytest.approx(2.25)
    order = [limited(0.75, 0.5), limited(0.25, 0.75), limited(0.0), limited(0.75, -0.05),
             limited(-5.0, 0.5), made("fell", 19.0), made("fell", 1.0)]  # fmt: skip
    severities = [run.severity(NOMINAL) for run in order]
    assert severities == sorted(severities) and severities[:3] == pytest.approx([0.5, 0.75, 1.0])
    assert [bool(run.failure) for run in order] == [False] * 3 + [True] * 4


def test_a_row_is_of_the_run_of_the_simulator() -> None:
    late = afl.Imperfections(delay=0.004)
    peak = np.abs(afl.simulate_mujoco(replace(NEAR, imperfections=late), LQR).state[:, 0]).max()
    rail = replace(late, end_stops={"z": 0.999 * float(peak)})
    steep = (0.0, 1.5, 0.0, 0.0)
    scenarios = [NEAR, replace(NEAR, imperfections=rail), replace(NEAR, initial_state=steep)]
    for scenario, run in zip(scenarios, run_all(LQR, scenarios), strict=True):
        alone = afl.simulate_mujoco(scenario, LQR)
        other = run_of(scenario, LQR, alone)
        for name in ("outcome", "failure", "settled"):
            assert getattr(run, name) == getattr(other, name)
        assert run.metrics["peak_z"] == np.abs(alone.state[:, 0]).max()
        assert run.metrics["settling_time"] == other.metrics["settling_time"]
        if run.outcome == "completed":
            for name in ("iae_z", "iae_phi"):
                assert run.metrics[name] == pytest.approx(other.metrics[name], rel=1e-3)
        else:  # a part of the horizon is no integral
            assert run.metrics["iae_z"] is other.metrics["iae_z"] is None
    hit = run_all(LQR, scenarios)[1]
    assert hit.failure == "end_stops"
    far = np.abs(afl.simulate_mujoco(scenarios[1], LQR).state[:, 0]) >= rail.at("end_stops.z")
    assert hit.time == pytest.approx(1e-3 * np.flatnonzero(far)[0])
    assert run_of(scenarios[1], LQR, afl.simulate_mujoco(scenarios[1], LQR)).time == hit.time


def test_a_median_is_of_all_draws_also_of_those_that_have_no_number() -> None:
    """Three draws settle, four never do: the median never settles, and its margin is none."""
    limits = afl.Requirements(settling_time=4.0, max={"z": 1.0})
    asked = afl.Scenario(name="case", duration=9.0, requirements=limits)

    def draw(settles: float | None, z: float) -> Run:
        left = None if settles is None else 1.0 - settles / 4.0
        rest = Judgement("settling_time", 4.0, settles, left, graded=-0.1)
        return made(requirements=(Judgement("max.z", 1.0, z, 1.0 - z), rest))

    def told(*draws: Run) -> list[str]:
        rows = requirements_matrix(asked, {"lqr": draws}, {}).rows
        return [row[1].text for row in rows if str(row[0]).startswith(("|z|", "settles"))]

    never = [draw(None, 0.5)] * 4
    assert told(*never, *[draw(2.0, 0.25)] * 3) == ["0.5 (50 %)", "never 3 of 7"]
    assert told(*never, *[draw(2.0, 0.25)] * 5) == ["0.25 (75 %)", "2 (50 %) 5 of 9"]
    assert [middle(x, -math.inf) for x in ([None, 0.3, 0.5], [None, None, 0.5])] == [0.3, None]
