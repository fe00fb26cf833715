"""The names under which `gymnasium.make` finds the environments; cheap to import.

Gymnasium before 1.0 calls `register` by itself, through the entry point ``gymnasium.envs`` of this
package. Since 1.0 it ignores entry points, and a package registers when it is imported.
"""

from __future__ import annotations

import importlib.util
import sys
from typing import TYPE_CHECKING, Any

from afl_mujoco.errors import AflMujocoError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.abc import Loader
    from importlib.machinery import ModuleSpec
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
        raise AflMujocoError("Gymnasium", "is not installed: pip install afl-mujoco[gym]")


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
    """A module finder for Gymnasium alone, which wraps the loader that other finders return."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Leave every import to the other finders, but end that of Gymnasium with `register`."""
        if fullname != GYMNASIUM:
            return None
        sys.meta_path.remove(self)
        try:
            spec = importlib.util.find_spec(fullname)
        finally:
            sys.meta_path.insert(0, self)
        if spec is not None and spec.loader is not None:
            spec.loader = _ThenRegister(spec.loader)  # type: ignore[assignment]
        return spec


class _ThenRegister:
    """The loader of Gymnasium, followed by `register`."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Leave it to the loader."""
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Execute the module as its loader does, then register."""
        module.__loader__ = self._loader
        if module.__spec__ is not None:
            module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        register()
