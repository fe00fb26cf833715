"""What a page replays: the poses of MuJoCo, seen across the plane in which a plant moves."""

import base64
from pathlib import Path

import mujoco
import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.simulation import drawing
from afl_mujoco.simulation.drawing import FPS, replay_data
from tests.plants.plants import known

QUADROTOR = Path("examples/quadrotor_load.xml")
LENGTHS = afl.piecewise_linear((1.0, 2.0), (0.5, 0.8))


def decode(text: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(-1, *shape)


def moving(time: np.ndarray, *rows) -> tuple[np.ndarray, np.ndarray]:
    q = np.stack([np.broadcast_to(row, time.shape) for row in rows], -1)
    return time, np.concatenate([q, 0.0 * q], axis=1)


def flight(duration: float = 3.0):
    what = {"schedule": {"length": LENGTHS}, "requirements": afl.Requirements(max={"z": 0.4})}
    plant = known("quadrotor_load.py:plant")
    scenario = afl.Scenario(name="reel", plant=plant, duration=duration, **what)
    time = np.linspace(0.0, duration, 500)
    fast = np.sin(5.0 * time)
    return scenario, {"lqr": moving(time, 0.1 * time, 0.2 * fast, 0.1 * fast, 0.3 * fast)}


def test_poses_are_those_of_a_model_that_is_compiled_with_the_length_of_the_instant() -> None:
    scenario, runs = flight()
    data = replay_data(scenario, runs, {})
    (run,) = data["runs"]
    assert data["shapes"] == ["box", "capsule", "sphere"] and data["fps"] == FPS
    centres, turns = decode(run["centres"], 3, 3), decode(run["turns"], 3, 2, 3)
    sizes = decode(data["sizes"], 3, 3)
    assert len(centres) == len(turns) == len(sizes) == run["frames"] == 3 * FPS + 1
    for frame in (0, 45, 90):
        length = float(LENGTHS(np.array([frame / FPS]))[0])
        text, load = QUADROTOR.read_text(encoding="utf-8"), 'size="0.06" pos="0 0 '
        for old, new in (
            ("0.005 0.25", f"0.005 {length / 2}"), ("0 -0.25", f"0 {-length / 2}"),
            (f'{load}-0.5"', f'{load}{-length}"'),
        ):  # fmt: skip
            assert old in text
            text = text.replace(old, new)
        m = mujoco.MjModel.from_xml_string(text)
        d = mujoco.MjData(m)
        d.qpos[:] = [np.interp(frame / FPS, runs["lqr"][0], x) for x in runs["lqr"][1].T[:4]]
        mujoco.mj_kinematics(m, d)
        np.testing.assert_allclose(centres[frame][:, :2], d.geom_xpos[:, [0, 2]], atol=1e-6)
        rows = d.geom_xmat.reshape(-1, 3, 3)[:, [0, 2]]
        np.testing.assert_allclose(turns[frame], rows, atol=1e-6)
        np.testing.assert_allclose(sizes[frame], m.geom_size, atol=1e-6)
    (change,) = data["changes"]
    assert (change["name"], change["unit"]) == ("length", "m")
    np.testing.assert_allclose(decode(change["values"])[[0, 45, 90]], [0.5, 0.65, 0.8], rtol=1e-6)


def test_limits_of_positions_and_the_rail_are_lines_where_the_joint_reaches_them() -> None:
    found = replay_data(*flight(), {})["lines"]
    assert [(x["words"], x["at"], x["along"]) for x in found] == [
        ("limit", [0.0, -0.4], [-1.0, 0.0]), ("limit", [0.0, 0.4], [-1.0, 0.0]),
    ]  # fmt: skip
    asked, rail = afl.Requirements(max={"z": 1.5, "phi": 0.5}), {"end_stops": {"z": 2.0}}
    what = {"requirements": asked, "imperfections": afl.Imperfections(**rail)}
    scenario = afl.Scenario(name="rail", duration=1.0, **what)
    time = np.linspace(0.0, 1.0, 20)
    found = replay_data(scenario, {"lqr": moving(time, time, 0.1 * time)}, {})["lines"]
    assert [(x["words"], x["at"][0]) for x in found] == [
        ("", 0.0), ("end stop", -2.0), ("end stop", 2.0), ("limit", -1.5), ("limit", 1.5),
    ]  # fmt: skip
    assert found[0]["at"][1] == pytest.approx(-0.2) and found[0]["along"] == [1.0, 0.0]


def test_a_run_that_fell_has_the_frames_until_then_and_says_so() -> None:
    scenario = afl.Scenario(name="fall", duration=4.0)
    whole, short = np.linspace(0.0, 4.0, 50), np.linspace(0.0, 1.01, 30)
    runs = {"lqr": moving(whole, 0.0, 0.0), "fixed": moving(short, short, short)}
    data = replay_data(scenario, runs, {"fixed": "fell at t = 1.01 s"})
    lqr, fixed = data["runs"]
    assert (lqr["frames"], lqr["ended"]) == (4 * FPS + 1, "")
    assert (fixed["frames"], fixed["ended"]) == (int(1.01 * FPS) + 2, "fell at t = 1.01 s")
    assert decode(fixed["centres"], 2, 3)[-1, 0, 0] == pytest.approx(1.01)  # where it ended
    assert len(decode(data["sizes"], 2, 3)) == 1  # nothing changes
    assert lqr["colour"] != fixed["colour"]


@pytest.mark.parametrize("far", [0.5, 15.0], ids=["about where it is", "far away"])
def test_what_moves_is_in_view_at_every_instant(far: float) -> None:
    scenario = afl.Scenario(name="ride", duration=4.0)
    time = np.linspace(0.0, 4.0, 200)
    data = replay_data(scenario, {"lqr": moving(time, far * np.sin(time), 0.4 * time)}, {})
    (run,) = data["runs"]
    aims, middles = decode(run["aims"], 2), decode(run["centres"], 2, 3)[..., :2]
    hinge = middles[:, 0] + [0.0, 0.1]  # the top of the cart
    assert (np.ptp(aims, axis=0).max() == 0.0) == (far < 1.0)  # else it follows
    for points in (hinge, 2.0 * middles[:, 1] - hinge):
        assert (np.abs(points - aims) <= 0.5 * np.array(data["view"])).all()
    assert max(data["view"]) < 6.0  # of a plant of 1 m


def test_a_long_run_has_fewer_frames(monkeypatch) -> None:
    monkeypatch.setattr(drawing, "MOST_NUMBERS", 20_000)
    scenario, time = afl.Scenario(name="long", duration=300.0), np.linspace(0.0, 300.0, 900)
    data = replay_data(scenario, {"lqr": moving(time, np.sin(time), 0.1 * np.sin(time))}, {})
    assert 1.0 < data["fps"] < 8.0 and data["runs"][0]["frames"] * 9 * 2 <= 1.01 * 20_000
