"""How many closed loops of 20 s per second and core? The batch against its alternatives.

Run: python benchmarks/bench_batch.py [--repeats 10]

All ways are timed in turn in each repeat, on the same loops; a ratio is the median over the repeats
of the ratio within one repeat. Rates are by the processor time of the process; those of two threads
and two processes are by wall time. JAX is one of the ways if it is installed.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import math
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray
from ratios import say
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import afl_mujoco as afl
from afl_mujoco.control import law as fl
from afl_mujoco.control import law as sliding_mode
from afl_mujoco.control.law import sliding_and_drift
from afl_mujoco.plants import cartpole_equations as dynamics
from afl_mujoco.scenario.parameters import NOMINAL
from afl_mujoco.studies.verify.claims import objective
from research.batch import closed_loop_terms
from research.gain_tuning import GAIN_BOX, HORIZON, paper_scales

Array = NDArray[np.float64]
Way = Callable[[Array], Array]

LOWER, UPPER = np.array([(0.1, 0.05, *GAIN_BOX.lower), (2.0, 1.0, *GAIN_BOX.upper)])
"""The box of loops (M, l, K, lambda, Phi)."""

POLE_MASS, GRAVITY = NOMINAL.pole_mass, NOMINAL.gravity
START = (0.0, -math.pi / 3.0, 0.0, 0.0, 0.0, 0.0)
"""z, phi, their rates, and the integrals of their absolute values."""

CLAIM = 1e-5
"""Relative error of the objective that the batch claims, and that fixed steps must reach."""

LENGTHS = (0.05, 0.1, 0.2, 0.5, 1.0)
STEPS = (2e-2, 1e-2, 8e-3, 5e-3, 4e-3, 2.5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
"""Edges of the classes of half-lengths [m], and the fixed steps to choose from [s]."""

A_REPEAT, SHARED = 4, 20_000
"""Loops of a repeat, of which the fast ways integrate copies; loops that two threads share."""


@register_jitable
def rates(y, loop):
    """Return the slopes of the six states and F, by the readable equations, in any number type."""
    z, phi, z_dot, phi_dot = y[0], y[1], y[2], y[3]
    cart_mass, length, switching, slope, layer = loop
    surface, drift = sliding_and_drift(z, phi, z_dot, phi_dot, length, GRAVITY, slope)
    input_gain = fl.beta(phi, phi_dot, length, GRAVITY)
    u = sliding_mode.commanded_acceleration(surface, drift, input_gain, switching, layer)
    plant = (cart_mass, POLE_MASS, length, GRAVITY)
    force = fl.linearizing_force(u, phi, phi_dot, *plant)
    z_ddot = dynamics.cart_acceleration(phi, phi_dot, force, *plant)
    phi_ddot = dynamics.pole_acceleration(phi, phi_dot, force, *plant)
    return (z_dot, phi_dot, z_ddot, phi_ddot, abs(z), abs(phi)), force


@register_jitable
def added(y, h, k):
    """y + h k."""
    z, phi, z_dot, phi_dot = y[0] + h * k[0], y[1] + h * k[1], y[2] + h * k[2], y[3] + h * k[3]
    return z, phi, z_dot, phi_dot, y[4] + h * k[4], y[5] + h * k[5]


@register_jitable
def rk4_step(y, h, loop):
    """The state after a step, and abs(F) before it."""
    k1, force = rates(y, loop)
    k2, _ = rates(added(y, 0.5 * h, k1), loop)
    k3, _ = rates(added(y, 0.5 * h, k2), loop)
    k4, _ = rates(added(y, h, k3), loop)
    y = added(added(y, h / 6.0, k1), h / 3.0, k2)
    return added(added(y, h / 3.0, k3), h / 6.0, k4), abs(force)


compiled_rates = njit(error_model="numpy")(lambda y, loop: rates(y, loop))


@njit(error_model="numpy")
def fixed_steps(loops, steps):
    """Return the terms of (O1), one loop after the other."""
    terms = np.empty((len(loops), 3))
    for i in range(len(loops)):
        y, peak = START, 0.0
        for _ in range(round(HORIZON / steps[i])):
            y, force = rk4_step(y, steps[i], loops[i])
            peak = max(peak, force)
        terms[i] = y[4], y[5], peak
    return terms


def drawn(count: int, seed: int) -> Array:
    """Loops over the box by their logarithms, shape (count, 5)."""
    fractions = np.random.default_rng(seed).random((count, 5))
    return LOWER * (UPPER / LOWER) ** fractions


def costs(terms: Array) -> Array:
    return np.asarray(objective(*np.asarray(terms).T, paper_scales()))


def exact(loop: Array) -> Array:
    """The terms by DOP853 at rtol 1e-12, |z| and |phi| integrated from zero to zero."""

    def signed(_: float, y: Array) -> tuple[float, ...]:
        return (*compiled_rates(y, loop)[0][:4], y[0], y[1])

    def pull(t: float) -> float:
        return -abs(compiled_rates(run.sol(t), loop)[1])

    run = solve_ivp(
        signed, (0.0, HORIZON), START, method="DOP853", rtol=1e-12, atol=1e-13, max_step=0.02,
        events=(lambda t, y: y[0], lambda t, y: y[1]), dense_output=True,
    )  # fmt: skip
    at_zeros = [[0.0, *run.y_events[k][:, 4 + k], run.y[4 + k, -1]] for k in (0, 1)]
    forces = [abs(compiled_rates(y, loop)[1]) for y in run.y.T]
    k = np.argmax(forces)
    around = run.t[max(k - 1, 0)], run.t[min(k + 1, len(forces) - 1)]
    peak = minimize_scalar(pull, bounds=around, method="bounded", options={"xatol": 1e-9})
    return np.array([*(np.abs(np.diff(x)).sum() for x in at_zeros), max(forces[k], -peak.fun)])


def batch(loops: Array, threads: int = 1) -> Array:
    terms = closed_loop_terms(loops[:, 2:], loops[:, :2], duration=HORIZON, threads=threads)
    return np.stack([terms.iae_z, terms.iae_phi, terms.max_force], axis=1)


def by_scipy(rates_of: Callable[[Array], Callable[[Array], Any]]) -> Way:
    """RK45, the integrals as states, the largest force over the solver's steps."""

    def terms(loop: Array) -> list[float]:
        of = rates_of(loop)
        run = solve_ivp(lambda t, y: of(y)[0], (0.0, HORIZON), START, rtol=1e-6, atol=1e-9)
        return [*run.y[4:, -1], max(abs(of(y)[1]) for y in run.y.T)]

    return lambda loops: np.array([terms(loop) for loop in loops])


