"""The commands that are no study: simulate, log, render, view, report, regression."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from afl_mujoco.cli.study import CORES, Workers, require_films, write_page
from afl_mujoco.cli.terminal import (
    CHECK_FAILED,
    FILMS,
    RESULTS,
    SUCCESS,
    CallLimit,
    count_bar,
    say,
    separated,
    study_progress,
    typed,
)
from afl_mujoco.control.names import KNOWN, PAPER, SUBJECT, find_controllers
from afl_mujoco.errors import FileError, InvalidValueError, UnknownNameError
from afl_mujoco.studies.shared.contract import ScenarioNames, named_controllers

if TYPE_CHECKING:
    from afl_mujoco.control.controller import Controller
    from afl_mujoco.scenario.files import Replay
    from afl_mujoco.scenario.scenario import Scenario
    from afl_mujoco.scenario.time_steps import Deployed
    from afl_mujoco.simulation.trajectory import Trajectory

FRAMES_A_SECOND = 60  # frames of a view per second


_OWN = f"By default that of the file's [replay], else {SUBJECT}, of another plant lqr."
ControllerName = Annotated[str | None, tyro.conf.arg(help=f"Controller by name: {KNOWN} {_OWN}")]
Name = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")]


def _subject(name: str | None, scenario: Scenario) -> Controller:
    """Return the controller that is asked for, by default one that the plant can have."""
    (found,) = find_controllers([] if name is None else [name], [scenario], (SUBJECT,))
    return found


@dataclass(frozen=True, kw_only=True)
class _Deployed:
    timestep: float | None = None
    """Physics step of MuJoCo, and spacing of the instants of an ODE [s]; by default the longest up
    to 0.001 that divides the control period."""
    control_period: float | None = None
    """How long the force is held [s], a multiple of the timestep; by default that of the
    file's [replay] in `simulate`, else of the scenario, else one step."""
    integrator: str | None = None
    """MuJoCo's integrator: RK4, Euler, implicit, implicitfast; RK4 by default, in `simulate` that
    of the file's [replay]."""
    call_limit: CallLimit = None

    @property
    def deployment(self) -> Deployed:
        from afl_mujoco.scenario.time_steps import Deployed

        return Deployed(self.integrator or "RK4", self.timestep, self.control_period)


@dataclass(frozen=True, kw_only=True)
class Render(_Deployed):
    """Film runs in MuJoCo beside the ideal equations.

    Example: afl-mujoco render step-step-impulse --controllers fixed adaptive --size 1280x720

    Writes one MP4 for each scenario and controller, and one of up to four controllers side by
    side. Also writes films.json, from which `afl-mujoco report` takes them.
    """

    scenarios: ScenarioNames = ()
    """Scenarios by name, or TOML files; all nine of the paper by default."""
    controllers: Annotated[tuple[str, ...], named_controllers(" and ".join(PAPER))] = ()
    size: str = "1280x720"
    """Width x height in pixels, even, at most 1920x1080."""
    fps: int = 30
    """Frames per second."""
    workers: Workers = CORES
    out: Path = FILMS
    """Folder for the films."""

    def run(self) -> int:
        """Make the films."""
        from afl_mujoco.files import output_folder
        from afl_mujoco.graphics import require_backend
        from afl_mujoco.scenario.catalogue import SCENARIOS
        from afl_mujoco.scenario.files import find_scenario

        # What is quick to check comes before what is slow to import, the backend before MuJoCo.
        scenarios = [find_scenario(name) for name in self.scenarios or SCENARIOS]
        controllers = find_controllers(separated(self.controllers), scenarios, PAPER)
        if not (found := re.fullmatch(r"(\d{1,6})x(\d{1,6})", self.size)):
            raise InvalidValueError("size", "must be WIDTHxHEIGHT, such as 1280x720", self.size)
        require_backend()

        from afl_mujoco.films.video import make_films, plan

        films = plan(
            scenarios,
            controllers,
            self.deployment,
            size=(int(found[1]), int(found[2])),
            fps=self.fps,
            command=typed("render", self, leave_out=("out", "workers")),  # the same films
        )
        folder = output_folder(self.out)
        with count_bar(len(films), "filming") as progress:
            files = make_films(films, folder, workers=self.workers, progress=progress)
        say(*(f"wrote {file}" for file in files))
        return SUCCESS


@dataclass(frozen=True, kw_only=True)
class View(_Deployed):
    """Show a run in MuJoCo's interactive viewer, in real time.

    Example: afl-mujoco view step-step-impulse --controller adaptive
    """

    scenario: Name = "step-step-impulse"
    """Scenario by name, or a TOML file."""
    controller: ControllerName = None
    speed: float = 1.0
    """Seconds of the run that are shown per second."""

    def run(self) -> int:
        """Run the simulation, then show it."""
        from afl_mujoco.graphics import require_display
        from afl_mujoco.scenario.files import find_scenario

        scenario = find_scenario(self.scenario)
        controller = _subject(self.controller, scenario)
        if not 0.0 < self.speed < float("inf"):
            raise InvalidValueError("speed", "must be positive and finite", self.speed)
        require_display()
        os.environ["MUJOCO_GL"] = "glfw"

        from afl_mujoco.films.replay import record
        from afl_mujoco.films.scene import view

        replay = record(scenario, controller, self.deployment, FRAMES_A_SECOND)
        view(replay, FRAMES_A_SECOND, self.speed)
        return SUCCESS


