"""A Monte Carlo campaign in figures: the rates, and on which rigs the failures lie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from afl_mujoco.document.style import (
    BLACK,
    BLUE,
    CONTROLLERS,
    GREEN,
    ORANGE,
    PURPLE,
    VERMILION,
    Drawn,
    new_figure,
    styled,
)
from afl_mujoco.validation.montecarlo.campaign import Campaign
from afl_mujoco.validation.montecarlo.rates import CONFIDENCE, Rate
from afl_mujoco.validation.montecarlo.traits import most_telling, traits_of

PANELS, COLUMNS, BINS = 6, 3, 5

_SPARE = (VERMILION, PURPLE, BLACK, GREEN, ORANGE, BLUE)
_MARKERS = "osD^vP"
_LEVEL = f"{100 * CONFIDENCE:g} %"


def draw_montecarlo(campaign: Campaign) -> list[Drawn]:
    """Draw the rates, and where the failures lie if there are any.

    Parameters
    ----------
    campaign
        The campaign.
    """
    drawn = [draw_rates(campaign)]
    if any(campaign.failures(name) for name in campaign.trials):
        drawn.append(draw_failures(campaign))
    return drawn


@styled()
def draw_rates(campaign: Campaign) -> Drawn:
    """Draw how often each controller stays up, and settles, with the intervals.

    Parameters
    ----------
    campaign
        The campaign.
    """
    names, colours = list(campaign.trials), colours_of(campaign.trials)
    figure = new_figure(7.5, 1.3 + 0.55 * len(names))
    axis = figure.subplots()
    for row, name in enumerate(names):
        for rate, up in ((campaign.survival(name), True), (campaign.settling(name), False)):
            place = row + (-0.14 if up else 0.14)
            low, high = (100.0 * x for x in rate.interval)
            face = colours[name] if up else "white"
            axis.plot([low, high], [place, place], color=colours[name], linewidth=2.2)
            axis.plot(
                100.0 * rate.share, place, "o", color=colours[name], markersize=7.0,
                markerfacecolor=face,
            )  # fmt: skip
            words = f"{'stays up' if up else 'settles'} {100.0 * rate.share:.1f} %"
            right = high > 78.0  # no room to the right
            axis.annotate(
                words, (low if right else high, place), textcoords="offset points",
                xytext=(-6.0 if right else 6.0, 0.0), va="center", fontsize=8.0,
                ha="right" if right else "left",
            )  # fmt: skip
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_xlim(-1.0, 101.0)
    axis.set_xlabel("share of the rigs [%]")
    axis.grid(visible=False, axis="y")
    said = "; ".join(
        f"{name} stays up on {_words(campaign.survival(name))} and settles on "
        f"{_words(campaign.settling(name))}"
        for name in names
    )
    return Drawn(
        name="montecarlo-rates",
        title="How often each controller survives a laboratory rig",
        caption=f"{campaign.samples} rigs drawn at random, the same for every controller. Filled: "
        f"the pole stays up for {campaign.space.duration:g} s; hollow: z and φ also settle. Bars "
        f"are exact (Clopper-Pearson) {_LEVEL} intervals.",
        alt=f"Shares with intervals: {said}.",
        figure=figure,
    )


@styled()
def draw_failures(campaign: Campaign) -> Drawn:
    """Draw the failure rate over the traits of a rig that tell failures from survivors most.

    Parameters
    ----------
    campaign
        The campaign, with a failure.
    """
    traits = traits_of(campaign)
    failed = {
        name: np.array([not trial.survived for trial in found])
        for name, found in campaign.trials.items()
    }
    chosen = most_telling(traits, list(failed.values()), PANELS)
    figure = new_figure(10.5, 6.0)
    panels = figure.subplots(PANELS // COLUMNS, COLUMNS, sharey=True)
    for axis, trait in zip(panels.flat, chosen, strict=True):
        _draw_trait(axis, traits[trait], failed)
        axis.set_xlabel(trait)
    for axis in panels[:, 0]:
        axis.set_ylabel("failures [% of the rigs]")
    panels[0, 0].set_ylim(bottom=-0.03 * panels[0, 0].get_ylim()[1])  # room for a point at zero
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    counts = ", ".join(f"{name} {int(bad.sum())}" for name, bad in failed.items())
    return Drawn(
        name="montecarlo-failures",
        title="On which rigs the failures lie",
        caption=f"Share of the rigs on which the pole does not stay up, in {BINS} bins of as many "
        f"rigs each, with exact {_LEVEL} intervals; a bin's point stands at its median. Of "
        f"{len(traits)} traits of a rig, the {len(chosen)} whose distributions differ most "
        "between failures and survivors. They were chosen by the same samples, and the intervals "
        "are of each bin alone: read them as a hint where to look.",
        alt=f"Failure rates over {', '.join(chosen)}. Failures: {counts}, of {campaign.samples}.",
        figure=figure,
    )


def _draw_trait(
    axis: Axes, values: NDArray[np.float64], failed: Mapping[str, NDArray[np.bool_]]
) -> None:
    """Draw the failure rate of each controller over one trait."""
    bins = [part for part in np.array_split(np.argsort(values, kind="stable"), BINS) if len(part)]
    medians = np.array([np.median(values[part]) for part in bins])
    shift = 0.012 * float(np.ptp(values))
    colours = colours_of(failed)
    for row, (name, bad) in enumerate(failed.items()):
        rates = [Rate(int(bad[part].sum()), len(part)) for part in bins]
        shares = np.array([100.0 * rate.share for rate in rates])
        ends = 100.0 * np.array([rate.interval for rate in rates]).T
        axis.errorbar(
            medians + shift * (row - 0.5 * (len(failed) - 1)), shares,
            yerr=np.abs(ends - shares), color=colours[name], marker=_MARKERS[row % len(_MARKERS)],
            markersize=5.0, linewidth=1.2, elinewidth=1.2, capsize=2.5, label=name,
        )  # fmt: skip


def colours_of(names: Mapping[str, object] | Sequence[str]) -> dict[str, str]:
    """Return a colour for each controller, the usual one where it has one, each its own.

    Parameters
    ----------
    names
        Of the controllers.
    """
    known = {name: CONTROLLERS[name] for name in names if name in CONTROLLERS}
    spare = [colour for colour in _SPARE if colour not in known.values()]
    others = [name for name in names if name not in known]
    return known | {name: spare[i % len(spare)] for i, name in enumerate(others)}


def _words(rate: Rate) -> str:
    """Return a rate as a sentence has it."""
    low, high = (100.0 * x for x in rate.interval)
    return f"{100.0 * rate.share:.1f} % ({low:.1f} to {high:.1f})"
