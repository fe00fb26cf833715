"""Parameters written in place are those of a model compiled afresh."""

import pickle

import mujoco
import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.plants.library import write_row
from afl_mujoco.plants.plant import load_plant
from afl_mujoco.plants.writer import PlantModel
from tests.plants.plants import NAMES, SMALL, known, small, varied

MOTOR = '<motor name="torque" joint="arm"/>'
GEARED = MOTOR.replace("/>", ' gear="3"/>')
LIMITED = '<motor name="torque" joint="arm" ctrlrange="-2 3"/>'
SLIDE = '<joint name="arm" type="slide" axis="0 0 1"/>'
JOINT = '<joint name="arm" axis="0 1 0"/>'
TIP = '<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>'
PRODUCTS = TIP.replace("diaginertia", "fullinertia").replace('.1"/>', '.1 .01 0 0"/>')


def drawn(plant: afl.Plant, count: int) -> np.ndarray:
    low, high = np.array([(x.low, x.high) for x in plant.parameters.values()]).T
    return np.random.default_rng(0).uniform(low, high, (count, len(low)))


@pytest.mark.parametrize("name", NAMES)
def test_in_place_equals_afresh_and_rows_from_arrays_are_those_made_one_by_one(name) -> None:
    plant = known(name)
    model = PlantModel(plant)
    rows = model.rows(drawn(plant, 100))
    model.require(rows)
    model.mj_data.qpos[:] = 0.3
    for row in rows:
        model.write(row)
        assert model.differing(row) == {}
    assert np.all(model.mj_data.qpos == 0.3)  # mj_setConst has its own data
    one_by_one = [model.rows(row)[0] for row in drawn(plant, 7)]
    np.testing.assert_allclose(model.rows(drawn(plant, 7)), one_by_one, rtol=1e-12)


@pytest.mark.parametrize("change", [
    (MOTOR, LIMITED), (MOTOR, LIMITED.replace("/>", ' ctrllimited="false"/>')),
    (MOTOR, '<motor class="weak" name="torque" joint="arm"/>'), (MOTOR, GEARED),
    (MOTOR, '<general class="weak" name="torque" joint="arm" forcerange="-4 4"/>'),
    (JOINT, '<joint class="weak" name="arm" axis="0 0 1"/>'), (JOINT, f"<frame>{SLIDE}</frame>"),
])  # fmt: skip
def test_a_plant_reads_of_its_mjcf_what_the_compiler_does(change, tmp_path) -> None:
    weak = '<joint type="slide"/><general gainprm="9"/><motor ctrlrange="-1 1"/>'
    plant = small(
        tmp_path,
        change,
        ("<worldbody>", f'<default><default class="weak">{weak}</default></default><worldbody>'),
    )
    model = PlantModel(plant).mj_model
    ends = model.actuator_ctrlrange if model.actuator_ctrllimited[0] else [[-np.inf, np.inf]]
    np.testing.assert_array_equal(plant.limits, ends)
    slides = model.jnt_type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    known = abs(model.actuator_gainprm[0, 0] * model.actuator_gear[0, 0]) == 1.0
    assert plant.units["arm"] == ("rad", "m")[slides]
    assert plant.units["torque"] == ("N m", "N")[slides] * bool(known)


def included(folder, deep: int, old: str, new: str) -> afl.Plant:
    for i in range(deep):
        (folder / f"{i}.xml").write_text(f"<mujoco>{new}</mujoco>")
        new = f'<include file="{i}.xml"/>'
    (folder / "whole.xml").write_text(SMALL.split('"""')[1].replace(old, new))
    return small(folder, ("model=XML", f"model={str(folder / 'whole.xml')!r}"))


@pytest.mark.parametrize(("change", "refused"), [
    ((MOTOR, LIMITED), "actuator 'torque' must be in the MJCF.* its ctrlrange or force"),
    ((JOINT, SLIDE), "joint 'arm' must be in the MJCF.* its type is not seen"),
])  # fmt: skip
def test_a_file_of_an_mjcf_is_read_and_a_file_of_a_file_refused(change, refused, tmp_path) -> None:
    plant = included(tmp_path, 1, *change)
    PlantModel(plant)
    limited = change[0] == MOTOR
    assert (plant.limits.tolist() == [[-2.0, 3.0]]) == limited
    assert plant.units["torque"] == ("N m" if limited else "N")
    with pytest.raises(afl.AflMujocoError, match=refused):
        PlantModel(included(tmp_path, 2, *change))