@dataclass(frozen=True, kw_only=True)
class Log:
    """Plot logs of a measured cart-pole, and print a summary.

    Example: afl-mujoco log logs/swing-up.csv --description my-rig.toml
    """

    logs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG ...]")] = ()
    """Logs, CSV files or folders of them; by default the first recording of the package."""
    description: str | None = None
    """TOML file that says what their columns mean; required for your own logs."""
    out: Path = Path("renders/logs")
    """Folder for the pictures."""

    def run(self) -> int:
        """Read the logs, draw them, print a table."""
        from afl_mujoco.identification.prediction import FIT, described_logs

        first = sorted(FIT.glob("*.csv"))[:1]
        logs, description = described_logs(self.logs, self.description, first)

        import numpy as np

        from afl_mujoco.files import output_folder
        from afl_mujoco.report.blocks import Matrix, percent, short
        from afl_mujoco.report.figures import save_figure, styled
        from afl_mujoco.report.terminal import print_blocks
        from afl_mujoco.studies.shared.identified_parts import Shown, draw_log

        folder = output_folder(self.out)
        rows = []
        for log in logs:
            angle = np.where(log.valid, log.phi + 2.0 * np.pi * log.turns, np.nan)
            shown = Shown(name=log.name, time=log.time, z=log.z, phi=angle, command=log.command)
            with styled():
                figure = draw_log(shown)
            save_figure(figure, folder / f"{log.name}.png")
            rows.append(
                {
                    "Log": log.name,
                    "Rows": str(len(log.time)),
                    "Duration [s]": short(log.duration, 3),
                    "Period [ms]": short(1e3 * log.period),
                    "Jitter [ms]": short(1e3 * log.jitter, 2),
                    "Missing": str(log.missing),
                    "z [m]": f"{short(float(log.z.min()), 2)} to {short(float(log.z.max()), 2)}",
                    "φ [rad]": f"{short(np.nanmin(angle), 3)} to {short(np.nanmax(angle), 3)}",
                    "φ in the dead zone": percent(1.0 - float(log.valid.mean()), 2),
                }
            )
        cells = [list(row.values()) for row in rows]
        print_blocks([Matrix(caption=description.name, columns=list(rows[0]), rows=cells)])
        say(f"wrote {', '.join(f'{folder / log.name}.png' for log in logs)}")
        return SUCCESS


@dataclass(frozen=True, kw_only=True)
class Regression:
    """Compare every run of the paper with its baseline.

    Example: afl-mujoco regression --workers 2

    Prints a line for each value that changed. The exit code is 0 if none did, and 1 otherwise.
    """

    baselines: Path = Path("tests/regression/baselines")
    """Folder of the baselines."""
    update: bool = False
    """Make the current state the baselines, and print what changed."""
    workers: Workers = CORES

    def run(self) -> int:
        """Run everything; compare, or update the baselines."""
        from afl_mujoco.control.catalogue import CONTROLLERS
        from afl_mujoco.files import output_folder
        from afl_mujoco.scenario.catalogue import SCENARIOS
        from afl_mujoco.studies.verify import regression

        # what is quick to check comes first
        folder = output_folder(self.baselines) if self.update else self.baselines
        baselines = regression.load_baselines(folder)
        scenarios = list(SCENARIOS.values())
        controllers = [CONTROLLERS[name] for name in regression.REGRESSED]
        with study_progress() as progress:
            fresh = regression.record_all(
                scenarios, controllers, workers=self.workers, progress=progress
            )
        if self.update:
            say(*regression.update_baselines(self.baselines, baselines, fresh))
            return SUCCESS
        told = regression.compare(baselines, fresh)
        runs = sum(len(baseline.runs) for baseline in fresh.values())
        verdict = f"PASS: {runs} runs match their baselines"
        if told:
            verdict = f"FAIL: {len(told)} baselines; {regression.UPDATE} accepts intended changes"
        say(*told.values(), verdict)
        return CHECK_FAILED if told else SUCCESS


