"""How a benchmark says what it measured beside its aim; `benchmarks/__main__.py` reads it."""

from __future__ import annotations

import re
import statistics
from collections.abc import Sequence

LINE = re.compile(r"^  (.+?) +(\S+)  aim (at \S+ \S+|-) +(yes|NO|-)$")


def median_ratio(above: Sequence[float], below: Sequence[float]) -> float:
    """Return the median over the repeats of the ratio within one."""
    return statistics.median(a / b for a, b in zip(above, below, strict=True))


def say(what: str, value: float, *, least: float | None = None, most: float | None = None) -> None:
    """Print a measured number, its aim if there is one, and whether it holds."""
    aim, holds = "-", "-"
    if least is not None:
        aim, holds = f"at least {least:g}", "yes" if value >= least else "NO"
    if most is not None:
        aim, holds = f"at most {most:g}", "yes" if value <= most else "NO"
    print(f"  {what:<74} {value:>7.2f}  aim {aim:<13} {holds}", flush=True)
