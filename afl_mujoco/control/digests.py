"""Which scenarios and controllers a result is of: a file may change under the same name."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable

from afl_mujoco.control.controller import Controller
from afl_mujoco.scenario.files import scenario_to_table
from afl_mujoco.scenario.scenario import Scenario


def digests(scenarios: Iterable[Scenario], controllers: Iterable[Controller]) -> dict[str, str]:
    """Return a digest of each scenario and each controller, by ``scenario NAME`` and so on.

    That of a controller in Python covers the file that defines it, not what it imports.
    """
    found = {f"scenario {one.name}": scenario_to_table(one) for one in scenarios}
    found |= {f"controller {one.name}": one.describe() for one in controllers}
    return {
        name: hashlib.blake2b(json.dumps(content).encode(), digest_size=16).hexdigest()
        for name, content in found.items()
    }
