"""Where the results come from that the pages rest on."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from afl_mujoco.studies.shared.contract import find_study

ROOT = Path(__file__).resolve().parent.parent

MADE = ROOT / "renders" / "results"
"""Where the studies write all that they write; the pages need only a part of it."""

RESEARCH = {"readings": "make readings", "optimisers": "python -m research.optimisers"}
"""Modules of ``research`` and their commands."""

CHEAP = 3.0
"""Minutes up to which a result is cheap enough for every CI run."""


@dataclass(frozen=True, slots=True)
class Source:
    """What makes a result.

    Attributes
    ----------
    name
        Of the study, the benchmark, the example or the module of ``research``.
    minutes
        That it takes on two cores.
    words
        Behind it on the command line.
    """

    name: str
    minutes: float
    words: tuple[str, ...] = ()

    @property
    def script(self) -> str:
        """The script whose output is kept as it is printed, empty if a study is run."""
        folders = ("benchmarks",) if self.name.startswith("bench_") else ("examples", "docs")
        there = (path for x in folders if (ROOT / (path := f"{x}/{self.name}.py")).is_file())
        return next(there, "")

    @property
    def research(self) -> bool:
        """Whether a module of ``research`` makes it."""
        return self.name in RESEARCH

    @property
    def command(self) -> str:
        """What makes it, as typed into a shell."""
        if self.research:
            return RESEARCH[self.name]
        first = f"python {self.script}" if self.script else f"afl-mujoco {self.name}"
        return shlex.join([*first.split(), *self.words])

    @property
    def file(self) -> str:
        """The file of ``docs/results``."""
        if self.script:
            return f"{self.name}.txt"
        return f"{self.name if self.research else find_study(self.name).stem}.json"

    @property
    def cheap(self) -> bool:
        """Whether CI makes it anew."""
        return self.minutes <= CHEAP and not self.timed

    @property
    def timed(self) -> bool:
        """Whether it prints times, which differ from machine to machine."""
        return self.name.startswith("bench_")


SOURCES = (
    Source("quickstart", 1),
    Source("tutorial", 1),
    Source("validate", 2, ("--full",)),
    Source("estimation", 0.5),
    Source("readings", 25),
    Source("optimisers", 8),
    Source("margins", 1),
    Source("hardware", 2),
    Source("identify", 2),
    Source("attraction", 7),
    Source("thresholds", 12),
    Source("montecarlo", 6),
    Source("bench_gymnasium", 2),
    Source("bench_estimator", 3),
    Source("bench_estimator_candidates", 3),
    Source("bench_gain_functions", 3),
    Source("bench_equal_effort", 40),
    Source("bench_batch", 3),
    Source("bench_failure_causes", 3, (str(MADE.relative_to(ROOT)),)),
    Source("bench_montecarlo", 5),
    Source("bench_identification", 20, ("--rigs", "12", "--dry", "6")),
    Source("bench_mpc", 30),  # last: it needs CasADi, which the set-up does not install
)
