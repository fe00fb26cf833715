"""The search breeds as the paper says, finds minima, and goes on to the same bits if killed."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from afl_mujoco.errors import InvalidValueError
from research import genetic

LIKELY = 1e-3  # p-value: at the fixed seed of `rng` a right operator has passed
X_I, X_J, X_K = (1.0, 2.0), (3.0, -1.0), (0.0, 4.0)  # 2 x_i - x_j - x_k = (-1, 1)
# 6 groups, 4 mutants, 18 copies
SMALL = genetic.GeneticSettings(population_size=40, generations=12)
BOX = genetic.Box((-2.0, 5.0, 0.0), (2.0, 9.0, 0.5))


@pytest.fixture
def rng():
    return np.random.default_rng(20260)


@pytest.mark.parametrize(("chromosomes", "costs", "rhos", "expected"), [
    ([X_I, X_J, X_K], [-3.0, 7.0, 5.0], (0.5, 0.25, 0.75),
     [(0.5, 2.5), (2.75, -0.75), (-0.75, 4.75)]),
    ([X_J, X_I], [5.0, 1.0], (0.5, 0.25), [(2.0, 0.5), (0.5, 2.75)]),  # x_i - x_j = (-2, 3)
    ([(8.0,), (1.0,), (2.0,), (-4.0,)], [4.0, 3.0, 2.0, 6.0], (0.5, 0.0, 0.25, 1.0),
     [(8.5,), (1.0,), (2.25,), (-3.0,)]),  # 3 * 2 - 8 - 1 + 4 = 1
])  # fmt: skip
def test_a_group_moves_along_the_ways_to_its_fittest(chromosomes, costs, rhos, expected) -> None:
    given = (np.array(x) for x in (chromosomes, costs, [range(len(costs))]))
    drawing = SimpleNamespace(random=lambda size: np.reshape(rhos, size))
    assert genetic.multiple_crossover(*given, drawing).tolist() == [[list(x) for x in expected]]


def test_a_mutant_is_shifted_by_one_uniform_number_of_at_most_the_constant(rng) -> None:
    chromosomes = rng.normal(size=(5000, 3))
    shifts = genetic.mutate(chromosomes, 0.25, rng) - chromosomes
    assert np.allclose(shifts, shifts[:, :1], rtol=0.0, atol=1e-14)  # round-off of the difference
    assert stats.kstest(shifts[:, 0] / 0.25, stats.uniform(-1.0, 2.0).cdf).pvalue > LIKELY


def test_a_tournament_selects_as_the_better_of_two_and_genes_stay_in_the_box(rng) -> None:
    size, count = 10, 20000
    ranks = rng.permutation(size)
    selected = ranks[genetic.tournament(ranks.astype(float), count, rng)]
    # Rank r wins when both drawn are of rank r or worse but not both worse: ((n-r)^2-(n-r-1)^2)/n^2
    expected = (2.0 * (size - np.arange(size)) - 1.0) / size**2 * count
    assert stats.chisquare(np.bincount(selected, minlength=size), expected).pvalue > LIKELY
    chromosomes = np.array([[0.5, 2.0], [-0.1, 2.9], [1.1, 1.9], [1.0, 3.5]])
    clipped = genetic.clip(chromosomes, np.array([0.0, 2.0]), np.array([1.0, 3.0]))
    assert clipped.tolist() == [[0.5, 2.0], [0.0, 2.9], [1.0, 2.0], [1.0, 3.0]]


def sphere(chromosomes):
    return np.sum((chromosomes - [0.3, 6.1, 0.2]) ** 2, axis=1)


def told(generations: int, cost=sphere) -> genetic.MultipleCrossoverGA:
    search = genetic.MultipleCrossoverGA(BOX, SMALL, 1)
    for _ in range(generations + 1):
        search.tell(cost(search.ask()))
    return search


def test_the_defaults_are_the_papers_and_settings_that_make_no_search_are_refused() -> None:
    settings = genetic.GeneticSettings()
    assert (settings.population_size, settings.generations) == (1000, 1000)
    assert (settings.reproduction, settings.crossover, settings.mutation) == (0.45, 0.45, 0.1)
    assert (settings.mutation_constant, settings.parents) == (1e-7, 3)
    assert (settings.groups, settings.mutants, settings.copies) == (150, 100, 450)
    with pytest.raises(InvalidValueError, match=r"^reproduction \+ crossover \+ mutation .*1\.1"):
        genetic.GeneticSettings(mutation=0.2)
    with pytest.raises(InvalidValueError, match=r"^population_size .* 6$"):  # 0.45 * 6 < 3
        genetic.GeneticSettings(population_size=6)


def test_chromosomes_keep_their_costs_of_which_the_order_counts_and_the_best_stays() -> None:
    for generations in range(8):
        search = told(generations)
        assert np.array_equal(search.costs, sphere(search.population))
    search, least = genetic.MultipleCrossoverGA(BOX, SMALL, 4), math.inf
    noise = np.random.default_rng(8)  # costs without sense: the best is seldom a child of the best
    for generation in range(60):
        costs = noise.random(len(search.ask()))
        least = min(least, costs.min())
        search.tell(costs)
        assert search.best_cost == search.history[generation] == least
        assert search.costs[np.flatnonzero((search.population == search.best).all(1))[0]] == least
    one, other = told(10), told(10, cost=lambda x: np.exp(sphere(x)) - 7.0)
    assert np.array_equal(one.population, other.population)
