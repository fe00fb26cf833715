"""A search that is interrupted or killed goes on as if it were not; a spoilt file is refused."""

from __future__ import annotations

import hashlib
import json
import pickle
import random
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from afl_mujoco.errors import AflMujocoError, FileError, InvalidValueError
from afl_mujoco.tuning import checkpoint as files
from afl_mujoco.tuning.genetic import Box, GeneticSettings, SearchResult, minimise

SETTINGS = GeneticSettings(population_size=30, generations=12)  # 4 groups, 3 mutants
BOX = Box((-2.0, 5.0), (2.0, 9.0))
SEED = (7, 3)


def cost(chromosomes):
    return np.sum((chromosomes - [0.3, 6.1]) ** 2, axis=1)


def searched(file=None, cost=cost, **wanted) -> SearchResult:
    return minimise(cost, BOX, SETTINGS, SEED, checkpoint=file, **wanted)


def stopped(file: Path, evaluated: int) -> None:
    """Interrupt a search when it asks for costs again after so many generations, 0 included."""
    left = iter(range(evaluated))

    def interrupted(chromosomes):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return cost(chromosomes)

    with pytest.raises(KeyboardInterrupt):
        searched(file, interrupted, resume=True)


def bits(result: SearchResult) -> tuple[object, ...]:
    """All of a result, comparable to the last bit."""
    arrays = (result.best.tobytes(), result.history.tobytes(), result.cost.hex())
    return (*arrays, result.evaluations, result.generations)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "search.ga"


@pytest.fixture(scope="module")
def whole() -> SearchResult:
    """The search without a break."""
    return searched()


# Interrupted and resumed


@pytest.mark.parametrize("evaluated", [0, 1, 2, 7, 12])
def test_a_resumed_search_gives_the_bits_of_an_uninterrupted_one(
    file: Path, whole: SearchResult, evaluated: int
) -> None:
    stopped(file, evaluated)
    asked = []
    result = searched(file, lambda x: asked.append(len(x)) or cost(x), resume=True)
    assert bits(result) == bits(whole)
    assert len(asked) == 13 - evaluated  # nothing is computed twice


def test_a_search_may_be_interrupted_after_every_generation(
    file: Path, whole: SearchResult
) -> None:
    for _ in range(12):
        stopped(file, 1)
    assert bits(searched(file, resume=True)) == bits(whole)


def test_checkpoints_do_not_disturb_the_search(file: Path, whole: SearchResult) -> None:
    assert bits(searched(file)) == bits(whole)


def test_a_finished_search_is_read_back_and_not_repeated(file: Path, whole: SearchResult) -> None:
    searched(file)
    before = file.read_bytes()
    assert bits(searched(file, cost=None, resume=True)) == bits(whole)
    assert file.read_bytes() == before


def test_the_checkpoint_of_the_generation_before_is_kept_and_nothing_else(file: Path) -> None:
    stopped(file, 6)
    assert files.load(file).generation == 5
    assert files.load(files.previous(file)).generation == 4
    assert sorted(path.name for path in file.parent.iterdir()) == [
        "search.ga",
        "search.ga.previous",
    ]


def test_progress_is_told_after_the_checkpoint(file: Path) -> None:
    def progress(generation: int, best: float) -> None:
        state = files.load(file)
        assert (state.generation, state.history[-1]) == (generation, best)

    searched(file, progress=progress)


def end_at_a_rename(patch: pytest.MonkeyPatch, number: int, when: str) -> None:
    """Interrupt before or after the rename of that number."""
    genuine, left = Path.replace, iter(range(number))

    def rename(self: Path, target: Path) -> Path:
        end = next(left, None) is None
        if end and when == "before":
            raise KeyboardInterrupt
        genuine(self, target)
        if end:
            raise KeyboardInterrupt
        return target

    patch.setattr(Path, "replace", rename)


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("renames", range(12))
def test_an_end_between_any_two_renames_loses_at_most_a_generation(
    file: Path, whole: SearchResult, monkeypatch: pytest.MonkeyPatch, renames: int, when: str
) -> None:
    saved = [-1]
    with monkeypatch.context() as patch:
        end_at_a_rename(patch, renames, when)
        with pytest.raises(KeyboardInterrupt):
            searched(file, progress=lambda generation, _: saved.append(generation))
    states = [files.load(path) for path in (file, files.previous(file)) if path.exists()]
    assert max((state.generation for state in states), default=-1) >= saved[-1]
    assert bits(searched(file, resume=True)) == bits(whole)


