"""The search breeds as the paper says, loses nothing it was told, and finds minima."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from scipy import stats

from afl_mujoco.errors import AflMujocoError, InvalidValueError
from afl_mujoco.studies.gain_tuning import genetic
from afl_mujoco.studies.gain_tuning.genetic import (
    Box,
    GeneticSettings,
    MultipleCrossoverGA,
    minimise,
)

SMALL = GeneticSettings(population_size=40, generations=12)  # 6 groups, 4 mutants, 18 copies
BOX = Box((-2.0, 5.0, 0.0), (2.0, 9.0, 0.5))
CENTRE = np.array([0.3, 6.1, 0.2])


def sphere(chromosomes):
    return np.sum((chromosomes - CENTRE) ** 2, axis=1)


def rosenbrock(x):
    return np.sum((1.0 - x[:, :-1]) ** 2 + 100.0 * (x[:, 1:] - x[:, :-1] ** 2) ** 2, axis=1)


def told(generations: int, seed=1, settings=SMALL, cost=sphere) -> MultipleCrossoverGA:
    """A search that has bred so many generations."""
    search = MultipleCrossoverGA(BOX, settings, seed)
    for _ in range(generations + 1):
        search.tell(cost(search.ask()))
    return search


# Settings


def test_the_defaults_are_the_papers() -> None:
    settings = GeneticSettings()
    assert (settings.population_size, settings.generations) == (1000, 1000)
    assert (settings.reproduction, settings.crossover, settings.mutation) == (0.45, 0.45, 0.1)
    assert (settings.mutation_constant, settings.parents) == (1e-7, 3)
    assert (settings.groups, settings.mutants, settings.copies) == (150, 100, 450)


def test_settings_are_frozen_and_given_by_name() -> None:
    with pytest.raises(FrozenInstanceError):
        SMALL.parents = 2
    with pytest.raises(TypeError):
        GeneticSettings(1000)


@pytest.mark.parametrize(
    ("wrong", "thing", "value"),
    [
        ({"population_size": 0}, "population_size", 0),
        ({"population_size": 100.0}, "population_size", "100.0"),
        ({"population_size": True}, "population_size", "True"),
        ({"generations": 0}, "generations", 0),
        ({"parents": 1}, "parents", 1),
        ({"crossover": -0.1, "reproduction": 1.0}, "crossover", -0.1),
        ({"reproduction": 1.35, "crossover": -0.45}, "reproduction", 1.35),
        ({"mutation": math.nan}, "mutation", math.nan),
        ({"mutation": "0.1"}, "mutation", "'0.1'"),
        ({"mutation": 0.2}, "reproduction + crossover + mutation", 1.1),
        ({"mutation_constant": 0.0}, "mutation_constant", 0.0),
        ({"mutation_constant": math.inf}, "mutation_constant", math.inf),
        ({"population_size": 6}, "population_size", 6),  # 0.45 * 6 < 3
        ({"population_size": 40, "parents": 30}, "population_size", 40),
        ({"reproduction": 0.54, "mutation": 0.01, "population_size": 49}, "population_size", 49),
        (
            {"reproduction": 0.0, "crossover": 0.6, "mutation": 0.4, "population_size": 5},
            "population_size",
            5,
        ),
        ({"reproduction": 1.0, "crossover": 0.0, "mutation": 0.0}, "reproduction", 1.0),
    ],
    ids=str,
)
def test_settings_that_make_no_search_are_refused(wrong: dict, thing: str, value: object) -> None:
    with pytest.raises(InvalidValueError) as caught:
        GeneticSettings(**wrong)
    assert caught.value.thing == thing
    assert caught.value.value == pytest.approx(value, nan_ok=True)


def test_round_off_costs_neither_a_group_nor_the_sum_of_the_shares() -> None:
    assert 0.57 * 100 < 57.0
    shares = {"reproduction": 0.33, "crossover": 0.57, "mutation": 0.1}
    assert GeneticSettings(population_size=100, **shares).groups == 19
    assert 0.7 + 0.2 + 0.1 != 1.0
    GeneticSettings(reproduction=0.7, crossover=0.2, mutation=0.1)


@pytest.mark.parametrize(
    ("lower", "upper", "thing"),
    [
        pytest.param((0.0, 2.0), (1.0, 1.0), "upper[1]", id="lower-above-upper"),
        pytest.param((0.0, math.nan), (1.0, 1.0), "lower[1]", id="nan"),
        pytest.param((0.0,), (math.inf,), "upper[0]", id="infinite"),
        pytest.param((0.0,), ("1",), "upper[0]", id="text"),
        pytest.param((), (), "lower", id="empty"),
        pytest.param((0.0, 0.0), (1.0,), "upper", id="lengths"),
    ],
)
def test_bounds_that_make_no_box_are_refused(lower: tuple, upper: tuple, thing: str) -> None:
    with pytest.raises(InvalidValueError) as caught:
        Box(lower, upper)
    assert caught.value.thing == thing


@pytest.mark.parametrize("seed", [-1, 1.0, "1", (), (1, -2), [1, 2], None, True], ids=repr)
def test_what_is_no_seed_is_refused(seed: object) -> None:
    with pytest.raises(InvalidValueError, match="seed must be "):
        MultipleCrossoverGA(BOX, SMALL, seed)


# What is asked


def test_the_first_question_is_a_population_uniform_in_the_box() -> None:
    settings = GeneticSettings(population_size=2000)
    chromosomes = MultipleCrossoverGA(BOX, settings, 1).ask()
    assert chromosomes.shape == (2000, 3)
    for gene, low, high in zip(chromosomes.T, BOX.lower, BOX.upper, strict=True):
        assert stats.kstest((gene - low) / (high - low), "uniform").pvalue > 1e-3
    assert np.abs(np.corrcoef(chromosomes.T) - np.eye(3)).max() < 4.0 / math.sqrt(2000)


def test_only_children_and_mutants_are_asked_later() -> None:
    search = told(3)
    assert search.ask().shape == (22, 3)
    assert (search.generation, search.evaluations) == (3, 40 + 3 * 22)
    assert search.population.shape == (40, 3)
    assert search.history.shape == (4,)


def test_a_question_stands_until_it_is_answered_and_cannot_be_written_into() -> None:
    search = told(1)
    asked = search.ask()
    search.ask()[:] = math.nan
    assert np.array_equal(search.ask(), asked)
    search.tell(sphere(asked))
    assert not np.array_equal(search.ask(), asked)


def test_parents_and_mutants_are_each_taken_once(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[list[int]] = []

    def crossover_of(population, costs, groups, rng):
        taken.append(groups.ravel().tolist())
        return genuine_crossover(population, costs, groups, rng)

    def mutants_of(chromosomes, constant, rng):
        places = [np.flatnonzero((search.population == x).all(axis=1)) for x in chromosomes]
        taken[-1] += np.concatenate(places).tolist()
        return genuine_mutate(chromosomes, constant, rng)

    genuine_crossover, genuine_mutate = genetic.multiple_crossover, genetic.mutate
    monkeypatch.setattr(genetic, "multiple_crossover", crossover_of)
    monkeypatch.setattr(genetic, "mutate", mutants_of)
    for seed in range(20):
        search = told(0, seed)  # all chromosomes of the initial population are different
        search.ask()
        assert len(taken[-1]) == len(set(taken[-1])) == 6 * 3 + 4
    assert len(set(map(tuple, taken))) == 20  # drawn anew
    assert set().union(*taken) == set(range(40))  # from the whole population


def test_what_is_asked_stays_in_the_box_and_reaches_its_walls() -> None:
    search = MultipleCrossoverGA(BOX, SMALL, 1)
    walls = 0
    for _ in range(10):
        asked = search.ask()
        assert np.all((asked >= BOX.lower) & (asked <= BOX.upper))
        walls += np.sum((asked == BOX.lower) | (asked == BOX.upper))
        search.tell(sphere(asked))
    assert walls > 0


def test_a_gene_with_equal_bounds_stays_fixed() -> None:
    search = MultipleCrossoverGA(Box((0.0, 1 / 3), (1.0, 1 / 3)), SMALL, 1)
    for _ in range(5):
        assert np.all(search.ask()[:, 1] == 1 / 3)
        search.tell(search.ask()[:, 0])


# What is told


def test_every_chromosome_keeps_the_cost_that_it_was_told() -> None:
    for generations in range(8):
        search = told(generations)
        assert np.array_equal(search.costs, sphere(search.population))


def copies_of(search: MultipleCrossoverGA) -> list[int]:
    """Which chromosomes of a population without equals the next generation copies."""
    before = search.population
    search.tell(sphere(search.ask()))
    return [np.flatnonzero((before == x).all(axis=1)).item() for x in search.population[:18]]


def test_the_rest_of_a_generation_are_copies_selected_by_cost() -> None:
    ranks = []
    for seed in range(50):
        search = told(0, seed)
        rank = stats.rankdata(search.costs) - 1.0
        best, *others = rank[copies_of(search)]
        assert best == 0.0
        ranks += others
    # The better of two of n draws has the mean rank (n - 1) (2 n - 1) / 6 n; any draw, 19.5.
    deviation = 9.4 / math.sqrt(len(ranks))
    assert np.mean(ranks) == pytest.approx(39 * 79 / 240, abs=4.0 * deviation)


def test_the_best_chromosome_ever_told_is_never_lost() -> None:
    search, least = MultipleCrossoverGA(BOX, SMALL, 4), math.inf
    noise = np.random.default_rng(8)  # costs without sense: the best is seldom a child of the best
    for generation in range(60):
        costs = noise.random(len(search.ask()))
        least = min(least, costs.min())
        search.tell(costs)
        assert search.best_cost == search.history[generation] == least
        assert search.costs[np.flatnonzero((search.population == search.best).all(1))[0]] == least


def test_the_search_heeds_only_the_order_of_the_costs() -> None:
    one, other = told(10), told(10, cost=lambda x: np.exp(sphere(x)) - 7.0)
    assert np.array_equal(one.population, other.population)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_cost_that_is_not_finite_is_refused_and_can_be_told_anew(wrong: float) -> None:
    search, spared = told(2), told(3)
    costs = sphere(search.ask())
    place = ", ".join(f"{x:.6g}" for x in search.ask()[5])
    spoilt = costs.copy()
    spoilt[[5, 9]] = wrong
    with pytest.raises(InvalidValueError) as caught:
        search.tell(spoilt)
    assert str(caught.value) == f"cost of ({place}) must be finite, got {wrong}"
    search.tell(costs)
    assert np.array_equal(search.population, spared.population)


@pytest.mark.parametrize(
    "costs", [[1.0] * 21, [[1.0] * 22], 1.0, ["low"] * 22, None], ids=lambda costs: str(costs)[:12]
)
def test_costs_that_are_not_one_number_a_chromosome_are_refused(costs: object) -> None:
    search = told(1)
    search.ask()
    with pytest.raises(InvalidValueError, match="costs must"):
        search.tell(costs)


def test_what_is_not_known_yet_is_not_given() -> None:
    search = MultipleCrossoverGA(BOX, SMALL, 1)
    for read in (lambda: search.best, lambda: search.best_cost, search.state):
        with pytest.raises(AflMujocoError):
            read()
    with pytest.raises(AflMujocoError, match="tell must follow ask"):
        search.tell([1.0] * 40)
    search.tell(sphere(search.ask()))
    with pytest.raises(AflMujocoError, match="tell must follow ask"):
        search.tell([1.0] * 22)


def test_the_population_cannot_be_written_into() -> None:
    search = told(1)
    for array in (search.population, search.costs, search.best):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


# Reproducible


def test_the_same_seed_gives_the_same_bits_and_another_seed_others() -> None:
    first, again, other = told(12, (3, 1)), told(12, (3, 1)), told(12, (3, 2))
    assert first.population.tobytes() == again.population.tobytes()
    assert first.history.tobytes() == again.history.tobytes()
    assert first.population.tobytes() != other.population.tobytes()


def test_the_search_leaves_the_global_generator_alone() -> None:
    np.random.seed(1)  # noqa: NPY002
    before = np.random.get_state()[1].tolist()  # noqa: NPY002
    told(2)
    assert np.random.get_state()[1].tolist() == before  # noqa: NPY002


# Minima are found


@pytest.mark.parametrize("parents", [2, 3, 4])
def test_a_sphere_is_minimised(parents: int) -> None:
    settings = GeneticSettings(population_size=200, generations=200, parents=parents)
    result = minimise(sphere, BOX, settings, 1)
    assert np.allclose(result.best, CENTRE, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("genes", [2, 3])
def test_rosenbrocks_valley_is_followed_to_its_end(genes: int) -> None:
    settings = GeneticSettings(population_size=300, generations=200)
    result = minimise(rosenbrock, Box((-2.0,) * genes, (2.0,) * genes), settings, 1)
    assert np.allclose(result.best, 1.0, rtol=0.0, atol=1e-4)


def test_a_minimum_in_a_corner_is_found_to_the_last_bit() -> None:
    settings = GeneticSettings(population_size=100, generations=60)
    result = minimise(lambda x: x @ [1.0, -3.0, 0.2], BOX, settings, 1)
    assert result.best.tolist() == [BOX.lower[0], BOX.upper[1], BOX.lower[2]]


def test_minimise_is_ask_and_tell_to_the_end_and_reports_every_generation() -> None:
    reported: list[tuple[int, float]] = []
    result = minimise(sphere, BOX, SMALL, 1, progress=lambda *line: reported.append(line))
    search = told(12)
    assert (result.generations, result.evaluations) == (12, 40 + 12 * 22)
    assert np.array_equal(result.best, search.best)
    assert result.cost == search.best_cost == sphere(result.best[np.newaxis])[0]
    assert np.array_equal(result.history, search.history)
    assert reported == list(enumerate(result.history))
    assert np.all(np.diff(result.history) <= 0.0)
