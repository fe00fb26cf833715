"""The whole cart-pole in MuJoCo, driven by the recorded commands."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from afl_mujoco.compiled import kernel
from afl_mujoco.identification import pole
from afl_mujoco.identification.description import Description
from afl_mujoco.identification.least_squares import Array, Parameter
from afl_mujoco.identification.log import Windows
from afl_mujoco.identification.pole import coulomb_motion
from afl_mujoco.pool import on_threads
from afl_mujoco.scenario.imperfections import Imperfections
from afl_mujoco.scenario.parameters import NOMINAL, CartPoleParameters
from afl_mujoco.simulation.mujoco_model import CartPoleModel

import mujoco  # isort: skip  (after the model, which chooses how MuJoCo draws)
from mujoco import rollout  # isort: skip

LEFT = 0.5  # share of the change of speed that a first guess of the drive may leave

START_SCALE = np.array([0.001, 0.01, 0.05, 0.1])  # of (z, phi, z_dot, phi_dot) [m, rad, m/s, rad/s]


def parameters_of(description: Description, windows: Windows | None = None) -> list[Parameter]:
    """Return the parameters of the cart and its drive, guessed from windows of logs if given."""
    n, period, limit = description.nominal, description.period, description.command.limit or 1.0
    whole = n.cart_mass + n.pole_mass
    gain, decay = n.force / whole, n.rail_damping / whole
    if windows is not None:
        largest = max(float(np.abs(log.command).max()) for log in windows.logs)
        limit = description.command.limit or largest
        gain, decay = _guessed(windows) or (gain, decay)
    decay = min(max(decay, 1.0), 20.0)
    reach = max(5.0 * period, 0.1)
    return [  # name, unit, title, start, low, high, scale
        Parameter("mass_ratio", "1", "m / (M + m): the reaction of the pole",
                  n.pole_mass / whole, 1e-4, 0.9, 0.1),
        Parameter("gain", "m/s²", "acceleration of one of the command",
                  gain, 0.01 * gain, 100.0 * gain, gain),
        Parameter("decay", "1/s", "decay of the speed", decay, 0.0, 100.0 * decay, decay),
        Parameter("dry_deceleration", "m/s²", "deceleration by dry friction",
                  0.02 * gain * limit, 0.0, 2.0 * gain * limit, 0.1 * gain * limit),
        Parameter("delay", "s", "delay of the command", 0.2 * period, 0.0, reach, 1e-2),
        Parameter("lag", "s", "lag of the drive", 0.2 * period, 0.0, reach, 1e-2),
        Parameter("bias", "1", "command at which the drive does not pull",
                  0.0, -0.5 * limit, 0.5 * limit, 0.01 * limit),
    ]  # fmt: skip


def _guessed(windows: Windows) -> tuple[float, float] | None:
    """Return gain and decay as momentum tells them from window to window, None where it does not.

    z' + m l / (M + m) phi' cos phi changes by the impulse of the drive less that of the damping.
    """
    w, tables = windows, [np.empty((0, 4))]
    z, phi, z_dot, phi_dot = w.starts.T
    told = np.stack([z_dot, z_dot, -z, -phi_dot * np.cos(phi)], axis=1)
    for number in np.unique(w.log):
        log, mine = w.logs[number], w.log == number
        time, columns = w.time[mine, 0], told[mine]
        columns[:, 1] = _impulses(log.time, log.command, 0.0, time[None])[0]
        follows = np.diff(time) < w.spacing * w.time.shape[1]
        tables.append(np.diff(columns, axis=0)[follows])
    change, *causes = np.concatenate(tables).T
    gain, decay, _ = found = np.linalg.lstsq(np.transpose(causes), change, rcond=None)[0]
    left = change - found @ np.array(causes)
    enough = len(change) > len(causes) and np.sum(left**2) < LEFT * np.sum(change**2)
    return (float(gain), float(decay)) if enough and gain > 0.0 else None


def physical(values: Mapping[str, float], description: Description) -> dict[str, float]:
    """Return masses, forces and frictions from identified ratios, for a pole of the given mass.

    In SI units; the force is for one unit of command.
    """
    v, n = values, description.nominal
    half_length = 0.75 * n.gravity / v["gravity_term"]
    inertia = 4.0 / 3.0 * n.pole_mass * half_length**2
    whole = n.pole_mass / v["mass_ratio"]
    return {
        "half_length": half_length,
        "cart_mass": whole - n.pole_mass,
        "force": whole * v["gain"],
        "rail_damping": whole * v["decay"],
        "rail_friction": whole * v["dry_deceleration"],
        "hinge_damping": inertia * v["damping"],
        "hinge_friction": inertia * v["friction"],
    }


FRICTION = "dry_friction.z"  # dry friction of the rail among the imperfections


def model_of(
    values: Mapping[str, float], description: Description
) -> tuple[CartPoleParameters, Imperfections]:
    """Return an identified cart-pole as a cart with a uniform rod, and its friction."""
    n, found = description.nominal, physical(values, description)
    plant = CartPoleParameters(
        cart_mass=found["cart_mass"],
        pole_mass=n.pole_mass,
        half_length=found["half_length"],
        gravity=n.gravity,
    )
    # one estimated as negative, within its error, is none
    damping, dry = (
        {"z": max(0.0, found[f"rail_{kind}"]), "phi": max(0.0, found[f"hinge_{kind}"])}
        for kind in ("damping", "friction")
    )
    return plant, Imperfections(damping=damping, dry_friction=dry)


class Rig:
    """The cart-poles of some windows; `workers` are threads, on which no result depends.

    Dry friction is that of Coulomb where it is `exact`, else softened, as by MuJoCo: the exact one
    has no derivative by the speed of a cart that sticks.
    """

    def __init__(
        self, windows: Windows, description: Description, workers: int = 1, *, exact: bool = False
    ) -> None:
        self.windows, self.description = windows, description
        self.workers, self.exact = min(workers, windows.count), exact
        count = self.workers if exact else 1
        self._models = [CartPoleModel(NOMINAL, timestep=windows.step) for _ in range(count)]

    def readings(self, values: Mapping[str, float], starts: Array) -> Array:
        """Return the readings at the rows, shape (B, 2, n), from states at the first, (B, 4)."""
        return self.read(values, self.motion(values, starts))

    def read(self, values: Mapping[str, float], track: Array) -> Array:
        """Return the readings of the sensors along a motion, shape (B, 2, n)."""
        w, v = self.windows, values
        z, phi, z_dot, phi_dot = np.moveaxis(track, -1, 0)
        angle = pole.at_rows(w, phi, phi_dot, 0.0)
        read, rate = z, z_dot
        if v["compliance"]:
            acceleration = np.gradient(z_dot, w.step, axis=1)
            read = z - v["compliance"] * acceleration
            rate = z_dot - v["compliance"] * np.gradient(acceleration, w.step, axis=1)
        position = pole.at_rows(w, read, rate, v["skew"]) / v["coupling"]
        return np.stack([position, pole.readings(v, angle, w.turns)], axis=1)

    def motion(self, values: Mapping[str, float], starts: Array) -> Array:
        """Return the states on the steps of the windows, shape (B, steps + 1, 4)."""
        forces, step = self.forces(values), self.windows.step
        plant, imperfections = model_of(values, self.description)
        friction = imperfections.at(FRICTION) if self.exact else 0.0
        if friction > 0.0:
            imperfections = imperfections.changed({FRICTION: 0.0})
        for model in self._models:
            model.set_imperfections(imperfections)
            model.set_parameters(plant)
            model.compute_only()
        if friction > 0.0:
            track = np.empty((len(starts), forces.shape[1] + 1, 4))
            idle = deque(self._models)  # one for each thread

            def move(first: int) -> None:
                model, part = idle.popleft(), slice(first, first + 8)
                motion = starts[part], forces[part], friction, step, track[part]
                coulomb_motion(model.addresses, *motion)
                idle.append(model)

            on_threads(move, range(0, len(starts), 8), self.workers)
            return track
        full, model = mujoco.mjtState.mjSTATE_FULLPHYSICS, self._models[0].mj_model
        initial = np.zeros((len(starts), mujoco.mj_stateSize(model, full)))
        initial[:, 1:5] = starts
        data = [mujoco.MjData(model) for _ in range(self.workers)]
        found, _ = rollout.rollout(model, data, initial, forces[..., None])
        return np.concatenate([starts[:, None], found[..., 1:5]], axis=1)

    def forces(self, values: Mapping[str, float]) -> Array:
        """Return the mean force of the drive over each step [N], shape (B, steps)."""
        w, v = self.windows, values
        force = physical(v, self.description)["force"]
        forces = np.empty((w.count, w.steps))
        edges = w.step * np.arange(w.steps + 1)
        for number in np.unique(w.log):
            log, mine = w.logs[number], w.log == number
            when = w.time[mine, :1] + edges - v["delay"]
            impulse = _impulses(log.time, log.command - v["bias"], v["lag"], when)
            forces[mine] = force * np.diff(impulse, axis=1) / w.step
        return forces


@kernel
def _impulses(times, commands, lag, when):
    """Return the integral of a held command behind a first-order lag, shape of `when`.

    A command holds from its time on; before the first time the first one does, and the lag has
    settled. `when` ascends in each row [s].
    """
    count = len(times)
    behind, whole = np.empty(count), np.zeros(count)  # lagged command and integral at each time
    behind[0] = commands[0]
    for i in range(count - 1):
        length = times[i + 1] - times[i]
        left = math.exp(-length / lag) if lag > 0.0 else 0.0
        behind[i + 1] = commands[i] + (behind[i] - commands[i]) * left
        whole[i + 1] = (
            whole[i] + commands[i] * length + (behind[i] - commands[i]) * lag * (1.0 - left)
        )
    found = np.empty(when.shape)
    for b in range(when.shape[0]):
        i = 0
        for k in range(when.shape[1]):
            t = when[b, k]
            while i < count - 1 and times[i + 1] <= t:
                i += 1
            length = t - times[i]
            if length < 0.0:
                found[b, k] = commands[0] * length
            else:
                left = math.exp(-length / lag) if lag > 0.0 else 0.0
                excess = (behind[i] - commands[i]) * lag * (1.0 - left)
                found[b, k] = whole[i] + commands[i] * length + excess
    return found
