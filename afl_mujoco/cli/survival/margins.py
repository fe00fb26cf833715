"""`afl-mujoco margins`."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from afl_mujoco.cli.terminal import SUCCESS, count_bar


@dataclass(frozen=True, kw_only=True)
class Margins:
    """Gain, phase, disk and delay margins of each controller at upright, over a grid of plants.

    Example: afl-mujoco margins --controllers fixed lqr --control-period 0.005

    The loop is linearised by finite differences on MuJoCo. Writes margins.json.
    """

    controllers: tuple[str, ...] = (
        "fixed",
        "adaptive",
        "fixed-retuned",
        "adaptive-retuned",
        "lqr",
        "pole-placement",
        "partial-linearization",
    )
    """Controllers by name, or a law in Python, my_module:my_law."""
    cart_masses: tuple[float, ...] | None = None
    """Cart masses M of the grid [kg]; the paper's 20 by default."""
    half_lengths: tuple[float, ...] | None = None
    """Half-lengths l of the grid [m]; the paper's 20 by default."""
    control_period: float = 1e-3
    """How long the sampled loop holds the force [s]."""
    workers: int = min(2, os.cpu_count() or 1)
    """Processes to share the work among; the numbers do not depend on it."""
    out: Path = Path("renders/margins")
    """Folder for the file."""

    def run(self) -> int:
        """Survey the margins, write and print them."""
        import json

        from rich.console import Console

        from afl_mujoco.control.baselines.design import CART_MASSES, HALF_LENGTHS
        from afl_mujoco.control.controllers import find_controller
        from afl_mujoco.control.estimation.estimated_law import refuse_estimated
        from afl_mujoco.output import output_folder, write_text
        from afl_mujoco.reporting.survival.margins_table import print_margins
        from afl_mujoco.validation.margins.survey import survey_margins

        controllers = [find_controller(name) for name in self.controllers]
        refuse_estimated(controllers)
        masses = self.cart_masses or CART_MASSES
        folder = output_folder(self.out)
        with count_bar(len(controllers) * len(masses), "linearising") as progress:
            survey = survey_margins(
                controllers,
                cart_masses=masses,
                half_lengths=self.half_lengths or HALF_LENGTHS,
                control_period=self.control_period,
                workers=self.workers,
                progress=progress,
            )
        text = json.dumps(survey.to_dict(), allow_nan=False)
        write_text(folder / "margins.json", f"{text}\n")
        print(f"wrote {folder / 'margins.json'}")
        print_margins(survey, Console(width=None if sys.stdout.isatty() else 140))
        return SUCCESS
