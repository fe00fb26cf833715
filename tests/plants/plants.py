"""Plants for tests: a small one whose text is varied, and those of the examples."""

import math
from pathlib import Path

from afl_mujoco.plants.plant import Parameter, Plant, load_plant

EXAMPLES = Path(__file__).parents[2] / "examples"

OWN = ("cart_double_pendulum", "quadrotor_load", "double_pendulum")
NAMES = ("cart-pole", *(f"{name}.py:plant" for name in OWN))

SMALL = '''
from math import cos, sin
import afl_mujoco as afl

XML = """<mujoco><compiler angle="radian"/><worldbody>
<geom name="floor" type="plane" size="1 1 .1" contype="0" conaffinity="0"/>
<body name="arm"><joint name="arm" axis="0 1 0"/>
<inertial pos="0 0 .2" mass="1" diaginertia=".1 .1 .1"/>
<geom name="arm" type="capsule" size=".02 .1" pos="0 0 .2" contype="0" conaffinity="0"/>
<body name="tip" pos="0 0 .4"><joint name="tip" axis="1 0 0"/>
<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>
<site name="end" pos="0 0 .2"/></body></body></worldbody>
<actuator><motor name="torque" joint="arm"/></actuator></mujoco>"""


def write(p):
    return {"body arm": afl.rod(mass=p.mass, length=p.length), "body tip pos 2": p.length,
            "geom arm size 1": p.length / 2, "geom arm pos 2": p.length / 2}


plant = afl.Plant(
    name="small", model=XML, coordinates=("arm", "tip"), inputs=("torque",), write=write,
    parameters={"mass": afl.Parameter(1.0, "kg", low=0.5, high=2.0),
                "length": afl.Parameter(0.4, "m", low=0.2, high=0.8)},
)
'''


PENDULUM = Plant(
    name="pendulum", coordinates=("angle",), inputs=("torque",), upright=(math.pi,),
    wraps=("angle",),
    model="""<mujoco><worldbody><body name="rod"><joint name="angle" axis="0 1 0"/>
      <inertial pos="0 0 -.3" mass="1" diaginertia=".01 .01 .01"/></body></worldbody>
      <actuator><motor name="torque" joint="angle"/></actuator></mujoco>""",
)  # fmt: skip


def varied(folder: Path, *changes: tuple[str, str], name: str = "small") -> str:
    """Write the small plant with some of its text changed; return what names it."""
    text = SMALL
    for old, new in changes:
        assert text.count(old) >= 1, old
        text = text.replace(old, new)
    (folder / f"{name}.py").write_text(text)
    return f"{name}.py:plant"


def equations(body: str, name="accelerations", arguments="q, v, u, p") -> tuple[str, str]:
    plant = "plant = afl.Plant(\n"
    return plant, f"def {name}({arguments}):\n    {body}\n\n{plant}    {name}={name},\n"


def small(folder: Path, *changes: tuple[str, str]) -> Plant:
    return load_plant(varied(folder, *changes), folder)


def known(name: str) -> Plant:
    return load_plant(name, EXAMPLES)


CART = """<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"{joint}/>
  <inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body></worldbody>
  <actuator><motor name="f" joint="x"{motor}/></actuator></mujoco>"""


def cart(field: str = "", nominal: float = 0.0, joint: str = "", motor: str = "") -> Plant:
    mu = {"mu": Parameter(nominal, low=0.0, high=5000.0)} if field else {}
    return Plant(
        name="cart", model=CART.format(joint=joint, motor=motor), coordinates=("x",), inputs=("f",),
        parameters=mu, write=(lambda p: {f"joint x {field}": p.mu}) if field else None,
    )  # fmt: skip


def idle(time, state, belief):
    return 0.0
