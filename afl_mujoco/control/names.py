"""Names of the controllers, for code that must not import them: ``--help``, defaults, texts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from afl_mujoco.errors import UnknownNameError

if TYPE_CHECKING:
    from afl_mujoco.control.controller import Controller
    from afl_mujoco.scenario.scenario import Scenario

PAPER = ("fixed", "adaptive")  # the paper's two controllers, the default where results are for it

AFL = (*PAPER, *(f"{name}-retuned" for name in PAPER), *(f"{name}-nominal" for name in PAPER))
"""Feedback linearisation: the paper's gains; gains found here; nominal M and l assumed."""

ANGLE = "adaptive-angle"  # feedback linearisation, its slope by the pole's angle; interpreted
BASELINES = ("lqr", "pole-placement", "partial-linearization")
"""State feedback controllers to compare it with."""

NAMES = (*AFL, ANGLE, *BASELINES)  # every controller of the catalogue, in its order

INFORMED = tuple(n for n in NAMES if not n.endswith("-nominal") and n != ANGLE)
"""Compiled controllers that know the true M(t) and l(t) at every instant, nothing of the past."""

ESTIMATED = "-estimated"
"""Ending of the name of a controller that uses the estimator: ``adaptive-estimated``. Such
controllers are not in the catalogue: only sampled mode supports them."""

SUBJECT, REFERENCE = "adaptive", "lqr"
"""The controller that a single run shows and findings are about, and the one it is compared
with."""


def subject_of(names: Sequence[str]) -> str:
    """Return whom findings are about: the first of one's own, else the paper's, else not LQR."""
    own = [name for name in names if name.removesuffix(ESTIMATED) not in NAMES]
    others = [name for name in names if name != REFERENCE]
    return next(iter([*own, *(name for name in others if name == SUBJECT), *others]), names[0])


SWEPT = (*(name for name in AFL if name != "fixed-nominal"), f"{SUBJECT}{ESTIMATED}", *BASELINES)
"""Those whose thresholds are looked for."""


def chosen(
    names: Sequence[str],
    scenarios: Iterable[Scenario],
    default: Sequence[str] = (SUBJECT, REFERENCE),
) -> tuple[str, ...]:
    """Return the controllers that are asked for, by default those that the plants can have."""
    paper = all(scenario.is_cart_pole for scenario in scenarios)
    return tuple(names or (default if paper else (REFERENCE,)))


def require_known(name: str) -> None:
    """Raise unless a name is that of a controller, with the estimator or not, or says a module."""
    base = name.removesuffix(ESTIMATED)
    if ":" not in name and name not in NAMES and not (base != name and base in INFORMED):
        others = (f"({', '.join(INFORMED)}){ESTIMATED}", "module:attribute")
        raise UnknownNameError.among("controller", name, (*NAMES, *others))


def find_controllers(
    names: Sequence[str],
    scenarios: Sequence[Scenario],
    default: Sequence[str] = (SUBJECT, REFERENCE),
) -> list[Controller]:
    """Return the controllers that are asked for; one that is not known before a slow import."""
    asked = chosen(names, scenarios, default)
    for name in asked:
        require_known(name)
    from afl_mujoco.control.catalogue import find_controller

    return [find_controller(name) for name in asked]


KNOWN = (
    f"{', '.join(NAMES)}; any but -nominal followed by {ESTIMATED} (sampled mode); or your own, "
    "as module:attribute or FILE.py:NAME."
)
"""Every way to name a controller."""
