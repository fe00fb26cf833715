"""A search that is interrupted goes on as if it were not; another's file is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from afl_mujoco.errors import FileError
from research import genetic
from research.genetic import Box, GeneticSettings, SearchResult, minimise
from tests.messages import line

SETTINGS = GeneticSettings(population_size=30, generations=12)  # 4 groups, 3 mutants
BOX = Box((-2.0, 5.0), (2.0, 9.0))
SEED = (7, 3)


@pytest.fixture(autouse=True)
def after_every_generation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(genetic, "CHECKPOINT_INTERVAL", 0.0)


def cost(chromosomes):
    return np.sum((chromosomes - [0.3, 6.1]) ** 2, axis=1)


def searched(file=None, cost=cost, **wanted) -> SearchResult:
    return minimise(cost, BOX, SETTINGS, SEED, checkpoint=file, **wanted)


def stopped(file, evaluated: int) -> None:
    left = iter(range(evaluated))

    def interrupted(chromosomes):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return cost(chromosomes)

    with pytest.raises(KeyboardInterrupt):
        searched(file, interrupted, resume=True)


def bits(result: SearchResult) -> tuple[object, ...]:
    arrays = (result.best.tobytes(), result.history.tobytes(), result.cost.hex())
    return (*arrays, result.evaluations, result.generations)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "search"


@pytest.mark.parametrize("evaluated", [0, 1, 7, 12])
def test_a_resumed_search_gives_the_bits_of_an_uninterrupted_one(file, evaluated) -> None:
    stopped(file, evaluated)
    asked = []
    result = searched(file, lambda x: asked.append(len(x)) or cost(x), resume=True)
    assert bits(result) == bits(searched())
    assert len(asked) == 13 - evaluated  # nothing is computed twice


@pytest.mark.parametrize("change", [{"schema": 1}, {"costs": [1.0]}, None], ids=str)
def test_an_unsound_checkpoint_is_refused_in_one_line_and_left(file, change: dict) -> None:
    stopped(file, 4)
    text = file.read_text()
    file.write_text(text[:-9] if change is None else json.dumps(json.loads(text) | change))
    before = file.read_bytes()
    said = line(f"{file} is not a valid checkpoint: ", ..., ": remove it to start again")
    with pytest.raises(FileError, match=said):
        searched(file, cost=None, resume=True)
    assert file.read_bytes() == before


@pytest.mark.parametrize(("settings", "seed", "said"), [
    (replace(SETTINGS, parents=2), SEED, "parents is 3 there and 2 here"),
    (SETTINGS, (7, 4), "seed[1] is 3 there and 4 here"),
])  # fmt: skip
def test_a_checkpoint_of_another_search_is_told_apart(file, settings, seed, said) -> None:
    stopped(file, 3)
    said = f" is of another search: {said}; use the same values, or another file"
    with pytest.raises(FileError, match=line(..., said)):
        minimise(cost, BOX, settings, seed, checkpoint=file, resume=True)
