import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.plants import tree
from afl_mujoco.plants.writer import PlantModel
from afl_mujoco.studies import check as check_study
from afl_mujoco.studies.shared.contract import find_study
from afl_mujoco.studies.shared.record import load_record
from tests.plants.plants import NAMES, equations, known, small, varied

QUAD = "quadrotor_load.py:plant"


def rows(result) -> dict[str, bool]:
    return {one.id: one.passed for one in result.checks}


@pytest.mark.parametrize("name", NAMES)
def test_three_ways_agree_at_a_thousand_points(name: str) -> None:
    result = afl.check(known(name))
    assert result.passed and result.model_verified
    values = {one.id: one.value for one in result.checks}
    assert max(x for id, x in values.items() if id.endswith("accelerations")) < 1e-11
    assert values["mutation"] == values["recompile"] == 0


def test_the_command_checks_the_cart_pole_and_writes_what_it_says(command_line, tmp_path) -> None:
    code, output, errors = command_line("check", "cart-pole", "--samples", "100", "--out", "out")
    assert (code, errors) == (0, "")
    last = output.splitlines()[-1]
    assert last.startswith("PASS: cart-pole: MuJoCo obeys the equations at 100 points, to ")
    content = json.loads((tmp_path / "out" / "check.json").read_text())
    said = (content["verdict"], content["model_verified"], content["headline"])
    assert said == ("pass", True, last.removeprefix("PASS: "))
    assert {"id", "quantity", "value", "limit", "passed"} <= content["checks"][0].keys()
    assert {"coordinate", "term", "q", "v", "u", "p"} <= content["worst"].keys()
    assert content["worst"]["p"].keys() == {"cart_mass", "pole_mass", "half_length", "gravity"}
    assert load_record(find_study("check"), tmp_path / "out").result.headline == content["headline"]
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_plant_that_fails_gives_1_and_names_the_mistake(command_line, tmp_path) -> None:
    spec = varied(tmp_path, equations("return 0.0, 0.0"))
    code, output, _ = command_line("check", spec, "--samples", "50", "--no-page", "--out", "out")
    assert code == 1 and output.splitlines()[-1].startswith("FAIL: small: accelerations, ")
    assert "Not looked at, since terms differ: energy, and models written in place." in output
    content = json.loads((tmp_path / "out" / "check.json").read_text())
    assert (content["verdict"], content["model_verified"]) == ("fail", True)


def test_without_equations_the_model_is_not_verified_and_a_seed_repeats_itself(tmp_path) -> None:
    result = afl.check(small(tmp_path), samples=100)
    assert result.passed and not result.model_verified
    assert result.headline == "small: engine and mutation verified; model not: no equations"
    assert str(result).splitlines()[-1] == f"PASS: {result.headline}"
    one, two, other = (afl.check(known(NAMES[2]), 50, seed=x) for x in (1, 1, 2))
    assert one == two != other and repr(one) == f"<{one.headline}>"


def test_points_are_drawn_in_the_box_and_the_ranges_of_the_mjcf(command_line, tmp_path):
    asked = ("--samples", "20", "--box", "phi", "-0.5", "0.5", "phi_dot", "0", "1", "--out", "out")
    code, output, _ = command_line("check", "cart-pole", *asked)
    drawn = "z -1 to 1, phi -0.5 to 0.5, z_dot -2 to 2, phi_dot 0 to 1, force -10 to 10"
    assert code == 0 and drawn in " ".join(output.split())
    limited = ('joint="arm"/>', 'joint="arm" ctrlrange="-.5 .5"/>')
    plant = small(tmp_path, ('<joint name="tip"', '<joint name="tip" range="-.2 .3"'), limited)
    box = {"arm": (0.1, 0.2), "mass": (0.7, 0.7)}
    found = [afl.check(plant, 3, seed=x, box=box).worst for x in range(20)]
    assert all(0.1 <= x.q["arm"] <= 0.2 and x.p["mass"] == 0.7 for x in found)
    assert any("mass 0.7 to 0.7" in note for note in afl.check(plant, 3, box=box).notes)
    assert all(-0.2 <= x.q["tip"] <= 0.3 and abs(x.u["torque"]) <= 0.5 for x in found)

    # a range that may be in degrees is in the headline of a plant that passes
    plant = small(tmp_path, ('<joint name="tip"', '<joint name="tip" range="-.02 .03"'))
    assert "only within -0.02 to 0.03 rad: its range, in degrees?" in afl.check(plant, 3).headline
    assert "range" not in afl.check(plant, 3, box={"tip": (-1.0, 1.0)}).headline