def public_names(loop: Array) -> Callable[[Array], Any]:
    """Return the same as `rates`, as a user of the package would write it."""
    parameters = afl.CartPoleParameters(cart_mass=loop[0], half_length=loop[1])
    gains = afl.Gains(switching=loop[2], slope=loop[3], boundary_layer=loop[4])

    def of(y: Array) -> Any:
        force = afl.control_force(y[:4], parameters, gains)
        return [*y[2:4], *afl.acceleration(y[:4], force, parameters), *np.abs(y[:2])], force

    return of


def functions_of(namespace: object) -> contextlib.ExitStack:
    """Make the equations use sin, cos and the like from another module than NumPy."""
    stack = contextlib.ExitStack()
    for module in (fl, sliding_mode, dynamics):
        stack.enter_context(mock.patch.object(module, "np", namespace))
    return stack


def plain_floats(loops: Array) -> Array:
    """The equations with Python's floats and the functions of `math`."""
    floats = {"sin": math.sin, "cos": math.cos, "arcsinh": math.asinh}
    with functions_of(SimpleNamespace(**floats, minimum=min, maximum=max)):
        return by_scipy(lambda loop: lambda y: rates(y.tolist(), loop))(loops.tolist())


def by_jax(step_of: Callable[[Array], Array]) -> Way:
    """`jax.vmap` of a rollout under `lax.scan`, float64, one core; loops of one step together."""
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    import jax

    jax.config.update("jax_enable_x64", True)

    @functools.cache
    def compiled(h: float) -> Callable[[Any], Any]:
        def rollout(loop: Any) -> Any:
            def advance(carry: Any, _: None) -> Any:
                y, force = rk4_step(carry[0], h, loop)
                return (y, jax.numpy.maximum(carry[1], force)), None

            start = tuple(jax.numpy.array(START))
            (y, peak), _ = jax.lax.scan(advance, (start, start[0]), length=round(HORIZON / h))
            return y[4], y[5], peak

        return jax.jit(jax.vmap(rollout))

    def march(loops: Array) -> Array:
        found, steps = np.empty((len(loops), 3)), step_of(loops)
        with functions_of(jax.numpy):
            for h in np.unique(steps):
                found[steps == h] = np.stack(compiled(h)(loops[steps == h]), axis=1)
        return found

    return march


