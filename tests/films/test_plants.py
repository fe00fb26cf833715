from dataclasses import replace

import mujoco
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import afl_mujoco as afl
from afl_mujoco.control.own import PythonController
from afl_mujoco.films.picture import _columns, _numbers, _plot, draw_plots
from afl_mujoco.films.replay import record
from afl_mujoco.films.scene import Frame, Stage, pose
from afl_mujoco.films.video import make_films, side_by_side
from afl_mujoco.scenario.time_steps import Deployed
from afl_mujoco.simulation.drawing import LIMIT, STOP, add_forces, add_tracks, drawn_model
from tests.plants.plants import known

FPS = 20
SIZE = (640, 360)
RUNS = {
    "cart-pole": {"initial_state": {"phi": 0.8},
        "schedule": {"half_length": afl.staircase((0.5,), (0.3, 1.0))}},
    "quadrotor_load.py:plant": {"initial_state": {"x": -0.6, "z": 0.3, "cable": 0.3},
        "schedule": {"load": afl.staircase((0.5,), (0.02, 0.3)), "length": 0.7},
        "imperfections": afl.Imperfections(input_limit=12.0, delay=0.02)},
    "cart_double_pendulum.py:plant": {"initial_state": {"cart": 0.2, "lower": 0.05},
        "schedule": {"payload": afl.staircase((0.5,), (0.05, 0.15))}},
}  # fmt: skip


def scenario_of(name: str) -> afl.Scenario:
    return afl.Scenario(name="short", plant=known(name), duration=1.0, **RUNS[name])


def still(plant: afl.Plant) -> PythonController:
    nothing = np.zeros(len(plant.inputs))
    return PythonController(name="still", plant=plant, function=lambda t, x, p: nothing)


def segments(stage, renderer, replay, index, path):
    stage.draw(renderer, replay, index, path)
    renderer.enable_segmentation_rendering()
    try:
        return renderer.render()
    finally:
        renderer.disable_segmentation_rendering()


def seen(stage, renderer, replay) -> np.ndarray:
    found, model = [], stage.model.mj_model
    for index in range(len(replay.time)):
        picture = segments(stage, renderer, replay, index, stage.paths[0])
        geoms = picture[..., 1] == mujoco.mjtObj.mjOBJ_GEOM
        which = np.where(geoms, picture[..., 0], 0)
        places = np.argwhere(geoms & (model.body_weldid[model.geom_bodyid][which] > 0))
        assert len(places)
        found += [places.min(axis=0), places.max(axis=0)]
    return np.concatenate([np.min(found, axis=0), np.max(found, axis=0)])


@pytest.mark.slow
@pytest.mark.parametrize("falls", [False, True], ids=["stands", "falls"])
@pytest.mark.parametrize("name", RUNS)
def test_everything_that_moves_stays_in_the_frame(graphics, name, falls):
    scenario, frame = replace(scenario_of(name), duration=2.0), Frame()
    controller = still(scenario.plant) if falls else afl.CONTROLLERS["lqr"]
    replay = record(scenario, controller, Deployed(), 4)
    stage = Stage.of([replay], 4, SIZE, frame)
    with mujoco.Renderer(stage.model.mj_model, *SIZE[::-1]) as renderer:
        top, left, bottom, right = seen(stage, renderer, replay)
    width, height = SIZE
    assert top >= frame.top * height - 2 and bottom <= (1.0 - frame.bottom) * height + 2
    assert left >= frame.side * width - 2 and right <= (1.0 - frame.side) * width + 2
    across = (right - left) / (1.0 - 2.0 * frame.side) / width
    upright = (bottom - top) / (1.0 - frame.top - frame.bottom) / height
    if not falls:  # else the camera follows
        assert max(across, upright) > 0.75  # boxes around what is round take the rest


@pytest.mark.parametrize(("name", "beside"), [*zip(RUNS, (1, 3, 3), strict=True)])
def test_a_film_of_any_plant_is_made(graphics, name, beside, tmp_path):
    scenario = replace(scenario_of(name), duration=0.2)
    controllers = [afl.CONTROLLERS["lqr"], still(scenario.plant)]
    controllers.append(replace(controllers[1], name="idle"))
    film = side_by_side(scenario, controllers[:beside], size=SIZE, fps=FPS)
    (file,) = make_films([film], tmp_path)
    assert file.stat().st_size > 1000