def forgets(self, row, write=PlantModel.write):
    kept = self.mj_model.body_inertia.copy()
    write(self, row)
    self.mj_model.body_inertia[:] = kept


def more(*given, usual=check_study.terms_of):
    found = usual(*given)
    return found._replace(energy=found.energy * (1.0, 1.0 + 1e-6))


def light(self, row, usual=PlantModel.tree):
    return usual(self, row) | {"gravity": np.array([0, 0, -9.0])}


@pytest.mark.parametrize(("owner", "name", "wrong", "ids", "said"), [
    (PlantModel, "write", forgets, {"engine.accelerations"},
     "written in place it is another model (body_inertia)"),
    (PlantModel, "tree", light, {"engine.accelerations", "engine.bias"},
     "MuJoCo is not the tree of its MJCF"),
    (mujoco, "mj_setConst", lambda model, data: None, ["mutation", "recompile"],
     "body_subtreemass"),
    (check_study, "terms_of", more, ["energy"],
     "quadrotor-load: energy changes by the work of inputs"),
], ids=["a number forgotten", "a wrong tree", "constants not refreshed", "energy"])  # fmt: skip
def test_what_is_wrong_in_the_check_s_own_ways_is_noticed_and_named(
    owner, name, wrong, ids, said, monkeypatch
) -> None:
    """Of a list these rows fail and no other, of a set at least these."""
    assert afl.check(known(QUAD), 50).passed
    monkeypatch.setattr(owner, name, wrong)
    result = afl.check(known(QUAD), 50)
    failed = [id for id, passed in rows(result).items() if not passed]
    assert failed == ids if isinstance(ids, list) else ids <= {*failed}
    assert said in result.headline


@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_rounding_of_gravity_and_damping_or_stiffness_is_no_velocity_term(damping, tmp_path):
    """A textbook pendulum failed by 1e-6 of nothing."""
    stiff = 'axis="1 0 0" damping="50" stiffness="1e7"/>'
    result = afl.check(small(tmp_path, ('axis="1 0 0"/>', stiff)), 100)
    assert result.passed, result.headline
    model = f"""<mujoco><worldbody><body><joint name="a" axis="0 1 0" damping="{damping}"/>
        <inertial pos="0 0 -.5" mass="1" diaginertia=".1 .1 .01"/></body></worldbody>
        <actuator><motor name="t" joint="a"/></actuator></mujoco>"""

    def terms(q, v, p):
        return ((0.35,),), (4.905 * math.sin(q[0]) + damping * v[0],), ((1.0,),)

    plant = afl.Plant(name="pendulum", model=model, coordinates=("a",), inputs=("t",), terms=terms)
    result = afl.check(plant, 300)
    assert result.passed, result.headline
    assert "Drawn from a -3.14 to 3.14, a_dot -5 to 5, t -10 to 10;" in result.notes[1]


@pytest.mark.parametrize(("id", "terms"), [
    ("symmetric", lambda m, h, b, v: (m + np.triu(np.ones_like(m), 1), h, b)),
    ("positive", lambda m, h, b, v: (-np.asarray(m), h, b)),
    ("quadratic", lambda m, h, b, v: (m, np.asarray(h) + np.array([0, 0, 1, 0]) * v[2] ** 2, b)),
    ("linear", lambda m, h, b, v: (m, np.asarray(h) + np.array([0, 0, 1, 0]) * v[2], b)),
])  # fmt: skip
def test_terms_that_no_body_has_break_an_invariant(id: str, terms) -> None:
    plant = known(QUAD)
    usual = plant.terms
    changed = replace(plant, terms=lambda q, v, p: terms(*map(np.array, usual(q, v, p)), v))
    assert not rows(afl.check(changed, 50))[id]


def test_the_tree_is_not_read_from_the_model_that_was_written() -> None:
    model = PlantModel(known(QUAD))
    row = model.rows(known(QUAD).nominal)[0]
    before = model.tree(row)
    model.write(1.1 * row)
    model.mj_model.body_inertia *= 2.0
    model.mj_model.jnt_axis[:] = 1.0
    after = model.tree(row)
    for name in tree.Tree._fields:
        np.testing.assert_array_equal(before[name], after[name])


