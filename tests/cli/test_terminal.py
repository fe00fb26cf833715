from afl_mujoco import __version__
from afl_mujoco.cli import terminal
from afl_mujoco.studies.check import Options


def test_without_a_terminal_progress_is_a_line_now_and_then(monkeypatch, capsys) -> None:
    clock = iter((0.0, 0.0, 10.0, 31.0, 31.0, 40.0, 70.0, 70.0, 120.0))
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(clock))
    with terminal.count_bar(9, "filming") as progress:
        for done in (1, 2, 3, 4, 9):  # at 10 s, 31 s, 40 s, 70 s and 120 s
            progress(done)
    assert capsys.readouterr() == ("", "filming: 2 of 9\nfilming: 4 of 9\n")


def test_the_version_is_the_package_s_and_nothing_is_meant_by_another_option(command_line) -> None:
    assert command_line("--version") == (0, f"afl-mujoco {__version__}\n", "")
    assert "did you mean" not in command_line("report", "--out", "x")[2]


def test_lists_of_numbers_take_commas_and_nothing_else_is_taken_apart() -> None:
    words = "--cart-masses 0.1,2 --lower=1,2 -1,1e-3 a,b 1 640x480 ,".split()
    apart = "--cart-masses 0.1 2 --lower=1,2 -1 1e-3 a,b 1 640x480 ,".split()
    assert terminal.numbers_apart(words) == apart


def test_a_check_says_the_command_that_makes_it_again() -> None:
    plant = "furuta.py:plant"
    assert terminal.typed("check", Options(plant=plant)) == f"afl-mujoco check {plant}"
    boxed = Options(plant=plant, box={"arm": (-1.0, 2.0)})
    assert terminal.typed("check", boxed) == f"afl-mujoco check {plant} --box arm -1.0 2.0"
