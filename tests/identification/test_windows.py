from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.identification.log import log_of
from afl_mujoco.identification.windows import cut
from tests.synthetic_logs import Truth, swing

TRUTH = Truth()


@pytest.fixture(scope="module")
def log():
    return log_of("a", swing(TRUTH, 5), TRUTH.description)


def test_windows_share_their_ends_and_reach_the_last_row(log) -> None:
    windows = cut([log], 0.5, 0.5)
    assert windows.time.shape == (7, 26)
    assert windows.time[1:, 0] == pytest.approx(windows.time[:-1, -1])
    assert windows.steps * windows.step >= windows.time[0, -1] - windows.time[0, 0] + log.period
    assert windows.finer(2).step == windows.step / 2
    assert windows.some(3).count == 3


def test_a_window_that_begins_where_the_angle_is_unknown_is_left_out(log) -> None:
    valid = log.valid.copy()
    valid[25:40] = False
    windows = cut([replace(log, valid=valid)], 0.5, 0.5)
    assert list(windows.first) == [0, 50, 75, 100, 125, 150]


def test_of_readings_that_are_close_together_some_are_read(log) -> None:
    fine = replace(
        log, time=log.time / 20.0, period=log.period / 20.0, valid=log.valid
    )  # a kilohertz
    windows = cut([fine], 0.1, 0.1)
    assert np.diff(windows.time[0]).min() == pytest.approx(0.01, rel=1e-3)


def test_logs_shorter_than_a_window(log) -> None:
    with pytest.raises(AflMujocoError, match="logs must include one longer than 9 s"):
        cut([log], 9.0, 1.0)
