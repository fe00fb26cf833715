"""Maps of attraction as a table on the terminal: the shares, and how many cells disagree."""

from __future__ import annotations

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from afl_mujoco.simulation.attraction.cells import OUTCOMES
from afl_mujoco.validation.attraction.comparison import Comparison

SIDES = {"ode": "equations", "mujoco": "MuJoCo"}


def print_attraction(comparisons: Sequence[Comparison], console: Console | None = None) -> None:
    """Print two rows for each comparison: by the equations, in MuJoCo.

    Parameters
    ----------
    comparisons
        The maps.
    console
        Where; the terminal by default.
    """
    table = Table(box=SIMPLE_HEAD, title="how rollouts end, in % of the cells")
    for title in ("map", "controller", "by"):
        table.add_column(title)
    for title in (*OUTCOMES, "differ", "on a border", "inside", "of cells"):
        table.add_column(title, justify="right")
    for comparison in comparisons:
        content = comparison.to_dict()
        for side, name in SIDES.items():
            first = side == "ode"
            shares = [f"{100.0 * content[side]['shares'][outcome]:.2f}" for outcome in OUTCOMES]
            counts = [content["disagreement"][key] for key in ("differ", "on_border", "inside")]
            table.add_row(
                content["plane"] if first else "",
                content["controller"] if first else "",
                name,
                *shares,
                *("" if first else str(n) for n in (*counts, content["cells"])),
            )
    (console or Console()).print(table)
