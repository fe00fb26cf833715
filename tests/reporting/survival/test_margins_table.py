"""The table of margins on the terminal says of each loop what the survey holds of it."""

from __future__ import annotations

from io import StringIO

import numpy as np
from rich.console import Console

from afl_mujoco.reporting.survival.margins_table import print_margins
from afl_mujoco.validation.margins.survey import METRICS, Survey


def test_each_loop_has_its_own_count_of_unstable_plants() -> None:
    continuous = np.ones((1, 2, 3, len(METRICS)))
    held = continuous.copy()
    continuous[0, 0, 0], held[0, 0, :], held[0, 1, 2] = np.nan, np.nan, np.nan
    survey = Survey(
        controllers=("lqr",), cart_masses=(0.1, 2.0), half_lengths=(0.05, 0.2, 1.0),
        control_period=1e-3, continuous=continuous, sampled=held,
    )  # fmt: skip
    text = StringIO()
    print_margins(survey, Console(file=text, width=140))
    first, second = (line.split() for line in text.getvalue().splitlines() if " kg, " in line)
    assert first[:3] == ["lqr", "continuous", "1"]
    assert second[:4] == ["held", "1", "ms", "4"]
