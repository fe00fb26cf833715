"""Bad input of every study, through the real command line: exit code 2, one line, nothing left."""

from dataclasses import fields
from typing import get_type_hints

import pytest
import tyro

from afl_mujoco.studies.shared.contract import Study, studies

ALL = list(studies())
STEMS = {name: study.stem for name, study in studies().items()} | {"dice": "dice"}
NAMES = [*ALL, "dice"]  # the toy study passes as well, without a line of its own


def takes_scenarios(study: Study) -> bool:
    hints = get_type_hints(study.parts.Options, include_extras=True)
    given = (getattr(x, "__metadata__", ()) for n, x in hints.items() if n.startswith("scenario"))
    return any(tyro.conf.Positional in metadata for metadata in given)


def controllers_option(name: str) -> str:
    names = {field.name for field in fields(studies()[name].parts.Options)}
    return next((f"--{n}" for n in ("controllers", "controller") if n in names), "")


FILES = {
    "missing file": ("missing.toml", None, "missing.toml cannot be read: no such file"),
    "broken TOML": ("bad.toml", "duration = = 1", "bad.toml is not valid TOML"),
    "unknown key": ("bad.toml", "[schedule]\nhalf_lenght = 1", "got 'half_lenght'; did"),
    "unknown name": ("step-stp", None, "did you mean step-step"),
}


@pytest.mark.parametrize("case", FILES, ids=str)
@pytest.mark.parametrize("name", [*(x for x in ALL if takes_scenarios(studies()[x])), "dice"])
def test_a_scenario_file_that_cannot_be_used(toy, refuses, tmp_path, name, case) -> None:
    file, text, message = FILES[case]
    if text is not None:
        (tmp_path / file).write_text(text)
    if name == "estimation":  # of the paper's scenarios only
        message = "scenario must be one of nominal, step-step, "
    assert message in refuses(name, file, "--out", "out")


@pytest.mark.parametrize("name", [name for name in ALL if controllers_option(name)])
def test_an_unknown_controller_with_what_was_meant_and_one_that_comes_twice(refuses, name) -> None:
    option = controllers_option(name)
    said = refuses(name, option, "adaptve", "--out", "out")
    assert "controller must be one of fixed, adaptive, " in said
    assert "got 'adaptve'; did you mean adaptive" in said
    if option == "--controllers":
        said = refuses(name, option, "lqr", "lqr", "--out", "out")
        assert said.endswith("controller names must differ, got 'lqr' twice")


@pytest.mark.parametrize("name", NAMES)
def test_no_workers_or_no_number_of_them_and_an_unknown_option(toy, refuses, name: str) -> None:
    refuses(name, "--quik")
    refuses(name, "--workers", "many")
    if name == "dice" or studies()[name].takes("workers"):
        said = refuses(name, "--workers", "0", "--out", "out")
        assert "workers must be at least 1, got 0" in said


@pytest.mark.parametrize("name", NAMES)
def test_a_place_for_results_or_films_that_cannot_be_used(toy, refuses, tmp_path, name) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "held" / f"{STEMS[name]}.json").mkdir(parents=True)
    (tmp_path / "films.json").write_text("{}")
    for arguments, message in (
        (("--out", "file"), "output folder file cannot be written: file exists"),
        (("--out", "a\0b"), "argument must not contain a NUL character"),
        (("--out", "held"), f"held/{STEMS[name]}.json must be a file, but is a folder"),
        (("--films", ".", "--out", "out"), "films.json does not list films: films is missing"),
    ):
        assert message in refuses(name, *arguments)


CASES = {
    "validate": [
        (["--controllers", "fixed-estimated"],
         "controller 'fixed-estimated' uses the estimator; only mode \"sampled\" "),
        (["nominal", "--control-period", "40"],
         "control_period must be within the duration 20 s (in seconds, not Hz), got 40.0"),
        (["--controllers", "integrating:Force"], "is stateful, which this comparison does not"),
        (["flat.toml"], "scenario 'flat': initial_state must not be where a run ends"),
        (["down.toml"], "initial_state must be one at which fixed has an input"),
    ],
    "check": [
        (["--samples", "0"], "samples must be at least 1, got 0"),
        (["nowhere.py"], "plant must be FILE.py:NAME or MODULE:NAME, got 'nowhere.py'; did you"),
        (["json:dumps"], "plant 'json:dumps' must be an afl.Plant"),
        (["cart-pole", "--box", "fi", "-1", "1"], "box must be one of z, phi, "),
        (["cart-pole", "--box", "phi", "1"], "HIGH, again for each name, got phi 1"),
    ],
    "thresholds": [
        (["--imperfections", "gravity"], "imperfection must be one of control_period, delay, "),
        (["--scan", "1"], "scan must be at least 2, got 1"),
        (["--seeds", 20 * "9"], "seeds must be at most 1000, got 9"),
        (["slow.toml", "--timestep", "0.001"], "timestep 0.001 s must divide control_period"),
    ],
    "montecarlo": [
        (["--controllers", "nowhere:force"], "controller 'nowhere:force' must be in a module"),
        (["--samples", 20 * "9"], f"samples must be at most 1000000, got {20 * '9'}"),
        (["--workers", "100000"], "workers must be at most 1024, got 100000"),
        (["--generations", "0"], "generations must be at least 1, got 0"),
    ],
    "attraction": [(["--grid", "1"], "grid must be at least 2, got 1")],
    "margins": [(["--levels", "1"], "levels must be at least 2, got 1")],
    "identify": [
        (["none.csv", "--description", "rig.toml"], "none.csv cannot be read: no such file"),
        (["still.csv"], "description must be given: logs need their description"),
        (["still.csv", "--description", "rig.toml"], "phi must vary: the angle is constant"),
    ],
    "hardware": [
        (["--logs", "taken"], "taken must contain logs, *.csv"),
        (["--draws", "100001"], "draws must be at most 100000, got 100001"),
        (["--estimates", "real.toml", "--logs", "taken"], "real.toml has no estimates of afl-muj"),
    ],
    "estimation": [
        (["--seeds", "0"], "seeds must be at least 1, got 0"),
        (["--controller", "adaptive-estimated"], "controller 'adaptive-estimated' must be"),
        (["nominal", "nominal"], "scenario names must differ, got 'nominal' twice"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [(name, *case) for name, cases in CASES.items() for case in cases],
    ids=lambda x: " ".join(x) if isinstance(x, list) else "",
)
def test_an_option_that_breaks_its_rule(refuses, tmp_path, name, arguments, message) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "real.toml").write_text('name = "real"\n[imperfections]\ndelay = 0.01\n')
    (tmp_path / "slow.toml").write_text("[imperfections]\ncontrol_period = 0.0015\n")
    for stem, start in {"flat": "1.57 }", "down": "3.1 }\n[requirements]\nends_at = {}"}.items():
        (tmp_path / f"{stem}.toml").write_text(f"initial_state = {{ phi = {start}\n")
    nominal = "pole_mass = 0.1\nhalf_length = 0.2\ncart_mass = 0.5\nforce = 5.0\n"
    (tmp_path / "rig.toml").write_text(f'name = "rig"\nperiod = 0.02\n[nominal]\n{nominal}')
    rows = "".join(f"{0.02 * i},0.1,{0.001 * i},0.5\n" for i in range(60))
    (tmp_path / "still.csv").write_text(f"time,phi,z,command\n{rows}")
    own = "class Force:\n    def __call__(self, time, state, belief): return 0.0\n"
    (tmp_path / "integrating.py").write_text(own)
    where = [] if "--out" in arguments else ["--out", "out"]
    assert message in refuses(name, *arguments, *where)
