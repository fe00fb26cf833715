"""Friction, damping, end stops, spread of mass: closed forms, and what MuJoCo compiles by hand."""

import mujoco
import numpy as np
import pytest

from afl_mujoco import CartPoleModel, CartPoleParameters
from afl_mujoco.scenario.imperfections import IDEAL, Imperfections
from tests.engine import jump as jump_of

H = 1e-3
HANGING = np.pi
LIGHT = CartPoleParameters(cart_mass=1.37, pole_mass=1e-6, half_length=0.29, gravity=9.65)
"""So light a pole that the cart is alone on its rail."""
HEAVY = CartPoleParameters(cart_mass=1e7, pole_mass=0.083, half_length=0.29, gravity=9.65)
"""So heavy a cart that the pole hangs from a fixed hinge."""

FULL = Imperfections(
    damping={"z": 0.21, "phi": 0.0011}, dry_friction={"z": 0.31, "phi": 0.0007},
    armature={"z": 0.041, "phi": 0.00051}, end_stops={"z": 1.9}, tip_mass_share=0.23,
)  # fmt: skip

PASSIVE = {
    "friction": Imperfections(dry_friction={"z": 0.31}),
    "friction of the hinge": Imperfections(dry_friction={"phi": 0.0007}),
    "stops": Imperfections(end_stops={"z": 1.9}), "everything": FULL,
}  # fmt: skip


def motion(plant, imperfections, state, duration, integrator, force=0.0):
    model = CartPoleModel(plant, imperfections=imperfections, timestep=H, integrator=integrator)
    data, states = model.mj_data, []
    data.qpos[:], data.qvel[:], data.ctrl[0] = state[:2], state[2:], force
    for _ in range(round(duration / H)):
        mujoco.mj_step(model.mj_model, data)
        states.append([*data.qpos, *data.qvel])
    return np.array(states)


def _by_hand(p, r):
    """The same hardware as an MJCF of this test, the bodies of the pole welded by the compiler."""
    s, m, length = r.tip_mass_share, p.pole_mass, p.half_length
    com = (1 - s) * length + s * 2 * length
    about_com = (1 - s) * m * (length**2 / 3 + (com - length) ** 2)
    about_com += s * m * (2 * length - com) ** 2
    friction, hinge_friction = (
        f'frictionloss="{loss!r}" solimpfriction=".9999 .9999 .001 .5 2" solreffriction=".004 1"'
        for loss in (r.at("dry_friction.z"), r.at("dry_friction.phi"))
    )
    rail = r.at("end_stops.z")
    stops = f'range="{-rail!r} {rail!r}" solreflimit=".005 1"'
    return f"""<mujoco><compiler angle="radian" inertiafromgeom="false" autolimits="true"/>
      <option gravity="0 0 {-p.gravity!r}" timestep="0.001" integrator="RK4"/><worldbody>
        <body name="cart"><joint name="z" type="slide" axis="1 0 0" damping="{r.at("damping.z")!r}"
                                 armature="{r.at("armature.z")!r}" {friction} {stops}/>
          <inertial pos="0 0 0" mass="{p.cart_mass!r}" diaginertia="1 1 1"/>
          <body name="pole">
            <joint name="phi" type="hinge" axis="0 -1 0" damping="{r.at("damping.phi")!r}"
                   armature="{r.at("armature.phi")!r}" {hinge_friction}/>
            <inertial pos="0 0 {com!r}" mass="{m!r}"
                      diaginertia="{about_com!r} {about_com!r} {0.01 * about_com!r}"/></body></body>
      </worldbody><actuator><motor joint="z"/></actuator></mujoco>"""


