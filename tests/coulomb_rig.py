"""A cart-pole with exact Coulomb friction, integrated from event to event.

The rail sticks where the force that holds the cart is below the dry friction, and slips where it is
not; SciPy's events find the instants. The equations are Lagrange's, written down here anew.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from tests.synthetic_logs import PERIOD, Pumping, described, rounded, wrapped


@dataclass(frozen=True, kw_only=True)
class CoulombRig:
    """A cart-pole as it is, in SI units; `friction` is dry, `count`s are those of its sensors."""

    cart_mass: float
    pole_mass: float
    half_length: float
    force: float
    friction: float
    rail_damping: float
    hinge_damping: float
    delay: float
    angle_count: float = 2e-4
    position_count: float = 1e-5

    @property
    def physical(self):
        names = "half_length cart_mass force rail_damping hinge_damping delay".split()
        return {x: getattr(self, x) for x in names} | {"rail_friction": self.friction}

    def accelerations(self, state, force, way):
        """(z'', phi''): `way` is the sign of the sliding speed, None while the cart sticks."""
        _, phi, z_dot, phi_dot = state
        m, arm = self.pole_mass, self.pole_mass * self.half_length
        inertia = 4.0 / 3.0 * m * self.half_length**2
        torque = arm * 9.81 * np.sin(phi) - self.hinge_damping * phi_dot
        if way is None:
            return 0.0, torque / inertia
        pull = force - self.rail_damping * z_dot - self.friction * way
        pull -= arm * phi_dot**2 * np.sin(phi)
        c = arm * np.cos(phi)
        mass = [[self.cart_mass + m, -c], [-c, inertia]]
        return tuple(np.linalg.solve(mass, [pull, torque]).tolist())

    def holding(self, state, force):
        """The force of the rail that holds the cart where it stands."""
        _, phi, _, phi_dot = state
        _, turning = self.accelerations((0.0, phi, 0.0, phi_dot), force, None)
        arm = self.pole_mass * self.half_length
        return force + arm * (turning * np.cos(phi) - phi_dot**2 * np.sin(phi))

    def piece(self, state, start, end, force, times):
        """The state at the end of a piece of constant force, and the states at some times."""
        found, now = [], start
        way = self.way_of(state, force)
        while True:

            def rates(t, x, way=way):
                return (x[2], x[3], *self.accelerations(x, force, way))

            def turns(t, x, way=way):
                if way is None:
                    return self.friction - abs(self.holding(x, force))
                return way * x[2]

            turns.terminal, turns.direction = True, -1.0
            asked = times[(times >= now - 1e-12) & (times <= end)]
            run = solve_ivp(rates, (now, end), state, "DOP853", rtol=1e-11, atol=1e-13,
                            events=turns, dense_output=True)  # fmt: skip
            last = run.t[-1]
            found += [(t, *run.sol(max(t, now))[:2]) for t in asked[asked <= last]]
            times, state, now = times[times > last], run.y[:, -1].copy(), last
            if run.status == 0:
                return state, found
            state[2] = 0.0
            before, way = way, self.way_of(state, force)
            if before is None and way is None:  # on the brink: the force that grows lets it go
                way = float(np.sign(self.holding(state, force)))

    def way_of(self, state, force):
        if abs(state[2]) > 0.0:
            return float(np.sign(state[2]))
        held = self.holding(state, force)
        return None if abs(held) <= self.friction else float(np.sign(held))

    def log(self, seed, seconds=3.0):
        """A log as the columns of a description: a pumped pole, the cart kept near the middle."""
        rng = np.random.default_rng(seed)
        state = np.array([0.0, np.pi + rng.uniform(-1.0, 1.0), 0.0, 0.0])
        count = round(seconds / PERIOD)
        time = np.arange(count) * PERIOD
        commands, rows, pumping, before = [], [], Pumping(rng), 0.0
        for k in range(count):
            commands.append(pumping(state[0], state[1], state[3]))
            acts = time[k] + self.delay
            for start, end, u in ((time[k], acts, before), (acts, time[k] + PERIOD, commands[-1])):
                inside = time[k : k + 1] if start == time[k] else np.empty(0)
                state, found = self.piece(state, start, end, self.force * u, inside)
                rows += [row[1:] for row in found]
            before = commands[-1]
        z, angle = np.array(rows).T
        phi = wrapped(angle + rng.normal(0.0, 0.5 * self.angle_count, count))
        z = z + rng.normal(0.0, 0.5 * self.position_count, count)
        phi, z = rounded(phi, self.angle_count), rounded(z, self.position_count)
        return {"time": time, "phi": phi, "z": z, "command": np.array(commands)}


RIGS = (
    CoulombRig(cart_mass=0.5, pole_mass=0.1, half_length=0.2, force=9.0, friction=1.0,
               rail_damping=4.0, hinge_damping=3e-4, delay=0.006),
    CoulombRig(cart_mass=1.2, pole_mass=0.2, half_length=0.3, force=14.0, friction=3.0,
               rail_damping=3.0, hinge_damping=5e-4, delay=0.003),
    CoulombRig(cart_mass=0.4, pole_mass=0.06, half_length=0.15, force=7.0, friction=0.5,
               rail_damping=2.0, hinge_damping=1e-4, delay=0.01),
)  # fmt: skip
"""Three rigs with little, much and moderate dry friction."""


def description_of(rig):
    return described("dry", rig, rig.angle_count, cart_mass=0.7, force=8.0)
