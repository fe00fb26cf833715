"""The claims ledger judges what it is given, and not what it would like to find."""

from itertools import product

import pytest

import afl_mujoco as afl
from afl_mujoco.plants.cartpole import CART_POLE
from afl_mujoco.simulation.metrics import metrics
from afl_mujoco.studies.verify import claims as ledger
from afl_mujoco.studies.verify.claims import ObjectiveScales, with_objective

IMPROVEMENT = {case: row[2] for case, row in ledger.TABLE_3.items()}
PUBLISHED = {case: {"one": x} for case, x in IMPROVEMENT.items()}
TRIED = ledger.Readings(drawn=4, near=dict.fromkeys(PUBLISHED, 4), fitted=PUBLISHED)
SCALES = ObjectiveScales(iae_z=20.9, iae_phi=1.53, max_force=96.1)


def figures(objective: float | None, overshoot: float = 1.0, settling: float | None = 5.0) -> dict:
    found = {"overshoot": overshoot, "settling_2pc": settling}
    measured = {f"{name}_{x}": value for name, value in found.items() for x in CART_POLE.states}
    return {"objective": objective, **measured}


def as_published() -> dict:
    runs = {}
    for name, controller in product(afl.SCENARIOS, ("fixed", "adaptive")):
        cut = IMPROVEMENT.get(name.removesuffix("-impulse"), 30.0) / 100.0
        adaptive = controller == "adaptive"
        settling = (14.0 if "impulse" in name else 4.0) + (not adaptive)
        runs[name, controller] = figures(*(1.0 - cut, 0.5) if adaptive else (1.0, 1.0), settling)
    return runs


def verdicts(runs: dict) -> dict[str, str]:
    return {claim.id: claim.verdict for claim in ledger.performance_claims(runs, TRIED)}


def test_runs_as_published_reproduce_every_claim_on_performance() -> None:
    claims = {claim.id: claim for claim in ledger.performance_claims(as_published(), TRIED)}
    assert {claim.verdict for claim in claims.values()} == {ledger.REPRODUCED, ledger.EVERY}
    assert claims["C3"].here == pytest.approx(38.03)
    assert (claims["C2"].here, claims["C7"].here, claims["C8"].here) == (5.0, 32.0, 5.0)


@pytest.mark.parametrize(("objective", "expected"), [
    (0.66, ledger.EVERY), (0.75, "not reproduced; met under 100.0 % of readings"),
    (None, "not reproduced; met under 100.0 % of readings"),
])  # fmt: skip
def test_an_improvement_is_judged_under_every_reading(objective, expected) -> None:
    runs = as_published()
    runs["step-step", "adaptive"] = figures(objective, 0.5, 4.0)
    assert verdicts(runs)["C3"] == expected
    assert ledger.kind(expected) == (ledger.EVERY if expected == ledger.EVERY else ledger.RANDOM)


def test_a_run_that_never_settles_takes_from_three_of_the_twelve_claims() -> None:
    runs = as_published()
    runs["step-step", "adaptive"] = figures(0.62, 0.5, None)
    runs["step-step-impulse", "adaptive"] = figures(0.62, 0.5, None)
    found = verdicts(runs)
    assert (found["C2"], found["C7"], found["C8"]) == (ledger.IN_PART,) * 3
    known = ledger.shipped()
    claims = ledger.judge_claims(as_published(), known)
    assert [claim.id for claim in claims] == [f"C{k}" for k in range(1, 13)]
    assert set(known.random_schedules) == {"published", "retuned"}
    incomplete = {k: v for k, v in as_published().items() if k != ("nominal", "fixed")}
    assert ledger.decidable(as_published()) and not ledger.decidable(incomplete)


def test_the_retuned_adaptive_gains_beat_the_retuned_fixed_gains_in_all_four_cases() -> None:
    for case in IMPROVEMENT:
        found = []
        for name in ("fixed-retuned", "adaptive-retuned"):
            controller, scenario = afl.CONTROLLERS[name], afl.SCENARIOS[case]
            run = afl.simulate_ode_rk4(scenario, controller, timestep=1e-3)
            found.append(with_objective(metrics(scenario, controller, run), SCALES)["objective"])
        assert found[1] < found[0], case


def test_the_law_linearises_and_a_wrong_one_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert ledger.linearisation_claim().verdict == ledger.REPRODUCED
    original = ledger.linearizing_force
    for least in (0.0, 50.0):  # everywhere, and only where accelerations are large

        def wrong(u, phi, *others, least=least):
            return original(u, phi, *others) * (1.0 + 1e-6 * (abs(u) > least and abs(phi) < 1.0))

        monkeypatch.setattr(ledger, "linearizing_force", wrong)
        assert ledger.linearisation_claim().verdict == ledger.NOT_REPRODUCED
