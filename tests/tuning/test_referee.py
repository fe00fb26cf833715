"""The referee counts as defined, gives the same bits however shared, and refuses the unsound."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest, mannwhitneyu

from afl_mujoco.errors import AflMujocoError, FileError, InvalidValueError
from afl_mujoco.reporting.tuning_figures import draw_contest
from afl_mujoco.tuning.gain_cost import GAIN_BOX
from afl_mujoco.tuning.referee import (
    OPTIMISERS,
    PROBLEMS,
    Contest,
    ContestResult,
    Problem,
    effect_size,
    empirical_distribution,
    expected_running_time,
    hold_contest,
    known_optimum,
    load_result,
    save_result,
    shipped_result,
    summary,
    superiority,
)
from afl_mujoco.tuning.referee import runs as runs_module
from afl_mujoco.tuning.referee.optimisers import CountedCost, Finished
from afl_mujoco.tuning.settings import Box

NEVER = float("inf")
PAPER, SMALL = "multiple-crossover GA, Np = 1000", "multiple-crossover GA, Np = 60"
CORNER = Problem(cart_mass=0.5, half_length=0.2)
TINY = Contest(problems=(CORNER,), targets=(1e-1, 1e-2), runs=2, budget=1500)


@pytest.fixture(scope="module")
def tiny() -> ContestResult:
    return hold_contest(TINY)


# Scores, by hand


def test_ert_is_all_that_was_spent_over_the_number_of_successes() -> None:
    assert expected_running_time([10, 30], 100) == 20.0
    assert expected_running_time([10, NEVER, 30, NEVER], 100) == (10 + 100 + 30 + 100) / 2
    assert expected_running_time([NEVER, NEVER], 100) == NEVER
    assert expected_running_time([100], 100) == 100.0


def test_the_distribution_rises_where_a_target_is_reached_and_counts_what_is_not() -> None:
    where, share = empirical_distribution([[5, 2], [5, NEVER], [NEVER, 9], [1, 5]])
    np.testing.assert_array_equal(where, [1, 2, 5, 9])
    np.testing.assert_array_equal(share, np.array([1, 2, 5, 6]) / 8)
    where, share = empirical_distribution([NEVER])
    assert where.size == share.size == 0


def test_a12_is_the_share_of_pairs_in_which_a_run_is_sooner_ties_counting_half() -> None:
    # against 2: 1 wins, 2 ties, never loses; against never: 1 and 2 win, never ties
    assert (
        superiority(np.array([1, 2, NEVER]), np.array([2, NEVER]))
        == (1 + 0.5 + 0 + 1 + 1 + 0.5) / 6
    )
    assert superiority(np.array([1.0, 2.0]), np.array([3.0])) == 1.0
    assert superiority(np.array([NEVER]), np.array([NEVER])) == 0.5


def test_a12_is_the_u_statistic_of_mann_and_whitney() -> None:
    rng = np.random.default_rng(1)
    mine, theirs = rng.integers(1, 20, 30).astype(float), rng.integers(1, 25, 40).astype(float)
    mine[:5] = NEVER
    u = mannwhitneyu(theirs, mine).statistic / (30 * 40)
    assert superiority(mine, theirs) == pytest.approx(u, rel=1e-12)
    effect = effect_size([mine], [theirs])
    assert effect.a12 == pytest.approx(u, rel=1e-12)
    assert effect.p_value == mannwhitneyu(mine, theirs).pvalue
    assert effect.low < effect.a12 < effect.high


def test_the_interval_of_an_effect_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(2)
    truth, samples = 0.7602, 60  # P(x < y) of normal deviates one apart: Phi(1 / sqrt(2))
    draws = [(rng.normal(10.0, 1.0, 25), rng.normal(11.0, 1.0, 25)) for _ in range(samples)]
    effects = [effect_size([x], [y]) for x, y in draws]
    covered = sum(effect.low <= truth <= effect.high for effect in effects)
    assert binomtest(covered, samples, 0.95).pvalue > 1e-3, covered


def test_an_effect_over_several_problems_weighs_them_equally() -> None:
    effect = effect_size([[1, 2], [9] * 10], [[3, 4], [5] * 10])
    assert (effect.a12, effect.p_value) == (0.5, None)


def test_the_interval_of_separated_runs_is_the_exact_one_of_pairs() -> None:
    effect = effect_size([np.arange(1, 26)], [np.arange(101, 126)])
    assert (effect.a12, effect.high) == (1.0, 1.0)
    assert effect.low == pytest.approx(0.025 ** (1 / 25), rel=1e-9)  # Clopper and Pearson
    reverse = effect_size([np.arange(101, 126)], [np.arange(1, 26)])
    assert (reverse.a12, reverse.low, reverse.high) == (0.0, 0.0, pytest.approx(1.0 - effect.low))


@pytest.mark.parametrize("runs", [[], [0.0], [float("nan")], [[1.0]], [-3.0]], ids=str)
def test_evaluations_that_cannot_be_are_refused(runs: list) -> None:
    with pytest.raises(InvalidValueError, match="evaluations must"):
        expected_running_time(runs, 10)
    with pytest.raises(InvalidValueError, match="must"):
        effect_size([[1.0]], [runs])
    with pytest.raises(InvalidValueError, match="as many problems"):
        effect_size([[1.0]], [])


# Counting


def first_gene(points: np.ndarray) -> np.ndarray:
    return points[:, 0]


def test_a_counted_cost_notes_the_evaluation_within_a_batch_that_met_a_target() -> None:
    cost = CountedCost(first_gene, (5.0, 2.0, 0.0), 100)
    cost(np.array([[9.0], [4.0], [5.0]]))
    cost(np.array([[7.0], [2.0], [1.0]]))
    np.testing.assert_array_equal(cost.reached, [2, 5, NEVER])
    assert (cost.spent, cost.best) == (6, 1.0)
    with pytest.raises(Finished):
        cost(np.array([[0.0]]))
    assert (cost.reached[2], cost.best) == (7, 0.0)


def test_a_counted_cost_looks_at_nothing_beyond_its_budget() -> None:
    seen: list[np.ndarray] = []
    cost = CountedCost(lambda points: seen.append(points) or points[:, 0], (0.0,), 5)
    cost(np.ones((3, 1)))
    with pytest.raises(Finished):
        cost(np.array([[1.0], [1.0], [0.0]]))
    assert [len(points) for points in seen] == [3, 2]
    assert (cost.spent, cost.reached[0]) == (5, NEVER)


@pytest.mark.parametrize("name", OPTIMISERS)
def test_each_optimiser_spends_its_budget_in_the_box_from_its_seed_alone(name: str) -> None:
    box = Box((-2.0, 5.0), (2.0, 9.0))

    def searched() -> np.ndarray:
        seen: list[np.ndarray] = []

        def sphere(points: np.ndarray) -> np.ndarray:
            seen.append(points.copy())
            return np.sum((points - (0.3, 6.1)) ** 2, axis=1)

        with pytest.raises(Finished):
            OPTIMISERS[name].search(CountedCost(sphere, (-1.0,), 4000), box, (7, 3))
        return np.concatenate(seen)

    # Nobody may touch the global generator.
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    points = searched()
    assert points.shape == (4000, 2)  # CMA-ES ends by itself before, and begins anew
    assert np.all((points >= box.lower) & (points <= box.upper))
    np.testing.assert_array_equal(points, searched())
    np.testing.assert_array_equal(state, np.random.get_state()[1])  # noqa: NPY002
    nearest = np.sqrt(np.min(np.sum((points - (0.3, 6.1)) ** 2, axis=1)))
    assert nearest < 0.1, nearest


def test_without_the_package_cma_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cma", None)
    with pytest.raises(AflMujocoError, match=r"^CMA-ES needs the package cma: pip install cma$"):
        hold_contest(dataclasses.replace(TINY, optimisers=("CMA-ES",)))


# The optimum


def test_the_known_optimum_lies_in_its_corner_and_below_a_dense_sample() -> None:
    optimum = known_optimum(CORNER)
    assert optimum.gains == (100.0, 5.0, 90.0)
    assert optimum.cost == pytest.approx(optimum.tight_cost, rel=1e-6)
    lower, upper = np.array(GAIN_BOX.lower), np.array(GAIN_BOX.upper)
    sample = lower + (upper - lower) * np.random.default_rng(4).random((5000, 3))
    assert np.min(CORNER.cost(sample)) > optimum.cost


def test_an_optimum_that_a_run_undercuts_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    true = known_optimum(CORNER)
    false = dataclasses.replace(true, cost=true.cost * 1.01)
    monkeypatch.setattr(runs_module, "known_optimum", lambda problem: false)
    with pytest.raises(AflMujocoError, match=r"optimum of M = 0.5 kg, l = 0.2 m must not lie"):
        hold_contest(dataclasses.replace(TINY, optimisers=(SMALL,), targets=(1e-3,)))


# The contest


def test_a_tiny_contest_finds_what_it_should(tiny: ContestResult) -> None:
    assert tiny.evaluations.shape == TINY.shape == (len(OPTIMISERS), 1, 2, 2)
    assert np.all(tiny.evaluations[:, :, 0] <= tiny.evaluations[:, :, 1])
    assert np.all(tiny.successes[:, 0, 0] == TINY.runs)
    assert tiny.expected_running_times[0, 0, 0] == np.mean(tiny.evaluations[0, 0, 0])
    assert tiny.optima[0].cost <= tiny.best_costs[0] < tiny.optima[0].cost * 1.01
    where, share = tiny.distribution(SMALL)
    assert share[-1] == 1.0
    assert where[-1] == tiny.evaluations[1].max()


def test_the_result_is_the_same_to_the_bit_however_it_is_shared(
    tiny: ContestResult, tmp_path: Path
) -> None:
    ticks: list[tuple[int, int]] = []
    shared = hold_contest(TINY, workers=2, progress=lambda *tick: ticks.append(tick))
    assert ticks == [(k, 14) for k in range(1, 15)]
    save_result(tiny, tmp_path / "alone.json")
    save_result(shared, tmp_path / "shared.json")
    assert (tmp_path / "alone.json").read_bytes() == (tmp_path / "shared.json").read_bytes()


def test_a_run_gives_the_same_whatever_else_is_in_the_contest(tiny: ContestResult) -> None:
    alone = hold_contest(dataclasses.replace(TINY, optimisers=(SMALL,), runs=1))
    np.testing.assert_array_equal(alone.evaluations[0, 0, :, 0], tiny.evaluations[1, 0, :, 0])


def test_another_seed_gives_another_result(tiny: ContestResult) -> None:
    other = hold_contest(dataclasses.replace(TINY, optimisers=(PAPER,), seed=1))
    assert not np.array_equal(other.evaluations[0], tiny.evaluations[0])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"optimisers": ()}, "optimisers must hold at least one"),
        ({"optimisers": ("simplex",)}, "optimiser must be one of .*, got 'simplex'"),
        ({"optimisers": (SMALL, SMALL)}, "optimisers must differ"),
        ({"problems": (CORNER, CORNER)}, "problems must differ"),
        ({"targets": (1e-2, 1e-1)}, "targets must decrease, got 0.1 after 0.01"),
        ({"targets": (1e-2, 1e-7)}, "target must be at least 1e-06, .*, got 1e-07"),
        ({"targets": (float("nan"),)}, "target must be finite"),
        ({"runs": 0}, "runs must be a whole number of at least 1, got 0"),
        ({"budget": 10.0}, "budget must be a whole number of at least 1, got 10.0"),
        ({"runs": True}, "runs must be a whole number"),
        ({"seed": -1}, "seed must be a whole number of at least 0, got -1"),
    ],
    ids=str,
)
def test_a_contest_that_makes_no_sense_is_refused(wrong: dict, message: str) -> None:
    with pytest.raises(AflMujocoError, match=message):
        Contest(**wrong)


def test_a_plant_or_a_number_of_workers_that_makes_no_sense_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="half_length must be positive, got 0"):
        Problem(cart_mass=1.0, half_length=0.0)
    with pytest.raises(InvalidValueError, match="workers must be at least 1"):
        hold_contest(TINY, workers=0)


# The file


def test_a_result_comes_back_from_its_file(tiny: ContestResult, tmp_path: Path) -> None:
    save_result(tiny, tmp_path / "result.json")
    loaded = load_result(tmp_path / "result.json")
    for name in ("contest", "optima", "best_costs", "versions"):
        assert getattr(loaded, name) == getattr(tiny, name)
    np.testing.assert_array_equal(loaded.evaluations, tiny.evaluations)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("schema", 2, "schema must be 1, got 2"),
        ("box", {"lower": [0.0] * 3, "upper": [1.0] * 3}, "the box must be"),
        ("optimisers", {"CMA-ES": {"sigma0": 1.0}}, "CMA-ES had other settings"),
        ("runs", 3, "evaluations must have shape"),
        ("evaluations", {}, "optimisers must hold"),
        ("problems", [], "problems must hold"),
        ("targets", ["none"], "target must be a number"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_file_that_is_no_result_is_refused(
    tiny: ContestResult, tmp_path: Path, place: str, value: object, message: str
) -> None:
    file = tmp_path / "result.json"
    save_result(tiny, file)
    file.write_text(json.dumps({**json.loads(file.read_text()), place: value}))
    with pytest.raises(FileError, match=f"result.json is no result of a contest: .*{message}"):
        load_result(file)


@pytest.mark.parametrize("text", ["", "[]", "{}"])
def test_a_file_of_something_else_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(FileError, match="is no result of a contest"):
        load_result(tmp_path / "result.json")
    with pytest.raises(FileError, match="cannot be read: no such file"):
        load_result(tmp_path / "missing.json")


# What is shipped


def test_the_shipped_result_is_whole_and_its_scores_follow_from_its_runs() -> None:
    result = shipped_result()
    assert result.contest == Contest()
    assert result.contest.problems == PROBLEMS
    assert result.contest.runs >= 25
    file = Path(sys.modules["afl_mujoco"].__file__).parent / "control" / "data" / "optimisers.json"
    assert file.stat().st_size < 200_000
    few = dataclasses.replace(  # all would take seconds
        result,
        contest=dataclasses.replace(result.contest, optimisers=(PAPER, "CMA-ES")),
        evaluations=result.evaluations[[0, list(OPTIMISERS).index("CMA-ES")]],
    )
    written = json.loads(file.read_text())["summary"]
    for name, problems in summary(few).items():
        for problem, scores in problems.items():
            for score, values in scores.items():
                tolerance = 0.03 if score in ("low", "high") else 0.0  # another scipy may resample
                assert written[name][problem][score] == pytest.approx(values, abs=tolerance)


def test_every_run_of_the_papers_search_found_the_optimum() -> None:  # C12
    result = shipped_result()
    assert np.all(result.successes[:2] == result.contest.runs)


def test_the_figure_draws_the_share_solved_by_each_optimiser(tiny: ContestResult) -> None:
    figure = draw_contest(tiny)
    (axis,) = figure.axes
    assert [line.get_label() for line in axis.lines] == list(OPTIMISERS)
    assert axis.get_xscale() == "log"
    assert axis.get_xlabel() and axis.get_ylabel()
    for name, line in zip(OPTIMISERS, axis.lines, strict=True):
        assert line.get_ydata()[-1] == tiny.distribution(name)[1][-1]
    looks = {(line.get_linestyle(), line.get_marker(), line.get_mfc()) for line in axis.lines}
    assert len(looks) == len(OPTIMISERS)
