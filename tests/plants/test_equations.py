"""The user's equations: compiled where that gives the interpreter's numbers, and never stale."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import afl_mujoco as afl
from afl_mujoco.plants import equations
from afl_mujoco.plants.equations import Equations, Points, load_equations
from tests.plants import plants
from tests.plants.plants import cart, known, small

ROOT = Path(__file__).parents[2]
STALE = """
import afl_mujoco as afl, constants
from constants import weight
def twice(f):
    return f(2.0)
def accelerations(q, v, u, p):
    return ({},)
plant = afl.Plant(name="x", coordinates=("j",), accelerations=accelerations, model='<mujoco>'
    '<worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody></mujoco>')
"""
LOAD_STALE = """
import numpy as np
from afl_mujoco.plants.plant import load_plant
from afl_mujoco.plants.equations import Points, load_equations
z, none = np.zeros((1, 1)), np.zeros((1, 0))
for i in range(3):
    found = load_equations(load_plant(f"stale{i}.py:plant"), Points(z, z, none, none))
    print(found.at(Points(z, z, none, none))[0, 0], found.how.split(":")[0])
"""


def points(plant: afl.Plant, count: int = 20) -> Points:
    n, rng = len(plant.coordinates), np.random.default_rng(0)
    q, v, u = (rng.uniform(-1, 1, (count, x)) for x in (n, n, len(plant.inputs)))
    return Points(q, v, u, np.tile(plant.nominal, (count, 1)))


def test_compiled_and_interpreted_give_the_same_with_one_key_in_every_process(tmp_path) -> None:
    plant = known("cart_double_pendulum.py:plant")
    found = load_equations(plant, points(plant))
    assert found.how == "compiled"
    slow = Equations(plant, equations._interpreted(plant), "")
    np.testing.assert_allclose(found.at(points(plant)), slow.at(points(plant)), rtol=1e-12)
    # else nothing would be found in the cache
    body = "inner = lambda x: x + 1.0\n    return inner(q[0]), max(x for x in (1.0, 2.0))"
    plant = small(tmp_path, plants.equations(body))
    assert not any(" at 0x" in text for text in equations._read(plant.accelerations, {}))


def test_what_numba_cannot_compile_or_compiles_wrongly_is_interpreted(tmp_path, monkeypatch):
    plant = small(tmp_path, plants.equations("return {'a': [u[0], sin(q[1])]}.pop('a')"))
    found = load_equations(plant, points(plant))
    assert found.how.startswith("interpreted: ")
    np.testing.assert_allclose(found.at(points(plant))[:, 0], points(plant).u[:, 0])
    plant = small(tmp_path, plants.equations("return u[0], q[0]"))

    def wrong(q, v, u, p, out):
        out[:] = 1.0

    monkeypatch.setattr(equations, "_compiled", lambda plant: (wrong, None))
    how = load_equations(plant, points(plant)).how
    assert how == "interpreted: compiled, they give other numbers"


@pytest.mark.slow
def test_a_constant_in_an_imported_module_is_never_stale(tmp_path: Path) -> None:
    folder = tmp_path / "lib" / "python" / "site-packages"  # where nothing is installed
    folder.mkdir(parents=True)
    for i, body in enumerate(("constants.G * 2.0", "weight(2.0)", "twice(constants.weight)")):
        (folder / f"stale{i}.py").write_text(STALE.format(body))
    said = []
    for constant in (2.0, 1.0, 1.0):
        constants = f"G = {constant}\ndef weight(x):\n    return G * x\n"
        (folder / "constants.py").write_text(constants)
        run = subprocess.run(
            [sys.executable, "-c", LOAD_STALE], cwd=folder, capture_output=True, text=True,
            env={"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PATH": "",
                 "PYTHONDONTWRITEBYTECODE": "1"},  # Python's own cache knows no half seconds
        )  # fmt: skip
        assert run.returncode == 0, run.stderr
        said.append([line.split() for line in run.stdout.splitlines()])
    for i, value in enumerate(("4.0", "2.0", "2.0")):
        assert [number for number, _ in said[i]] == [value] * 3
        # of the last, a function as an argument has not been seen by Numba
        assert [how for _, how in said[i][:2]] == ["compiled"] * 2


def test_sympy_expressions_become_terms_that_compile_as_do_functions_that_terms_call() -> None:
    t = sp.Symbol("t")
    q, (u, m) = sp.Function("q")(t), sp.symbols("u m")
    terms = afl.from_sympy([[m]], [u - 3 * q - q.diff(t)], [q], [q.diff(t)], [u], {m: "mass"})
    plant = afl.Plant(
        name="x", coordinates=("j",), inputs=("u",), terms=terms,
        model='<mujoco><worldbody><body name="b"><joint name="j" type="slide" damping="1" '
        'stiffness="3"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>'
        '<actuator><motor name="u" joint="j"/></actuator></mujoco>',
        parameters={"mass": afl.Parameter(1.0, low=0.5, high=2.0)},
        write=lambda p: {"body b mass": p.mass, "option gravity 2": 0.0},
    )  # fmt: skip
    for one in (plant, replace(plant, terms=by_hand)):
        result = afl.check(one, samples=100)
        assert result.passed and result.notes[-1] == "Equations: compiled."


def pull(x):
    return 3.0 * x


def by_hand(q, v, p):
    return ((p.mass,),), (pull(q[0]) + v[0],), ((1.0,),)


@pytest.mark.parametrize(("said", "forcing"), [
    ("forcing must be linear in the inputs", lambda q, v, u: u**2),
    ("symbol must be one of q, v, u, m, got 'k'", lambda q, v, u: u - sp.Symbol("k") * q),
    ("expressions must have a form in Python", lambda q, v, u: u + sp.airyai(q)),
])  # fmt: skip
def test_expressions_that_are_no_terms_are_one_line(said, forcing) -> None:
    q, v, u, m = sp.symbols("q v u m")
    with pytest.raises(afl.AflMujocoError, match=said):
        afl.from_sympy([[m]], [forcing(q, v, u)], [q], [v], [u], [m])
    with pytest.raises(afl.AflMujocoError, match="must be symbols, or a dictionary from symbols"):
        afl.from_sympy([[m]], [u], [q], [v], [u], {"mass": m})


def free(q, v, p):
    return ((p.m,),), (0.0,), ((1.0,),)


def walled(q, v, p):
    return ((p.m,),), (100.0 * (q[0] - 1.5) if q[0] > 1.5 else 0.0,), ((1.0,),)


def test_two_plants_of_one_file_have_equations_of_their_own() -> None:
    """They differ where no point is drawn, so that only their compiled code can tell them apart."""

    mass = {"parameters": {"m": afl.Parameter(1.0)}, "write": lambda p: {"body cart mass": p.m}}
    plants = [replace(cart(), terms=of, **mass) for of in (free, walled)]
    scenarios = [afl.Scenario(name="s", plant=plant, duration=3.0) for plant in plants]
    ends = [afl.simulate_ode(x, lambda *_: 1.0).state[-1, 0] for x in scenarios + scenarios[::-1]]
    assert ends[0] == ends[3] == pytest.approx(4.5)
    assert ends[1] == ends[2] < 1.7


def test_what_turns_at_one_rate_only_has_velocity_terms_that_do_no_work() -> None:
    """A mass matrix of sines and cosines that is constant: only rounding of it is left."""
    plant = afl.Plant(
        name="wheel", coordinates=("a",), parameters={"m": afl.Parameter(1.0, low=0.5, high=2.0)},
        model="""<mujoco><option gravity="0 0 0"/><worldbody><body name="b">
        <joint name="a" axis="0 1 0" stiffness="0.01"/>
        <inertial pos="0 0 -0.5" mass="1" diaginertia="0.1 0.1 0.01"/></body></worldbody>
        </mujoco>""",
        write=lambda p: {"body b mass": p.m},
        terms=lambda q, v, p: (
            ((p.m * ((0.5 * np.cos(q[0])) ** 2 + (0.5 * np.sin(q[0])) ** 2) + 0.1,),),
            (0.01 * q[0],), ((),),
        ),
    )  # fmt: skip
    assert afl.check(plant).passed
