"""The noise is Philox's, is white and normal, and depends on nothing but seed and tick."""

import numpy as np
import pytest
from scipy import stats

from afl_mujoco.simulation.sampled.hardware import normals, philox

# The known answers of Random123 v1.14.0, tests/kat_vectors, philox4x32 with 10 rounds.
ZEROS, ONES, PI = "00000000 00000000", "ffffffff ffffffff", "13198a2e 03707344"
KNOWN = [
    (f"{ZEROS} {ZEROS}", ZEROS, "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    (f"{ONES} {ONES}", ONES, "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    (f"243f6a88 85a308d3 {PI}", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
]


def _words(text):
    return np.array([int(word, 16) for word in text.split()], dtype=np.uint64)


@pytest.mark.parametrize(("counter", "key", "block"), KNOWN, ids=["zeros", "ones", "pi"])
def test_philox_gives_the_known_answers(counter, key, block):
    assert list(philox(*_words(counter), *_words(key))) == _words(block).tolist()


def test_each_channel_is_standard_normal_and_white():
    n = 20_000
    noise = np.array([normals(11, tick) for tick in range(n)])
    for channel in noise.T:
        assert stats.kstest(channel, "norm").pvalue > 1e-3
    both = np.hstack([noise[1:], noise[:-1]])  # each channel with the others and with its past
    off_diagonal = np.corrcoef(both.T) - np.eye(8)
    assert np.abs(off_diagonal).max() < 4.5 / np.sqrt(n)  # 28 standard normal numbers / sqrt(n)


def test_the_channels_are_the_box_muller_transform_of_a_block_of_words():
    seed, tick = 3 * 2**32 + 7, 5 * 2**32 + 11
    block = philox(*np.array([11, 5, 0, 0, 7, 3], np.uint64))
    shares = (np.array(block, dtype=float) + 0.5) / 2**32
    radii, angles = np.sqrt(-2.0 * np.log(shares[::2])), 2.0 * np.pi * shares[1::2]
    expected = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1).ravel()
    np.testing.assert_allclose(normals(seed, tick), expected, rtol=1e-12)
