"""The estimator of M and l: against its equations in plain numpy, statistics, and the ODE."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.stats

import afl_mujoco as afl
from afl_mujoco.compiled import kernel
from afl_mujoco.control import estimator
from afl_mujoco.control.estimator import EstimatorSettings, fill_transition, linearise
from afl_mujoco.plants.cartpole_equations import cart_acceleration, pole_acceleration
from afl_mujoco.scenario.parameters import NOMINAL, PlantRange

DT = 1e-3
ODD = replace(NOMINAL, pole_mass=0.083, gravity=9.65)
EVERY_ODD = EstimatorSettings(
    position_noise=3e-4, angle_noise=2e-3, acceleration_noise=0.2, cart_mass_accuracy=0.05,
    half_length_accuracy=0.2, least_cart_acceleration=2.0, least_pole_acceleration=0.5,
    excitation_memory=0.02, initial_cart_mass=0.7, initial_half_length=0.3, cart_mass_spread=0.6,
    half_length_spread=0.4, speed_spread=0.3, rate_spread=0.2,
)  # fmt: skip
MATCHED = EstimatorSettings(
    acceleration_noise=0.05, cart_mass_accuracy=1e-6, half_length_accuracy=1e-6,
    initial_cart_mass=0.8, initial_half_length=0.4, cart_mass_spread=0.1, half_length_spread=0.1,
    speed_spread=0.1, rate_spread=0.1,
)  # fmt: skip


def flow(x, force, pole_mass, gravity):
    """(P3), (P4) as a rate of the estimator's six states; x may be complex."""
    given = (x[1], x[3], force, np.exp(x[4]), pole_mass, np.exp(x[5]), gravity)
    return np.array([x[2], x[3], cart_acceleration(*given), pole_acceleration(*given), 0.0, 0.0])


def jacobian(x, force, pole_mass, gravity):
    """The derivative of `flow` by the complex step, exact to round-off."""
    columns = [flow(x + 1e-30j * e, force, pole_mass, gravity).imag / 1e-30 for e in np.eye(6)]
    return np.stack(columns, axis=1)


def rk4(x, force, pole_mass, gravity, dt):
    k1 = flow(x, force, pole_mass, gravity)
    k2 = flow(x + dt / 2 * k1, force, pole_mass, gravity)
    k3 = flow(x + dt / 2 * k2, force, pole_mass, gravity)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + flow(x + dt * k3, force, pole_mass, gravity))


class Textbook:
    """The extended Kalman filter (E1) to (E8) in matrices, both measurements at once."""

    def __init__(self, settings: EstimatorSettings, plant, z: float, phi: float):
        s = self.settings = settings
        logs = np.log([s.initial_cart_mass, s.initial_half_length])
        self.x, self.plant = np.array([z, phi, 0.0, 0.0, *logs]), plant
        spreads = (s.speed_spread, s.rate_spread, s.cart_mass_spread, s.half_length_spread)
        self.P = np.diag(np.square([s.position_noise, s.angle_noise, *spreads]))
        self.excitation, self.nis = np.zeros(2), 0.0

    @property
    def said(self):
        return [*np.exp(self.x[4:]), *self.x[2:4], self.nis]

    def update(self, z, phi, force, dt):
        s, known = self.settings, (self.plant.pole_mass, self.plant.gravity)
        before, after = self.x, rk4(self.x, force, *known, dt)
        middle = np.concatenate([(before[:4] + after[:4]) / 2, before[4:]])
        A, rate = jacobian(middle, force, *known), flow(middle, force, *known)
        Phi = np.eye(6) + A * dt + A @ A * dt**2 / 2
        G = np.array([0, 0, 1, 0.75 / math.exp(before[5]) * math.cos(middle[1]), 0, 0])
        Q = np.outer(G, G) * s.acceleration_noise**2 * dt
        Q[3, 3] *= 1 + self.P[5, 5]
        P = Phi @ (self.P + Q / 2) @ Phi.T + Q / 2
        share = dt / (dt + s.excitation_memory)
        now = np.array([rate[2], rate[3] * math.exp(before[5])])
        self.excitation = self.excitation + share * (now - self.excitation)
        least = np.square([s.cart_mass_accuracy, s.half_length_accuracy])
        excited = np.abs(self.excitation) > [s.least_cart_acceleration, s.least_pole_acceleration]
        learns = excited | (np.diag(P)[4:] > least)
        H, R = np.eye(6)[:2], np.diag(np.square([s.position_noise, s.angle_noise]))
        S = H @ P @ H.T + R
        innovation = np.array([z, phi]) - after[:2]
        self.nis = innovation @ np.linalg.solve(S, innovation)
        K = P @ H.T @ np.linalg.inv(S)
        K[4:][~learns] = 0.0
        self.x = after + K @ innovation
        self.P = (np.eye(6) - K @ H) @ P @ (np.eye(6) - K @ H).T + K @ R @ K.T
        _, assumed = s.on(self.plant)
        ranges = np.log([assumed.cart_mass, assumed.half_length])
        for i in range(2):
            if excited[i]:
                self.P[4 + i, 4 + i] = max(self.P[4 + i, 4 + i], least[i])
            self.x[4 + i] = np.clip(self.x[4 + i], *ranges[i])