def test_the_ghost_is_the_loop_without_imperfections_by_the_equations():
    scenario, lqr = scenario_of("quadrotor_load.py:plant"), afl.CONTROLLERS["lqr"]
    held = replace(scenario.imperfections, control_period=0.01)  # is one of them
    scenario = replace(scenario, imperfections=held)
    replay = record(scenario, lqr, Deployed().on(scenario), FPS)
    run = afl.simulate_ode(scenario.ideal, lqr)
    kept = np.searchsorted(run.time, replay.time - 1e-9)
    np.testing.assert_allclose(replay.ideal, run.state[kept], atol=1e-12)
    assert not np.array_equal(replay.state, replay.ideal)
    unknown = replace(scenario, plant=replace(scenario.plant, accelerations=None, terms=None))
    assert record(unknown, lqr, Deployed().on(unknown), FPS).ideal is None


def test_curves_have_the_plant_s_names_and_units_also_of_what_changes_after_a_run(monkeypatch):
    scenario = scenario_of("cart_double_pendulum.py:plant")
    replay = record(scenario, afl.CONTROLLERS["lqr"], Deployed(), FPS)
    replay.state[0, 1] = -1e-3
    names, numbers = zip(*replay.readouts(0), strict=True)
    assert "-0.00" not in numbers
    words = ["payload [kg]", "force [N]", "cart [m]", "lower [rad]", "upper [rad]"]
    assert [*names] == ["t [s]", *words, *(f"|Δ{word.replace(' ', '| ')}" for word in words[2:])]
    labels, named = [], "matplotlib.axes.Axes.set_ylabel"
    monkeypatch.setattr(named, lambda self, text, **more: labels.append(text))
    draw_plots([replay, replay], (320, 180))
    assert labels == [*words[2:], words[1], words[0]]
    scenario = afl.Scenario(name="two", schedule={"cart_mass": afl.staircase([2.0], [1.0, 1.6])},
                            initial_state={"phi": 0.3}, duration=2.5)  # fmt: skip
    falls = PythonController(name="falls", function=lambda time, state, belief: 0.0)
    both = [record(scenario, one, Deployed(), FPS) for one in (falls, afl.CONTROLLERS["lqr"])]
    assert both[0].end < 2.0 and not both[0].changing
    seen, plot = [], Axes.plot
    monkeypatch.setattr(Axes, "plot", lambda *xy, **how: seen.append(xy[2]) or plot(*xy, **how))
    draw_plots(both, (320, 180))
    assert "cart_mass [kg]" in labels
    steps = [one.run.inputs[:, 0].tolist() for one in both]  # between two frames a force may peak
    assert [seen[k].tolist() for k in (2, 5)] == steps and len(seen[6]) == len(both[1].run.time)
    weak = replace(scenario, initial_state={"phi": -1.4},
                   imperfections=afl.Imperfections(input_limit=4.0))  # fmt: skip
    fallen = record(weak, afl.CONTROLLERS["lqr"], Deployed(), FPS)
    axes, _ = _plot(Figure(), [fallen], fallen.end)
    assert axes[2].get_ylim() == pytest.approx((-4.4, 4.4))  # though it falls at once
    for most, places in (
        (300.0, 1),
        (3.0, 2),
        (0.05, 3),
        (1e-3, 4),
        (3e-5, 2),
        (1e-17, 2),
        (0.0, 2),
    ):
        replay.state[:, 0] = np.linspace(0.0, -most, len(replay.time))
        assert dict(replay.readouts(-1))["cart [m]"] == f"{-most:+z.{places}f}"


SLIDER = """<mujoco><worldbody>{first}<body name="b">
<joint name="x" type="slide" axis="1 0 0" ref="{ref}"/>
<geom type="box" size=".1 .1 .1" pos="{at} 0 0" mass="1"/></body></worldbody>
<actuator><general name="pull" joint="x" gainprm="-3"/></actuator></mujoco>"""
WHEEL = """<body name="a" pos="0 1 0"><joint name="turn"/><geom size=".1" mass="1"
 contype="0" conaffinity="0"/></body>"""


