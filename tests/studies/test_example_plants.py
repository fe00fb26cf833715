from dataclasses import replace

import pytest

import afl_mujoco as afl
from afl_mujoco.studies import attraction, montecarlo, thresholds
from afl_mujoco.studies.shared.run import run_all
from tests.plants.plants import EXAMPLES, OWN


@pytest.mark.parametrize("name", OWN)
def test_an_lqr_meets_what_the_file_of_an_example_requires(name) -> None:
    scenario = afl.load_scenario(EXAMPLES / f"{name}.toml")
    (run,) = run_all(afl.CONTROLLERS["lqr"], [scenario])
    assert [one.requirement for one in run.requirements if not one.met] == []
    assert {f"peak_{x}" for x in scenario.plant.coordinates} < set(run.metrics)


def test_a_range_beyond_what_was_checked_is_told() -> None:
    file = str(EXAMPLES / "quadrotor_load.toml")
    request = montecarlo.prepare(montecarlo.Options(scenario=file, samples=1, worst_case=False))
    free = replace(request.space.scenario, requirements=afl.Requirements(), disturbances=())
    varied = replace(free, duration=0.5, schedule={}, ranges={"load": (0.02, 20.0)})
    space = replace(request.space, scenario=varied)
    said = montecarlo.report(montecarlo.run(request._replace(space=space))).blocks
    assert "load goes from 0.02 to 20 kg, but is checked in 0.01 to 0.6." in said


@pytest.mark.slow
def test_a_quadrotor_has_an_lqr_by_default_with_thresholds_samples_and_a_map() -> None:
    file = str(EXAMPLES / "quadrotor_load.toml")
    asked = ("delay", "load_error+")
    given = thresholds.Options(scenarios=(file,), imperfections=asked, quick=True)
    delay = thresholds.run(thresholds.prepare(given)).sweep("delay", "lqr").survives
    assert delay.holds_at is not None and 1e-3 < delay.holds_at < 0.2
    drawn = montecarlo.Options(scenario=file, samples=4, worst_case=False)
    runs = montecarlo.run(montecarlo.prepare(drawn), workers=2).runs["lqr"]
    assert [run.draw for run in runs] == [0, 1, 2, 3] and not any(run.message for run in runs)
    mapped = attraction.Options(scenario=file, grid=2, axes=("x", "pitch"))
    assert attraction.run(attraction.prepare(mapped)).kinds("lqr").shape == (2, 2)
