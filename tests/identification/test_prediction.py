from dataclasses import replace

import numpy as np
import pytest

from afl_mujoco.identification import prediction
from afl_mujoco.identification.log import log_of
from tests.synthetic_logs import Truth, swing

TRUTH = Truth()
D = TRUTH.description
NONE = ("friction", "compliance", "dry_deceleration", "lag", "bias")
VALUES = {**TRUTH.expected, **dict.fromkeys(NONE, 0.0), "angle_scale": 1.0}
SCATTER = (TRUTH.position_count, TRUTH.count)


@pytest.fixture(scope="module")
def starts() -> prediction.Starts:
    return prediction.starts_of([log_of("a", swing(TRUTH, 8), D)], 0.3, 0.5, 0.1)


def test_starts_are_where_they_should_be_and_nothing_predicted_is_fitted(starts) -> None:
    w = starts.windows
    assert starts.past == 16 and np.diff(w.time[:, 0]) == pytest.approx(0.1, rel=1e-3)
    rows, near = starts.rows(0.2)
    assert near.all()
    after = w.time[np.arange(w.count), rows] - w.time[:, starts.past - 1]
    assert after == pytest.approx(0.2, rel=1e-3)
    w = starts.windows
    spoilt = replace(w, phi=w.phi.copy(), z=w.z.copy())
    spoilt.phi[:, starts.past :] += 0.5
    spoilt.z[:, starts.past :] += 0.1
    other = replace(starts, windows=spoilt)
    assert np.array_equal(*(prediction.predicted_by_pole(s, VALUES, D) for s in (starts, other)))
    here, there = (prediction.predicted_by_rig(s, VALUES, D, SCATTER)[0] for s in (starts, other))
    assert np.array_equal(here, there)


def test_the_true_model_predicts_to_its_sensors_noise_and_errors_are_what_they_say(starts) -> None:
    read, _ = prediction.predicted_by_rig(starts, VALUES, D, SCATTER)
    near, far = prediction.errors_of(starts, read, (0.1, 0.5), VALUES, D)
    assert near.counts_phi < 3.0 and near.counts_z < 3.0
    assert near.explained_phi > 0.9999 and far.explained_phi > 0.99 and far.explained_z > 0.999
    alone = prediction.predicted_by_pole(starts, VALUES, D)
    (driven,) = prediction.errors_of(
        starts, np.stack([0.0 * alone, alone], axis=1), (0.1,), VALUES, D, position=False
    )
    assert driven.counts_phi < 3.0
    assert driven.rms_z is driven.counts_z is driven.explained_z is None
    w = starts.windows
    read = np.stack([w.z + 0.002, w.phi - 0.003], axis=1)
    (found,) = prediction.errors_of(starts, read, (0.2,), {**VALUES, "angle_scale": 0.5}, D)
    assert found.rms_z == pytest.approx(0.002) and found.counts_z == pytest.approx(20.0)
    assert found.counts_phi == pytest.approx(0.003 / TRUTH.count)
    assert found.rms_phi == pytest.approx(0.5 * 0.003)
    rows, _ = starts.rows(0.2)
    z = w.z[np.arange(w.count), rows]
    assert found.explained_z == pytest.approx(1.0 - 0.002**2 / z.var())
    assert found.starts == w.count >= found.away


def test_readings_that_say_nothing_are_not_judged_and_going_straight_on_is_no_model(starts) -> None:
    w = starts.windows
    valid = w.valid.copy()
    valid[::2, -1] = 0.0
    some = replace(starts, windows=replace(w, valid=valid))
    read = np.stack([w.z, w.phi], axis=1)
    read[::2, 1, -1] += 9.0
    (found,) = prediction.errors_of(some, read, (0.5,), VALUES, D)
    assert found.starts == w.count // 2 and found.rms_phi == 0.0
    read, states = prediction.predicted_by_rig(starts, VALUES, D, SCATTER)
    naive = prediction.straight_on(starts, states, VALUES)
    assert naive[:, 1, starts.past - 1] == pytest.approx(read[:, 1, starts.past - 1], abs=1e-3)
    (model,) = prediction.errors_of(starts, read, (0.5,), VALUES, D)
    (none,) = prediction.errors_of(starts, naive, (0.5,), VALUES, D)
    assert none.rms_phi > 20.0 * model.rms_phi
