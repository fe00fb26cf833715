"""What a comparison found: every run with its metrics, its requirements and its curves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from afl_mujoco.errors import UnknownNameError
from afl_mujoco.scenario.scenario import Scenario
from afl_mujoco.simulation.judgement import JudgedRun
from afl_mujoco.studies.arrays import Array

_ROW = ("scenario", "controller", "draw", "outcome", "failure", "settled")


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedRun(JudgedRun):
    """One controller on one scenario.

    Attributes
    ----------
    metrics
        Its metrics, as in `simulation.metrics`; empty if the controller failed.
    remarks
        What a reader should know about it, a sentence each.
    """

    metrics: Mapping[str, float | None]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """A run over time: instants [s], states, shape (N, 4), exerted forces and commands [N]."""

    time: Array
    state: Array
    force: Array
    command: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmRequest:
    """Controllers as they were requested."""

    controllers: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Result:
    """Controllers compared.

    Attributes
    ----------
    scenarios
        The scenarios.
    runs
        Runs of every scenario with every controller, draw by draw.
    curves
        The first draw of each over time, by ``scenario/controller``; missing if the controller
        failed.
    timestep, control_period, integrator
        How they were deployed; a period of None means that of the scenario, else one step.
    film
        What to film, as it was requested; None if no film was.
    """

    scenarios: tuple[Scenario, ...]
    runs: tuple[ComparedRun, ...]
    curves: Mapping[str, Curves] = field(default_factory=dict)
    timestep: float | None
    control_period: float | None
    integrator: str
    film: FilmRequest | None = None

    def __post_init__(self) -> None:
        """Raise if the parts contradict each other."""
        names = {scenario.name for scenario in self.scenarios}
        if not self.runs or {run.scenario for run in self.runs} != names:
            raise ValueError("runs must be those of the scenarios")
        known = {f"{run.scenario}/{run.controller}" for run in self.runs}
        if unknown := self.curves.keys() - known:
            raise ValueError(f"curves must be those of the runs, got {min(unknown)!r}")

    @property
    def passed(self) -> bool:
        """Whether every run meets every requirement."""
        return not any(run.missed for run in self.runs)

    @property
    def table(self) -> list[dict[str, Any]]:
        """How each run ended and its metrics, one row each, ready for pandas."""
        return [
            {
                **{name: getattr(run, name) for name in _ROW},
                **run.metrics,
            }
            for run in self.runs
        ]

    @property
    def requirements(self) -> list[dict[str, Any]]:
        """Each run judged by each requirement, one row each, ready for pandas."""
        return [
            {
                "scenario": run.scenario,
                "controller": run.controller,
                "draw": run.draw,
                **asdict(one),
                "relative": one.relative,
                "unit": one.unit,
                "met": one.met,
            }
            for run in self.runs
            for one in run.requirements
        ]

    def plot(self, scenario: str | None = None) -> Any:
        """Draw the runs of a scenario, the first by default; return the matplotlib figure."""
        from afl_mujoco.studies.compare.figures import draw_responses

        by_name = {one.name: one for one in self.scenarios}
        name = next(iter(by_name)) if scenario is None else scenario
        if name not in by_name:
            raise UnknownNameError.among("scenario", name, by_name)
        return draw_responses(by_name[name], self.curves_on(by_name[name]))

    def __repr__(self) -> str:
        """Summarise the outcome in one line."""
        names = ", ".join(dict.fromkeys(run.controller for run in self.runs))
        missed = sum(len(run.missed) for run in self.runs)
        total = sum(len(run.requirements) for run in self.runs)
        on = ", ".join(scenario.name for scenario in self.scenarios)
        return f"<{names} on {on}: {total - missed} of {total} requirements met>"

    def __str__(self) -> str:
        """Return who meets the requirements, and how much of each is left, as text."""
        from afl_mujoco.document.terminal import to_text
        from afl_mujoco.studies.compare.sections import judged_blocks

        return to_text(judged_blocks(self))

    def _repr_markdown_(self) -> str:
        """Return the same as Markdown, for a notebook."""
        from afl_mujoco.document.markdown import as_paragraph
        from afl_mujoco.studies.compare.sections import judged_blocks

        return "\n\n".join(map(as_paragraph, judged_blocks(self)))

    def runs_on(self, scenario: Scenario, draw: int | None = None) -> list[ComparedRun]:
        """Return the runs of a scenario, or those of one draw."""
        found = [run for run in self.runs if run.scenario == scenario.name]
        return [run for run in found if draw is None or run.draw == draw]

    def curves_on(self, scenario: Scenario) -> dict[str, Curves]:
        """Return the curves of a scenario by controller."""
        keys = {run.controller: f"{scenario.name}/{run.controller}" for run in self.runs}
        return {name: self.curves[key] for name, key in keys.items() if key in self.curves}
