"""Identify a cart-pole from its logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from afl_mujoco.errors import InvalidValueError
from afl_mujoco.files import remove_file, require_no_folder, write_json
from afl_mujoco.identification.description import Description
from afl_mujoco.identification.identify import Identified, identify
from afl_mujoco.identification.least_squares import FEW_CLUSTERS, Estimate
from afl_mujoco.identification.log import Log
from afl_mujoco.identification.prediction import FIT, described_logs, predicted_by_rig, starts_of
from afl_mujoco.report.blocks import MISSING, Block, Figure, Matrix, Report, percent, short
from afl_mujoco.studies.shared.contract import Progress, Study, silent
from afl_mujoco.studies.shared.identified_parts import AHEAD, Shown, draw_log, shown_of

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


Request = tuple[Sequence[Log], Description]


def prepare(options: Options) -> Request:
    """Return the logs and what they mean, or raise."""
    return described_logs(options.logs, options.description, [FIT])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """A cart-pole identified."""

    identified: Identified  # the estimates
    # the longest log beside the model; None if no drive was identified, or no log is long enough
    shown: Shown | None


def run(request: Request, *, progress: Progress = silent, workers: int = 1) -> Result:
    """Identify the cart-pole."""
    (logs, description), told = request, partial(progress, "identifying")
    identified = identify(logs, description, workers=workers, progress=told)
    longest = max(logs, key=lambda one: one.duration)
    return Result(identified=identified, shown=beside(identified, longest))


def beside(identified: Identified, log: Log) -> Shown | None:
    """Return a log beside the model; None without a drive, or if the log is too short."""
    try:
        starts, scatter = starts_of([log], AHEAD, AHEAD, AHEAD), identified.scatter()
    except InvalidValueError:  # neither is a reason to lose what was identified
        return None
    read = predicted_by_rig(starts, identified.values, identified.description, scatter)
    return shown_of(log, starts, read, identified.values)


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
        figure = Figure(
            name="identify-log",
            title=f"{result.shown.name}, measured and simulated",
            caption="Dots: measured. Lines: MuJoCo under the recorded command, each from a state "
            "that was fitted to the half second before it.",
            draw=partial(draw_log, result.shown),
        )
        blocks.append(figure)
    blocks.append(_estimates(one))
    blocks += _remarks(one)
    return Report(headline=headline, blocks=blocks)


NOT_LINEAR = 2.0
"""Times what the pole leaves of the angle that the whole may leave: its drive is taken as linear in
the command."""
NOISE, OFF = 2.5, 0.01
"""Scatter that the pole alone may leave of the angle, in resolutions, before something else than
its reading shows; and how far k may be from 1, that of a rigid pole."""
SLOW = 0.15
"""Time between rows, in time constants of the pole, beyond which intervals are too narrow: between
rows a held command moves the cart in a way that no interpolation of its readings follows."""


def _remarks(one: Identified) -> list[Block]:
    """Say what the estimates do not show of the logs."""
    slow = one.period * math.sqrt(one.find("gravity_term").value)
    said: list[Block] = [
        f"Rows are {short(1e3 * one.period, 3)} ms apart, which is slow for this pole: the "
        "intervals of skew, dry friction of the hinge, compliance, k, delay and lag are too narrow."
    ] * (slow > SLOW)
    count, left, k = one.description.phi.count, one.pole.scatter_phi, one.find("coupling")
    if count > 0.0 and left > NOISE * count:
        said.append(
            f"The pole alone leaves {short(left / count, 2)} resolutions of the angle: unless its "
            "sensor is as noisy, the scale of the angle or the hinge is not as described, and "
            "estimates of the pole may be off by more than their intervals."
        )
    if not k.low <= 1.0 <= k.high and abs(k.value - 1.0) > OFF:
        said.append(
            f"k is {short(k.value, 3)}, and 1 for a rigid pole: the scale of the position is off "
            "by as much, or that of the angle, and with it force and acceleration of the command."
        )
    said += [
        f"The {x.title} is on the largest value that is tried: the drive is not as modelled, or "
        "the guesses under [nominal] are far off."
        for x in (one.drive.estimates if one.drive else ())
        if x.name in ("delay", "lag") and x.on_bound and x.value > 0.0
    ]
    if one.drive is None:
        said.append("The command is constant in every log: cart and drive cannot be identified.")
    elif (times := one.drive.scatter_phi / one.pole.scatter_phi) > NOT_LINEAR:
        said.append(
            f"The whole leaves {short(times, 2)} times as much of the angle as the pole alone: the "
            "drive is not as modelled, which has neither a dead zone nor a saturation, or the "
            "guesses under [nominal] are far off; estimates of cart and drive may be, too."
        )
    return said


def _estimates(one: Identified) -> Matrix:
    n = one.description.nominal
    given = {
        "half_length": n.half_length, "cart_mass": n.cart_mass, "force": n.force,
        "rail_damping": n.rail_damping, "hinge_damping": n.hinge_damping,
    }  # fmt: skip
    few = "; the intervals are too narrow: too few logs" * (len(one.logs) < FEW_CLUSTERS)
    found = [x for step in one.steps for x in step.estimates]
    d, steps = one.description, zip(("pole alone", "whole"), one.steps, strict=False)
    left = [
        [f"scatter left of the {signal}, {step}", unit, short(sensor.count), short(x), MISSING]
        for step, fit in steps
        for signal, unit, sensor, x in (("angle", "rad", d.phi, fit.scatter_phi),
                                        ("position", "m", d.z, fit.scatter_z))
        if x is not None
    ]  # fmt: skip
    return Matrix(
        caption=f"From {len(one.logs)} {'logs' if len(one.logs) > 1 else 'log'}, "
        f"{percent(one.share, 3)} of their {short(one.seconds, 3)} s, for a pole of "
        f"{short(n.pole_mass)} kg{few}",
        columns=["Quantity", "Unit", "Given", "Identified", "95 % interval"],
        rows=[
            *([x.title, x.unit, short(given.get(x.name)), *_told(x)]
              for x in (*found, *one.physical)
              if not x.name.startswith(("sin_", "cos_"))),  # harmonics of the linearity
            *left,
        ],
    )  # fmt: skip


def _told(one: Estimate) -> tuple[str, str]:
    """Return an estimate and its interval, with so many digits that its ends differ in two."""
    width, size = one.high - one.low, max(abs(one.low), abs(one.high))
    digits = max(4, 2 + math.ceil(math.log10(size / width))) if 0.0 < width < math.inf else 4
    low, value, high = (short(x, digits) for x in (one.low, one.value, one.high))
    return value, "on its bound" if one.on_bound else f"{low} to {high}"


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


STUDY = Study(module=__name__, name="identify", title="A cart-pole identified", order=80, schema=1)
