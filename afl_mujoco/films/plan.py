"""The films to make, and the runs in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from afl_mujoco.control.controller import Controller
from afl_mujoco.control.digests import digests
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.films.film import RESULT_TIME, TITLE_TIME
from afl_mujoco.films.listing import Entry
from afl_mujoco.films.replay import IDEAL_ODE, Deployment, Replay, frame_times
from afl_mujoco.films.scene import require_size
from afl_mujoco.scenario.parameters import require_distinct
from afl_mujoco.scenario.scenario import Scenario

SINGLE, COMPARISON, SHOWCASE = "film", "comparison", "showcase"
AS_IS = Deployment()

BESIDE = 4
"""Largest number of runs in a film of one scenario."""

FPS_LIMIT = 240
"""Largest number of frames per second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """A film to be made.

    Attributes
    ----------
    kind
        `SINGLE`, `COMPARISON` or `SHOWCASE`.
    name
        Name of its file, without the suffix.
    title
        What it shows.
    runs
        Scenario and controller of each run in it.
    deployment
        How the controller is deployed.
    size
        Width and height [px].
    fps
        Frames per second.
    command
        Command that makes it, as typed into a shell.
    replay
        The run that it shows, if it exists already: a single run is not simulated again.
    """

    kind: str
    name: str
    title: str
    runs: tuple[tuple[Scenario, Controller], ...]
    deployment: Deployment = AS_IS
    size: tuple[int, int] = (1280, 720)
    fps: int = 30
    command: str = ""
    replay: Replay | None = None

    def __post_init__(self) -> None:
        """Validate size and frame rate."""
        require_size(*self.size)
        if not 1 <= self.fps <= FPS_LIMIT:
            raise InvalidValueError("fps", f"must lie between 1 and {FPS_LIMIT}", self.fps)
        scenario = self.runs[0][0]
        if self.running < 1:
            rule = f"must last a frame at {self.fps} frames per second"
            raise InvalidValueError(f"scenario {scenario.name!r}", rule, f"{scenario.duration} s")

    @property
    def file(self) -> str:
        """Name of its file."""
        return f"{self.name}.mp4"

    @property
    def poster(self) -> str:
        """Name of its poster."""
        return f"{self.name}.png"

    @property
    def running(self) -> int:
        """Number of frames that show the runs."""
        return len(frame_times(self.runs[0][0].duration, self.fps))

    @property
    def title_frames(self) -> tuple[int, int]:
        """Number of title frames before and after the runs."""
        if self.kind != SHOWCASE:
            return 0, 0
        return round(TITLE_TIME * self.fps), round(RESULT_TIME * self.fps)

    @property
    def frames(self) -> int:
        """Total number of frames."""
        return self.running + sum(self.title_frames)

    @property
    def controllers(self) -> tuple[str, ...]:
        """Names of the controllers, or of the recorded command, that drive the carts in it."""
        if self.replay is not None:
            return (self.replay.controller,)
        return tuple(dict.fromkeys(controller.name for _, controller in self.runs))

    @property
    def entry(self) -> Entry:
        """Its entry in the list of films."""
        scenarios = {scenario.name for scenario, _ in self.runs}
        return Entry(
            file=self.file,
            poster=self.poster,
            kind=self.kind,
            title=self.title,
            scenario=scenarios.pop() if len(scenarios) == 1 else None,
            controllers=self.controllers,
            width=self.size[0],
            height=self.size[1],
            fps=self.fps,
            frames=self.frames,
            deployment=self.deployment,
            command=self.command,
            ghost=IDEAL_ODE if self.replay is None else self.replay.ghost,
            inputs=digests(*zip(*self.runs, strict=True)),
        )


def side_by_side(
    scenario: Scenario, controllers: Sequence[Controller], deployment: Deployment, **settings: Any
) -> Film:
    """Return the film of the first `BESIDE` controllers on a scenario."""
    used = controllers[:BESIDE]
    names = [controller.name for controller in used]
    return Film(
        kind=COMPARISON if len(used) > 1 else SINGLE,
        name=f"{scenario.name}-{'-and-'.join(names)}",
        title=f"{scenario.name}, {' beside '.join(names)}",
        runs=tuple((scenario, controller) for controller in used),
        deployment=deployment.on(scenario),
        **settings,
    )


def plan(
    scenarios: Sequence[Scenario],
    controllers: Sequence[Controller],
    showcase: Sequence[Scenario] = (),
    deployment: Deployment = AS_IS,
    **settings: Any,
) -> list[Film]:
    """Return the films of some scenarios: one per controller, and the first four side by side.

    Parameters
    ----------
    showcase
        The four scenarios of a showcase, under the last controller; none by default.
    """
    planned = []
    for s in scenarios:
        planned += [side_by_side(s, [c], deployment, **settings) for c in controllers]
        if len(controllers) > 1:
            planned.append(side_by_side(s, controllers, deployment, **settings))
    if showcase:
        planned.append(
            Film(
                kind=SHOWCASE,
                name="showcase",
                title=f"The four cases with {controllers[-1].name}",
                runs=tuple((s, controllers[-1]) for s in showcase),
                deployment=deployment,
                **settings,
            )
        )
    require_distinct("film", [film.name for film in planned])
    return planned
