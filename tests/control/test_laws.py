"""A controller along a segment is the controller at each of its instants."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.control.controller import Laws, command
from afl_mujoco.control.own import PythonController
from afl_mujoco.simulation.bound_controllers import bound

EXAMPLES = Path(__file__).parents[2] / "examples"
RAMPS = {
    "load": afl.piecewise_linear((0.1, 1.3), (0.01, 0.09)),
    "length": afl.piecewise_linear((0.2, 1.1), (0.45, 0.8)),
}


def test_gains_along_ramps_are_those_of_the_parameters_of_each_instant() -> None:
    given = afl.load_scenario(EXAMPLES / "quadrotor_load.toml")
    asked = afl.Requirements(target={"z": 1.0}, max={"pitch": 0.5, "left": 12.0, "right": 12.0})
    what = {"plant": given.plant, "schedule": RAMPS, "requirements": asked, "duration": 2.0}
    scenario = afl.Scenario(name="ramps", **what)
    controller = bound(afl.CONTROLLERS["lqr"], scenario)
    state, found = np.linspace(-0.3, 0.4, 8), np.empty(2)
    pieces = []
    for segment in scenario.segments:
        law = Laws(controller, scenario).along(segment)
        pieces.append(len(law.rows))
        for time in np.linspace(segment.start, segment.end, 23):
            values = segment.values_at(time)
            command(law, time, state, values.copy(), found)
            np.testing.assert_allclose(found, controller.command(time, state, values), rtol=1e-12)
    assert min(pieces) == 1 < max(pieces)  # both constant and cut at nodes


@pytest.mark.parametrize("simulate", [afl.simulate_ode, afl.simulate_ode_held], ids=["ode", "held"])
def test_what_a_controller_raises_in_a_compiled_loop_is_raised(simulate) -> None:
    def fails(time, state, belief):
        if time > 0.1:
            raise LookupError("no gains")
        return 0.0

    with pytest.raises(afl.AflMujocoError, match=r"raised LookupError at t = 0.1.* no gains"):
        simulate("nominal", PythonController(name="fails", function=fails))


def test_a_ctrl_c_in_a_compiled_loop_or_before_the_first_line_of_a_callback_ends_it() -> None:
    called = []

    def interrupted(time, state, belief):
        called.append(time)
        raise KeyboardInterrupt

    controller = PythonController(name="interrupted", function=interrupted, stateful=False)
    with pytest.raises(KeyboardInterrupt):
        afl.simulate_ode_rk4("nominal", controller)
    assert len(called) == 1
    """The interpreter looks for one where a function begins; ctypes would print it and go on."""
    scenario = afl.SCENARIOS["nominal"]
    controller = PythonController(name="still", function=lambda t, x, b: 0.0, stateful=False)
    with pytest.raises(KeyboardInterrupt), Laws(controller, scenario).watched():
        sys.unraisablehook(SimpleNamespace(exc_value=KeyboardInterrupt()))  # type: ignore[arg-type]
