"""The store of finished units: what it gives back, and what it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from afl_mujoco.errors import FileError
from afl_mujoco.execution.store import Store
from tests.execution.units import hashed

FINGERPRINT = {"settings": {"timestep": 1e-3, "limits": (1, 2.0)}, "seed": 1}


@pytest.fixture
def filled(tmp_path: Path) -> Path:
    store = Store(tmp_path / "store.json", FINGERPRINT)
    for index in (0, 11, 3):
        store.keep(index, hashed(index))
    return tmp_path / "store.json"


def test_a_store_gives_back_the_bits_that_it_was_given(filled: Path) -> None:
    turned = dict(reversed(FINGERPRINT.items()))
    found = Store(filled, turned).results
    assert repr(found) == repr({i: hashed(i) for i in (0, 11, 3)})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"settings": {"timestep": 2e-3, "limits": [1, 2.0]}}, "settings.timestep is 0.001 there"),
        ({"settings": {"timestep": 1e-3, "limits": [1, 3]}}, "limits[1] is 2.0 there and 3 here"),
        ({"versions": "4"}, "versions is missing there and '4' here"),
        ({f"x{i}": i for i in range(5)}, ", and 2 more"),
    ],
)  # fmt: skip
def test_a_store_of_other_results_is_refused_with_what_differs(
    filled: Path, change: dict[str, Any], says: str
) -> None:
    with pytest.raises(FileError) as refusal:
        Store(filled, FINGERPRINT | change)
    assert str(refusal.value).startswith(f"{filled} holds other results: ")
    assert says in str(refusal.value)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": 2}'])
def test_a_file_of_something_else_is_refused_by_name(filled: Path, text: str) -> None:
    filled.write_text(text)
    with pytest.raises(FileError, match=r"store\.json is not a store of results: .*: remove it"):
        Store(filled, FINGERPRINT)


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        Store(tmp_path / "missing" / "store.json", FINGERPRINT)
