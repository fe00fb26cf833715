"""Which estimator of M and l? Six of them on the same measurements, outside the loop.

Run: python benchmarks/bench_estimator_candidates.py [--seeds 8]

The measurements are those of the run in MuJoCo as deployed at 1 kHz under the adaptive
controller with the true M and l, with white noise on z and phi, so no estimator disturbs another.
Errors are those of ln M and ln l, root mean square over the seeds and the four cases of the paper;
the drift is that of step-step at rest. Every candidate knows m, g and the
noise, starts at M = 0.1 kg, l = 0.5 m, and is clipped to the same box.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

import afl_mujoco as afl
from afl_mujoco.control import estimator
from afl_mujoco.control.estimator import EstimatorSettings, moved
from afl_mujoco.scenario.parameters import NOMINAL

Array = NDArray[np.float64]
Candidate = Callable[[Array, Array, Array, float, float, float], None]

DT = 1e-3
CASES = ("step-step", "step-trapezoid", "trapezoid-step", "trapezoid-trapezoid")
NOISES = {"none": (0.0, 0.0), "fine": (1e-4, 1e-4), "coarse": (1e-4, 1e-3)}
WINDOWS = {"20-100 ms": (20, 100), "0.1-1 s": (100, 1000), "1-6 s": (1000, 6000)}
REST = (8000, 19_999)  # of step-step, where nothing changes any more
ACCELERATION_NOISE, ACCURACY = 0.01, 0.1
SPREAD, INVERSE_SPREAD = np.array((1.5, 1.0)), np.array((7.0, 6.0))
LEAST_EXCITATION, EXCITATION_MEMORY = np.array((0.05, 0.03)), 0.3
POLE_MASS, GRAVITY = 0.05, 9.81
START = np.log([0.1, 0.5])
LOW, HIGH = np.log([0.08, 0.04]), np.log([2.5, 1.25])
LN, INVERSE = 0, 1


@njit
def parameters(x, kind):
    if kind == LN:
        return np.exp(x[4]), np.exp(x[5])
    return 1.0 / x[4], 1.0 / x[5]


@njit
def flow(x, force, kind):
    mass, length = parameters(x, kind)
    y = x.copy()
    plant = (mass, POLE_MASS, length, GRAVITY)
    y[0], y[1], y[2], y[3] = moved(x[0], x[1], x[2], x[3], force, plant, DT)
    return y


@njit
def by_differences(x, cov, force, kind):
    """The extended filter's prediction, its Jacobian by central differences."""
    jacobian = np.empty((6, 6))
    for j in range(6):
        up, down = x.copy(), x.copy()
        step = 1e-6 * max(1.0, abs(x[j]))
        up[j] += step
        down[j] -= step
        jacobian[:, j] = (flow(up, force, kind) - flow(down, force, kind)) / (2.0 * step)
    return flow(x, force, kind), jacobian @ cov @ jacobian.T


@njit
def by_cubature(x, cov, force, kind):
    """The unscented filter's prediction with its twelve equal points (kappa = 0)."""
    root = np.linalg.cholesky(cov) * np.sqrt(6.0)
    points = np.empty((12, 6))
    for i in range(6):
        points[2 * i] = flow(x + root[:, i], force, kind)
        points[2 * i + 1] = flow(x - root[:, i], force, kind)
    mean = np.empty(6)
    for j in range(6):
        mean[j] = points[:, j].mean()
    spread = points - mean
    return mean, spread.T @ spread / 12.0


@njit
def predicted(x, cov, force, kind, cubature, excitation):
    """State and covariance a period later, and the excitations."""
    length = parameters(x, kind)[1]
    direction = np.zeros(6)
    direction[2], direction[3] = 1.0, 0.75 / length * np.cos(x[1])
    unknown = np.outer(direction, direction) * (0.5 * ACCELERATION_NOISE**2 * DT)
    unknown[3, 3] *= 1.0 + cov[5, 5] / (1.0 if kind == LN else x[5]) ** 2
    if cubature:
        after, cov = by_cubature(x, cov + unknown, force, kind)
    else:
        after, cov = by_differences(x, cov + unknown, force, kind)
    now = (after[2:4] - x[2:4]) / DT * np.array((1.0, length))
    excitation += DT / (DT + EXCITATION_MEMORY) * (now - excitation)
    return after, cov + unknown


