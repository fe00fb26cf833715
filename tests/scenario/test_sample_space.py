from dataclasses import replace

import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.errors import InvalidValueError
from afl_mujoco.scenario import sample_space
from afl_mujoco.scenario.catalogue import HARDWARE_RANGES, LABORATORY
from afl_mujoco.scenario.imperfections import DRAWS
from afl_mujoco.scenario.sample_space import SampleSpace, sample_point, sample_scenario

SPACE = SampleSpace(LABORATORY)
MANY = 300


@pytest.fixture(scope="module")
def samples() -> list[afl.Scenario]:
    return [sample_scenario(SPACE, i, 7) for i in range(MANY)]


def test_a_coordinate_acts_where_it_changes_the_scenario_and_nowhere_else() -> None:
    seen = set()
    for index in range(6):
        point = sample_point(SPACE, index, 3)
        away = dict(zip(SPACE.coordinates, (point - SPACE.reference).tolist(), strict=True))
        for i, name in enumerate(SPACE.coordinates):
            if name.endswith("shape") or name in ("encoder_step.z", "encoder_step.phi"):
                continue
            other = point.copy()
            other[i] = (other[i] + 0.5) % 1.0
            same = SPACE.scenario_of(other, 0, 0) == SPACE.scenario_of(point, 0, 0)
            assert same == (name not in sample_space.acting(away)), name
            seen.add(same)
    assert seen == {True, False}


def test_a_sample_depends_on_index_and_seed_alone_and_is_the_same_for_ever() -> None:
    assert sample_scenario(SPACE, 3, 7) == sample_scenario(SPACE, 3, 7)
    drawn = [sample_scenario(SPACE, i, seed) for i in range(6) for seed in range(6)]
    assert len({one.initial_state for one in drawn}) == 36
    assert len({one.imperfections.seed for one in drawn}) == 36
    """Philox and SeedSequence promise their streams; a sample of today is that of tomorrow."""
    expected = [0.08889323355387169, 0.20068358985659007, 0.8312670906835586]
    np.testing.assert_array_equal(sample_point(SPACE, 12, 1)[:3], expected)
    assert sample_scenario(SPACE, 12, 1).imperfections.seed == 2389723553712521205
    assert [one.axis for one in DRAWS.values()] == [*range(11)]


def test_points_noise_and_searches_share_no_random_numbers() -> None:
    one, other = (SPACE.scenario_of(np.full(SPACE.dimension, 0.3), i, 1) for i in (0, 1))
    assert one.imperfections.seed != other.imperfections.seed
    same = replace(one.imperfections, seed=other.imperfections.seed)
    assert replace(one, name=other.name, imperfections=same) == other
    drawn = sample_space.search_generator(7).random(SPACE.dimension)
    assert all((sample_point(SPACE, i, 7) != drawn).all() for i in range(100))
    for outside in (np.zeros(3), np.full(SPACE.dimension, 1.1)):
        with pytest.raises(InvalidValueError, match=r"^point must "):
            SPACE.scenario_of(outside, 0, 0)


def test_every_sample_lies_in_the_ranges_and_fills_them(samples: list[afl.Scenario]) -> None:
    states = np.array([sample.initial_state for sample in samples])
    found = {name: states[:, i] for i, name in enumerate(("z", "phi", "z_dot", "phi_dot"))}
    for thing in ("cart_mass", "half_length"):
        found[thing] = np.concatenate([getattr(sample, thing).values for sample in samples])
    for name in HARDWARE_RANGES:
        found[name] = np.array([sample.imperfections.at(name) for sample in samples])
    ranges = LABORATORY.ranges
    assert set(found) == set(ranges)
    for name, values in found.items():
        low, high = ranges[name]
        share = (values - low) / (high - low)
        assert 0.0 <= share.min() < 0.05, name
        assert 0.95 < share.max() <= 1.0, name
        assert share.mean() == pytest.approx(0.5, abs=0.08), name  # 5 sigma of 300


def test_the_shapes_and_their_instants_are_as_said(samples: list[afl.Scenario]) -> None:
    counts = dict.fromkeys((1, 4, 6), 0)
    for sample in samples:
        assert sample.duration == 20.0 and sample.imperfections.input_limit is None
        for schedule in (sample.cart_mass, sample.half_length):
            breaks = schedule.breakpoints
            counts[{0: 1, 2: 6, 4: 4}[len(breaks)]] += 1
            assert all(0.0 < t <= SPACE.last_change for t in breaks)
            assert all(round(1e3 * t) == pytest.approx(1e3 * t, abs=1e-9) for t in breaks)
    assert min(counts.values()) > MANY / 2  # each a third of twice as many schedules
