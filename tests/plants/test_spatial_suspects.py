"""Mistakes about an arm in space, named; its equations are MuJoCo's own, of another MJCF."""

import mujoco
import numpy as np
import pytest

import afl_mujoco as afl

RIGHT = """<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>
<body name="base" pos="0 0.1 0.3" euler="0.5 0 0"><joint name="yaw" axis="0 0 1" damping="0.1"/>
<inertial pos="0.02 0.01 0.05" mass="1.5" diaginertia="0.03 0.032 0.014"/>
<body name="arm" pos="0.1 0.05 0.2"><joint name="pitch" axis="0 1 0" pos="0.03 0 0.01" ref="0.4"/>
<inertial pos="0.15 0.02 0.04" euler="0 0.3 0" mass="0.7" diaginertia="0.002 0.006 0.0065"/>
<body name="tip" pos="0.3 0 -0.05"><joint name="spin" axis="1 0 0"/>
<inertial pos="0.01 0.03 0" mass="0.2" fullinertia="0.005 0.006 0.007 0.001 0.002 -0.001"/>
</body></body></body></worldbody><actuator>
<motor name="a" joint="yaw"/><motor name="b" joint="pitch"/></actuator>
</mujoco>"""


def terms_of(text: str):
    model = mujoco.MjModel.from_xml_string(text)
    data, mass = mujoco.MjData(model), np.empty((3, 3))

    def terms(q, v, p):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        return mass.copy(), data.qfrc_bias - data.qfrc_passive, np.eye(3)[:, :2]

    return terms


def headline(text: str, terms) -> str:
    names = {"coordinates": ("yaw", "pitch", "spin"), "inputs": ("a", "b")}
    return afl.check(afl.Plant(name="arm", model=text, terms=terms, **names), samples=60).headline


EQUATIONS = {
    "base turned back": ('euler="0.5 0 0"', 'euler="-0.5 0 0"',
        "the orientation of the frame of body base is turned back in the equations"),
    "base not turned": ('euler="0.5 0 0"', "",
        "the orientation of the frame of body base is missing in the equations"),
    "inertia not turned": ('euler="0 0.3 0"', "",
        "the orientation of the inertia of body arm is missing in the equations"),
    "inertias exchanged": ("0.002 0.006 0.0065", "0.006 0.002 0.0065",
        "the inertias of body arm about its x and y are exchanged in the equations"),
    "signs of products": ("0.001 0.002 -0.001", "-0.001 -0.002 0.001",
        "the products of inertia of body tip have the other sign in the equations"),
    "no products": (" 0.001 0.002 -0.001", " 0 0 0",
        "the products of inertia of body tip are missing in the equations"),
    "x for y": ('pos="0.15 0.02 0.04"', 'pos="0.02 0.15 0.04"',
        "x and y of the centre of mass of body arm are exchanged in the equations"),
    "sign of y": ('pos="0.15 0.02 0.04"', 'pos="0.15 -0.02 0.04"',
        "y of the centre of mass of body arm has the other sign in the equations"),
    "sign of a place": ('pos="0.3 0 -0.05"', 'pos="0.3 0 0.05"',
        "z of the place of body tip has the other sign in the equations"),
    "axis": ('axis="0 1 0"', 'axis="1 0 0"', "the axis of pitch is [1, 0, 0] in the equations"),
    "anchor": ('pos="0.03 0 0.01" ', "", "the anchor of pitch is missing in the equations"),
    "ref": (' ref="0.4"', "", "the ref of pitch is missing in the equations"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", EQUATIONS)
def test_a_mistake_of_the_equations_is_named(mistake: str) -> None:
    right, wrong, words = EQUATIONS[mistake]
    assert right in RIGHT
    said = headline(RIGHT, terms_of(RIGHT.replace(right, wrong)))
    assert words in said and said.count(", or ") <= 1, said


def test_an_inertia_about_the_joint_is_named_whatever_the_axes_of_the_body() -> None:
    model = mujoco.MjModel.from_xml_string(RIGHT)
    turn, arm = np.empty(9), np.array([0.12, 0.02, 0.03])  # from the joint
    mujoco.mju_quat2Mat(turn, model.body("arm").iquat)
    turn = turn.reshape(3, 3)
    whole = turn * model.body("arm").inertia @ turn.T
    whole += 0.7 * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    full = " ".join(map(repr, whole[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist()))
    own = 'euler="0 0.3 0" mass="0.7" diaginertia="0.002 0.006 0.0065"'
    assert own in RIGHT
    said = headline(RIGHT, terms_of(RIGHT.replace(own, f'mass="0.7" fullinertia="{full}"')))
    assert "inertia about another point: the equations have I + m r^2 of body arm" in said


def test_an_mjcf_in_degrees_exchanged_rates_and_terms_of_a_spinning_body_are_named() -> None:
    said = headline(RIGHT.replace('<compiler angle="radian"/>', ""), terms_of(RIGHT))
    assert "angles of the MJCF are in degrees" in said
    usual = terms_of(RIGHT)
    said = headline(RIGHT, lambda q, v, p: usual(q, v[[1, 0, 2]], p))
    assert "the rates of yaw and pitch are exchanged in the equations" in said

    def without(q, v, p):
        mass, _, inputs = usual(q, v, p)
        spin = v * (0, 0, 1)
        still = [usual(q, x, p)[1] for x in (v - spin, spin, 0.0 * v)]
        return mass, still[0] + still[1] - still[2], inputs

    assert "mixed velocity terms with spin_dot is missing" in headline(RIGHT, without)
