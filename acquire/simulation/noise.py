"""Counter-based random numbers of the simulated rig: each is a function of its counters, not of the order of use."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from .kernels import F4, kernel

TABLE_BITS = 14
GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31 = np.uint64(30), np.uint64(27), np.uint64(31)
POSITION_RESOLUTION = 1024
"""Positions that differ by less than 1 / 1024 microstep have the same noise: rounding must not change it."""
_MASK_64 = 2**64 - 1


def normal_table() -> F4:
    """Quantiles of the normal distribution at 2^14 equal steps, float32, variance exactly 1, reach 4.0."""
    count = 1 << TABLE_BITS
    # one half mirrored: the mean of the table is exactly 0
    half = [NormalDist().inv_cdf((i + 0.5) / count) for i in range(count // 2)]
    values = np.array(half + [-value for value in reversed(half)])
    scaled: F4 = (values / values.std()).astype(np.float32)
    return scaled


def frame_key(seed: int, position_steps: float, attempt: int = 0) -> np.uint64:
    """Key of a frame's noise, 64 bits, from its three counters."""
    key = 0
    # Python integers with a mask: numpy would warn of the overflow that is wanted here
    for word in (seed, round(position_steps * POSITION_RESOLUTION), attempt):
        key = int(mix64(np.uint64(((key ^ word) + int(GOLDEN)) & _MASK_64)))
    return np.uint64(key)


@kernel
def mix64(word: np.uint64) -> np.uint64:
    """Bijection of 64 bits in which each input bit flips each output bit half of the time (that of splitmix64)."""
    word = (word ^ (word >> _S30)) * _MIX_1
    word = (word ^ (word >> _S27)) * _MIX_2
    return word ^ (word >> _S31)


@kernel
def counter_bits(key: np.uint64, counter: int) -> np.uint64:
    """64 random bits number ``counter`` of the stream ``key``."""
    # XOR, not a sum: streams of different keys are then no shifted copies of each other
    return mix64(key ^ (np.uint64(counter) * GOLDEN))


@kernel
def lattice_value(seed: np.uint64, i: int, j: int, k: int) -> float:
    """A random number 0..1 at an integer point of space."""
    word = mix64(seed ^ (np.uint64(i) * GOLDEN)) ^ (np.uint64(j) * _MIX_1)
    # 24 bits: as many as a float32 holds exactly
    return float(mix64(mix64(word) ^ (np.uint64(k) * _MIX_2)) >> np.uint64(40)) / 16777216.0


@kernel
def value_noise(seed: np.uint64, x: float, y: float, z: float) -> float:
    """Smooth random field over space, values 0..1, features of about one unit."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    u, v, w = x - i, y - j, z - k
    # smoothstep weights: no creases at the lattice planes
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    total = 0.0
    for di in range(2):
        for dj in range(2):
            for dk in range(2):
                weight = (u if di else 1 - u) * (v if dj else 1 - v) * (w if dk else 1 - w)
                total += weight * lattice_value(seed, i + di, j + dj, k + dk)
    return total
