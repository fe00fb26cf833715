"""The store of a sweep: what it gives back, and what it refuses."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from sweep_units import hashed

from afl_mujoco.errors import FileError, InvalidValueError
from afl_mujoco.sweep.store import Store, plain

FINGERPRINT = {
    "settings": {"timestep": 1e-3, "limits": [1, 2.0]},
    "function": "hashed",
    "versions": {"numpy": "2.4"},
}


@pytest.fixture
def filled(tmp_path: Path) -> Path:
    store = Store(tmp_path, FINGERPRINT, 12)
    for index in (0, 3, 11):
        store.keep(index, plain("a result", hashed(index)))
    return tmp_path


def test_a_store_gives_back_the_bits_that_it_was_given(filled: Path) -> None:
    found = Store(filled, FINGERPRINT, 12).finished()
    assert repr(found) == repr({i: plain("a result", hashed(i)) for i in (0, 3, 11)})


def test_the_order_of_the_fingerprint_does_not_matter(filled: Path) -> None:
    turned = dict(reversed(FINGERPRINT.items()))
    assert list(Store(filled, turned, 12).finished()) == [0, 3, 11]


@pytest.mark.parametrize(
    ("fingerprint", "units", "says"),
    [
        pytest.param(
            {**FINGERPRINT, "settings": {"timestep": 2e-3, "limits": [1, 2.0]}},
            12,
            "settings.timestep is 0.001 there and 0.002 here",
            id="number",
        ),
        pytest.param(
            {**FINGERPRINT, "settings": {"timestep": 1e-3, "limits": [1, 2]}},
            12,
            "settings.limits[1] is 2.0 there and 2 here",
            id="type",
        ),
        pytest.param(
            {**FINGERPRINT, "function": None, "seed": 1},
            12,
            'function is "hashed" there and null here, seed is missing there and 1 here',
            id="two",
        ),
        pytest.param(FINGERPRINT, 13, "units is 12 there and 13 here", id="units"),
        pytest.param(
            {},
            13,
            "units is 12 there and 13 here, settings is "
            '{"timestep": 0.001, "limits": [1, 2.0]} there and missing here, '
            'function is "hashed" there and missing here, and 1 more',
            id="many",
        ),
    ],
)
def test_a_store_of_another_sweep_is_refused_with_what_differs(
    filled: Path, fingerprint: dict[str, object], units: int, says: str
) -> None:
    with pytest.raises(FileError) as refusal:
        Store(filled, fingerprint, units)
    assert str(refusal.value) == f"{filled} holds another sweep: {says}; name another folder"


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", '{"result": 1}', "\0", "[" * 100_000],
    ids=["empty", "half", "list", "null", "foreign", "binary", "deep"],
)
def test_a_corrupt_unit_is_refused_by_name(filled: Path, text: str) -> None:
    (filled / "unit-0003.json").write_text(text)
    with pytest.raises(FileError, match=r"unit-0003\.json is not unit 3 .* delete it to have it"):
        Store(filled, FINGERPRINT, 12).finished()


def test_a_changed_character_of_a_unit_is_noticed(filled: Path) -> None:
    path = filled / "unit-0003.json"
    text = path.read_text()
    store = Store(filled, FINGERPRINT, 12)
    for place in range(0, len(text), 3):
        other = "1" if text[place] != "1" else "2"
        path.write_text(text[:place] + other + text[place + 1 :])
        with pytest.raises(FileError):
            store.finished()


def test_a_unit_of_another_sweep_or_number_is_refused(filled: Path, tmp_path: Path) -> None:
    shutil.copy(filled / "unit-0003.json", filled / "unit-0004.json")
    with pytest.raises(FileError, match=r"unit-0004\.json is not unit 4"):
        Store(filled, FINGERPRINT, 12).finished()
    (filled / "unit-0004.json").unlink()
    (filled / "sweep.json").unlink()
    with pytest.raises(FileError, match=r"unit-0000\.json is not unit 0"):
        Store(filled, {"another": 1}, 12).finished()


@pytest.mark.parametrize("text", ["", "\0\0", "[" * 100_000], ids=["empty", "binary", "deep"])
def test_a_corrupt_sweep_file_is_refused_by_name(filled: Path, text: str) -> None:
    (filled / "sweep.json").write_text(text)
    with pytest.raises(FileError, match=r"sweep\.json is not valid JSON"):
        Store(filled, FINGERPRINT, 12)


def test_a_sweep_file_that_is_something_else_is_refused(filled: Path) -> None:
    (filled / "sweep.json").write_text("[1]")
    with pytest.raises(FileError, match=r"holds another sweep: it is \[1\] there and \{"):
        Store(filled, FINGERPRINT, 12)


def test_a_folder_that_cannot_be_one_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="cannot be written"):
        Store(tmp_path / "file", FINGERPRINT, 12)


def test_what_is_no_plain_data_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match=r"fingerprint must be plain data: .*PosixPath"):
        Store(tmp_path, {"folder": tmp_path}, 12)
    assert list(tmp_path.iterdir()) == []


def test_the_files_can_be_read_without_this_package(filled: Path) -> None:
    entry = json.loads((filled / "unit-0011.json").read_text())
    assert entry["index"] == entry["result"]["unit"] == 11
    assert json.loads((filled / "sweep.json").read_text())["fingerprint"] == FINGERPRINT


def test_ten_thousand_units_are_numbered_in_order(tmp_path: Path) -> None:
    store = Store(tmp_path, {}, 10_001)
    for index in (9_999, 10_000):
        store.keep(index, index)
    assert store.finished() == {9_999: 9_999, 10_000: 10_000}
