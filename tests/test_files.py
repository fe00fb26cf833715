"""Files are whole or missing, and what cannot be read or written is one line."""

import os
from pathlib import Path

import pytest

import afl_mujoco as afl
from afl_mujoco import files
from afl_mujoco.errors import FileError


def test_a_file_is_written_whole_or_not_at_all(tmp_path) -> None:
    assert files.output_folder(tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match=r"output folder .*file cannot be written"):
        files.output_folder(tmp_path / "file")
    path = tmp_path / "a" / "b" / "file.txt"
    files.write_text(path, "whole")
    with pytest.raises(KeyboardInterrupt), files.atomic_file(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert ([*path.parent.iterdir()], path.read_text()) == ([path], "whole")
    with pytest.raises(FileError, match="cannot be written"):
        files.write_text(tmp_path / "missing" / "file.txt", "")


@pytest.mark.parametrize("special", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_what_is_no_regular_file_or_without_end_is_refused_at_once(refuses, special, tmp_path):
    special(tmp_path / "special.toml")
    logs = ("log special.toml --description x.toml", "log x.csv --description special.toml")
    for command in ("simulate special.toml", *logs):
        refuses(*command.split())
    for read_it in (afl.load_scenario, afl.Trajectory.load):
        with pytest.raises(FileError, match="must be a file, but is a device, a pipe or a socket"):
            read_it("special.toml")
    with (tmp_path / "sparse.toml").open("wb") as file:
        file.truncate(10**11)
    assert "sparse.toml must be at most 10 MB, has 100000 MB" in refuses("simulate", "sparse.toml")


@pytest.mark.parametrize("name", ["marked.toml", "Upper.TOML"])
def test_a_scenario_with_a_mark_of_encoding_or_in_capitals_is_read(command_line, tmp_path, name):
    (tmp_path / name).write_text("duration = 0.2\n", encoding="utf-8-sig")
    code, _, errors = command_line("simulate", name, "--no-page", "--out", "out")
    assert (code, errors) == (0, "") and (tmp_path / "out" / f"{Path(name).stem}.toml").is_file()


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_a_scenario_in_another_encoding_is_refused(refuses, tmp_path, encoding) -> None:
    (tmp_path / "a.toml").write_text("duration = 0.2\n# Größe\n", encoding=encoding)
    assert "not UTF-8 text: save it as UTF-8" in refuses("simulate", "a.toml")
