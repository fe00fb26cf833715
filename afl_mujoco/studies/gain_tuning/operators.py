"""Operators of the genetic algorithm, Eqs. (A1) and (A2): arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


def tournament(costs: FloatArray, count: int, rng: Generator) -> IndexArray:
    """Select by fitness, `count` times: the cheaper of two chromosomes drawn at random.

    The paper only says "reproduction"; the binary tournament is a decision of this project. It
    depends only on the order of the costs. A chromosome may be drawn against itself.

    Returns
    -------
    IndexArray
        Indices into `costs`, shape (count,), with repetitions.
    """
    first, second = rng.integers(len(costs), size=(2, count))
    winners: IndexArray = np.where(costs[first] <= costs[second], first, second)
    return winners


def multiple_crossover(
    population: FloatArray, costs: FloatArray, groups: IndexArray, rng: Generator
) -> FloatArray:
    """Move every chromosome of a group along the sum of the ways to its fittest, Eq. (A1).

    With `i` the fittest of a group of n, ``x_q' = x_q + rho_q sum_j (x_i - x_j)`` for each q in it,
    `i` included. For n = 3 that is the paper's ``2 x_i - x_j - x_k``; for n = 2 the usual crossover
    of two parents, ``x_i - x_j``. The paper calls each of rho_1, rho_2, rho_3 "a random value": one
    scalar per chromosome, the same for all its genes, so that a child lies on a line.

    Parameters
    ----------
    population
        Chromosomes, shape (P, D).
    costs
        Their costs, shape (P,); among equal costs, the first of a group counts as its fittest.
    groups
        Indices of the parents, shape (G, n).
    rng
        Gives rho ~ U[0, 1).

    Returns
    -------
    FloatArray
        Children, shape (G, n, D), in the places of their parents; not clipped.
    """
    parents = population[groups]
    best = np.argmin(costs[groups], axis=1)
    fittest = parents[np.arange(len(groups)), best]
    direction = np.sum(fittest[:, np.newaxis] - parents, axis=1, keepdims=True)
    moved: FloatArray = parents + rng.random((*groups.shape, 1)) * direction
    return moved


def mutate(chromosomes: FloatArray, constant: float, rng: Generator) -> FloatArray:
    """Shift every chromosome at random, Eq. (A2): ``x' = x + rho c``.

    The paper calls rho "a random value": one scalar per chromosome, as in (A1), so that all its
    genes shift by the same amount.

    Parameters
    ----------
    chromosomes
        Shape (N, D).
    rng
        Gives rho ~ U[-1, 1).

    Returns
    -------
    FloatArray
        Mutants, shape (N, D); not clipped.
    """
    return chromosomes + constant * rng.uniform(-1.0, 1.0, (len(chromosomes), 1))


def clip(chromosomes: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Move every gene that left the box to the bound that it crossed.

    Parameters
    ----------
    chromosomes
        Shape (N, D).
    lower, upper
        Bounds, shape (D,).

    Returns
    -------
    FloatArray
        Shape (N, D).
    """
    return np.minimum(np.maximum(chromosomes, lower), upper)
