"""What equations cannot describe is refused with the attribute to set, or said to be left out."""

from dataclasses import replace

import pytest

import afl_mujoco as afl
from afl_mujoco.control.catalogue import digests
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.plants.writer import PlantModel
from tests.plants.plants import small

ARM = '<joint name="arm" axis="0 1 0"/>'
MOTOR = '<motor name="torque" joint="arm"/>'
FRAME = ("</body></body></worldbody>", "</body></frame></body></worldbody>")

REFUSED = {
    "contact of bodies 'world' and 'arm' .*contype": ((' contype="0" conaffinity="0"', ""),),
    "equality constraint .*<equality>": (
        ("</mujoco>", '<equality><joint joint1="arm" joint2="tip"/></equality></mujoco>'),),
    "tendon .*<tendon>": (
        ("</mujoco>", '<tendon><fixed><joint joint="arm" coef="1"/></fixed></tendon></mujoco>'),),
    "activation state .*dyntype": (
        (MOTOR, '<general name="torque" joint="arm" dyntype="filter" dynprm="1"/>'),),
    "servo of actuator 'torque' .*<motor>": (
        (MOTOR, '<position name="torque" joint="arm" kp="1"/>'),),
    "fluid .*density": (("<worldbody>", '<option density="1.2"/><worldbody>'),),
    "joint 'arm' must be .*: free and ball": ((ARM, '<joint name="arm" type="ball"/>'),),
    "mocap body .*mocap": (("</worldbody>", '<body name="m" mocap="true"/></worldbody>'),),
    "flex .*deformable": (
        ("</worldbody>",
         '<flexcomp name="f" type="grid" count="2 2 1" mass="1" radius=".01" rigid="true">'
         '<contact contype="0" conaffinity="0"/></flexcomp></worldbody>'),),
    "armature of actuator 'torque'": ((MOTOR, '<motor name="torque" joint="arm" armature="1"/>'),),
    "switched off group of actuators .*actuatorgroupdisable": (
        ("<worldbody>", '<option actuatorgroupdisable="0"/><worldbody>'),),
    "body 'fixed' must have an <inertial>, .*got geom 'plate'": (
        ("</worldbody>", '<body name="fixed"><geom name="plate" size=".1" contype="0" '
         'conaffinity="0"/></body></worldbody>'),
        ('    return {', '    return {"geom plate size 0": p.length, ')),
    "<compiler inertiafromgeom> must be": (("angle=", 'inertiafromgeom="true" angle='),),
    "<compiler boundmass> must be": (("angle=", 'boundmass="0.01" angle='),),
    "<compiler settotalmass> must be": (("angle=", 'settotalmass="3" angle='),),
    "<compiler balanceinertia> must be": (("angle=", 'balanceinertia="true" angle='),),
    "<inertial fullinertia> of body 'arm' must be": (
        ('<inertial pos="0 0 .2" mass="1" diaginertia=".1 .1 .1"/>',
         '<inertial pos="0 0 .2" mass="1" fullinertia=".1 .1 .1 0 0 0"/>'),),
    "<joint 'arm' springdamper> must be": ((ARM, ARM.replace("/>", ' springdamper="1 1"/>')),),
    "write: body tip pos 2 must be in the model as it is written": (
        ('<body name="tip"', '<frame pos="0 0 .1"><body name="tip"'), FRAME),
    "write: body tip pos 0 must be in the model .* makes it 0.099": (
        ('<body name="tip"', '<frame euler="0 0 .1"><body name="tip"'), FRAME,
        ("    return {", '    return {"body tip pos 0": 0.0 * p.length, ')),
    "sleep cannot .*sleep=": (
        ("<worldbody>", '<option><flag sleep="enable"/></option><worldbody>'),),
    **{f"<flag {name}> must be left out": (
        ("<worldbody>", f'<option><flag {name}="disable"/></option><worldbody>'),)
       for name in ("constraint", "limit", "frictionloss", "damper", "clampctrl")},
}  # fmt: skip


@pytest.mark.parametrize("said", REFUSED)
def test_it_is_refused_in_one_line(said: str, tmp_path) -> None:
    with pytest.raises(afl.AflMujocoError, match=rf"\A.*{said}.*\Z"):
        PlantModel(small(tmp_path, *REFUSED[said]))


def test_a_plant_whose_mjcf_has_changed_is_refused_and_digests_tell_it(tmp_path) -> None:
    plant, inner, outer = small(tmp_path), tmp_path / "arm.xml", tmp_path / "outer.xml"
    whole = str(plant.model)
    inner.write_text(whole)
    outer.write_text('<mujoco><include file="arm.xml"/></mujoco>')

    def made():
        made = replace(plant, model=outer)
        PlantModel(made)
        return made, digests([afl.Scenario(name="own", plant=made)], [])

    (before, one), (_, same) = made(), made()
    inner.write_text(whole.replace('mass="1"', 'mass="2"'))
    assert inner.read_text() != whole
    with pytest.raises(InvalidValueError, match="must be as it was when the plant was made"):
        PlantModel(before)
    assert one == same != made()[1]


@pytest.mark.parametrize(("what", "old", "new"), [
    ("dry friction", ARM, ARM.replace("/>", ' frictionloss="1"/>')),
    ("joint limits", ARM, ARM.replace("/>", ' range="-.1 .1"/>')),
    ("limits of inputs", MOTOR, MOTOR.replace("/>", ' ctrlrange="-.1 .1"/>')),
    ("actuatorfrcrange", ARM, ARM.replace("/>", ' actuatorfrcrange="-.1 .1"/>')),
    ("gravcomp", '<body name="tip"', '<body name="tip" gravcomp="1"'),
    ("implicit integrator", "<worldbody>", '<option integrator="implicitfast"/><worldbody>'),
    ("eulerdamp", ARM, ARM.replace("/>", ' damping=".1"/>')), ("autoreset", ARM, ARM),
])  # fmt: skip
def test_it_is_left_out_and_said_so(what: str, old: str, new: str, tmp_path) -> None:
    result = afl.check(small(tmp_path, (old, new)), samples=50)
    assert result.passed and what in result.notes[0]


def test_geoms_that_cannot_touch_are_no_contact(tmp_path) -> None:
    end = 'size=".02 .1" pos="0 0 .2"'
    neighbours = (f'{end} contype="0" conaffinity="0"/>', f"{end}/>")
    geom = ('<site name="end"', '<geom size=".1"/><site name="end"')
    PlantModel(small(tmp_path, neighbours, geom))  # parent and child
    off = ("<worldbody>", '<option><flag contact="disable"/></option><worldbody>')
    PlantModel(small(tmp_path, (' contype="0" conaffinity="0"', ""), off))