@pytest.mark.parametrize(("ref", "at", "here", "first"), [
    (0.0, 0.3, 0.6, ""), (0.5, 0.0, -0.9, ""), (0.0, 0.3, 0.6, WHEEL),
], ids=str)  # fmt: skip
def test_end_stops_stand_where_what_moves_touches_them(ref, at, here, first):
    plant = afl.Plant(name="slider", model=SLIDER.format(ref=ref, at=at, first=first),
                      coordinates=("turn", "x") if first else ("x",), inputs=("pull",))  # fmt: skip
    scenario = afl.Scenario(
        name="s", plant=plant, initial_state={"x": here}, duration=0.2,
        imperfections=afl.Imperfections(end_stops={"x": 1.0}),
        requirements=afl.Requirements(max={"x": 0.8}),
    )  # fmt: skip
    replay = record(scenario, still(plant), Deployed(), FPS)
    stage = Stage.of([replay], FPS, SIZE, Frame())
    pose(stage.model, replay, 0)
    m, d = stage.model.mj_model, stage.model.mj_data
    assert d.geom_xpos[-1, 0] == pytest.approx(at + here - ref)  # MuJoCo's own
    scene = mujoco.MjvScene(m, 100)
    add_tracks(scene, stage.model, stage.rails, replay.state[0])
    boxes = scene.geoms[: scene.ngeom]
    stops, limits = (sorted(float(g.pos[0]) for g in boxes if np.allclose(g.rgba, colour))
                     for colour in (STOP, LIMIT))  # fmt: skip
    thick = 0.015 * m.stat.extent
    np.testing.assert_allclose(stops, [at - ref - 1.1 - thick, at - ref + 1.1 + thick], atol=1e-6)
    np.testing.assert_allclose(limits, [-ref - 0.8, -ref + 0.8], atol=1e-6)


def test_readouts_stand_where_they_stood_in_a_film():
    scenario = afl.Scenario(name="long", initial_state={"phi": 0.1}, duration=11.0)
    replay = record(scenario, afl.CONTROLLERS["lqr"], Deployed(), FPS)
    for width, count in ((640, 6), (290, 2)):  # t = 10.00 is longer than 9.90
        columns = _columns(replay, width, 1.0)
        for index in range(len(replay.time)):
            texts = _numbers(replay, index, columns, (width, 360), 1.0, False)
            assert [one.x for one in texts[::2]] == columns and len(columns) == count


@pytest.mark.parametrize("within", [False, True])
def test_an_arrow_points_where_the_drive_pushes(within):
    model = SLIDER.format(ref=0, at=0, first="")
    if within:  # what the slide moves is drawn of a body in its own
        model = model.replace("<geom", "<body><geom").replace("</body>", "</body></body>")
    plant = afl.Plant(name="slider", model=model, coordinates=("x",), inputs=("pull",))
    model = drawn_model(afl.Scenario(name="s", plant=plant))
    model.mj_data.ctrl[0] = 2.0
    mujoco.mj_forward(model.mj_model, model.mj_data)
    scene = mujoco.MjvScene(model.mj_model, 10)
    add_forces(scene, model, np.array([2.0]), np.zeros(2))
    (arrow,) = scene.geoms[: scene.ngeom]
    assert np.sign(arrow.mat[0, 2]) == np.sign(model.mj_data.qacc[0]) == -1.0
    assert arrow.pos[0] == pytest.approx(-0.1)  # from the side of the box on


@pytest.mark.parametrize(("coordinate", "ghost"), [("phi", False), ("z", True)])
def test_there_is_no_ghost_of_what_the_equations_cannot_say(coordinate, ghost):
    push = afl.ForcePulse(force=0.1, start=0.101, duration=0.01, coordinate=coordinate)
    scenario = afl.Scenario(name="s", disturbances=(push,), duration=0.4)
    replay = record(scenario, afl.CONTROLLERS["adaptive"], Deployed(), FPS)
    assert (replay.ideal is not None) == ghost
    seen = replay.channels.any(axis=1)
    assert seen.sum() == 5 and not seen[:3].any()  # 0.25 s, though it lies between two frames
