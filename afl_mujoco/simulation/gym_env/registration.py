"""The names under which `gymnasium.make` finds the environments; cheap to import.

Gymnasium reads no entry points: a package registers when it is imported.
"""

from __future__ import annotations

import importlib.util
import sys
from typing import TYPE_CHECKING, Any

from afl_mujoco.errors import AflMujocoError

if TYPE_CHECKING:
    from types import ModuleType

NAMESPACE = "afl_mujoco"
ENTRY_POINT = "afl_mujoco.simulation.gym_env.environment:ScenarioEnv"
VECTOR_ENTRY_POINT = "afl_mujoco.simulation.gym_env.vector:ScenarioVectorEnv"
ANY = f"{NAMESPACE}/Scenario-v0"
"""The environment that takes its scenario as ``scenario=``, of any plant."""
GYMNASIUM = "gymnasium"
LABORATORY = "laboratory"


def require_gymnasium() -> None:
    """Raise if Gymnasium is not installed."""
    if sys.modules.get(GYMNASIUM) is None and importlib.util.find_spec(GYMNASIUM) is None:
        raise AflMujocoError("Gymnasium", "is not installed: pip install gymnasium")


def environment_id(scenario: str, *, randomize: bool = False) -> str:
    """Return the name of a scenario, or its variant drawn at random, without laboratory."""
    parts = ["CartPole", *([scenario] * (scenario != LABORATORY)), *(["Random"] * randomize)]
    return f"{NAMESPACE}/{'-'.join(parts)}-v0"


def register() -> None:
    """Make every scenario known to `gymnasium.make`, as it is and drawn at random; once."""
    require_gymnasium()
    from gymnasium.envs import registration

    from afl_mujoco.scenario.catalogue import SCENARIOS

    found: dict[str, dict[str, Any]] = {ANY: {}}
    for name in SCENARIOS:
        found[environment_id(name)] = {"scenario": name}
    for name in (*SCENARIOS, LABORATORY):
        found[environment_id(name, randomize=True)] = {"scenario": name, "randomize": True}
    for known, settings in found.items():
        if known not in registration.registry:
            registration.register(
                known,
                entry_point=ENTRY_POINT,
                vector_entry_point=VECTOR_ENTRY_POINT,
                kwargs=settings,
            )


def register_with_gymnasium() -> None:
    """Register now if Gymnasium has been imported, else as soon as it is; costs nothing."""
    if sys.modules.get(GYMNASIUM) is not None:
        register()
    elif not any(isinstance(finder, _Watch) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Watch())


class _Watch:
    """A module finder for Gymnasium alone, which ends the import that others find by `register`."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        """Leave every import to the other finders."""
        if fullname != GYMNASIUM:
            return None
        sys.meta_path.remove(self)
        try:
            spec = importlib.util.find_spec(fullname)
        finally:
            sys.meta_path.insert(0, self)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def executed(module: ModuleType) -> None:
                execute(module)
                register()

            spec.loader.exec_module = executed  # type: ignore[method-assign]
        return spec