@kernel
def along(memory, settings, measured, forces, dt):
    out = np.empty((len(measured), 5))
    for k in range(len(measured)):
        if k == 0:
            out[k, :2] = estimator.start(memory, settings, measured[k, 0], measured[k, 1])
        else:
            z, phi = measured[k]
            out[k, 0], out[k, 1] = estimator.update(memory, settings, z, phi, forces[k - 1], dt)
        out[k, 2], out[k, 3], out[k, 4] = memory.state[2], memory.state[3], memory.nis
    return out


def run_estimator(settings, measured, forces, dt=DT, plant=NOMINAL):
    memory = estimator.new_filter()
    record, _ = settings.on(plant)
    return along(memory, record, np.ascontiguousarray(measured), np.asarray(forces), dt), memory


def driven(rng, x, count, push=8.0, known=(0.05, 9.81), walk=0.0):
    """States and forces of a plant that a random force and a stabilising one drive for `count` ms.

    `walk` [m/s^2/sqrt(Hz)] is an acceleration of the cart that nobody measures.
    """
    states, forces = np.empty((count + 1, 6)), np.empty(count)
    states[0] = x
    wobble = 0.0
    for k in range(count):
        wobble += 0.02 * (push * rng.standard_normal() - wobble)
        z, phi, z_dot, phi_dot, ln_mass, ln_length = states[k]
        mass, length = math.exp(ln_mass), math.exp(ln_length)
        forces[k] = mass * (-(z + 2 * z_dot) - 30 * phi - 8 * phi_dot * math.sqrt(length)) + wobble
        inertia = mass + known[0] * (1 - 0.75 * math.cos(phi) ** 2)
        unknown = inertia * walk * rng.standard_normal() / math.sqrt(DT)
        states[k + 1] = rk4(states[k], forces[k] + unknown, *known, DT)
    return states, forces


def test_its_sensitivities_are_derivatives_and_its_transition_their_exponential(random_states, rng):
    plant = (1.37, 0.083, 0.29, 9.65)
    for state, force in zip(random_states, rng.uniform(-50, 50, len(random_states)), strict=True):
        x = np.array([*state, math.log(plant[0]), math.log(plant[2])])
        expected = jacobian(x, force, plant[1], plant[3])
        cart_row, pole_row, transition = (np.full(s, np.nan) for s in (6, 6, (6, 6)))
        linearise(state[1], state[3], force, plant, cart_row, pole_row)
        np.testing.assert_allclose([cart_row, pole_row], expected[2:4], rtol=1e-10, atol=1e-9)
        fill_transition(cart_row, pole_row, DT, transition)
        exact = scipy.linalg.expm(expected * DT)
        third = np.linalg.norm(expected * DT) ** 3 / 6  # the first term left out
        np.testing.assert_allclose(transition, exact, rtol=0, atol=2 * third + 1e-12)


