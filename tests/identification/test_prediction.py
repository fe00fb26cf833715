from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest

from afl_mujoco.identification import pole, prediction, rig
from afl_mujoco.identification.log import Windows, cut, log_of
from tests.synthetic_logs import Truth, swing

TRUTH = Truth()
D = TRUTH.description
NONE = ("friction", "compliance", "dry_deceleration", "lag", "bias")
VALUES = {**TRUTH.expected, **dict.fromkeys(NONE, 0.0), "angle_scale": 1.0}
SCATTER = (TRUTH.position_count, TRUTH.count)


@pytest.fixture(scope="module")
def w() -> Windows:
    return prediction.starts_of([log_of("a", swing(TRUTH, 8), D)], 0.3, 0.5, 0.1)


def test_starts_are_where_they_should_be_and_nothing_predicted_is_fitted(w) -> None:
    assert w.past == 16 and np.diff(w.time[:, 0]) == pytest.approx(0.1, rel=1e-3)
    rows, near = w.rows(0.2)
    assert near.all()
    assert w.time[np.arange(w.count), rows] - w.time[:, w.past - 1] == pytest.approx(0.2, rel=1e-3)
    other = replace(w, phi=w.phi.copy(), z=w.z.copy())
    other.phi[:, w.past :] += 0.5
    other.z[:, w.past :] += 0.1
    assert np.array_equal(*(prediction.predicted_by_pole(s, VALUES, D) for s in (w, other)))
    here, there = (prediction.predicted_by_rig(s, VALUES, D, SCATTER) for s in (w, other))
    assert np.array_equal(here, there)


def test_the_true_model_predicts_to_its_sensors_noise_and_errors_are_what_they_say(w) -> None:
    read = prediction.predicted_by_rig(w, VALUES, D, SCATTER)
    near, far = prediction.errors_of(w, read, (0.1, 0.5), VALUES, D)
    assert near.counts_phi < 3.0 and near.counts_z < 3.0
    assert near.explained_phi > 0.9999 and far.explained_phi > 0.99 and far.explained_z > 0.999
    alone = prediction.predicted_by_pole(w, VALUES, D)
    both = np.stack([0.0 * alone, alone], axis=1)
    (driven,) = prediction.errors_of(w, both, (0.1,), VALUES, D, position=False)
    assert driven.counts_phi < 3.0 and driven.rms_z is driven.counts_z is driven.explained_z is None
    read = np.stack([w.z + 0.002, w.phi - 0.003], axis=1)
    (found,) = prediction.errors_of(w, read, (0.2,), {**VALUES, "angle_scale": 0.5}, D)
    assert found.rms_z == pytest.approx(0.002) and found.counts_z == pytest.approx(20.0)
    assert found.counts_phi == pytest.approx(0.003 / TRUTH.count)
    assert found.rms_phi == pytest.approx(0.5 * 0.003)
    rows, _ = w.rows(0.2)
    assert found.explained_z == pytest.approx(1.0 - 0.002**2 / w.z[np.arange(w.count), rows].var())
    assert found.starts == w.count >= found.away
    valid = w.valid.copy()  # readings that say nothing are not judged
    valid[::2, -1] = 0.0
    read = np.stack([w.z, w.phi], axis=1)
    read[::2, 1, -1] += 9.0
    (found,) = prediction.errors_of(replace(w, valid=valid), read, (0.5,), VALUES, D)
    assert found.starts == w.count // 2 and found.rms_phi == 0.0


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.0), (0.007, 0.0), (0.003, 0.02)])
def test_the_force_is_the_command_behind_delay_and_lag(delay: float, lag: float) -> None:
    windows = cut([log := log_of("a", swing(TRUTH, 5), D)], 0.5, 0.5, least=None)
    windows = replace(windows, step=windows.step / 2)
    forces = rig.Rig(windows, D).forces({**VALUES, "delay": delay, "lag": lag, "bias": 0.05})
    fine = np.arange(0.0, log.duration, 1e-5)  # by brute force: Euler at 10 us
    command = log.command[np.searchsorted(log.time, fine - delay, side="right") - 1]
    command = np.where(fine < delay, log.command[0], command) - 0.05
    if lag:
        command = np.array([*accumulate(command.tolist(), lambda x, c: x + 1e-5 / lag * (c - x))])
    for b in (1, 3):
        for j in (0, 7, 50):
            start = windows.time[b, 0] + j * windows.step
            part = (fine >= start) & (fine < start + windows.step)
            assert forces[b, j] == pytest.approx(TRUTH.force * command[part].mean(), abs=0.02)


def test_friction_takes_energy_as_it_says_and_ratios_become_masses_and_forces() -> None:
    start, still = np.array([[np.pi + 0.3, 0.0]]), np.zeros((1, 8001))
    for viscous, dry, near in ((0.2, 0.0, 1e-4), (0.0, 0.5, 0.03)):
        angle, rate = pole.pole_motion(start, still, 1e-3, 37.0, viscous, dry)[0].T
        energy = 0.5 * rate**2 + 37.0 * np.cos(angle)
        lost = viscous * np.trapezoid(rate**2, dx=1e-3) + dry * np.abs(np.diff(angle)).sum()
        assert energy[0] - energy[-1] == pytest.approx(lost, rel=near)
    found = rig.physical(VALUES, D)
    for name in ("half_length", "cart_mass", "force", "rail_damping", "hinge_damping"):
        assert found[name] == pytest.approx(getattr(TRUTH, name), rel=1e-9), name
