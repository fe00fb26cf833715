"""Identify a cart-pole from its logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import tyro

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.files import remove_file, require_no_folder, write_json
from afl_mujoco.identification.description import Description
from afl_mujoco.identification.identify import WINDOW, Identified
from afl_mujoco.identification.least_squares import FEW_CLUSTERS
from afl_mujoco.identification.log import Log
from afl_mujoco.identification.pole import linearity
from afl_mujoco.report.blocks import Block, Figure, Matrix, Report
from afl_mujoco.report.markdown import code
from afl_mujoco.report.numbers import fixed, percent, short
from afl_mujoco.studies.contract import Progress, Study, silent
from afl_mujoco.studies.identified_parts import (
    AHEAD,
    Shown,
    draw_shown,
    estimates_matrix,
    physical_matrix,
    shown_of,
)

ESTIMATES, SCENARIO = "estimates.json", "identified.toml"


@dataclass(frozen=True, kw_only=True)
class Options:
    """Identify a cart-pole from its logs: the pole alone, then the whole in MuJoCo.

    Example: afl-mujoco identify logs/*.csv --description my-rig.toml --out renders/my-rig

    Writes identify.json, estimates.json for `afl-mujoco hardware`, and identified.toml, the
    cart-pole as a scenario for every other command. Takes a minute or two for 40 logs of 5 s.
    """

    logs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG ...]")] = ()
    """Logs, CSV files or folders of them; by default the recordings that come with the package."""
    description: str | None = None
    """TOML file that says what their columns mean and what is known about the cart-pole; required
    for your own logs."""


class Request(NamedTuple):
    """What is identified."""

    logs: Sequence[Log]
    description: Description


def prepare(options: Options) -> Request:
    """Return the logs and what they mean, or raise."""
    from afl_mujoco.identification.prediction import FIT, described_logs

    return Request(*described_logs(options.logs, options.description, [FIT]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """A cart-pole identified."""

    identified: Identified  # the estimates
    # the longest log beside the model; None if no drive was identified, or no log is long enough
    shown: Shown | None


def run(request: Request, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Identify the cart-pole."""
    from afl_mujoco.identification.identify import identify

    identified = identify(
        request.logs,
        request.description,
        workers=workers,
        progress=partial(progress, "identifying"),
    )
    longest = max(request.logs, key=lambda one: one.duration)
    return Result(identified=identified, shown=beside(identified, longest))


def beside(identified: Identified, log: Log) -> Shown | None:
    """Return a log beside the model; None without a drive, or if the log is too short."""
    from afl_mujoco.identification.prediction import predicted_by_rig, starts_of

    if identified.drive is None:
        return None
    try:
        starts = starts_of([log], AHEAD, AHEAD, AHEAD)
    except InvalidValueError:  # too short a log is no reason to lose what was identified
        return None
    drive, values = identified.drive, identified.values
    scatter = (drive.scatter_z or 1e-3, drive.scatter_phi)
    read, _ = predicted_by_rig(starts, values, identified.description, scatter)
    return shown_of(log, starts, read, values)


# --- what is shown ------------------------------------------------------------------------------


def report(result: Result) -> Report:
    """Return what is shown of an identification."""
    one = result.identified
    w2, k = one.find("gravity_term"), one.find("coupling")
    off = w2.value / one.description.nominal.gravity_term - 1.0
    headline = (
        f"{one.description.name}: w2 = {short(w2.value)} 1/s², {percent(off, 2)} off that of its "
        f"rod · k = {short(k.value)}, {percent(k.value - 1.0, 2)} off that of a rigid body"
    )
    blocks: list[Block] = []
    if result.shown is not None:
        blocks.append(
            Figure(
                name="identify-log",
                title=f"{result.shown.name}, measured and simulated",
                caption="Dots: measured. Lines: MuJoCo under the recorded command, each from a "
                "state that was fitted to the half second before it.",
                draw=partial(draw_shown, result.shown),
            )
        )
    blocks.append(estimates_matrix("The pole and the sensors", one.pole.estimates))
    if one.drive is None:
        blocks.append("The command is constant in every log: cart and drive cannot be identified.")
    else:
        blocks += [estimates_matrix("Cart and drive", one.drive.estimates), physical_matrix(one)]
    blocks += [_fit(one), _correlations(one)]
    if one.drive is not None:
        blocks.append(
            f"{code(f'afl-mujoco compare {SCENARIO} --controllers lqr adaptive')} runs controllers "
            f"on it; {code('afl-mujoco hardware --estimates')} reads {code(ESTIMATES)}."
        )
    return Report(headline=headline, blocks=blocks)


def _fit(one: Identified) -> Matrix:
    """Return what was fitted to what, and how well."""
    count = one.description.angle_count
    few = len(one.logs) < FEW_CLUSTERS
    rows = [
        ["Logs", str(len(one.logs))],
        ["Their duration [s]", short(one.seconds, 3)],
        ["Period of their rows [ms]", short(1e3 * one.period)],
        [f"Windows of at most {short(WINDOW)} s", str(one.pole.windows)],
        ["Share of the duration in windows", percent(one.share, 3)],
        ["Stretches between lost rows that are in none", str(one.dropped)],
        ["Taken as independent", "windows: too few logs, so too narrow" if few else "logs"],
        ["Residual of φ, pole alone [mrad]", short(1e3 * one.pole.scatter_phi, 3)],
    ]
    if count:
        rows.append(["The same in counts", short(one.pole.scatter_phi / count, 2)])
    if one.drive is not None:
        rows += [
            ["Residual of φ, whole cart-pole [mrad]", short(1e3 * one.drive.scatter_phi, 3)],
            ["Residual of z, whole cart-pole [mm]", short(1e3 * (one.drive.scatter_z or 0.0), 2)],
        ]
    if "sin_1" in one.values:
        off = linearity(one.values, np.linspace(-np.pi, np.pi, 1000))
        most = float(np.abs(off - off.mean()).max())
        rows.append(["Angle off a straight line, at most [mrad]", short(1e3 * most, 2)])
    return Matrix(caption="What was fitted", columns=["Quantity", "Value"], rows=rows)


def _correlations(one: Identified) -> Matrix:
    """Return the estimates that are known better in combination than individually."""
    titles = {x.name: x.title for step in one.steps for x in step.estimates}
    pairs = [
        pair
        for step in one.steps
        for pair in step.alike
        if not any(name.startswith(("sin_", "cos_")) for name in pair[:2])  # of its linearity
    ]
    return Matrix(
        folded="Correlated estimates",
        caption="Estimates that are known better in combination than individually",
        columns=["One", "Other", "Correlation"],
        rows=[[titles[a], titles[b], fixed(r, 2)]
              for a, b, r in sorted(pairs, key=lambda pair: -abs(pair[2]))],
    )  # fmt: skip


def require_files(folder: Path) -> None:
    """Raise if a folder is in the way of the files that other commands read."""
    require_no_folder(folder, (ESTIMATES, SCENARIO))


def write_files(result: Result, folder: Path) -> list[Path]:
    """Write the estimates, and the scenario if a drive was identified."""
    from afl_mujoco.identification.export import scenario_of
    from afl_mujoco.scenario.files import save_scenario

    write_json(folder / ESTIMATES, result.identified)
    remove_file(folder / SCENARIO)
    if result.identified.drive is None:
        return [folder / ESTIMATES]
    save_scenario(scenario_of(result.identified), folder / SCENARIO)
    return [folder / ESTIMATES, folder / SCENARIO]


STUDY = Study(
    name="identify",
    title="A cart-pole identified",
    order=80,
    schema=1,
    configuration=Options,
    prepare=prepare,
    run=run,
)