def test_the_hardware_model_is_what_the_compiler_makes_of_an_mjcf(odd_parameters, rng):
    model = CartPoleModel(CartPoleParameters(), imperfections=PASSIVE["stops"])
    model.set_imperfections(FULL)
    model.set_parameters(odd_parameters)
    by_hand = mujoco.MjModel.from_xml_string(_by_hand(odd_parameters, FULL))
    dof = "damping armature frictionloss solref solimp M0 invweight0"
    fields = {"dof": dof, "jnt": "limited range solref solimp margin",
              "body": "mass subtreemass ipos"}  # fmt: skip
    for name in [f"{kind}_{x}" for kind, names in fields.items() for x in names.split()]:
        mine, theirs = getattr(model.mj_model, name), getattr(by_hand, name)
        np.testing.assert_allclose(mine, theirs, rtol=1e-12, err_msg=name)
    mine, theirs = model.mj_data, mujoco.MjData(by_hand)
    for state in rng.uniform((-2.5, -3, -3, -5), (2.5, 3, 3, 5), size=(50, 4)):
        for m, d in ((model.mj_model, mine), (by_hand, theirs)):
            mujoco.mj_resetData(m, d)
            d.qpos[:], d.qvel[:], d.ctrl[:] = state[:2], state[2:], 3.0
            mujoco.mj_forward(m, d)
        assert mine.nefc == theirs.nefc > 0
        # the constraint solver's tolerance
        np.testing.assert_allclose(mine.qacc, theirs.qacc, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("before", PASSIVE.values(), ids=PASSIVE)
@pytest.mark.parametrize("after", [IDEAL, PASSIVE["stops"]], ids=["ideal", "stops"])
def test_what_a_model_was_before_leaves_no_trace(before, after, odd_parameters):
    used = CartPoleModel(CartPoleParameters(), imperfections=before)
    used.set_imperfections(after)
    used.set_parameters(odd_parameters)
    fresh = CartPoleModel(odd_parameters, imperfections=after)
    for name in dir(fresh.mj_model):
        array = getattr(fresh.mj_model, name)
        if not name.startswith("_") and isinstance(array, np.ndarray):
            assert getattr(used.mj_model, name).tobytes() == array.tobytes(), name


@pytest.mark.parametrize("integrator", ["RK4", "Euler"])
def test_dry_friction_holds_below_break_away_and_an_end_stop_holds_the_cart(integrator):
    real, still = Imperfections(dry_friction={"z": 2.2}), (0, HANGING, 0, 0)
    assert abs(motion(LIGHT, real, still, 1.0, integrator, force=2.0)[-1, 2]) < 4e-5  # creep
    sliding = motion(LIGHT, real, still, 1.0, integrator, force=3.0)[-1, 2]
    assert sliding == pytest.approx((3.0 - 2.2) / LIGHT.cart_mass, rel=2e-6)
    real = Imperfections(end_stops={"z": 0.3})
    states = motion(LIGHT, real, (0, HANGING, 1.1, 0), 2.0, integrator, force=5.0)
    assert 0.3 < states[:, 0].max() < 0.304  # it gives by a few millimetres at a metre per second
    assert states[-1, 0] == pytest.approx(0.3, abs=2e-5) and abs(states[-1, 2]) < 1e-9


@pytest.mark.parametrize("radius", [0.003, 0.02, 0.5], ids=str)
def test_a_thick_pole_is_the_capsule_of_mujoco_s_compiler(radius, odd_parameters):
    p = odd_parameters
    capsule = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint type="hinge" axis="0 -1 0"/>
        <geom type="capsule" size="{radius} {p.half_length}" mass="{p.pole_mass}"/>
        </body></worldbody></mujoco>"""
    )
    pole = CartPoleModel(p, imperfections=Imperfections(pole_radius=radius)).mj_model.body("pole")
    np.testing.assert_allclose(pole.inertia[:2], capsule.body_inertia[1].max(), rtol=1e-12)
    assert pole.ipos[2] == p.half_length


def test_an_impulse_outruns_friction_and_feels_armature(odd_parameters):
    p = odd_parameters
    real = Imperfections(dry_friction={"z": 5.0}, armature={"phi": 0.01, "z": 0.4})
    phi, impulse = 0.3, 0.21
    coupling = -p.pole_mass * p.half_length * np.cos(phi)
    turning = 4 / 3 * p.pole_mass * p.half_length**2 + 0.01
    mass_matrix = [[p.cart_mass + p.pole_mass + 0.4, coupling], [coupling, turning]]
    model = CartPoleModel(p, imperfections=real)
    jump = jump_of(model, (0.1, phi, 0.0, 0.0), impulse)  # at rest, where friction holds
    np.testing.assert_allclose(jump, np.linalg.solve(mass_matrix, [impulse, 0.0]), rtol=1e-10)
