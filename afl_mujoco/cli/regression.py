"""`afl-mujoco regression`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from afl_mujoco.cli.terminal import CHECK_FAILED, SUCCESS, progress_bar, say


@dataclass(frozen=True, kw_only=True)
class Regression:
    """Compare every run of the paper's scenarios with its baseline.

    Example: afl-mujoco regression --workers 2

    Prints a line for each value that changed. The exit code is 0 if none did, and 1 otherwise.
    """

    baselines: Path = Path("tests/regression/baselines")
    """Folder of the baselines."""
    update: bool = False
    """Make the current state the baselines, and print what changed."""
    workers: int = min(2, os.cpu_count() or 1)
    """Number of processes that share the work; the results do not depend on it."""

    def run(self) -> int:
        """Run everything; compare, or update the baselines."""
        from afl_mujoco.control.catalogue import CONTROLLERS
        from afl_mujoco.scenario.catalogue import SCENARIOS
        from afl_mujoco.studies.regression.regression import (
            REGRESSED,
            compare,
            load_baselines,
            open_for_update,
            record_all,
            update_baselines,
        )

        read = open_for_update if self.update else load_baselines
        baselines = read(self.baselines)  # what is quick to check comes first
        scenarios = list(SCENARIOS.values())
        controllers = [CONTROLLERS[name] for name in REGRESSED]
        with progress_bar(len(scenarios) * len(controllers), "validating") as progress:
            fresh = record_all(scenarios, controllers, workers=self.workers, progress=progress)
        if self.update:
            say(*update_baselines(self.baselines, baselines, fresh))
            return SUCCESS
        comparison = compare(baselines, fresh)
        say(*comparison.lines(self.baselines))
        return SUCCESS if comparison.passed else CHECK_FAILED
