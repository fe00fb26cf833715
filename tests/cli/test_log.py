import pytest

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
    said = refuses("log", "one.csv", "--out", "out")
    assert said.startswith("afl-mujoco: description must be given: logs need their description")
    said = refuses("simulate", "step-step", "--log", "--out", "out")
    assert said.endswith("scenario of a log must keep M and l constant, got step-step")