@njit
def corrected(x, cov, measured, noise, learns):
    """State and covariance with a measurement, by Joseph's form; zeros in `learns` freeze."""
    for i in range(2):
        gain = cov[:, i] / (cov[i, i] + noise[i] ** 2)
        gain[4:] *= learns
        x = x + gain * (measured[i] - x[i])
        left = np.eye(6)
        left[:, i] -= gain
        cov = left @ cov @ left.T + np.outer(gain, gain) * noise[i] ** 2
    return x, cov


@njit
def kalman(z, phi, force, noise, out, kind, cubature, walk):
    """A filter on (z, phi, z', phi', two parameters); `walk` [1/sqrt(s)]: random walks instead."""
    x, cov = np.array((z[0], phi[0], 0.0, 0.0, START[0], START[1])), np.eye(6)
    cov[0, 0], cov[1, 1] = noise[0] ** 2, noise[1] ** 2
    low, high, spread = LOW, HIGH, SPREAD
    if kind == INVERSE:
        x[4:], low, high, spread = np.exp(-x[4:]), np.exp(-HIGH), np.exp(-LOW), INVERSE_SPREAD
    cov[4, 4], cov[5, 5] = spread[0] ** 2, spread[1] ** 2
    excitation = np.zeros(2)
    for k in range(1, len(z)):
        x, cov = predicted(x, cov, force[k - 1], kind, cubature, excitation)
        least = (ACCURACY * (np.ones(2) if kind == LN else x[4:])) ** 2
        variance = np.array((cov[4, 4], cov[5, 5]))
        excited = np.abs(excitation) > LEAST_EXCITATION
        learns = 1.0 * (excited | (variance > least) | (walk > 0.0))
        x, cov = corrected(x, cov, (z[k], phi[k]), noise, learns)
        x[4:] = np.minimum(np.maximum(x[4:], low), high)
        for j in range(4, 6):
            if walk > 0.0:
                cov[j, j] += walk**2 * DT * least[j - 4] / ACCURACY**2
            elif excited[j - 4]:
                cov[j, j] = max(cov[j, j], least[j - 4])
        out[k] = parameters(x, kind)


@njit
def least_squares(z, phi, force, noise, out, pole, forgetting):
    """Recursive least squares of 1/(M + m) and 1/l on (P2), (P1) behind H = pole^2/(s + pole)^2.

    (M + m) s^2 H z = H F + m l s^2 H sin phi;  4/3 s^2 H phi = (cos phi s^2 H z + g H sin phi) / l.
    `forgetting` is the factor of a step; 1 is forgetting in proportion to the information.
    """
    share = 1.0 - np.exp(-pole * DT)
    signal, once, twice = np.zeros(5), np.zeros(5), np.zeros(5)  # what drives starts from zero
    signal[0], signal[1], signal[2] = z[0], phi[0], np.sin(phi[0])
    once[:3], twice[:3] = signal[:3], signal[:3]
    theta = np.exp(-START)
    cov = INVERSE_SPREAD**2
    for k in range(1, len(z)):
        signal[0], signal[1], signal[2], signal[3] = z[k], phi[k], np.sin(phi[k]), force[k - 1]
        signal[4] = signal[2]
        once += share * (signal - once)
        twice += share * (once - twice)
        second = pole**2 * (signal - 2.0 * once + twice)
        drive = twice[3] + POLE_MASS / theta[1] * second[2]
        lean = 0.75 * (np.cos(twice[1]) * second[0] + GRAVITY * twice[4])
        for i, y, r in ((0, second[0], drive), (1, second[1], lean)):
            variance = (pole**2 * max(noise[i], 1e-5)) ** 2
            gain = cov[i] * r / (variance + r * r * cov[i])
            theta[i] += gain * (y - r * theta[i])
            cov[i] -= gain * r * cov[i]
            if forgetting < 1.0:
                cov[i] /= forgetting
            else:
                wanted = (ACCURACY * theta[i]) ** 2
                cov[i] += wanted**2 * r * r / (variance + r * r * wanted)
            theta[i] = min(max(theta[i], np.exp(-HIGH[i])), np.exp(-LOW[i]))
        out[k, 0], out[k, 1] = 1.0 / theta[0] - POLE_MASS, 1.0 / theta[1]


