"""White Gaussian noise that depends on a seed and a tick alone.

Philox4x32-10 (Salmon, Moraes, Dror and Shaw, SC11) is a function of key and counter without state:
the noise of a tick is the same in every thread, run or loop that draws it, and switching one
channel on changes no other. NumPy's generators offer neither, and do not promise the same numbers
in every version, which the replay of a stored scenario needs.
"""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable

from afl_mujoco.compiled import kernel

_ROUNDS = 10
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _WORD = np.uint64(0xFFFFFFFF), np.uint64(32)
_UNIT = 2.0**-32


@register_jitable
def _philox(c0, c1, c2, c3, k0, k1):
    """Return four words of 32 bits for a counter of four and a key of two, all as uint64."""
    for _ in range(_ROUNDS):
        p0, p1 = _M0 * c0, _M1 * c2
        c0, c1, c2, c3 = (p1 >> _WORD) ^ c1 ^ k0, p1 & _LOW, (p0 >> _WORD) ^ c3 ^ k1, p0 & _LOW
        k0, k1 = (k0 + _W0) & _LOW, (k1 + _W1) & _LOW
    return c0, c1, c2, c3


@kernel
def random_words(counter, key):
    """Return the block of Philox4x32-10, four words.

    counter, key: Words of 32 bits as uint64, shape (4,) and (2,).
    """
    return _philox(counter[0], counter[1], counter[2], counter[3], key[0], key[1])


@register_jitable
def _pair(first, second):
    """Return two independent standard normal numbers from two words, by Box and Muller."""
    radius = math.sqrt(-2.0 * math.log((float(first) + 0.5) * _UNIT))
    angle = 2.0 * math.pi * ((float(second) + 0.5) * _UNIT)
    return radius * math.cos(angle), radius * math.sin(angle)


@kernel
def normals(seed, tick):
    """Return four independent standard normal numbers."""
    s, t, zero = np.uint64(seed), np.uint64(tick), np.uint64(0)
    a, b, c, d = _philox(t & _LOW, t >> _WORD, zero, zero, s & _LOW, s >> _WORD)
    n0, n1 = _pair(a, b)
    n2, n3 = _pair(c, d)
    return n0, n1, n2, n3
