"""The examples by which the public face is agreed on, word for word: outside checks run them."""

import afl_mujoco as afl

FURUTA = """<mujoco><worldbody><body name="arm"><joint name="arm" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".005" mass=".05"/>
<body name="pole" pos=".2 0 0"><joint name="pole" axis="1 0 0"/><geom name="pole" size=".004 .15"
type="capsule" pos="0 0 .15" mass=".13"/></body></body></worldbody>
<actuator><motor name="motor" joint="arm"/></actuator></mujoco>"""

FILE = f'''
import afl_mujoco as afl

def write(p):
    return {{"body pole": afl.rod(mass=p.pole_mass, length=0.3, axis="z")}}

plant = afl.Plant(
    name="furuta",
    model="""{FURUTA}""",
    coordinates=("arm", "pole"),
    inputs=("motor",),
    parameters={{"pole_mass": afl.Parameter(0.13, "kg", low=0.05, high=0.3)}},
    write=write,
    upright=(0.0, 0.0),
    wraps=("pole",),
)
'''

SCENARIO = """
plant = "furuta.py:plant"
duration = 10.0
initial_state = { pole = 0.12 }
[schedule]
pole_mass = { shape = "staircase", times = [2.0], values = [0.13, 0.2] }
[[disturbances]]
shape = "pulse"
force = 0.5
start = 3.0
duration = 0.1
[imperfections]
control_period = 0.005
delay = 0.004
noise = { pole = 5e-4, pole_dot = 5e-3 }
encoder_step = { pole = 0.0015 }
damping = { arm = 1e-3 }
end_stops = { arm = 2.0 }
[belief]
pole_mass = { value = "true", error = 0.1 }
[requirements]
completes = true
target = { arm = 0.0 }
ends_at = { pole = 1.5708 }
max = { arm = 1.0, motor = 4.0, motor_command = 5.0 }
end_stops_allowed = false
settling_time = 3.0
recover_within = 2.0
bands = { arm = 0.05, pole = 0.02 }
[ranges]
pole_mass = [0.1, 0.2]
pole = [-0.2, 0.2]
"""


def test_the_scenario_in_python_is_made_and_runs():
    sc = afl.Scenario(name="own", duration=8.0, initial_state={"phi": 0.2},
        schedule={"cart_mass": afl.staircase([5.0], [8.0, 10.0]), "half_length": 1.5,
                  "pole_mass": 0.2},
        disturbances=(afl.ForcePulse(force=30.0, start=6.0, duration=0.2),
                      afl.Impulse(momentum=1.0, time=7.0)),
        imperfections=afl.Imperfections(control_period=0.01, delay=0.004,
            noise={"phi_dot": 5e-3}, encoder_step={"phi": 0.0015}, input_limit=60.0,
            end_stops={"z": 1.0}, seed=1),
        requirements=afl.Requirements(max={"z": 1.0, "force": 250.0},
                                      settling_time=6.0))  # fmt: skip
    assert afl.simulate_mujoco(sc, "lqr").outcome.kind == "completed"


def test_the_scenario_of_a_plant_of_one_s_own_is_read_and_runs(tmp_path):
    (tmp_path / "furuta.py").write_text(FILE)
    (tmp_path / "furuta.toml").write_text(SCENARIO)
    scenario = afl.load_scenario(tmp_path / "furuta.toml")
    assert scenario.requirements.settling_time == 3.0 and scenario.ends_at == {"pole": 1.5708}
    run = afl.simulate_mujoco(scenario, lambda t, x, belief: 0.0)
    assert run.outcome.kind == "fell" and run.provenance["settings"]["control_period"] == 0.005