def largest_steps(loops: Array, expected: Array) -> Callable[[Array], Array]:
    """Return the fixed step of each loop: the largest with which all of its class keep the claim.

    The largest force is left out: steps that do not end on the edge of the boundary layer miss it
    where it is there, however small they are.
    """
    edges, steps = LENGTHS[1:-1], []
    for k in range(len(edges) + 1):
        these = np.digitize(loops[:, 1], edges) == k
        for h in STEPS:
            found = fixed_steps(loops[these], np.full(these.sum(), h))
            found[:, 2] = expected[these, 2]
            if np.abs(costs(found) / costs(expected[these]) - 1.0).max(initial=0.0) <= CLAIM:
                break
        steps.append(h)
        print(f"  {1e3 * h:g} ms for half-lengths from {LENGTHS[k]} to {LENGTHS[k + 1]} m")
    return lambda loops: np.array(steps)[np.digitize(loops[:, 1], edges)]


def the_ways(loops: Array, expected: Array) -> dict[str, tuple[Way, int]]:
    """Return every way to integrate loops on one core, and its number of copies of a loop."""
    print(f"\nfixed steps, chosen for an error of {CLAIM:g} without the largest force")
    step_of = largest_steps(loops, expected)
    ways = {
        "batch": (batch, 512),
        "solve_ivp, public names": (by_scipy(public_names), 1),
        "solve_ivp, plain floats": (plain_floats, 1),
        "solve_ivp, compiled": (by_scipy(lambda p: lambda y: compiled_rates(y, p)), 1),
        "compiled RK4, fixed step": (lambda loops: fixed_steps(loops, step_of(loops)), 8),
    }
    try:
        ways["jax.vmap, RK4, fixed step"] = (by_jax(step_of), 256)
    except ImportError:
        print("  JAX is not installed: skipped")
    return ways


def compare_ways(repeats: int) -> None:
    """Time every way on one core, and print its rate and its error."""
    loops = drawn(A_REPEAT * repeats, seed=1)
    expected = np.array([exact(loop) for loop in loops])
    ways = the_ways(loops, expected)
    per_second, errors = {name: [] for name in ways}, {name: [] for name in ways}
    parts = np.split(loops, repeats)
    for way, copies in ways.values():
        for part in parts if copies > 1 else ():
            way(np.tile(part, (copies, 1)))  # compiles
    for part, right in zip(parts, np.split(expected, repeats), strict=True):
        for name, (way, copies) in ways.items():
            batch = np.tile(part, (copies, 1))
            start = time.process_time()
            found = way(batch)
            per_second[name].append(len(batch) / (time.process_time() - start))
            errors[name] += list(np.abs(costs(found[:A_REPEAT]) / costs(right) - 1.0))
    print(f"\none core, {len(loops)} loops over the box, median of {repeats} repeats")
    for name in ways:
        ratios = [a / b for a, b in zip(per_second["batch"], per_second[name], strict=True)]
        print(
            f"  {name:<30}{statistics.median(per_second[name]):>9,.1f} loops/s,"
            f" batch / it {statistics.median(ratios):>8,.1f},"
            f" error {np.median(errors[name]):.0e}, at most {max(errors[name]):.1e}"
        )
        if name == "solve_ivp, public names":
            say("batch / solve_ivp with public names", statistics.median(ratios), least=1000.0)
    say(f"error of the batch / {CLAIM:g}", max(errors["batch"]) / CLAIM, most=1.0)


def compare_sharing(repeats: int) -> None:
    """Time two threads and two processes against one thread."""
    loops = drawn(SHARED, seed=2)
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        calls = {
            "one thread": lambda: batch(loops),
            "two threads": lambda: batch(loops, threads=2),
            "two processes": lambda: list(pool.map(batch, np.array_split(loops, 8))),
        }
        times = {name: [] for name in calls}
        for _ in range(repeats + 1):
            for name, call in calls.items():
                start = time.perf_counter()
                call()
                times[name].append(time.perf_counter() - start)
    print(f"\n{SHARED} loops, wall time, median of {repeats} repeats")
    for name, spent in times.items():
        gains = [a / b for a, b in zip(times["one thread"][1:], spent[1:], strict=True)]
        rate = SHARED / statistics.median(spent[1:])
        print(f"  {name:<30}{rate:>9,.0f} loops/s, {statistics.median(gains):.2f} times one thread")
        if name == "two threads":
            say("batch: two threads / one", statistics.median(gains), least=1.8)


def main() -> None:
    """Compare on one core, then on two."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=10)
    repeats = parser.parse_args().repeats
    compare_ways(repeats)
    compare_sharing(repeats)


if __name__ == "__main__":
    main()
