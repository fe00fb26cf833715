"""A scenario in words says what its schedules and disturbances are."""

from __future__ import annotations

import pytest

import afl_mujoco as afl
from afl_mujoco.scenario.disturbances import ForcePulse, Impulse
from afl_mujoco.scenario.words import MOST, describe


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("nominal", "1 kg throughout"),
        ("step-step", "0.5 kg; jumps to 1 kg at 1 s; jumps to 2 kg at 3 s"),
        ("trapezoid-step", "0.5 kg; rises to 2 kg over 0 to 2 s; falls to 0.5 kg over 6 to 8 s"),
    ],
)
def test_the_papers_schedules_are_told_as_they_are(name: str, text: str) -> None:
    assert dict(describe(afl.SCENARIOS[name]))["cart mass M"] == text


def test_disturbances_start_and_horizon_are_told() -> None:
    struck = afl.Scenario(
        name="struck",
        disturbances=(
            ForcePulse(force=-10.0, start=10.0, duration=0.1),
            Impulse(momentum=0.2, time=1.5),
        ),
        initial_state=(0.1, 0.3, 0.0, 0.0),
        duration=12.0,
        schedule={"pole_mass": 0.2},
    )
    told = dict(describe(struck))
    pulse, impulse = "−10 N over 10 to 10.1 s", "an impulse of 0.2 N s at 1.5 s"
    assert told["disturbances"] == f"{pulse}; {impulse}"
    assert told["start"] == "z = 0.1 m, φ = 17.19°, the rest 0"
    assert (told["horizon"], told["pole mass m"]) == ("12 s", "0.2 kg")
    rest = dict(describe(afl.SCENARIOS["nominal"]))
    assert (rest["disturbances"], rest["start"]) == ("none", "φ = −60°, the rest 0")
    many = tuple(Impulse(momentum=0.1, time=float(k)) for k in range(MOST + 1))
    shaken = dict(describe(afl.Scenario(name="shaken", disturbances=many)))
    assert shaken["disturbances"] == "9 pulses and impulses"
    all_but_one = dict(describe(afl.Scenario(name="shaken", disturbances=many[1:])))
    assert all_but_one["disturbances"].count("impulse of 0.1 N s") == MOST
