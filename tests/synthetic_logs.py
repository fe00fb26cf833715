"""Logs of cart-poles whose parameters are known: MuJoCo stepped by itself, sensors as real ones."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

import afl_mujoco as afl
from afl_mujoco.identification import description as columns

RIG = afl.Scenario(
    name="rig", duration=6.0, initial_state=(0.0, 0.4, 0.0, 0.0),
    schedule={"cart_mass": 1.0, "half_length": 0.3, "pole_mass": 0.1},
    imperfections=afl.Imperfections(
        control_period=0.01, delay=0.004, encoder_step={"phi": 1.5e-3, "z": 1e-4},
        noise={"phi": 5e-4}, damping={"z": 2.0, "phi": 3e-4},
    ),
)  # fmt: skip
"""A cart-pole whose closed loop is logged."""

PERIOD, STEP = 0.02, 1e-3
COUNT = 2.0 * np.pi / 4096.0


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A cart-pole as it is; in SI units; the delay is a multiple of `STEP`."""

    cart_mass: float = 0.8
    half_length: float = 0.2
    pole_mass: float = 0.1
    force: float = 9.0
    rail_damping: float = 5.0
    hinge_damping: float = 3e-4
    delay: float = 0.006
    skew: float = 0.004
    offset: float = 0.01
    angle_scale: float = 1.0
    count: float = COUNT
    position_count: float = 1e-4

    @property
    def expected(self) -> dict[str, float]:
        inertia = 4.0 / 3.0 * self.pole_mass * self.half_length**2
        whole = self.cart_mass + self.pole_mass
        return {
            "gravity_term": 0.75 * 9.81 / self.half_length, "coupling": 1.0,
            "damping": self.hinge_damping / inertia, "skew": self.skew,
            "angle_offset": self.offset, "mass_ratio": self.pole_mass / whole,
            "gain": self.force / whole, "decay": self.rail_damping / whole, "delay": self.delay,
        }  # fmt: skip

    @property
    def description(self) -> columns.Description:
        return described("made up", self, self.count, cart_mass=0.5, force=5.0)


def described(name: str, rig: Any, count: float, **guessed: float) -> columns.Description:
    """What its owner would say of its logs: the length is a little off, the rest a guess."""
    lengths = {"pole_mass": rig.pole_mass, "half_length": 1.03 * rig.half_length}
    phi = columns.AngleColumn(resolution=count)
    z = columns.PositionColumn(resolution=rig.position_count)
    nominal = columns.Nominal(**lengths, **guessed, rail_damping=2.0)
    more = {"phi": phi, "z": z, "nominal": nominal, "command": columns.CommandColumn(limit=1.0)}
    return columns.Description(name=name, period=PERIOD, **more)


class Pumping:
    """Commands that pump a pole and keep the cart near the middle."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.noise = rng, 0.0

    def __call__(self, z: float, phi: float, phi_dot: float) -> float:
        self.noise = 0.8 * self.noise + self.rng.normal(0.0, 0.35)
        pump = 0.7 * np.sign(phi_dot * np.cos(phi))
        return float(np.clip(pump + self.noise - 6.0 * z, -1.0, 1.0))


def wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def rounded(values: np.ndarray, count: float) -> np.ndarray:
    return np.round(values / count) * count


def swing(truth: Truth, seed: int, seconds: float = 4.0, period: float = PERIOD):
    """A log as columns of its description: a pumped pole, the cart kept near the middle."""
    rng = np.random.default_rng(seed)
    names = ("cart_mass", "pole_mass", "half_length")
    plant = afl.CartPoleParameters(**{name: getattr(truth, name) for name in names})
    passive = afl.Imperfections(damping={"z": truth.rail_damping, "phi": truth.hinge_damping})
    model = afl.CartPoleModel(plant, timestep=STEP, imperfections=passive)
    m, d = model.mj_model, model.mj_data
    d.qpos[:] = 0.0, np.pi + rng.uniform(-1.0, 1.0)
    ticks, hold = round(seconds / PERIOD), round(PERIOD / STEP)
    late = round(truth.delay / STEP)
    commands, states, pumping = [0.0], [], Pumping(rng)
    for k in range(ticks * hold + 40):
        if k % hold == 0:
            commands.append(pumping(*d.qpos, d.qvel[1]))
        states.append((d.qpos[0], d.qpos[1]))
        d.ctrl[0] = truth.force * commands[max(0, (k - late) // hold + 1)]
        mujoco.mj_step(m, d)
    track = np.array(states)
    count = round(seconds / period)
    time = np.arange(count) * period
    instants = np.arange(len(track)) * STEP
    z = np.interp(time + truth.skew, instants, track[:, 0])
    angle = np.interp(time, instants, track[:, 1])
    phi = (angle - truth.offset) / truth.angle_scale + rng.normal(0.0, 0.5 * truth.count, count)
    stamps = 1e4 + time + rng.normal(0.0, 5e-3 * period, count)
    command = np.array(commands)[1 + (time / PERIOD + 1e-6).astype(int)]
    phi, z = rounded(wrapped(phi), truth.count), rounded(z, truth.position_count)
    return {"time": stamps, "phi": phi, "z": z, "command": command}
