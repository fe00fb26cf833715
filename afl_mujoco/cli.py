"""The command line: reads arguments, calls the floors below, turns errors into exit codes."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from afl_mujoco.errors import AflMujocoError, UnknownNameError

if TYPE_CHECKING:
    from afl_mujoco.control.controllers import Controller
    from afl_mujoco.scenario.scenario import Scenario
    from afl_mujoco.simulation.trajectory import Trajectory

PROGRAM = "afl-mujoco"
SUCCESS, CHECK_FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
SIMULATORS = ("ode", "exact", "continuous", "sampled")

Names = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO ...")]
Name = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")]


@dataclass(frozen=True, kw_only=True)
class Validate:
    """Compare MuJoCo with the analytic model and give a verdict.

    Example: afl-mujoco validate step-step my-scenario.toml --controllers fixed adaptive

    Writes report.json, report.md and junit.xml. Exit code 0 if every check holds, 1 if one fails.
    """

    scenarios: Names = ()
    """Scenarios by name, or TOML files; all nine of the paper by default."""
    controllers: tuple[str, ...] = ("fixed", "adaptive")
    """Controllers by name: fixed, adaptive, fixed-nominal, adaptive-nominal."""
    gain_labels: str = "table2"
    """Reading of the paper's gain columns K and Phi: table2 or table1 (decision D2)."""
    full: bool = False
    """Add refinement studies, ledgers, a second method, and what the paper's physics leaves out."""
    timestep: float = 1e-3
    """Physics step of MuJoCo [s]."""
    control_period: float | None = None
    """How long sampled mode holds the force [s], a multiple of the timestep; one by default."""
    workers: int = min(2, os.cpu_count() or 1)
    """Processes to share the work among; the numbers do not depend on it."""
    out: Path = Path("renders/validate")
    """Folder for the report."""

    def run(self) -> int:
        """Run the campaign, write and print its report."""
        from afl_mujoco.scenario.catalogue import SCENARIOS
        from afl_mujoco.scenario.files import find_scenario

        # What is quick to check comes before what is slow to import.
        scenarios = [find_scenario(name) for name in self.scenarios or SCENARIOS]

        from rich.console import Console

        from afl_mujoco.control.controllers import find_controller
        from afl_mujoco.output import output_folder
        from afl_mujoco.reporting.tables import print_report, write_report
        from afl_mujoco.validation.campaign import require_runnable, run_campaign
        from afl_mujoco.validation.checks.closed_loop_checks import Settings

        controllers = [find_controller(name, self.gain_labels) for name in self.controllers]
        period = self.timestep if self.control_period is None else self.control_period
        settings = Settings(timestep=self.timestep, control_period=period, full=self.full)
        require_runnable(scenarios, controllers, settings, self.workers)
        folder = output_folder(self.out)
        with _progress(len(scenarios) * len(controllers)) as progress:
            report = run_campaign(
                scenarios, controllers, settings, workers=self.workers, progress=progress
            )
        files = write_report(report, folder)
        print(f"wrote {', '.join(str(file) for file in files)}")
        print_report(report, Console(width=None if sys.stdout.isatty() else 140))
        return SUCCESS if report.passed else CHECK_FAILED


