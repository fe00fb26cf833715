"""The gain table: the paper's search on each of its 400 plants, as independent units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from afl_mujoco.control.gain_function import GAIN_NAMES
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario.parameters import NOMINAL, require_positive
from afl_mujoco.studies.gain_tuning.gain_cost import GAIN_BOX, HORIZON, gain_cost, paper_scales
from afl_mujoco.studies.gain_tuning.genetic import minimise
from afl_mujoco.studies.gain_tuning.settings import Box, GeneticSettings, require_seed

_PACKAGES = ("afl_mujoco", "mujoco", "numba", "numpy")

QUICK_MASSES, QUICK_LENGTHS = (0.1, 1.0, 2.0), (0.05, 0.5, 1.0)
QUICK_SETTINGS = GeneticSettings(population_size=200, generations=60)
"""A small grid and budget."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairSearch:
    """One unit of the table: the search on one plant.

    Attributes
    ----------
    cart_mass, half_length
        M [kg] and l [m].
    settings, box
        Settings and box of the search.
    seed
        Seed of the table, and of the unit within it.
    checkpoint
        File that the search writes as it runs and resumes from; ``None`` to write none.
    """

    cart_mass: float
    half_length: float
    settings: GeneticSettings
    box: Box
    seed: tuple[int, int]
    checkpoint: Path | None = None


def pair_searches(
    cart_masses: Sequence[float],
    half_lengths: Sequence[float],
    settings: GeneticSettings,
    seed: int,
    *,
    box: Box = GAIN_BOX,
    checkpoints: Path | None = None,
) -> list[PairSearch]:
    """Return the units of a table, half-lengths first, each seeded by its position.

    Parameters
    ----------
    cart_masses, half_lengths
        The grid: M [kg] and l [m].
    """
    grid = {"cart mass": cart_masses, "half-length": half_lengths}
    for name, values in grid.items():
        if not values:
            raise InvalidValueError(f"{name} of the grid", "must have at least one value")
        for value in values:
            require_positive(f"{name} of the grid", value)
            if list(values).count(value) > 1:
                raise InvalidValueError(f"{name} of the grid", "must differ", f"{value} twice")
    require_seed(seed)
    for gene, bound in zip(GAIN_NAMES, box.lower, strict=True):
        require_positive(f"lower bound of {gene}", bound)
    stiffest = np.array([[box.upper[0], box.upper[1], box.lower[2]]])
    gain_cost(cart_masses[0], min(half_lengths))(stiffest)  # refuses what would never finish
    pairs = [(mass, length) for length in half_lengths for mass in cart_masses]
    return [
        PairSearch(
            cart_mass=mass,
            half_length=length,
            settings=settings,
            box=box,
            seed=(seed, index),
            checkpoint=checkpoints and checkpoints / f"pair-{index:04d}-M{mass:g}-l{length:g}",
        )
        for index, (mass, length) in enumerate(pairs)
    ]


def search_pair(unit: PairSearch) -> list[float]:
    """Run one unit and return its row of the table."""
    found = minimise(
        gain_cost(unit.cart_mass, unit.half_length),
        unit.box,
        unit.settings,
        unit.seed,
        checkpoint=unit.checkpoint,
        resume=unit.checkpoint is not None,
    )
    return [unit.cart_mass, unit.half_length, *found.best.tolist(), found.cost]


def table_provenance(units: Sequence[PairSearch]) -> dict[str, Any]:
    """Return what decides the table, as plain data: grid, settings, box, seed and versions."""
    first = units[0]
    return {
        "cart_masses": list(dict.fromkeys(unit.cart_mass for unit in units)),
        "half_lengths": list(dict.fromkeys(unit.half_length for unit in units)),
        "pole_mass": NOMINAL.pole_mass,
        "gravity": NOMINAL.gravity,
        "horizon": HORIZON,
        "scales": asdict(paper_scales()),
        "settings": asdict(first.settings),
        "box": {"lower": list(first.box.lower), "upper": list(first.box.upper)},
        "seed": first.seed[0],
        "versions": {name: version(name) for name in _PACKAGES},
    }