@dataclass(frozen=True, kw_only=True)
class Report:
    """Make report.html again from the results of a folder.

    Example: afl-mujoco report renders/validation --films renders

    Nothing is computed: the page is made from the results and figures in the folder.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")] = RESULTS
    """Folder with the results of studies, such as `afl-mujoco validate`."""
    films: Path = FILMS
    """Folder with films.json, which `afl-mujoco render` writes."""

    def run(self) -> int:
        """Read the folder, write the page."""
        require_films(self.films)
        page = write_page(self.folder, self.films)
        say(f"wrote {page}, {page.stat().st_size / 1e6:.1f} MB")
        return SUCCESS


SIMULATORS = ("ode", "exact", "continuous", "sampled")


@dataclass(frozen=True, kw_only=True)
class Simulate(_Deployed):
    """Run one controller on one scenario; print its metrics.

    Example: afl-mujoco simulate step-step --controller adaptive --simulator sampled
    """

    scenario: Name = "nominal"
    """Scenario by name, or a TOML file."""
    controller: ControllerName = None
    simulator: str = "sampled"
    """ode, or a mode of MuJoCo: exact, continuous, sampled."""
    log: bool = False
    """Write the run as a log that the hardware would write, for `afl-mujoco identify`."""
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
        given = {one.name: getattr(self, one.name) for one in fields(Replay)}
        how = replace(replay, **{key: x for key, x in given.items() if x is not None})
        controller = _subject(how.controller, scenario)
        how = replace(how, controller=how.controller or controller.name)
        if self.log:
            from afl_mujoco.identification.export import require_loggable, write_run

            require_loggable(scenario, controller, self.simulator)

        from afl_mujoco.files import output_folder, remove_file
        from afl_mujoco.report.blocks import Block, Report
        from afl_mujoco.report.figures import save_figure
        from afl_mujoco.report.terminal import print_report
        from afl_mujoco.scenario.sample_space import NOISE_DRAWS
        from afl_mujoco.scenario.time_steps import LONGEST_STEP
        from afl_mujoco.simulation.bound_controllers import bound
        from afl_mujoco.simulation.judgement import remarks_on
        from afl_mujoco.simulation.metrics import in_order, metrics
        from afl_mujoco.simulation.trajectory import Layout
        from afl_mujoco.studies.shared import tables
        from afl_mujoco.studies.shared.run import run_of
        from afl_mujoco.studies.verify.claims import nominal_scales, with_objective

        controller = bound(controller, scenario)
        run = self.simulate(scenario, controller, how)
        resolved = self.out / f"{scenario.name}.toml"
        file = Path(self.scenario)
        if resolved.is_file() and file.is_file() and resolved.samefile(file):
            rule = "is the input scenario and would be overwritten: choose another --out"
            raise FileError(str(resolved), rule)
        folder = output_folder(self.out)
        stem = f"{scenario.name}-{controller.name}-{self.simulator}"
        for ending in (".png", "-log.csv", "-log.toml"):  # of an older run
            remove_file(folder / f"{stem}{ending}")
        run.save(folder / f"{stem}.npz")
        save_scenario(scenario, resolved, replay=None if replay == Replay() else how)
        others = [f"{scenario.name}.toml"]
        if self.page:
            others.insert(0, f"{stem}.png")
            save_figure(run.plot(), folder / others[0])
        figures = metrics(scenario, controller, run)
        if scenario.is_cart_pole:
            figures = with_objective(figures, nominal_scales(how.timestep or LONGEST_STEP))
        digits = 3 if scenario.imperfections.drawn else 6
        row = run_of(scenario, controller, run)
        remarks = [f"- {remark}" for remark in remarks_on(run, scenario, controller)]
        if scenario.imperfections.drawn and self.simulator == "sampled":
            remarks.append(f"- draw 1 of {NOISE_DRAWS}: afl-mujoco compare runs them all")
        blocks: list[Block] = [
            tables.metrics_matrix(
                {run.simulator: [figures]},
                in_order(figures),
                digits=digits,
                layout=Layout.of(scenario),
            ),
            tables.requirements_matrix(scenario, {controller.name: [row]}, {}),
            *(["\n".join(remarks)] if remarks else []),
        ]
        if self.log:
            others += [f.name for f in write_run(scenario, run, folder, stem)]
        say(f"wrote {folder / stem}.npz, {', '.join(others)}")
        ending = row.ending
        if row.failure not in ("", row.outcome):
            ending = tables.how(row.failure, scenario)
        headline = f"{controller.name} on {scenario.name}: {ending}"
        print_report(Report(headline=headline, blocks=blocks, passed=not row.missed))
        return CHECK_FAILED if row.missed else SUCCESS

    def simulate(self, scenario: Scenario, controller: Controller, how: Replay) -> Trajectory:
        """Return the run; refuse an option that could not act on it."""
        from afl_mujoco.scenario.time_steps import LONGEST_STEP
        from afl_mujoco.simulation.mujoco_rollout import require_not_held, simulate_mujoco
        from afl_mujoco.simulation.simulate import simulate_ode

        if self.simulator == "ode":
            require_not_held("ode", self.control_period, self.integrator)
            return simulate_ode(scenario, controller, sample_period=how.timestep or LONGEST_STEP)
        given = how if self.simulator == "sampled" else self  # [replay] is of sampled mode
        return simulate_mujoco(
            scenario, controller, self.simulator, timestep=how.timestep,
            control_period=given.control_period, integrator=given.integrator or "RK4",
        )  # fmt: skip