@dataclass(frozen=True, kw_only=True)
class Simulate:
    """Simulate one scenario with one controller; print its metrics, write the run and a figure.

    Example: afl-mujoco simulate step-step --controller adaptive --simulator sampled --compare
    """

    scenario: Name = "nominal"
    """Scenario by name, or a TOML file."""
    controller: str = "adaptive"
    """Controller by name: fixed, adaptive, fixed-nominal, adaptive-nominal."""
    simulator: str = "sampled"
    """ode, or a mode of MuJoCo: exact, continuous, sampled."""
    compare: bool = False
    """Draw the other side as well: the ODE over a MuJoCo run, MuJoCo's exact mode over the ODE."""
    gain_labels: str = "table2"
    """Reading of the paper's gain columns K and Phi: table2 or table1 (decision D2)."""
    timestep: float = 1e-3
    """Physics step, and spacing of the reported instants [s]."""
    control_period: float | None = None
    """How long sampled mode holds the force [s], a multiple of the timestep; one by default."""
    integrator: str = "RK4"
    """MuJoCo's integrator in sampled mode: RK4, Euler, implicit, implicitfast."""
    out: Path = Path("renders/simulate")
    """Folder for the files."""

    def run(self) -> int:
        """Simulate, write the files, print the metrics."""
        from afl_mujoco.scenario.files import find_scenario, save_scenario

        scenario = find_scenario(self.scenario)
        if self.simulator not in SIMULATORS:
            raise UnknownNameError.among("simulator", self.simulator, SIMULATORS)

        from afl_mujoco.control.controllers import find_controller
        from afl_mujoco.output import output_folder
        from afl_mujoco.reporting.figures import draw_runs, save_figure
        from afl_mujoco.reporting.tables import print_metrics
        from afl_mujoco.validation.campaign import nominal_scales
        from afl_mujoco.validation.checks.closed_loop_checks import Settings
        from afl_mujoco.validation.metrics import metrics, with_objective

        controller = find_controller(self.controller, self.gain_labels)
        other = "exact" if self.simulator == "ode" else "ode"
        simulators = (self.simulator, other) if self.compare else (self.simulator,)
        runs = [self._simulate(scenario, controller, simulator) for simulator in simulators]
        folder = output_folder(self.out)
        stem = f"{scenario.name}-{controller.name}-{self.simulator}"
        runs[0].save(folder / f"{stem}.npz")
        save_scenario(scenario, folder / f"{scenario.name}.toml")
        save_figure(draw_runs(runs, f"{scenario.name}, {controller.name}"), folder / f"{stem}.png")
        scales = nominal_scales(Settings(timestep=self.timestep))
        print_metrics(
            {
                run.simulator: with_objective(metrics(scenario, controller, run), scales)
                for run in runs
            },
            {run.simulator: str(run.outcome) for run in runs},
        )
        print(f"wrote {folder / stem}.npz, {stem}.png, {scenario.name}.toml")
        return SUCCESS

    def _simulate(self, scenario: Scenario, controller: Controller, simulator: str) -> Trajectory:
        """Run one simulator."""
        from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
        from afl_mujoco.simulation.ode import simulate_ode

        if simulator == "ode":
            return simulate_ode(scenario, controller, sample_period=self.timestep)
        return simulate_mujoco(
            scenario,
            controller,
            simulator,
            timestep=self.timestep,
            control_period=self.control_period,
            integrator=self.integrator,
        )


@dataclass(frozen=True, kw_only=True)
class Regression:
    """Compare every run of the paper's scenarios with the blessed baselines.

    Example: afl-mujoco regression --workers 2

    Prints a line for each figure that moved. Exit code 0 if none did, 1 otherwise.
    """

    baselines: Path = Path("tests/regression/baselines")
    """Folder of the baselines."""
    bless: bool = False
    """Make what is now the baselines, and print what moved."""
    workers: int = min(2, os.cpu_count() or 1)
    """Processes to share the work among; the numbers do not depend on it."""

    def run(self) -> int:
        """Run everything; compare, or bless."""
        from afl_mujoco.control.controllers import CONTROLLERS
        from afl_mujoco.scenario.catalogue import SCENARIOS
        from afl_mujoco.validation.regression import (
            REGRESSED,
            bless,
            compare,
            load_baselines,
            open_for_blessing,
            record_all,
        )

        read = open_for_blessing if self.bless else load_baselines
        blessed = read(self.baselines)  # what is quick to check comes first
        scenarios = list(SCENARIOS.values())
        controllers = [CONTROLLERS[name] for name in REGRESSED]
        with _progress(len(scenarios) * len(controllers)) as progress:
            fresh = record_all(scenarios, controllers, workers=self.workers, progress=progress)
        if self.bless:
            print(*bless(self.baselines, blessed, fresh), sep="\n")
            return SUCCESS
        comparison = compare(blessed, fresh)
        print(*comparison.lines(self.baselines), sep="\n")
        return SUCCESS if comparison.passed else CHECK_FAILED


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments
        As of ``sys.argv[1:]``, its default.

    Returns
    -------
    int
        0 success, 1 a check failed, 2 bad input, 130 interrupted.
    """
    try:
        return _parse(arguments).run()
    except AflMujocoError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted", file=sys.stderr)
        return INTERRUPTED


def _parse(arguments: Sequence[str] | None) -> Validate | Simulate | Regression:
    """Parse the arguments; bad ones end the program with one line."""
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            command: Validate | Simulate | Regression = tyro.cli(
                Validate | Simulate | Regression,
                prog=PROGRAM,
                description="Compare a cart-pole controller in MuJoCo with its ideal equations.\n\n"
                "Example: afl-mujoco validate step-step",
                args=arguments,
                config=(tyro.conf.FlagCreatePairsOff,),
            )
    except SystemExit as end:
        if end.code == BAD_INPUT:
            lines = (line.strip("│╭╮╰╯─ ") for line in complaint.getvalue().splitlines()[1:])
            said = " ".join(line for line in lines if line)
            print(f"{PROGRAM}: {said}", file=sys.stderr)
        raise
    return command


@contextlib.contextmanager
def _progress(total: int) -> Iterator[Callable[[str], None]]:
    """Give a callable that advances a bar on stderr; silent when that is no terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task("validating", total=total)
        yield lambda done: bar.update(task, advance=1, description=done)
