import shutil

import pytest

from afl_mujoco.identification.prediction import DESCRIPTION, FIT
from afl_mujoco.scenario.files import save_scenario
from tests.synthetic_logs import RIG


def test_a_recording_of_the_package_is_plotted(command_line, tmp_path) -> None:
    code, output, errors = command_line("log", "--out", "out")
    assert (code, errors) == (0, "")
    assert "Experiment-1008" in output and "20.28" in output and "5 %" in output
    assert (tmp_path / "out" / "Experiment-1008.png").is_file()


@pytest.mark.slow
def test_a_simulated_run_is_written_as_a_log_and_plotted(command_line, tmp_path) -> None:
    save_scenario(RIG, tmp_path / "rig.toml")
    command = ("simulate", "rig.toml", "--controller", "lqr", "--log", "--out", "out")
    code, output, _ = command_line(*command)
    assert code == 0 and "rig-lqr-sampled-log.csv, rig-lqr-sampled-log.toml" in output
    stem = "out/rig-lqr-sampled-log"
    code, output, _ = command_line("log", f"{stem}.csv", "--description", f"{stem}.toml")
    assert code == 0 and "wrote renders/logs/rig-lqr-sampled-log.png" in output


def test_what_cannot_be_is_refused_in_a_line_and_nothing_is_written(refuses) -> None:
    for arguments, message in (
        (("log", "one.csv"), "description must be given: logs need their description"),
        (("log", "--description", "x.toml"), "logs must be given: logs need their description"),
        (
            ("simulate", "step-step", "--log"),
            "scenario of a log must keep M and l constant, got step-step",
        ),
    ):
        assert refuses(*arguments, "--out", "out").startswith(f"afl-mujoco: {message}")


def test_neither_the_name_of_a_log_nor_of_its_rig_steers_the_terminal(command_line, tmp_path):
    text = DESCRIPTION.read_text().replace('name = "', 'name = "\\u001b[31m')
    (tmp_path / "rig.toml").write_text(text)
    shutil.copy(next(FIT.glob("*.csv")), tmp_path / "a\x1b]0;b\x07.csv")
    code, output, errors = command_line("log", ".", "--description", "rig.toml", "--out", "out")
    assert (code, errors) == (0, "")
    assert "\x1b" not in output and "\x07" not in output
    assert r"\x1b[31m" in output and r"out/a\x1b]0;b\x07.png" in output