@njit
def of_the_package(z, phi, force, settings, memory, out):
    estimator.start(memory, settings, z[0], phi[0])
    for k in range(1, len(z)):
        out[k] = estimator.update(memory, settings, z[k], phi[k], force[k - 1], DT)


def package(z: Array, phi: Array, force: Array, noise: tuple[float, float], out: Array) -> None:
    chosen = EstimatorSettings(position_noise=noise[0], angle_noise=noise[1])
    settings, _ = chosen.on(NOMINAL)
    of_the_package(z, phi, force, settings, estimator.new_filter(), out)


def candidates() -> dict[str, Callable[..., None]]:
    def variant(kind: int, cubature: bool, walk: float) -> Callable[..., None]:
        return lambda *run: kalman(*run, kind, cubature, walk)

    def recursive(pole: float, forgetting: float) -> Callable[..., None]:
        return lambda *run: least_squares(*run, pole, forgetting)

    return {
        "extended, ln M, ln l (chosen)": package,
        "extended, 1/M, 1/l": variant(INVERSE, False, 0.0),
        "unscented, ln M, ln l": variant(LN, True, 0.0),
        "extended, ln, random walk 0.3": variant(LN, False, 0.3),
        "extended, ln, random walk 1.0": variant(LN, False, 1.0),
        "least squares, 30/s": recursive(30.0, 1.0),
        "least squares, 60/s": recursive(60.0, 1.0),
        "least squares, 100/s": recursive(100.0, 1.0),
        "least squares, 30/s, factor 0.99": recursive(30.0, 0.99),
    }


def errors(out: Array, run: afl.Trajectory) -> Array:
    truth = np.stack([run.cart_mass, run.half_length], axis=1)
    return np.log(out[1:] / truth[:-1])


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare estimators of M and l.")
    parser.add_argument("--seeds", type=int, default=8)
    options = parser.parse_args()
    law = afl.CONTROLLERS["adaptive"]
    runs = {c: afl.simulate_mujoco(afl.SCENARIOS[c], law, "sampled") for c in CASES}
    for label, sigma in NOISES.items():
        assumed = tuple(max(s, 1e-5) for s in sigma)
        print(f"\nnoise {label}: {sigma[0]:g} m, {sigma[1]:g} rad; rms of ln M / ln l")
        print(f"  {'':<34}" + "".join(f"{w:>14}" for w in WINDOWS) + "    drift 8-20 s    us/step")
        for name, estimate in candidates().items():
            found, drift, spent = [], [], []
            for case, run in runs.items():
                for seed in range(options.seeds if any(sigma) else 1):
                    rng = np.random.default_rng(seed)
                    n = rng.standard_normal((2, len(run.time)))
                    z, phi = (run.state[:, i] + sigma[i] * n[i] for i in range(2))
                    out = np.empty((len(z), 2))
                    start = time.perf_counter()
                    estimate(z, phi, np.ascontiguousarray(run.force), assumed, out)
                    spent.append((time.perf_counter() - start) / len(z) * 1e6)
                    e = errors(out, run)
                    found.append([np.mean(e[a:b] ** 2, axis=0) for a, b in WINDOWS.values()])
                    if case == CASES[0]:
                        drift.append(np.log(out[REST[1]] / out[REST[0]]))
            rms = np.sqrt(np.mean(found, axis=0))
            moved_by = np.sqrt(np.mean(np.square(drift), axis=0))
            print(
                f"  {name:<34}"
                + "".join(f"   {m:5.3f}/{x:5.3f}" for m, x in rms)
                + f"     {moved_by[0]:5.3f}/{moved_by[1]:5.3f}     {np.median(spent):6.2f}"
            )


if __name__ == "__main__":
    main()