@pytest.mark.parametrize(("least", "target", "changes"), [
    *((0.3, "body arm ipos 2", (("    return {", f"    length = {said}\n    return {{"),
                                ("length=p.length)", "length=length)")))
      for said in ("max(p.length, 0.3)", "0.3 if p.length < 0.3 else p.length")),
    (0.0, "geom arm size 1", (("p.length / 2,", "float(np.sum(p.length)) / 2,"),
                              ("def write", "import numpy as np\n\n\ndef write"))),
])  # fmt: skip
def test_a_write_that_knows_no_arrays_is_called_row_by_row(least, target, changes, tmp_path):
    plant = small(tmp_path, *changes)
    model, p = PlantModel(plant), drawn(plant, 50)
    found = model.rows(p)[:, [str(x) for x in model.targets].index(target)]
    np.testing.assert_array_equal(found, np.maximum(p[:, 1], least) / 2)


MASS = '"body tip mass": p.mass'
FLAGS = '<geom name="stub" size=".1" mass="1"/><geom name="flag" size=".1" mass="{}"/>'
QUIET = ("<worldbody>", '<option><flag contact="disable"/></option><worldbody>')
MOVED = ('"geom arm pos 2"', '"geom flag pos 2": p.mass, "geom arm pos 2"')


@pytest.mark.parametrize(("said", "changes"), [
    ("write must not change p",
     [("    return {", "    p.length = max(p.length, 0.3)\n    return {")]),
    ("^write must return the same for the same p",
     [("p.length / 2,", "p.length / 2 * __import__('random').random(),")]),
    ("a geom that has its mass", [QUIET, (TIP, FLAGS.format(0.1)), MOVED]),
    ("p has mass, length; did you mean length", [("length=p.length", "length=p.lenght")]),
    ("masses that are written would be ignored",
     [('<compiler angle="radian"/>', '<compiler angle="radian" inertiafromgeom="true"/>')]),
])  # fmt: skip
def test_a_write_that_cannot_be_used_is_refused(said, changes, tmp_path) -> None:
    with pytest.raises(afl.AflMujocoError, match=said):
        PlantModel(plant := small(tmp_path, *changes)).rows(drawn(plant, 50))


@pytest.mark.parametrize("name", NAMES)
def test_the_compiled_writer_writes_the_same(name: str) -> None:
    plant = known(name)
    other = PlantModel(plant)
    for row in other.rows(drawn(plant, 3)):
        write_row(other.structures, other.addresses, row)
        assert other.differing(row) == {}


def test_a_file_that_changes_while_it_runs_is_refused_by_another_process(tmp_path) -> None:
    written = pickle.dumps(load_plant(varied(tmp_path), tmp_path))
    varied(tmp_path, ("length=p.length)", "length=0.9 * p.length)"))
    with pytest.raises(afl.AflMujocoError, match="must not change while it runs, but its file did"):
        pickle.loads(written)


@pytest.mark.parametrize(("old", "new", "said"), [
    ("def write(p):", "while True:\n    pass\n\n\ndef write(p):", "small.py must be done within"),
    ("    return {", "    while True:\n        pass\n    return {", "write must be done within"),
    ("write=write,", "write=write, accelerations=endless,", "accelerations must be done within"),
], ids=["file", "write", "equations"])  # fmt: skip
def test_code_that_never_ends_is_refused(old, new, said, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("afl_mujoco.loading.LIMIT", 0.2)
    loop = ("plant = afl", "def endless(*_):\n    while True:\n        pass\n\n\nplant = afl")
    with pytest.raises(afl.AflMujocoError, match=said):
        afl.check(small(tmp_path, (old, new), loop), samples=10)


@pytest.mark.parametrize(("inertial", "written"), [
    (TIP, '"body tip inertia 1": 0.12'), (PRODUCTS, MASS),
    ('<geom size=".1" contype="0" conaffinity="0"/>', MASS),
], ids=["one axis", "products", "of a geom"])  # fmt: skip
def test_the_rest_of_an_inertia_is_that_of_the_mjcf(inertial, written, tmp_path) -> None:
    # a geom without mass may be written without its body
    PlantModel(small(tmp_path, QUIET, (TIP, FLAGS.format(0)), MOVED))
    plant = small(tmp_path, (TIP, inertial), ("    return {", f"    return {{{written}, "))
    model = PlantModel(plant)
    for row in model.rows(drawn(plant, 5)):
        model.write(row)
        assert model.differing(row) == {}
