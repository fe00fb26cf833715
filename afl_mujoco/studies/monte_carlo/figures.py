"""A Monte Carlo campaign in figures: the rates, and where the failures lie."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from afl_mujoco.document.style import BLACK, colours, new_figure
from afl_mujoco.studies.monte_carlo.features import features_of, most_separating
from afl_mujoco.studies.monte_carlo.rates import Rate
from afl_mujoco.studies.monte_carlo.result import QUANTILES, Result

PANELS, COLUMNS, BINS = 6, 3, 5

_MARKERS = "osD^vP"


def draw_rates(result: Result) -> Figure:
    """Draw how often each controller passes and settles, with intervals."""
    passes = "meets all" if result.judged else "survives"
    names = [rates.controller for rates in result.controllers]
    found = colours(names)
    figure = new_figure(7.5, 1.3 + 0.55 * len(names))
    axis = figure.subplots()
    for row, rates in enumerate(result.controllers):
        colour = found[rates.controller]
        for rate, up in ((rates.success, True), (rates.settling, False)):
            place = row + (-0.14 if up else 0.14)
            low, high = (100.0 * x for x in rate.interval)
            axis.plot([low, high], [place, place], color=colour, linewidth=2.2)
            axis.plot(
                100.0 * rate.share, place, "o", color=colour, markersize=7.0,
                markerfacecolor=colour if up else "white",
            )  # fmt: skip
            words = f"{passes if up else 'settles'} {100.0 * rate.share:.1f} %"
            right = high > 78.0  # no room to the right
            axis.annotate(
                words, (low if right else high, place), textcoords="offset points",
                xytext=(-6.0 if right else 6.0, 0.0), va="center", fontsize=8.0,
                ha="right" if right else "left",
            )  # fmt: skip
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_xlim(-1.0, 101.0)
    axis.set_xlabel("share of the samples [%]")
    axis.grid(visible=False, axis="y")
    return figure


def draw_margins(result: Result) -> Figure:
    """Draw quantiles of the least margin of each controller's runs."""
    names = [rates.controller for rates in result.controllers]
    found = colours(names)
    figure = new_figure(7.5, 1.2 + 0.45 * len(names))
    axis = figure.subplots()
    axis.axvline(0.0, color=BLACK, linewidth=0.9)
    for row, rates in enumerate(result.controllers):
        if rates.margins:
            at = dict(zip(QUANTILES, (100.0 * x for x in rates.margins), strict=True))
            colour = found[rates.controller]
            axis.plot([at[0.05], at[0.95]], [row, row], color=colour, linewidth=1.2)
            axis.plot([at[0.25], at[0.75]], [row, row], color=colour, linewidth=5.0)
            axis.plot(at[0.5], row, "o", color=colour, markersize=8.0, markeredgecolor="white")
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_xlabel("least margin [% of the limit]; larger is better")
    axis.grid(visible=False, axis="y")
    return figure


def failed_by_controller(result: Result) -> dict[str, NDArray[np.bool_]]:
    """Return for each controller whether it did not pass each sample, shape (samples,)."""
    found = {}
    for rates in result.controllers:
        found[rates.controller] = np.zeros(result.samples, dtype=np.bool_)
        found[rates.controller][[failure.index for failure in rates.failures]] = True
    return found


def separating_features(result: Result) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Return every feature of every sample, and which separate failures from survivors best."""
    features = features_of(result.space, result.samples, result.seed)
    failed = list(failed_by_controller(result).values())
    return features, most_separating(features, failed, PANELS)


def draw_failures(result: Result) -> Figure:
    """Draw the failure rate over the features that separate failures from survivors best."""
    features, chosen = separating_features(result)
    failed = failed_by_controller(result)
    columns = min(COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = new_figure(3.5 * columns if columns > 1 else 5.0, 0.6 + 2.7 * rows)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for axis, feature in zip(panels.flat, chosen, strict=False):
        _draw_feature(axis, features[feature], failed)
        axis.set_xlabel(feature)
    for axis in panels.flat[len(chosen) :]:
        axis.set_axis_off()
    for axis in panels[:, 0]:
        axis.set_ylabel("failures [% of the samples]")
    panels[0, 0].set_ylim(bottom=-0.03 * panels[0, 0].get_ylim()[1])  # room for a point at zero
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def _draw_feature(
    axis: Axes, values: NDArray[np.float64], failed: Mapping[str, NDArray[np.bool_]]
) -> None:
    """Draw the failure rate of each controller over one feature."""
    bins = [part for part in np.array_split(np.argsort(values, kind="stable"), BINS) if len(part)]
    medians = np.array([np.median(values[part]) for part in bins])
    shift = 0.012 * float(np.ptp(values))
    found = colours(failed)
    for row, (name, bad) in enumerate(failed.items()):
        rates = [Rate(int(bad[part].sum()), len(part)) for part in bins]
        shares = np.array([100.0 * rate.share for rate in rates])
        ends = 100.0 * np.array([rate.interval for rate in rates]).T
        axis.errorbar(
            medians + shift * (row - 0.5 * (len(failed) - 1)), shares,
            yerr=np.abs(ends - shares), color=found[name], marker=_MARKERS[row % len(_MARKERS)],
            markersize=5.0, linewidth=1.2, elinewidth=1.2, capsize=2.5, label=name,
        )  # fmt: skip
