"""`afl-mujoco log`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from afl_mujoco.cli.terminal import SUCCESS, say
from afl_mujoco.errors import InvalidValueError

Logs = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG ...]")]


@dataclass(frozen=True, kw_only=True)
class Log:
    """Plot logs of a measured cart-pole, and print a summary.

    Example: afl-mujoco log logs/swing-up.csv --description my-rig.toml
    """

    logs: Logs = ()
    """Logs, CSV files or folders of them; by default the first recording of the package."""
    description: str | None = None
    """TOML file that says what their columns mean; required for your own logs."""
    out: Path = Path("renders/logs")
    """Folder for the pictures."""

    def run(self) -> int:
        """Read the logs, draw them, print a table."""
        from afl_mujoco.identification.description import load_description
        from afl_mujoco.identification.log import read_logs
        from afl_mujoco.identification.shipped import DESCRIPTION, FIT

        if bool(self.logs) != (self.description is not None):
            thing = "description" if self.logs else "logs"
            raise InvalidValueError(thing, "must be given: logs need their description")
        description = load_description(
            DESCRIPTION if self.description is None else self.description
        )
        logs = read_logs(self.logs or sorted(FIT.glob("*.csv"))[:1], description)

        import numpy as np

        from afl_mujoco.files import output_folder
        from afl_mujoco.report.blocks import Matrix
        from afl_mujoco.report.numbers import percent, short
        from afl_mujoco.report.style import save_figure, styled
        from afl_mujoco.report.terminal import print_blocks
        from afl_mujoco.studies.identified_parts import draw_log

        folder = output_folder(self.out)
        rows = []
        for log in logs:
            angle = np.where(log.valid, log.phi + 2.0 * np.pi * log.turns, np.nan)
            with styled():
                figure = draw_log(log.time, log.z, angle, log.command)
            save_figure(figure, folder / f"{log.name}.png")
            rows.append(
                (
                    log.name, str(len(log.time)), short(log.duration, 3),
                    short(1e3 * log.period), short(1e3 * log.jitter, 2), str(log.missing),
                    f"{short(float(log.z.min()), 2)} to {short(float(log.z.max()), 2)}",
                    f"{short(float(np.nanmin(angle)), 3)} to {short(float(np.nanmax(angle)), 3)}",
                    percent(1.0 - float(log.valid.mean()), 2),
                )
            )  # fmt: skip
        table = Matrix(
            caption=description.name,
            columns=(
                "Log", "Rows", "Duration [s]", "Period [ms]", "Jitter [ms]", "Missing", "z [m]",
                "φ [rad]", "φ in the dead zone",
            ),
            rows=rows,
        )  # fmt: skip
        print_blocks([table])
        say(f"wrote {', '.join(f'{folder / log.name}.png' for log in logs)}")
        return SUCCESS