def test_while_only_the_previous_checkpoint_is_there_it_is_not_written_over(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped(file, 3)
    file.unlink()
    only = files.previous(file).read_bytes()

    def no_more(*_: object) -> int:
        raise KeyboardInterrupt  # where the new file would be opened

    monkeypatch.setattr(files.os, "open", no_more)
    with pytest.raises(KeyboardInterrupt):
        searched(file, resume=True)
    assert files.previous(file).read_bytes() == only


@pytest.mark.parametrize("length", [10, 100_000])
def test_a_half_written_file_of_a_search_that_died_is_written_over(
    file: Path, whole: SearchResult, length: int
) -> None:
    stopped(file, 3)
    files.previous(file).rename(file.with_name("search.ga.spare"))
    file.with_name("search.ga.spare").write_bytes(b"?" * length)
    stopped(file, 1)
    assert files.load(file).generation == 3
    assert bits(searched(file, resume=True)) == bits(whole)


# Killed

LONG = replace(SETTINGS, generations=1000)
PROGRAM = """
import runpy, sys
from pathlib import Path

def progress(generation, _):
    print(generation, flush=True)
    if next(left, None) is None:
        sys.stdin.read()  # wait, should the kill be late

left = iter(range(250))
test = runpy.run_path(sys.argv[1])
test["searched_long"](Path(sys.argv[2]), progress)
"""


def searched_long(file: Path | None = None, progress=None) -> SearchResult:
    resume = file is not None
    return minimise(cost, BOX, LONG, SEED, checkpoint=file, resume=resume, progress=progress)


def killed(file: Path, after: int) -> int:
    """Kill a search so many generations after its first report; return the last it reported."""
    command = [sys.executable, "-c", PROGRAM, __file__, file]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        first = [process.stdout.readline() for _ in range(after)]
        time.sleep(random.Random(after).uniform(0.0, 1e-3))
        process.send_signal(signal.SIGKILL)
        reported = [*first, *process.stdout]
    assert process.returncode == -signal.SIGKILL
    return int([line for line in reported if line.endswith("\n")][-1])


def test_a_search_that_is_killed_again_and_again_ends_with_the_same_bits(file: Path) -> None:
    for after in (1, 40, 90):
        reported = killed(file, after)
        states = [files.load(path) for path in (file, files.previous(file)) if path.exists()]
        assert reported <= max(state.generation for state in states) <= reported + 1
    assert reported < LONG.generations
    assert bits(searched_long(file)) == bits(searched_long())


# Nothing is overwritten unasked


@pytest.mark.parametrize("left", ["both", "previous"])
def test_a_checkpoint_is_not_overwritten_unasked(file: Path, left: str) -> None:
    stopped(file, 3)
    if left == "previous":
        file.unlink()
    before = {path: path.read_bytes() for path in file.parent.iterdir()}
    with pytest.raises(FileError, match="exists: pass resume=True to go on from it, or remove it"):
        searched(file)
    assert {path: path.read_bytes() for path in file.parent.iterdir()} == before


def test_resuming_begins_where_there_is_no_checkpoint(file: Path, whole: SearchResult) -> None:
    assert bits(searched(file, resume=True)) == bits(whole)


def test_resuming_needs_a_checkpoint() -> None:
    with pytest.raises(InvalidValueError, match="resume needs a checkpoint"):
        searched(resume=True)


def test_a_checkpoint_that_cannot_be_written_is_said_in_one_line(file: Path) -> None:
    file = file.parent / "nowhere" / "search.ga"
    with pytest.raises(FileError) as caught:
        searched(file)
    assert str(caught.value) == f"{file} cannot be written: no such file or directory"


# Unsound files


def unsound(file: Path) -> str:
    """The refusal of a checkpoint, which is left as it is."""
    before = file.read_bytes()
    with pytest.raises(FileError) as caught:
        searched(file, cost=None, resume=True)
    assert file.read_bytes() == before
    assert "\n" not in str(caught.value)
    assert caught.value.thing == str(file)
    return str(caught.value)


def test_no_flipped_byte_goes_unnoticed(file: Path) -> None:
    stopped(file, 4)
    sound = file.read_bytes()
    for place in range(0, len(sound), 7):
        file.write_bytes(sound[:place] + bytes([sound[place] ^ 0x10]) + sound[place + 1 :])
        assert "is no sound checkpoint" in unsound(file)


def test_no_cut_and_no_appendix_goes_unnoticed(file: Path) -> None:
    stopped(file, 4)
    sound = file.read_bytes()
    for length in (*range(0, len(sound), 13), len(sound) - 8, len(sound) - 1):
        file.write_bytes(sound[:length])
        assert "is no sound checkpoint" in unsound(file)
    file.write_bytes(sound + bytes(8))
    assert "is no sound checkpoint" in unsound(file)


class Bomb:
    """Goes off when it is unpickled."""

    def __reduce__(self):
        return pytest.exit, ("a checkpoint was unpickled",)


@pytest.mark.parametrize(
    "content",
    [b"", b"\n", b"PK\x03\x04 an archive", "déjà vu\n".encode(), pickle.dumps(Bomb())],
    ids=["empty", "newline", "archive", "text", "pickle"],
)
def test_another_kind_of_file_is_refused(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    assert unsound(file).endswith("it does not begin as one; remove it to begin anew")


def forged(file: Path, schema: int = files.SCHEMA, numbers: int = 0, **scalars: object) -> None:
    """Rewrite a checkpoint with other content and the right digest."""
    _, head, raw = file.read_bytes().split(b"\n", 2)
    changed = {**json.loads(head), **scalars}
    kept = {name: value for name, value in changed.items() if value is not None}
    body = json.dumps(kept).encode() + b"\n" + raw + bytes(numbers)
    digest = hashlib.sha256(body).hexdigest()
    file.write_bytes(f"afl-mujoco genetic search {schema} {digest}\n".encode() + body)


@pytest.mark.parametrize(
    "change",
    [
        {"schema": 2},
        {"numbers": 8},
        {"numbers": 3},
        {"generation": 2},
        {"rng": None},
        {"problem": 1},
        {"extra": 1},
    ],
    ids=str,
)
def test_a_file_with_the_right_digest_and_the_wrong_content_is_refused(
    file: Path, whole: SearchResult, change: dict
) -> None:
    stopped(file, 4)
    forged(file)
    assert files.load(file).generation == 3
    forged(file, **change)
    assert "is no sound checkpoint" in unsound(file)


def test_the_way_out_of_a_corrupt_checkpoint_is_said_and_works(
    file: Path, whole: SearchResult
) -> None:
    stopped(file, 5)
    file.write_bytes(file.read_bytes()[:-1])
    assert unsound(file) == (
        f"{file} is no sound checkpoint: it is cut short or altered; "
        f"remove it to resume from generation 3, which {files.previous(file)} holds"
    )
    file.unlink()
    assert bits(searched(file, resume=True)) == bits(whole)


def test_when_both_are_corrupt_one_begins_anew(file: Path, whole: SearchResult) -> None:
    stopped(file, 5)
    for path in (file, files.previous(file)):
        path.write_bytes(b"?")
    assert unsound(file).endswith("; remove it to begin anew")
    file.unlink()
    file = files.previous(file)
    with pytest.raises(FileError, match="remove it to begin anew") as caught:
        searched(file.with_suffix(""), resume=True)
    assert caught.value.thing == str(file)
    file.unlink()
    assert bits(searched(file.with_suffix(""), resume=True)) == bits(whole)


def test_a_folder_is_no_checkpoint(file: Path) -> None:
    file.mkdir()
    with pytest.raises(FileError, match="cannot be read: is a directory"):
        searched(file, resume=True)


# Other searches

OTHER_SETTINGS = {
    "population_size": 31,
    "generations": 13,
    "reproduction": 0.46,
    "crossover": 0.44,
    "mutation": 0.12,
    "mutation_constant": 2e-7,
    "parents": 2,
}


@pytest.mark.parametrize("name", [field.name for field in fields(GeneticSettings)])
def test_a_checkpoint_of_other_settings_is_refused(file: Path, name: str) -> None:
    stopped(file, 3)
    changed = {name: OTHER_SETTINGS[name]}
    partner = {"reproduction": "mutation", "crossover": "reproduction", "mutation": "crossover"}
    if name in partner:
        changed[partner[name]] = getattr(SETTINGS, partner[name]) - (
            changed[name] - getattr(SETTINGS, name)
        )
    before = file.read_bytes()
    with pytest.raises(AflMujocoError) as caught:
        settings = replace(SETTINGS, **changed)
        minimise(cost, BOX, settings, SEED, checkpoint=file, resume=True)
    there, here = getattr(SETTINGS, name), OTHER_SETTINGS[name]
    assert f"{name} is {there} in it and {here} here" in str(caught.value)
    assert str(caught.value).count(" in it and ") == len(changed)
    assert caught.value.thing == str(file)
    assert file.read_bytes() == before


@pytest.mark.parametrize("left", ["both", "previous"])
@pytest.mark.parametrize(
    ("box", "seed", "said"),
    [
        (Box((-2.5, 5.0), (2.0, 9.0)), SEED, "lower is [-2.0, 5.0] in it and [-2.5, 5.0] here"),
        (Box((-2.0, 5.0), (2.0, 9.5)), SEED, "upper is [2.0, 9.0] in it and [2.0, 9.5] here"),
        (BOX, (7, 4), "seed is [7, 3] in it and [7, 4] here"),
        (BOX, 7, "seed is [7, 3] in it and 7 here"),
    ],
    ids=["lower", "upper", "seed", "kind-of-seed"],
)
def test_a_checkpoint_of_another_box_or_seed_is_refused(
    file: Path, box: Box, seed: int | tuple[int, ...], said: str, left: str
) -> None:
    stopped(file, 3)
    if left == "previous":
        file.unlink()
    with pytest.raises(FileError) as caught:
        minimise(cost, box, SETTINGS, seed, checkpoint=file, resume=True)
    rule = f"is of another search: {said}; give the same, or another file"
    assert caught.value.rule == rule


def test_a_checkpoint_from_before_there_was_a_setting_is_refused(file: Path) -> None:
    stopped(file, 3)
    problem = dict(files.load(file).problem)
    del problem["parents"]
    forged(file, problem=problem)
    assert "parents is None in it and 3 here" in unsound(file)
