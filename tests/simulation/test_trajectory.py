import gc
import zipfile

import numpy as np
import pytest

from afl_mujoco import Outcome, Trajectory, simulate_ode_rk4
from afl_mujoco.errors import FileError, InvalidValueError
from tests.messages import line

ARRAYS = ("time", "state", "input", "command")


def _made(**changes):
    fields = {
        "time": np.linspace(0, 1, 3), "state": np.arange(12.0).reshape(3, 4), "input": np.zeros(3),
        "parameters": {"cart_mass": np.ones(3), "half_length": np.ones(3)},
        "outcome": Outcome("completed", 1.0),
    }  # fmt: skip
    return Trajectory(**{**fields, **changes})


@pytest.fixture
def saved(tmp_path, smooth_scenario, adaptive):
    run = simulate_ode_rk4(smooth_scenario, adaptive, timestep=0.01)
    run.save(tmp_path / "run.npz")
    return run, tmp_path / "run.npz"


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_cannot_be_written_to_nor_replaced_nor_have_another_length(name):
    run = _made()
    with pytest.raises(ValueError, match="read-only"):
        getattr(run, name)[0] = 7.0
    with pytest.raises(AttributeError):
        setattr(run, name, np.zeros(3))
    said = rf"^{name} must have shape \(3,( 4)?\), got \(2,"
    if name != "time":
        with pytest.raises(InvalidValueError, match=said):
            _made(**{name: np.zeros((2, 4) if name == "state" else 2)})


def test_a_run_comes_back_from_its_file_bit_for_bit_with_its_provenance(saved):
    run, path = saved
    back = Trajectory.load(path)
    for name in ARRAYS:
        assert getattr(back, name).tobytes() == getattr(run, name).tobytes()
        assert not getattr(back, name).flags.writeable
    assert back.outcome == run.outcome and back.provenance == run.provenance
    assert back.simulator == "ode RK4"
    provenance = run.provenance
    names = [provenance[x]["name"] for x in ("scenario", "controller")]
    assert (names, provenance["settings"]) == (["smooth", "adaptive"], {"timestep": 0.01})
    assert set(provenance["versions"]) >= {"afl_mujoco", "mujoco", "numpy", "scipy"}
    with pytest.raises(FileError, match=line(". must be a file to write, not a folder")):
        run.save("")


OBJECTS = {name: np.array([object()]) for name in ARRAYS}


@pytest.mark.parametrize("spoil", [
    lambda p: p.write_bytes(bytes(range(256))), lambda p: np.savez(p, time=np.zeros(3)),
    lambda p: np.savez(p, **OBJECTS, meta=np.array("{}")),
], ids=["garbage", "other npz", "pickled array"])  # fmt: skip
def test_a_file_that_holds_no_trajectory_is_said_so(spoil, saved):
    _, path = saved
    spoil(path)
    with pytest.raises(FileError, match=line(f"{path} is not a saved trajectory", ...)):
        Trajectory.load(path)
    gc.collect()  # a file left open is a warning, hence an error, here and not in a later test


def test_a_run_that_would_fill_the_memory_is_refused_whatever_its_headers_say(saved, monkeypatch):
    path = saved[1].with_name("lying.npz")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("time", "state", "input", "command", "meta"):
            with archive.open(f"{name}.npy", "w") as stream:
                header = {"descr": "<f8", "fortran_order": False, "shape": (10**14,)}
                np.lib.format.write_array_header_1_0(stream, header)
    with pytest.raises(FileError, match="is not a saved trajectory"):
        Trajectory.load(path)
    monkeypatch.setattr("afl_mujoco.files.MOST_ARRAYS", 1e4)
    with pytest.raises(FileError, match=r"its arrays must take at most 0\.01 MB, take "):
        Trajectory.load(saved[1])