BAD = {
    "coordinates must be one of arm, tip, got 'amr'; did you mean arm?": (
        ('("arm", "tip")', '("amr", "tip")'),),
    "must be every joint of the MJCF in its order, ('arm', 'tip'), got ('tip', 'arm')": (
        ('("arm", "tip")', '("tip", "arm")'),),
    "parameter 'idle' must change something that write returns, but nothing does": (
        ("parameters={", 'parameters={"idle": afl.Parameter(1.0), '),),
    "write: body arm mass must be written once, but is twice": (
        ("    return {", '    return {"body arm mass": 1.0, '),),
    "write must be one of body NAME, body NAME mass": (
        ("    return {", '    return {"body arm mas": 1.0, '),),
    "write: 'body tip pos 7' must have an index below 3, got 7": (("tip pos 2", "tip pos 7"),),
    "write must return a dictionary, got None": (
        ("    return {", "    return None\n    return {"),),
    "write: body arm mass must be positive, got -1 at mass = -1, length = 0.4": (
        ('Parameter(1.0, "kg", low=0.5', 'Parameter(-1.0, "kg", low=-1.5'),),
    "write: body tip pos 0 must be a number, got 'far'": (
        ("    return {", '    return {"body tip pos 0": "far", '),),
    "write: body tip inertia 0 must be at most the sum of the other two, got 5": (
        ("    return {", '    return {"body tip inertia": (5.0, 1.0, 1.0), '),),
    "accelerations must be real numbers, got complex": (equations("return 1j, 0.0"),),
    "accelerations must not change its arguments, but does": (
        equations("q[0] = 1.0\n    return q"),),
    "object has no attribute 'maas'; p has mass, length; did you mean mass": (
        equations("return (p.maas, 0.0)"),),
    "terms must return (M, h, B), got 1.0": (equations("return 1.0", "terms", "q, v, p"),),
    "small.py cannot be imported: ZeroDivisionError": (("def write", "1 / 0\ndef write"),),
    "MJCF of plant 'small' cannot be parsed: XML": (("<mujoco>", "<mujoco><"),),
    "absent.xml cannot be read: no such file": (("model=XML", 'model="absent.xml"'),),
    "signal 'far' must be one number": (
        ('name="small"', 'signals={"far": lambda q, v, p: (1.0, 2.0)}, name="small"'),),
    "small.py:24: value must lie in 0.5 to 0.8, got 0.4": (("low=0.2", "low=0.5"),),
    "small.py:24: rate must be one of frozen, enters, got 'enter'; did you mean": (
        ('low=0.2, high=0.8', 'low=0.2, high=0.8, rate="enter"'),),
    "small.py:17: axis must be one of x, y, z": (("length=p.length)", 'length=p.length, axis="w")'),
        ("plant = afl", "write(afl.ball(mass=1, radius=1))\nplant = afl"),
        ("mass=p.mass, length=p.length", "mass=p.mass, length=p.mass")),
    "plant 'small.py:plan' must be": (),
}  # fmt: skip


@pytest.mark.parametrize("said", BAD)
def test_bad_input_is_one_line_with_exit_code_2(said: str, refuses, tmp_path) -> None:
    spec = varied(tmp_path, *BAD[said])
    spec = spec[:-1] if "small.py:plan'" in said else spec
    line = refuses("check", spec, "--samples", "30", "--out", "out")
    assert said.rstrip() in line or spec.endswith("plan")


@pytest.mark.parametrize(("line", "said"), [
    ("a = float('nan') if q[0] > 2.8 else 0.0", "accelerations must be finite; box= of afl"),
    ("a = 0.0\n    if q[0] > 2.8: raise ValueError('far')", "accelerations raised ValueError: far"),
])  # fmt: skip
@pytest.mark.parametrize("more", ["", "\n    {}.get(a)"])  # compiled or not
def test_what_goes_wrong_at_few_points_is_found_at_once(line, said, more, refuses, tmp_path):
    spec = varied(tmp_path, equations(f"{line}{more}\n    return a, a"))
    assert said in refuses("check", spec, "--out", "out")


def test_parameters_never_drawn_elsewhere_are_said_and_a_box_leaves_a_singularity_out(tmp_path):
    """Equations could have constants in their place."""
    bounds = (', "kg", low=0.5, high=2.0', ""), equations("return q[0], p.mass")
    notes = afl.check(small(tmp_path, *bounds), 20).notes
    assert notes[-2] == "Drawn at one value, for want of low and high: mass."
    plant = small(tmp_path, equations("return (q[0] - 0.15) ** 0.5 * 0.0, 0.0"))
    with pytest.raises(afl.AflMujocoError, match="accelerations must be"):
        afl.check(plant, 300)
    afl.check(plant, 300, box={"arm": (0.2, 1.0)})
