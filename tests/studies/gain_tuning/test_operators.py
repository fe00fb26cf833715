"""The operators do what Eqs. (A1) and (A2) say, with random values distributed as they say."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from afl_mujoco.studies.gain_tuning.operators import clip, multiple_crossover, mutate, tournament

LIKELY = 1e-3  # p-value: at the fixed seed of `rng` a right operator has passed


class Given:
    """A generator whose random values are given."""

    def __init__(self, *values: float) -> None:
        self.values = values

    def random(self, size):
        return np.reshape(self.values, size)


def crossed(chromosomes, costs, rng, groups=None):
    """Children of a population that is one group."""
    groups = [range(len(costs))] if groups is None else groups
    return multiple_crossover(np.array(chromosomes), np.array(costs), np.array(groups), rng)


# Crossover (A1)

X_I, X_J, X_K = (1.0, 2.0), (3.0, -1.0), (0.0, 4.0)  # 2 x_i - x_j - x_k = (-1, 1)


@pytest.mark.parametrize("place", [0, 1, 2], ids=["first", "second", "third"])
def test_a_triple_moves_along_twice_the_fittest_less_the_others(place: int) -> None:
    chromosomes, costs, rhos = [X_J, X_K], [7.0, 5.0], [0.25, 0.75]
    expected = [(2.75, -0.75), (-0.75, 4.75)]
    chromosomes.insert(place, X_I)
    costs.insert(place, -3.0)
    rhos.insert(place, 0.5)
    expected.insert(place, (0.5, 2.5))
    assert crossed(chromosomes, costs, Given(*rhos)).tolist() == [[list(x) for x in expected]]


def test_a_pair_moves_along_the_difference_from_the_worse_to_the_better() -> None:
    children = crossed([X_J, X_I], [5.0, 1.0], Given(0.5, 0.25))  # x_i - x_j = (-2, 3)
    assert children.tolist() == [[[2.0, 0.5], [0.5, 2.75]]]


def test_four_parents_move_along_thrice_the_fittest_less_the_others() -> None:
    chromosomes = [(8.0,), (1.0,), (2.0,), (-4.0,)]  # 3 * 2 - 8 - 1 + 4 = 1
    children = crossed(chromosomes, [4.0, 3.0, 2.0, 6.0], Given(0.5, 0.0, 0.25, 1.0))
    assert children.ravel().tolist() == [8.5, 1.0, 2.25, -3.0]


def test_each_group_has_its_own_fittest_and_children_stand_where_their_parents_stood() -> None:
    chromosomes = [(0.0,), (10.0,), (1.0,), (20.0,)]
    groups = [[3, 0], [1, 2]]
    children = crossed(chromosomes, [1.0, 2.0, 3.0, 4.0], Given(1.0, 0.5, 0.25, 1.0), groups)
    # Group (20, 0): the fittest 0 is -20 away. Group (10, 1): the fittest 10 is +9 away.
    assert children[:, :, 0].tolist() == [[0.0, -10.0], [12.25, 10.0]]


def test_equal_parents_have_children_equal_to_them(rng) -> None:
    population = np.tile([0.1, 1e9 / 3.0, -7e-9], (5, 1))
    children = multiple_crossover(population, np.arange(5.0), np.array([[4, 0, 1, 3, 2]]), rng)
    assert np.array_equal(children[0], population)


def test_rho_is_one_number_a_chromosome_uniform_and_drawn_anew(rng) -> None:
    count = 3000
    population = rng.normal(size=(3 * count, 4))
    costs = rng.normal(size=3 * count)
    groups = rng.permutation(3 * count).reshape(count, 3)
    before = population.copy()
    children = multiple_crossover(population, costs, groups, rng)
    assert np.array_equal(population, before)
    rho = np.empty((count, 3))
    for g, group in enumerate(groups):
        i = min(group, key=lambda q: costs[q])
        j, k = (q for q in group if q != i)
        direction = 2.0 * population[i] - population[j] - population[k]
        moves = (children[g] - population[group]) / direction  # the same for each gene
        rho[g] = moves[:, 0]
        assert np.allclose(moves, moves[:, :1], rtol=0.0, atol=1e-9)  # round-off over small genes
    assert stats.kstest(rho.ravel(), "uniform").pvalue > LIKELY
    correlation = np.corrcoef(rho.T) - np.eye(3)
    assert np.abs(correlation).max() < 4.0 / np.sqrt(count)  # four standard deviations


def test_crossover_does_not_care_where_zero_is_nor_what_the_unit_is() -> None:
    rng = np.random.default_rng(3)
    population, costs = rng.normal(size=(12, 3)), rng.normal(size=12)
    groups = rng.permutation(12).reshape(4, 3)
    children = multiple_crossover(population, costs, groups, np.random.default_rng(4))
    scale, shift = np.array([2.0, -0.5, 40.0]), np.array([1.0, -2.0, 3.0])
    moved = multiple_crossover(population * scale + shift, costs, groups, np.random.default_rng(4))
    assert np.allclose(moved, children * scale + shift, rtol=1e-12)


def test_no_groups_have_no_children(rng) -> None:
    none = np.empty((0, 3), dtype=np.intp)
    assert multiple_crossover(np.zeros((5, 2)), np.zeros(5), none, rng).shape == (0, 3, 2)


# Mutation (A2)


def test_a_mutant_is_shifted_by_one_uniform_number_of_at_most_the_constant(rng) -> None:
    chromosomes = rng.normal(size=(5000, 3))
    shifts = mutate(chromosomes, 0.25, rng) - chromosomes
    assert np.allclose(shifts, shifts[:, :1], rtol=0.0, atol=1e-14)  # round-off of the difference
    assert stats.kstest(shifts[:, 0] / 0.25, stats.uniform(-1.0, 2.0).cdf).pvalue > LIKELY


# Selection


def test_a_tournament_selects_each_rank_as_often_as_the_better_of_two(rng) -> None:
    size, count = 10, 20000
    ranks = rng.permutation(size)
    selected = ranks[tournament(ranks.astype(float), count, rng)]
    # Rank r wins when both drawn are of rank r or worse but not both worse: ((n-r)^2-(n-r-1)^2)/n^2
    expected = (2.0 * (size - np.arange(size)) - 1.0) / size**2 * count
    assert stats.chisquare(np.bincount(selected, minlength=size), expected).pvalue > LIKELY


def test_a_tournament_heeds_only_the_order_of_the_costs() -> None:
    costs = np.random.default_rng(5).normal(size=50)
    selected = [
        tournament(values, 200, np.random.default_rng(6)).tolist()
        for values in (costs, np.exp(3.0 * costs), costs - 1e3)
    ]
    assert selected[0] == selected[1] == selected[2]


def test_a_tournament_among_equals_selects_all_alike(rng) -> None:
    selected = tournament(np.zeros(10), 20000, rng)
    assert stats.chisquare(np.bincount(selected, minlength=10)).pvalue > LIKELY


# The box


def test_a_gene_that_left_the_box_is_put_on_the_bound_it_crossed() -> None:
    chromosomes = np.array([[0.5, 2.0], [-0.1, 2.9], [1.1, 1.9], [1.0, 3.5]])
    clipped = clip(chromosomes, np.array([0.0, 2.0]), np.array([1.0, 3.0]))
    assert clipped.tolist() == [[0.5, 2.0], [0.0, 2.9], [1.0, 2.0], [1.0, 3.0]]
