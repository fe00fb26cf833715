"""Where the results come from that the pages rest on."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

MADE = ROOT / "renders" / "results"
"""Where the studies write all that they write; the pages need only a part of it."""

CHEAP = 3.0
"""Minutes up to which a result is cheap enough for every CI run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """What makes a result.

    Attributes
    ----------
    name
        Of the study or the benchmark.
    words
        Behind it on the command line.
    minutes
        That it takes on two cores.
    stem
        Of the files that are kept.
    """

    name: str
    words: tuple[str, ...] = ()
    minutes: float
    stem: str

    @property
    def benchmark(self) -> bool:
        """Whether what it prints is kept: its times differ from machine to machine."""
        return self.name.startswith("bench_")

    @property
    def command(self) -> str:
        """What makes it, as typed into a shell."""
        first = f"python benchmarks/{self.name}.py" if self.benchmark else f"afl-mujoco {self.name}"
        return shlex.join([*first.split(), *self.words])

    @property
    def file(self) -> str:
        """The file of ``docs/results``."""
        return f"{self.stem}.{'txt' if self.benchmark else 'json'}"

    @property
    def cheap(self) -> bool:
        """Whether CI makes it anew."""
        return self.minutes <= CHEAP and not self.benchmark


def _study(name: str, *words: str, minutes: float, stem: str = "") -> Source:
    """Return a study."""
    return Source(name=name, words=words, minutes=minutes, stem=stem or name)


def _benchmark(name: str, *words: str, minutes: float) -> Source:
    """Return a benchmark."""
    return Source(name=f"bench_{name}", words=words, minutes=minutes, stem=f"bench_{name}")


SOURCES = (
    _study("validate", "--full", minutes=2, stem="report"),
    _study("estimation", minutes=0.5),
    _study("margins", minutes=1),
    _study("hardware", minutes=2),
    _study("identify", minutes=2),
    _study("attraction", minutes=7),
    _study("thresholds", minutes=12),
    _study("montecarlo", minutes=8),
    _benchmark("gymnasium", minutes=2),
    _benchmark("estimator", minutes=3),
    _benchmark("estimator_candidates", minutes=3),
    _benchmark("gain_functions", minutes=3),
    _benchmark("batch", minutes=3),
    _benchmark("failure_causes", str(MADE.relative_to(ROOT)), minutes=3),
    _benchmark("montecarlo", minutes=5),
    _benchmark("identification", minutes=15),
)
