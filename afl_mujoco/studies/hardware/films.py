"""The film of a recording: MuJoCo's prediction, half a second at a time, the measurement behind."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from afl_mujoco.identification.export import with_values
from afl_mujoco.identification.rig import physical
from afl_mujoco.studies.hardware.result import Result

if TYPE_CHECKING:
    from afl_mujoco.films.plan import Film

FPS = 30


def films(result: Result, command: str) -> list[Film]:
    """Return the film of the recording that the report shows, if it was asked for."""
    if not result.film:
        return []
    from afl_mujoco.control.catalogue import find_controller
    from afl_mujoco.films.plan import SINGLE, Film
    from afl_mujoco.films.replay import Deployment, Replay, frame_times

    r, one = result.recorded, result.identified
    base = with_values(one, one.values)
    first, last = float(r.predicted_time[0, 0]), float(r.predicted_time[-1, -1])
    duration = np.floor((last - first) * FPS) / FPS
    scenario = replace(base, name=r.name.lower(), duration=float(duration))
    times = frame_times(scenario.duration, FPS)
    at, seen = first + times, ~np.isnan(r.phi)
    predicted = [
        np.interp(at, r.predicted_time.ravel(), values.ravel())
        for values in (r.predicted_z, r.predicted_phi)
    ]
    measured = [np.interp(at, r.time, r.z), np.interp(at, r.time[seen], r.phi[seen])]
    held = np.searchsorted(r.time, at, side="right") - 1
    force = physical(one.values, one.description)["force"]
    replay = Replay(
        scenario=r.name,
        controller="recorded command",
        time=times,
        state=_states(times, predicted),
        ideal=_states(times, measured),
        force=force * r.command[held],
        push=np.zeros(len(times)),
        cart_mass=np.full(len(times), base.parameters_at(0.0).cart_mass),
        half_length=np.full(len(times), base.parameters_at(0.0).half_length),
        pole_mass=base.pole_mass,
        gravity=base.gravity,
        ghost="measured",
        rail_half_length=base.imperfections.rail_half_length,
        looks=min(0.1, one.description.nominal.cart_mass),
    )
    return [
        Film(
            kind=SINGLE,
            name=f"hardware-{r.name.lower()}",
            title=f"{r.name} as MuJoCo predicts it, half a second at a time, and as measured",
            runs=((scenario, find_controller("lqr")),),
            deployment=Deployment(control_period=round(one.period, 5)),
            fps=FPS,
            command=command,
            replay=replay,
        )
    ]


def _states(times: np.ndarray, positions: list[np.ndarray]) -> np.ndarray:
    """Return states of two positions at some times, shape (N, 4)."""
    rates = [np.gradient(values, times) for values in positions]
    return np.stack([*positions, *rates], axis=1)
