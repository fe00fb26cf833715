"""`afl-mujoco simulate`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from afl_mujoco.cli.terminal import CHECK_FAILED, SUCCESS, CallLimit, say
from afl_mujoco.control.names import KNOWN, SUBJECT
from afl_mujoco.errors import FileError, UnknownNameError

if TYPE_CHECKING:
    from afl_mujoco.control.controller import Controller
    from afl_mujoco.scenario.scenario import Scenario
    from afl_mujoco.simulation.trajectory import Trajectory

SIMULATORS = ("ode", "exact", "continuous", "sampled")

_HELP = f"Controller by name: {KNOWN} By default that of the file's [replay], else {SUBJECT}."
ControllerName = Annotated[str | None, tyro.conf.arg(help=_HELP)]
Name = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")]


@dataclass(frozen=True, kw_only=True)
class Simulate:
    """Simulate one scenario with one controller; print its metrics, write the run and a figure.

    Example: afl-mujoco simulate step-step --controller adaptive --simulator sampled --compare
    """

    scenario: Name = "nominal"
    """Scenario by name, or a TOML file."""
    controller: ControllerName = None
    simulator: str = "sampled"
    """ode, or a mode of MuJoCo: exact, continuous, sampled."""
    compare: bool = False
    """Draw the other side as well: the ODE over a MuJoCo run, MuJoCo's exact mode over the ODE.
    The scenario must have no imperfections."""
    timestep: float | None = None
    """Physics step, and spacing of the reported instants [s]; by default the longest up to 0.001
    that divides the control period."""
    control_period: float | None = None
    """How long sampled mode holds the force [s], a multiple of the timestep; by default
    that of the scenario, else one step."""
    integrator: str | None = None
    """MuJoCo's integrator in sampled mode: RK4, Euler, implicit, implicitfast; by default that of
    the file's [replay], else RK4."""
    log: bool = False
    """Write the run as a log that the hardware would write, for `afl-mujoco identify`."""
    call_limit: CallLimit = None
    page: bool = True
    """Skip the figure; this command makes no report.html."""
    out: Path = Path("renders/simulate")
    """Folder for the files."""

    def run(self) -> int:
        """Simulate, write the files, print the metrics."""
        from afl_mujoco.scenario.files import Replay, find_replay, find_scenario, save_scenario

        scenario, replay = find_scenario(self.scenario), find_replay(self.scenario)
        if self.simulator not in SIMULATORS:
            raise UnknownNameError.among("simulator", self.simulator, SIMULATORS)

        from afl_mujoco.control.catalogue import find_controller

        name = _first(self.controller, replay.controller, SUBJECT)
        integrator = _first(self.integrator, replay.integrator, "RK4")
        timestep = replay.timestep if self.timestep is None else self.timestep
        controller = find_controller(name)
        if self.log:
            from afl_mujoco.identification.simulated import require_loggable, write_run

            require_loggable(scenario, controller, self.simulator)

        from afl_mujoco.files import output_folder
        from afl_mujoco.report.blocks import Block, Report
        from afl_mujoco.report.style import save_figure
        from afl_mujoco.report.terminal import print_report
        from afl_mujoco.scenario.sample_space import DRAWS
        from afl_mujoco.scenario.sampling import LONGEST_STEP
        from afl_mujoco.simulation.figures import draw_runs
        from afl_mujoco.simulation.judgement import remarks_on
        from afl_mujoco.simulation.metrics import UNITS, metrics
        from afl_mujoco.simulation.scoring import nominal_scales, with_objective
        from afl_mujoco.studies.run import run_of
        from afl_mujoco.studies.tables import how, metrics_matrix, requirements_matrix

        other = "exact" if self.simulator == "ode" else "ode"
        simulators = (self.simulator, other) if self.compare else (self.simulator,)
        own = replace(self, timestep=timestep, integrator=integrator)
        runs = [own._simulate(scenario, controller, kind) for kind in simulators]
        resolved = self.out / f"{scenario.name}.toml"
        given = Path(self.scenario)
        if resolved.is_file() and given.is_file() and resolved.samefile(given):
            rule = "is the input scenario and would be overwritten: choose another --out"
            raise FileError(str(resolved), rule)
        folder = output_folder(self.out)
        stem = f"{scenario.name}-{controller.name}-{self.simulator}"
        runs[0].save(folder / f"{stem}.npz")
        as_run = (
            None
            if replay == Replay()
            else Replay(controller=name, integrator=integrator, timestep=timestep)
        )
        save_scenario(scenario, resolved, replay=as_run)
        others = [f"{scenario.name}.toml"]
        if self.page:
            others.insert(0, f"{stem}.png")
            save_figure(draw_runs(runs, f"{scenario.name}, {controller.name}"), folder / others[0])
        scales = nominal_scales(timestep or LONGEST_STEP)
        figures = [with_objective(metrics(scenario, controller, run), scales) for run in runs]
        digits = 3 if scenario.imperfections.drawn else 6
        run = run_of(scenario, controller, runs[0])
        remarks = [f"- {remark}" for remark in remarks_on(runs[0], scenario, controller)]
        if scenario.imperfections.drawn and self.simulator == "sampled":
            remarks.append(f"- draw 1 of {DRAWS}: afl-mujoco compare runs them all")
        by_simulator = {one.simulator: [figure] for one, figure in zip(runs, figures, strict=True)}
        blocks: list[Block] = [
            metrics_matrix(by_simulator, [n for n in UNITS if n in figures[0]], digits=digits),
            requirements_matrix(scenario, {controller.name: [run]}, {}),
            *(["\n".join(remarks)] if remarks else []),
        ]
        if self.log:
            others += [f.name for f in write_run(scenario, runs[0], folder, stem)]
        say(f"wrote {folder / stem}.npz, {', '.join(others)}")
        ending = run.ending if not run.failure else how(run.failure)
        headline = f"{controller.name} on {scenario.name}: {ending}"
        print_report(Report(headline=headline, blocks=blocks, passed=not run.missed))
        return CHECK_FAILED if run.missed else SUCCESS

    def _simulate(self, scenario: Scenario, controller: Controller, simulator: str) -> Trajectory:
        """Run one simulator."""
        from afl_mujoco.scenario.sampling import LONGEST_STEP
        from afl_mujoco.simulation.mujoco_rollout import simulate_mujoco
        from afl_mujoco.simulation.ode import simulate_ode

        if simulator == "ode":
            return simulate_ode(scenario, controller, sample_period=self.timestep or LONGEST_STEP)
        return simulate_mujoco(
            scenario,
            controller,
            simulator,
            timestep=self.timestep,
            control_period=self.control_period,
            integrator=self.integrator or "RK4",
        )


def _first(*choices: str | None) -> str:
    """Return the first choice that was made."""
    return next(choice for choice in choices if choice is not None)
