from dataclasses import replace

import numpy as np
import pytest

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.identification.log import cut, log_of
from tests.synthetic_logs import Truth, swing

TRUTH = Truth()


@pytest.fixture(scope="module")
def log():
    return log_of("a", swing(TRUTH, 5), TRUTH.description)


def test_windows_share_their_ends_and_reach_the_last_row(log) -> None:
    windows = cut([log], 0.5, 0.5)
    assert windows.time.shape == (8, 26)
    assert list(windows.there.sum(axis=1)) == [26.0] * 7 + [25.0]  # of 200 rows
    assert (windows.dropped, windows.share) == (0, 1.0)
    assert windows.time[1:, 0] == pytest.approx(windows.time[:-1, -1])
    assert windows.steps * windows.step >= windows.time[0, -1] - windows.time[0, 0] + log.period
    assert windows.some(3).count == 3


def test_a_window_that_begins_where_the_angle_is_unknown_is_left_out(log) -> None:
    valid = log.valid.copy()
    valid[25:40] = False
    windows = cut([replace(log, valid=valid)], 0.5, 0.5)
    assert list(windows.first) == [0, 50, 75, 100, 125, 150, 175]
    assert windows.dropped == 1


def test_of_readings_that_are_close_together_some_are_read(log) -> None:
    fine = replace(
        log, time=log.time / 20.0, period=log.period / 20.0, valid=log.valid
    )  # a kilohertz
    windows = cut([fine], 0.1, 0.1)
    assert np.diff(windows.time[0]).min() == pytest.approx(0.01, rel=1e-3)


def test_a_lost_row_ends_a_window_and_the_next_begins_after_it() -> None:
    columns = swing(TRUTH, 5)
    kept = np.delete(np.arange(200), [12, 60, 65, 130])
    log = log_of("a", {name: values[kept] for name, values in columns.items()}, TRUTH.description)
    windows = cut([log], 0.5, 0.5)
    spans = [(float(t[0]), float(t[m > 0.0][-1])) for t, m in zip(
        windows.time / log.period, windows.there, strict=True)]  # fmt: skip
    assert np.round(spans).tolist() == [
        *([0.0, 11.0], [13.0, 38.0], [38.0, 59.0], [66.0, 91.0], [91.0, 116.0], [116.0, 129.0]),
        *([131.0, 156.0], [156.0, 181.0], [181.0, 199.0]),
    ]
    assert windows.dropped == 1  # rows 61 to 64
    assert windows.share == pytest.approx(1.0 - 11.0 / 199.0, abs=1e-3)


def test_logs_shorter_than_a_window(log) -> None:
    with pytest.raises(AflMujocoError, match="logs must include one longer than 9 s"):
        cut([log], 9.0, 1.0, least=None)
