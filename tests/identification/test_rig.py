from dataclasses import replace

import numpy as np
import pytest

from afl_mujoco.identification import rig
from afl_mujoco.identification.least_squares import fitted_starts
from afl_mujoco.identification.log import cut, log_of
from tests.synthetic_logs import Truth, swing

TRUTH = Truth()
NONE = ("friction", "compliance", "dry_deceleration", "lag", "bias")
VALUES = {**TRUTH.expected, **dict.fromkeys(NONE, 0.0)}


@pytest.fixture(scope="module")
def windows():
    windows = cut([log_of("a", swing(TRUTH, 5), TRUTH.description)], 0.5, 0.5, least=None)
    return replace(windows, step=windows.step / 2)


def test_ratios_become_masses_and_forces_of_the_given_pole() -> None:
    found = rig.physical(VALUES, TRUTH.description)
    for name in ("half_length", "cart_mass", "force", "rail_damping", "hinge_damping"):
        assert found[name] == pytest.approx(getattr(TRUTH, name), rel=1e-9), name


def test_the_true_parameters_meet_the_readings_to_the_same_bits_for_any_threads(windows) -> None:
    whole = rig.Rig(windows=windows, description=TRUTH.description)
    measured = np.stack([windows.z, windows.phi], axis=1)
    counts = np.array([TRUTH.position_count, TRUTH.count])[:, None]

    def residuals(own):
        return ((whole.readings(VALUES, own) - measured) / counts).reshape(windows.count, -1)

    starts = fitted_starts(lambda own: residuals(own) / 1e3, windows.starts, rig.START_SCALE)
    assert np.sqrt(np.mean(residuals(starts) ** 2)) < 1.0
    rigs = (rig.Rig(windows=windows, description=TRUTH.description, workers=n) for n in (1, 2))
    assert np.array_equal(*(one.readings(VALUES, windows.starts) for one in rigs))


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.0), (0.007, 0.0), (0.003, 0.02)])
def test_the_force_is_the_command_behind_delay_and_lag(windows, delay: float, lag: float) -> None:
    values = {**VALUES, "delay": delay, "lag": lag, "bias": 0.05}
    forces = rig.Rig(windows=windows, description=TRUTH.description).forces(values)
    (log,) = windows.logs
    fine = np.arange(0.0, log.duration, 1e-5)  # by brute force: Euler at 10 us
    command = log.command[np.searchsorted(log.time, fine - delay, side="right") - 1]
    command = np.where(fine < delay, log.command[0], command) - 0.05
    if lag:
        behind = np.empty_like(command)
        state = command[0]
        for i, c in enumerate(command):
            state += 1e-5 / lag * (c - state)
            behind[i] = state
        command = behind
    for b in (1, 3):
        for j in (0, 7, 50):
            start = windows.time[b, 0] + j * windows.step
            part = (fine >= start) & (fine < start + windows.step)
            assert forces[b, j] == pytest.approx(TRUTH.force * command[part].mean(), abs=0.02)
