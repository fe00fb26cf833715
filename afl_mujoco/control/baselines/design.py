"""How the baselines get their gains: over the paper's box of plants, from the linear model alone.

Run: python -m afl_mujoco.control.baselines.design afl_mujoco/control/data/baselines.json
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

from afl_mujoco.control.baselines.linear_model import (
    accelerated_mass,
    partially_linear_model,
    pole_placing_gains,
    upright_model,
)
from afl_mujoco.control.baselines.state_feedback import SCHEMA
from afl_mujoco.control.compiled_controller import LINEAR, PARTIAL
from afl_mujoco.control.gains import FIXED_GAINS
from afl_mujoco.files import write_text
from afl_mujoco.scenario.parameters import NOMINAL, CartPoleParameters

CART_MASSES = tuple(k / 10 for k in range(1, 21))
"""Nodes M [kg]: the paper's grid."""

HALF_LENGTHS = tuple(k / 20 for k in range(1, 21))
"""Nodes l [m]: the paper's grid."""

LARGEST_STATE = (7.60, 1.05, 8.13, 2.84)
"""Bryson's rule: each state is weighted by the inverse square of this [m, rad, m/s, rad/s]: the
peaks of the paper's own controller, fixed gains, on the nominal plant from -60 degrees."""

LARGEST_ACCELERATION = 41.76
"""The force is weighted by the inverse square of this times M + m/4 [m/s^2], chosen so that the LQR
needs the same largest force on the nominal plant from -60 degrees as the paper's one, 96.1 N."""

DIGITS = 10
"""Significant digits that are kept of a gain: the rest is the linear algebra library's."""


def paper_poles(half_length: float, gravity: float) -> tuple[float, ...]:
    """Return the poles that the paper's controller with its fixed gains has at upright [1/s].

    There its linearisation is exact: ``xi1`` obeys ``(d/dt + lambda)^3 xi1 = s`` and, within the
    boundary layer, ``s' = -3 g K / (4 l Phi) s``. So pole placement with these is the paper's
    controller without what is nonlinear in it.

    Parameters
    ----------
    half_length, gravity
        l [m] and g [m/s^2].
    """
    g = FIXED_GAINS
    fast = 0.75 * gravity / half_length * g.switching / g.boundary_layer
    return (-g.slope, -g.slope, -g.slope, -fast)


def lqr_gains(parameters: CartPoleParameters) -> NDArray[np.float64]:
    """Return the gains that minimise the quadratic cost of Bryson's rule, shape (4,)."""
    a, b = upright_model(parameters)
    states = np.diag([x**-2 for x in LARGEST_STATE])
    force = (LARGEST_ACCELERATION * accelerated_mass(parameters)) ** -2
    cost = solve_continuous_are(a, b[:, None], states, np.array([[force]]))
    return np.asarray(b @ cost / force)


def placed_gains(parameters: CartPoleParameters) -> NDArray[np.float64]:
    """Return the gains that give the plant `paper_poles`, shape (4,)."""
    p = parameters
    return pole_placing_gains(upright_model(p), paper_poles(p.half_length, p.gravity))


def outer_gains(parameters: CartPoleParameters) -> NDArray[np.float64]:
    """Return the gains that give the plant `paper_poles` through the input map (L1), shape (4,)."""
    p = parameters
    model = partially_linear_model(p.half_length, p.gravity)
    return pole_placing_gains(model, paper_poles(p.half_length, p.gravity))


_POLES = (
    "-lambda three times, -3 g K / (4 l Phi): those of the paper's controller with its fixed gains"
)

DESIGNS: dict[
    str, tuple[int, Callable[[CartPoleParameters], NDArray[np.float64]], dict[str, Any]]
] = {
    "lqr": (
        LINEAR,
        lqr_gains,
        {
            "method": "LQR by Bryson's rule",
            "largest_state": list(LARGEST_STATE),
            "largest_force": f"{LARGEST_ACCELERATION} (M + m/4)",
        },
    ),
    "pole-placement": (LINEAR, placed_gains, {"method": "pole placement", "poles": _POLES}),
    "partial-linearization": (
        PARTIAL,
        outer_gains,
        {"method": "pole placement behind the input map (L1)", "poles": _POLES},
    ),
}
"""The baselines by name: kind of controller, its gains for a plant, and how they are found."""


def tables() -> dict[str, Any]:
    """Return the gains of every baseline on the grid, as the package ships them."""
    controllers = {}
    for name, (kind, gains, design) in DESIGNS.items():
        table = [[_rounded(gains(_plant(m, x))) for x in HALF_LENGTHS] for m in CART_MASSES]
        controllers[name] = {"kind": kind, "design": design, "gains": table}
    return {
        "schema": SCHEMA,
        "provenance": {
            "command": "python -m afl_mujoco.control.baselines.design",
            "pole_mass": NOMINAL.pole_mass,
            "gravity": NOMINAL.gravity,
            "slope": FIXED_GAINS.slope,
            "switching": FIXED_GAINS.switching,
            "boundary_layer": FIXED_GAINS.boundary_layer,
            "versions": {name: version(name) for name in ("afl_mujoco", "numpy", "scipy")},
        },
        "cart_masses": list(CART_MASSES),
        "half_lengths": list(HALF_LENGTHS),
        "controllers": controllers,
    }


def _plant(cart_mass: float, half_length: float) -> CartPoleParameters:
    """Return the paper's plant with this M [kg] and l [m]."""
    return CartPoleParameters(cart_mass=cart_mass, half_length=half_length)


def _rounded(gains: NDArray[np.float64]) -> list[float]:
    """Return gains with as many digits as are kept."""
    return [float(f"{gain:.{DIGITS}g}") for gain in gains.tolist()]


def as_text(content: dict[str, Any]) -> str:
    """Return the tables as JSON, the gains of a cart mass a line."""
    lines = {
        f"@{name}-{i}@": row
        for name, entry in content["controllers"].items()
        for i, row in enumerate(entry["gains"])
    }
    marked = {
        name: {**entry, "gains": [f"@{name}-{i}@" for i in range(len(entry["gains"]))]}
        for name, entry in content["controllers"].items()
    }
    text = json.dumps({**content, "controllers": marked}, indent=1)
    for mark, row in lines.items():
        text = text.replace(f'"{mark}"', json.dumps(row))
    return f"{text}\n"


def main(arguments: Sequence[str]) -> None:
    """Write the tables to the file that the one argument names."""
    write_text(Path(arguments[0]), as_text(tables()))


if __name__ == "__main__":
    main(sys.argv[1:])