@pytest.mark.parametrize(("settings", "dt"), [(EstimatorSettings(), 1e-3), (EVERY_ODD, 4e-3)])
def test_it_is_the_textbook_s_filter(settings, dt, rng):
    x = np.array([0.1, -0.4, 0.3, 0.5, math.log(1.1), math.log(0.35)])
    states, forces = driven(rng, x, 600, known=(ODD.pole_mass, ODD.gravity))
    forces[300:] *= 0.01  # and a stretch with little to learn from
    measured = states[:, :2] + rng.standard_normal((601, 2)) * [1e-4, 5e-4]
    out, memory = run_estimator(settings, measured, forces, dt, ODD)
    book = Textbook(settings, ODD, *measured[0])
    expected = [book.said]
    for (z, phi), force in zip(measured[1:], forces, strict=True):
        book.update(z, phi, force, dt)
        expected.append(book.said)
    # two orders of the same sums, and their rounding fed back over 600 updates
    np.testing.assert_allclose(out, expected, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(memory["covariance"], book.P, rtol=1e-6, atol=1e-12)


def test_its_errors_match_its_covariance_and_its_innovations_theirs():
    """NEES and NIS over 30 runs of plants drawn from its own prior, with the noise it assumes."""
    rng, s, runs, count = np.random.default_rng(20261), MATCHED, 30, 200
    spreads = [0.0, 0.0, s.speed_spread, s.rate_spread, s.cart_mass_spread, s.half_length_spread]
    mean = [0.0, 0.2, 0.0, 0.0, math.log(s.initial_cart_mass), math.log(s.initial_half_length)]
    nees, nis = np.zeros((runs, 3)), np.zeros((runs, count))
    for i in range(runs):
        start = mean + spreads * rng.standard_normal(6)
        states, forces = driven(rng, start, count, walk=s.acceleration_noise)
        noise = rng.standard_normal((count + 1, 2)) * [s.position_noise, s.angle_noise]
        measured = states[:, :2] + noise
        for column, end in enumerate((50, 100, count)):
            out, memory = run_estimator(s, measured[: end + 1], forces[:end])
            error = memory["state"] - states[end]
            nees[i, column] = error @ np.linalg.solve(memory["covariance"], error)
        nis[i] = out[1:, 4]
    low, high = scipy.stats.chi2.ppf([0.0005, 0.9995], 6 * runs) / runs
    assert ((low < nees.mean(axis=0)) & (nees.mean(axis=0) < high)).all(), nees.mean(axis=0)
    low, high = scipy.stats.chi2.ppf([0.0005, 0.9995], 2 * nis.size) / nis.size
    assert low < nis.mean() < high


def run_with_truth(mass, length, duration=0.6):
    schedule = {"cart_mass": mass, "half_length": length}
    scenario = afl.Scenario(name="run_with_truth", schedule=schedule, duration=duration)
    return afl.simulate_ode_held(scenario, "adaptive", control_period=DT)


@pytest.mark.parametrize("plant", [(0.1, 0.05), (0.1, 1.0), (0.6, 0.3), (2.0, 0.05), (2.0, 1.0)])
def test_without_noise_it_finds_any_plant_of_the_box(plant):
    run = run_with_truth(*plant)
    settings = EstimatorSettings(position_noise=1e-6, angle_noise=1e-6)
    out, _ = run_estimator(settings, run.state[:, :2], run.force[:-1])
    assert np.abs(np.log(out[50, :2] / plant)).max() < 0.01
    np.testing.assert_allclose(out[100:, 2:4], run.state[100:, 2:4], rtol=0, atol=0.01)


def test_it_finds_both_again_after_a_step_and_alike_in_the_mirror(rng):
    steps = (afl.staircase((0.3,), values) for values in ((0.5, 1.0), (0.2, 0.5)))
    run = run_with_truth(*steps, duration=1.0)
    measured = run.state[:, :2] + rng.standard_normal((len(run.time), 2)) * [1e-4, 1e-4]
    settings = EstimatorSettings(angle_noise=1e-4)
    out, _ = run_estimator(settings, measured, run.force[:-1])
    assert np.abs(np.log(out[290, :2] / [0.5, 0.2])).max() < 0.15
    assert np.abs(np.log(out[-1, :2] / [1.0, 0.5])).max() < 0.15
    mirrored, _ = run_estimator(settings, -measured, -run.force[:-1])
    np.testing.assert_array_equal(mirrored, out * [1, 1, -1, -1, 1])


def test_at_rest_nothing_moves_an_estimate_and_what_is_learned_is_kept(rng):
    out, memory = run_estimator(EstimatorSettings(), np.zeros((20_001, 2)), np.zeros(20_000))
    np.testing.assert_array_equal(out[:, :2], np.broadcast_to(out[0, :2], (20_001, 2)))
    assert all(np.isfinite(memory[name]).all() for name in ("state", "covariance"))
    run = run_with_truth(0.6, 0.3, duration=12.0)
    measured = run.state[:, :2] + rng.standard_normal((len(run.time), 2)) * [1e-4, 5e-4]
    out, _ = run_estimator(EstimatorSettings(), measured, run.force[:-1])
    assert len(np.unique(out[10_000:, :2], axis=0)) == 1
    assert np.abs(np.log(out[-1, :2] / [0.6, 0.3])).max() < 0.1


def test_whatever_it_is_given_it_stays_finite_and_in_its_range():
    """200 cases: any plant and start of the box, noise, period; sensors and forces that lie."""
    rng, (_, assumed) = np.random.default_rng(7), EstimatorSettings().on(NOMINAL)
    least, largest = np.array([assumed.cart_mass, assumed.half_length]).T
    for _ in range(200):
        noise = 10 ** rng.uniform(-6, -2, 2)
        settings = EstimatorSettings(
            position_noise=noise[0], angle_noise=noise[1],
            initial_cart_mass=rng.uniform(0.1, 2), initial_half_length=rng.uniform(0.05, 1),
        )  # fmt: skip
        phi = rng.uniform(-1.5, 1.5) + np.cumsum(rng.uniform(-0.05, 0.05, 101))
        z = rng.uniform(-3, 3) + np.cumsum(rng.uniform(-0.02, 0.02, 101))
        forces = rng.uniform(-200, 200) * rng.standard_normal(100)
        dt = float(10 ** rng.uniform(-4, -2))
        out, memory = run_estimator(settings, np.stack([z, phi], axis=1), forces, dt)
        assert all(np.isfinite(memory[name]).all() for name in ("state", "covariance"))
        assert (out[:, :2] >= least * (1 - 1e-12)).all()
        assert (out[:, :2] <= largest * (1 + 1e-12)).all()
        covariance = memory["covariance"]
        np.testing.assert_array_equal(covariance, covariance.T)
        scale = np.sqrt(np.diag(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > -1e-9


def test_it_knows_m_and_g_keeps_to_the_box_and_twice_the_start_and_starts_over_there():
    settings, usual = EstimatorSettings().on(NOMINAL)
    assert usual == PlantRange((0.08, 2.5), (0.04, 1.25), 0.05, 9.81)
    heavy = afl.CartPoleParameters(cart_mass=8.0, half_length=1.5, pole_mass=0.2, gravity=3.7)
    record, assumed = EstimatorSettings().on(heavy)
    assert assumed == PlantRange((0.08, 16.0), (0.04, 3.0), 0.2, 3.7)
    assert (record["pole_mass"], record["gravity"]) == (0.2, 3.7)
    np.testing.assert_allclose(np.exp(record["ln_highest"]), (16.0, 3.0))
    memory = estimator.new_filter()
    estimator.start(memory, settings, 0.1, 0.2)
    memory["state"][:] = 1.0, 1.0, 1.0, 600.0, math.log(1.7), math.log(0.8)
    assert estimator.update(memory, settings, 0.3, 0.4, 0.0, 1e-3) == pytest.approx((1.7, 0.8))
    kept = [0.3, 0.4, 0.0, 0.0, math.log(1.7), math.log(0.8)]
    assert memory["state"].tolist() == pytest.approx(kept) and memory["nis"] == 0.0
