"""Small inputs that once had wrong answers, through the public face, with the right ones."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import afl_mujoco as afl
from afl_mujoco.cli.main import main
from afl_mujoco.scenario.sample_space import SampleSpace, sample_scenario

LEAN = (0.0, 0.1, 0.0, 0.0)


def test_a_jump_one_rounding_after_a_tick_is_learned_at_the_tick() -> None:
    """It was learned a control period late: the cart went 2.04 m and not 0.77 m."""
    scenario = afl.Scenario(
        name="jump", duration=4.0, schedule={"pole_mass": 0.2, "half_length": 0.3},
        initial_state=(0.0, 0.15, 0.0, 0.0), imperfections=afl.Imperfections(control_period=0.05),
    )  # fmt: skip
    jumps = [afl.staircase([at], [8.0, 1.0]) for at in (0.3, 0.1 + 0.2, 0.3 - 1e-13)]
    runs = [afl.simulate_mujoco(scenario.with_schedule(cart_mass=jump), "lqr") for jump in jumps]
    assert np.abs(runs[0].state[:, 0]).max() == pytest.approx(0.772, abs=1e-3)
    assert all(np.array_equal(run.state, runs[0].state) for run in runs)


def test_a_joined_schedule_jumps_at_the_instant_that_its_pieces_say(tmp_path: Path) -> None:
    head = "duration = 2.0\ninitial_state = [0, 0.15, 0, 0]\nimperfections.control_period = 0.02\n"
    head += "[schedule]\npole_mass = 0.2\nhalf_length = 0.3\ncart_mass = "
    piece = "{shape = 'staircase', times = [0.2], values = [8.0, 1.0]}"
    joined = f"{{shape = 'joined', starts = [0.0, 0.1], pieces = [8.0, {piece}]}}"
    (tmp_path / "joined.toml").write_text(head + joined)
    (tmp_path / "plain.toml").write_text(head + piece.replace("0.2", "0.3"))
    one, other = (afl.simulate_mujoco(tmp_path / f"{x}.toml", "lqr") for x in ("joined", "plain"))
    assert np.array_equal(one.state, other.state)


@pytest.mark.parametrize("period", [1 / 60, 0.0166666667, 0.0166667, 1 / 400, 0.0013])
def test_any_control_period_runs_in_every_study(period: float, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hz.toml").write_text(
        "duration = 0.5\ninitial_state = [0.0, 0.1, 0.0, 0.0]\n"
        "[schedule]\npole_mass = 0.2\ncart_mass = 4.0\nhalf_length = 0.6\n"
        f"[imperfections]\ncontrol_period = {period}\n"
    )
    run = afl.simulate_mujoco("hz.toml", "lqr")
    settings = run.provenance["settings"]
    hold = round(period / settings["timestep"])
    assert hold * settings["timestep"] == pytest.approx(period, rel=1e-12)
    assert settings["timestep"] <= 1e-3 and run.time[-1] == pytest.approx(0.5, abs=1e-9)
    assert set(np.flatnonzero(np.diff(run.command[:-1])) + 1) <= set(range(0, len(run.time), hold))
    quick = ("--controllers", "lqr", "--no-page", "--out", "out", "--workers", "1")
    assert main(["montecarlo", "hz.toml", "--samples", "2", "--no-worst-case", *quick]) == 0
    assert main(["attraction", "hz.toml", "--grid", "2", *quick]) == 0
    if period > 0.01:
        sweep = ("--imperfections", "delay", "--scan", "2", "--tolerance", "1", "--seeds", "1")
        assert main(["thresholds", "hz.toml", *sweep, *quick]) == 0


@pytest.mark.parametrize("delay", [0.0, 0.0005, 0.001, 0.0015])
def test_the_force_is_the_one_exerted_and_not_its_mean_over_a_step(delay: float) -> None:
    """With half a step of delay spikes of 29.8 N were reported as 19.8 N."""
    scenario = afl.Scenario(
        name="spikes", initial_state=LEAN, duration=2.0,
        requirements=afl.Requirements(max={"force": 24.0}),
        imperfections=afl.Imperfections(delay=delay, noise={"phi_dot": 0.3}, seed=1),
    )  # fmt: skip
    run = afl.simulate_mujoco(scenario, "lqr")
    arrived = run.command[: -3 - round(delay / 1e-3)]
    assert run.metrics["max_command"] == np.abs(run.command[:-1]).max()
    found = [run.metrics[name] for name in ("max_force", "force_squared", "force_variation")]
    expected = np.abs(arrived).max(), 1e-3 * (arrived**2).sum(), np.abs(np.diff(arrived)).sum()
    assert found == pytest.approx(expected, rel=0.02)
    (row,) = afl.run_all("lqr", scenario)
    assert row.missed and row.metrics["max_force"] == found[0]


@pytest.mark.parametrize("start", [1.0004, 1.0006, 1.001], ids=str)
def test_all_of_a_pulse_acts_in_sampled_as_in_exact_mode(start: float) -> None:
    """The force of the middle of each step lost it, or acted with 2 N s in place of 1.6."""
    pulse = afl.ForcePulse(force=2000.0, start=start, duration=0.0008)
    acts = {"initial_state": (0.0,) * 4, "disturbances": (pulse,)}
    scenario = afl.Scenario(name="pulse", duration=3.0, **acts)
    for mode in ("sampled", "exact"):
        far = np.abs(afl.simulate_mujoco(scenario, "lqr", mode).state[:, 0]).max()
        assert far == pytest.approx(0.1293, abs=2e-4)


def test_a_stiff_damper_holds_the_pole() -> None:
    """RK4 at 1 ms is unstable there, and the pole was said to have fallen at 0.03 s."""
    m, half, g, damping = 0.05, 0.05, 9.81, 0.5

    def slopes(t, x):
        phi, w = x[1], x[3]
        mass = np.array([[1.0 + m, -m * half * np.cos(phi)],
                         [-m * half * np.cos(phi), 4 / 3 * m * half**2]])  # fmt: skip
        loads = [-m * half * w * w * np.sin(phi), m * g * half * np.sin(phi) - damping * w]
        return [x[2], w, *np.linalg.solve(mass, loads)]

    truth = solve_ivp(slopes, (0.0, 2.0), LEAN, method="Radau", rtol=1e-9, atol=1e-11).y[:, -1]
    assert truth[1] == pytest.approx(0.110, abs=5e-4)
    stiff = afl.Scenario(
        name="stiff", duration=2.0, initial_state=LEAN, schedule={"half_length": half},
        imperfections=afl.Imperfections(damping={"phi": damping}),
    )  # fmt: skip
    for integrator in ("RK4", "implicit"):
        run = afl.simulate_mujoco(stiff, lambda t, x, b: 0.0, integrator=integrator)
        assert run.outcome.kind == "completed"
        assert run.state[-1, 1] == pytest.approx(truth[1], rel=2e-4)
    (remarks,) = afl.compare(stiff, "lqr").remarks.values()
    assert any(remark.startswith("the physics step is 0.25 ms") for remark in remarks)
    env = afl.load(stiff)
    assert env.control_timestep() == pytest.approx(1e-3) and env.physics.world.hold == 4


FALLS = "duration = 1.0\ninitial_state = [0.0, 0.5, 0.0, 0.0]\n[requirements]\ncompletes = false\n"
RAIL = "duration = 5.0\ninitial_state = [0, -0.1, 0, 0]\nimperfections.end_stops.z = 0.2\n"
ALLOWED = RAIL + "requirements.end_stops_allowed = true\n"


@pytest.mark.parametrize(("text", "code", "word"), [
    (FALLS, 0, ""), (FALLS.replace("false", "true"), 1, "fell"), (RAIL, 1, "end_stops"),
    (ALLOWED, 0, ""),
], ids=["nothing required", "falls", "end stop", "end stop allowed"])  # fmt: skip
def test_every_study_says_the_same_word(text, code, word, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    name = "lqr" if "end_stops" in text else "idle_law:zero"
    Path("idle_law.py").write_text("def zero(t, x, b):\n    return 0.0\n")
    Path("case.toml").write_text(text + "[ranges]\nz_dot = [0.0, 1e-9]\n")
    common = ("--no-page", "--out", "out", "case.toml")
    assert main(["simulate", *common, "--controller", name]) == code
    common = (*common, "--controllers", name)
    assert main(["compare", *common]) == code
    said = capsys.readouterr().out
    assert ("completes = false and nothing else is required" in said) == (text is FALLS)
    few = {"montecarlo": "--samples 2 --no-worst-case", "attraction": "--grid 2",
           "thresholds": "--imperfections delay --scan 2 --tolerance 1"}  # fmt: skip
    columns = []
    for study in ("compare", *few):
        if study in few:
            main([study, *common, "--workers", "1", *few[study].split()])
        rows = json.loads(Path(f"out/{study}.json").read_text())["rows"]
        row = rows[-1 if study == "attraction" else 0]
        assert row["failure"] == word, study
        columns.append([*row])
    assert all(found == columns[0] for found in columns)
    assert afl.run_all(name, "case.toml")[0].failure == word


def test_nominal_is_what_the_scenario_has_at_the_start_before_anything_is_drawn() -> None:
    """Told the truth, a controller that was tuned by hand answers another question."""

    def told(scenario):
        seen = set()

        def spy(time, state, belief):
            seen.add((belief.cart_mass, belief.pole_mass, belief.half_length, belief.gravity))
            return 0.0

        afl.simulate_mujoco(scenario, spy)
        return seen

    scenario = afl.Scenario(
        name="told", duration=0.2, belief="nominal",
        schedule={"cart_mass": afl.staircase([0.1], [8.0, 10.0]), "pole_mass": 0.2},
        ranges={"cart_mass": (2.0, 4.0), "pole_mass": (0.3, 0.4)},
    )  # fmt: skip
    assert told(scenario) == {(8.0, 0.2, 0.5, 9.81)}  # M jumps at 0.1 s, not told
    assert told(sample_scenario(SampleSpace(scenario), 0, 1)) == {(8.0, 0.2, 0.5, 9.81)}
    partly = {"cart_mass": "nominal", "gravity": {"value": 9.8, "error": 0.1}}
    drawn = sample_scenario(SampleSpace(replace(scenario, belief=partly)), 0, 1)
    truth = drawn.parameters_at(0.0)
    assert truth.cart_mass < 4.0 and truth.pole_mass > 0.3
    assert told(drawn) == {(8.0, truth.pole_mass, 0.5, 9.8 * 1.1)}


def test_validate_compares_the_ideal_part_and_judges_a_deployed_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    hardware = "imperfections = {delay = 0.3, control_period = 0.01}\n"
    Path("rig.toml").write_text(f"duration = 2.0\ninitial_state = [0, 0.1, 0, 0]\n{hardware}")
    arguments = ("validate", "rig.toml", "--controllers", "lqr", "--no-page", "--workers", "1")
    assert main([*arguments, "--out", "out"]) == 1
    report = json.loads(Path("out/report.json").read_text())
    assert all(check["passed"] for check in report["checks"])  # of the loop without the delay
    assert report["rows"][0]["failure"] in ("fell", "diverged")
    assert "the codes are compared without" in " ".join(capsys.readouterr().out.split())
