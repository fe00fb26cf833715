"""Passive physics and limits that an MJCF or a plant's `write` gives, in every way to run it."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.catalogue import as_controller
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.imperfections import IDEAL
from afl_mujoco.simulation.drawing import tracks
from afl_mujoco.simulation.judgement import remarks_on
from afl_mujoco.simulation.mujoco_model import SimulatedModel
from tests.plants.plants import cart, idle


def gliding(plant: afl.Plant, **more) -> afl.Scenario:
    what = {"duration": 1.0, "initial_state": {"x_dot": 1.0}} | more
    return afl.Scenario(name="gliding", plant=plant, **what)


def travelled(scenario: afl.Scenario) -> list[float]:
    found = [afl.simulate_mujoco(scenario, idle).state[-1, 0]]
    found += [afl.run_all(idle, scenario)[0].metrics["peak_x"]]
    how = {"vectorization_mode": "vector_entry_point", "control_period": 0.1, "scaled": False}
    many = gymnasium.make_vec("afl_mujoco/Scenario-v0", 1, scenario=scenario, **how)
    one = afl.load(scenario, control_period=0.1)
    many.reset(), one.reset()
    for _ in range(10):
        seen, step = many.step(np.zeros((1, 1)))[0], one.step([0.0])
    return [*found, float(seen[0, 0]), float(step.observation["position"][0])]


@pytest.mark.parametrize("nominal", [0.0, 1.0])
def test_dry_friction_that_a_plant_writes_acts_when_it_comes(nominal: float) -> None:
    """From 0 to 1 N at 0.2 s: x(1) = 0.2 + 0.8 - 0.8^2 / 2."""
    schedule = {"mu": afl.staircase((0.2,), (0.0, 1.0))}
    found = travelled(gliding(cart("frictionloss", nominal), schedule=schedule))
    np.testing.assert_allclose(found, 0.68, atol=1e-3)
    assert max(found) - min(found) < 1e-12
    # damping of 4000 N s/m from 0.2 s on stops it within a quarter of a millisecond
    schedule = {"mu": afl.staircase((0.2,), (0.0, 4000.0))}
    found = travelled(gliding(cart("damping", nominal), schedule=schedule))
    np.testing.assert_allclose(found, 0.20025, atol=1e-6)


def test_the_step_is_fine_enough_for_a_spring_and_where_the_run_starts() -> None:
    """A spring of 1e7 N/m, whose period is 2 ms; an arm that is light at the start."""
    stiff = gliding(cart(joint=' stiffness="1e7"'), duration=0.1)
    for integrator, near in (("RK4", 0.05), ("Euler", 0.2)):
        run = afl.simulate_mujoco(stiff, idle, integrator=integrator)
        assert np.abs(run.state[:, 0]).max() == pytest.approx(1.0 / np.sqrt(1e7), rel=near)
    model = """<mujoco><worldbody><body name="b"><joint name="turn" axis="0 1 0" damping="2"/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="1e-6 1e-6 1e-6"/><body name="tip" pos="0 0 1">
      <joint name="reach" type="slide" axis="0 0 1" ref="1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1e-4 1e-4 1e-4"/></body></body></worldbody>
      </mujoco>"""
    arm = afl.Plant(name="arm", model=model, coordinates=("turn", "reach"))
    near = {"reach": 0.02, "turn_dot": 0.1}
    light = afl.Scenario(name="light", plant=arm, duration=0.05, initial_state=near)
    run, exact = (afl.simulate_mujoco(light, lambda *_: (), x) for x in ("sampled", "exact"))
    assert run.outcome.kind == "completed"
    np.testing.assert_allclose(run.state[-1], exact.state[-1], atol=1e-6)


@pytest.mark.parametrize(("friction", "start", "band", "end", "law"), [
    (20.0, 1.9e-3, 1e-3, 8.0, lambda t, x, b: -1e4 * x[0] - 140.0 * x[1]),  # stuck: 19 N
    (0.0, 0.1, 0.02, 4.3, lambda t, x, b: -1.2 * x[0]),  # 1.1 rad/s passes 0 at 4.28 s
])  # fmt: skip
def test_a_stuck_joint_and_a_passage_through_the_bands_are_no_rest(friction, start, band, end, law):
    how = {"requirements": afl.Requirements(bands={"x": band}, settling_time=end)}
    how["imperfections"] = afl.Imperfections(dry_friction={"x": friction})
    (row,) = afl.run_all(law, gliding(cart(), duration=end, initial_state={"x": start}, **how))
    assert row.failure == "settling_time"


def test_friction_of_the_mjcf_that_creeps_is_remarked_on() -> None:
    firm, held = ' solimpfriction=".9999 .9999"', afl.Imperfections(dry_friction={"x": 1.0})
    for more, own, said in (("", IDEAL, True), (firm, IDEAL, False), ("", held, False)):
        rubs = gliding(cart(joint=f' frictionloss="2"{more}'), imperfections=own)
        told = remarks_on(afl.simulate_mujoco(rubs, idle), rubs, as_controller(idle))
        assert any(one.startswith("x creeps under the frictionloss") for one in told) == said


def test_a_requirement_that_depends_on_the_physics_step_is_remarked_on() -> None:
    """Euler goes h / 2 further; at 1000 rad/s RK4 damps what a controller alone lets ring."""
    rest = {"bands": {"x": 1e-4}, "settling_time": 0.5}
    for law, how, asked, said in (
        (lambda t, x, b: 1.0, {"integrator": "Euler"}, {"max": {"x": 1.5004}}, "at 0.5 ms 0.01 %"),
        (lambda t, x, b: -1e6 * x[0], {"mode": "continuous"}, rest, "at 0.5 ms none"),
    ):
        glides = gliding(cart(), requirements=afl.Requirements(**asked))
        run = afl.simulate_mujoco(glides, law, **how)
        (told,) = remarks_on(run, glides, as_controller(law))
        assert "depends on the physics step: its margin is" in told and said in told


@pytest.mark.parametrize(("stiffness", "mode"), [(2.5e5, "sampled"), (2.5e6, "continuous")])
def test_what_a_spring_without_damping_lets_ring_rings_on(stiffness: float, mode: str) -> None:
    """Of 500 and 1581 rad/s RK4 at 1 ms would take a tenth, and all, in 1 s: (w h)^6 / 144."""
    rings = gliding(cart(joint=f' stiffness="{stiffness:g}"'), duration=1.0)
    run = afl.simulate_mujoco(rings, idle, mode)
    assert np.abs(run.state[-200:, 1]).max() == pytest.approx(1.0, rel=0.03)
    assert run.provenance["settings"]["asked_timestep"] == 1e-3


@pytest.mark.parametrize("motor", [' forcerange="-1 1"', ' ctrlrange="-1 1"'])
def test_a_limit_of_the_mjcf_s_actuator_is_that_of_the_input_everywhere(motor: str) -> None:
    asked = afl.Requirements(max={"f": 5.0})
    pushed = gliding(cart(motor=motor), initial_state={}, requirements=asked)
    for mode in ("sampled", "exact", "continuous"):
        run = afl.simulate_mujoco(pushed, lambda *_: 10.0, mode)
        assert run.state[-1, 0] == pytest.approx(0.5) and set(run.input.tolist()) == {1.0}
        assert set(run.command.tolist()) == {10.0}
    (row,) = afl.run_all(lambda *_: 10.0, pushed)
    assert (row.failure, row.metrics["max_f"], row.metrics["max_command"]) == ("", 1.0, 10.0)


def test_limits_that_cannot_be_read_or_are_of_a_joint_are_refused_and_a_gain_turns_them() -> None:
    plant = cart(motor=' forcerange="a b"')
    with pytest.raises(afl.AflMujocoError, match="cannot be parsed"):
        afl.simulate_mujoco(gliding(plant), idle)
    weak = cart(motor=' forcerange="-1 3" gainprm="-2"').model.replace("motor", "general")
    assert replace(plant, model=weak).limits.tolist() == [[-1.5, 0.5]]
    limited = cart(joint=' actuatorfrcrange="-1 1"')
    limited = replace(limited, accelerations=lambda q, v, u, p: (u[0],))
    for simulate in (afl.simulate_mujoco, afl.simulate_ode, afl.simulate_ode_held):
        with pytest.raises(InvalidValueError, match="<joint 'x' actuatorfrcrange> would limit inp"):
            simulate(gliding(limited), idle)


def test_a_run_starts_within_the_range_of_the_mjcf_wherever_it_is_started() -> None:
    """MuJoCo would throw it back."""
    ranged = cart(joint=' range="-0.2 0.3"')
    out = gliding(ranged, initial_state={"x": 0.4})
    drawn = gliding(ranged, ranges={"x": (0.0, 0.4)})
    said = r"^initial_state x must lie within its range in the MJCF, -0.2 to 0.3 m, got 0.4 m$"
    for start in (
        lambda: afl.simulate_mujoco(out, idle), lambda: afl.simulate_mujoco(out, idle, "exact"),
        lambda: afl.run_all(idle, out), lambda: afl.load(out).reset(),
        lambda: afl.load(drawn, randomize=True),
    ):  # fmt: skip
        with pytest.raises(InvalidValueError, match=said):
            start()
    steps = afl.Imperfections(encoder_step={"x": 0.21})  # a draw may lie half a step beyond
    afl.simulate_mujoco(replace(out, imperfections=steps), idle)


def test_an_end_stop_beyond_the_range_of_the_mjcf_leaves_that_range() -> None:
    ranged = cart(joint=' range="-0.2 0.3"')
    for stop, reached in ((1.0, 0.3), (0.1, 0.1)):
        rail = afl.Imperfections(end_stops={"x": stop})
        run = afl.simulate_mujoco(gliding(ranged, imperfections=rail), idle)
        assert reached < run.state[:, 0].max() < reached + 0.02


def test_a_jump_that_keeps_momenta_is_not_said_to_keep_velocities() -> None:
    parameters = {"m": afl.Parameter(1.0, low=0.1, high=9.0, rate="frozen", jump="momenta")}
    plant = replace(cart(), parameters=parameters, write=lambda p: {"body cart mass": p.m})
    scenario = gliding(plant, schedule={"m": afl.staircase((0.5,), (1.0, 2.0))})
    said = remarks_on(afl.simulate_mujoco(scenario, idle), scenario, as_controller(idle))
    assert not any("velocities stay" in one for one in said)


def test_a_rail_is_drawn_of_slides_that_are_fixed_in_the_world_alone() -> None:
    slide, hinge = '<joint name="s" type="slide" axis="1 0 0"/>', '<joint name="h" axis="0 1 0"/>'
    fixed, turns = (slide + hinge, ("s", "h"), "", [0]), (hinge + slide, ("h", "s"), "", [])
    for joints, names, mount, railed in (fixed, turns, (slide, ("s",), '<body pos="0 0 1">', [0])):
        tree = f'{mount}<body>{joints}<geom size=".1"/></body>{"</body>" if mount else ""}'
        model = f"<mujoco><worldbody>{tree}</worldbody></mujoco>"
        plant = afl.Plant(name="tree", model=model, coordinates=names)
        scenario = afl.Scenario(name="s", plant=plant)
        found = tracks(scenario, SimulatedModel(plant), np.array([0.0, -1.0, 0.0]))
        assert [one.coordinate for one in found] == railed
