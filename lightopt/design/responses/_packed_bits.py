"""Bool packed into words of 64: counted over images, weighted, and counted where two rows share them."""

import numpy as np

from lightopt.core.arrays import Bool, Int64, UInt8, UInt64
from lightopt.core.kernels import kernel

Words = UInt64


def pack_flags(rows: Bool) -> Words:
    """Rows of flags, shape (n, p), as words of 64 flags, shape (n, ⌈p / 64⌉); unused bits are 0."""
    octets = np.packbits(rows, axis=1)
    padded = np.zeros((len(octets), -(-octets.shape[1] // 8) * 8), np.uint8)
    padded[:, : octets.shape[1]] = octets
    return padded.view(np.uint64)


def unpack_flags(words: Words, count: int) -> UInt8:
    """Bits as flags 0 and 1: words of shape (…, ⌈t / 64⌉) to shape (…, t)."""
    octets = np.ascontiguousarray(words).astype("<u8", copy=False).view(np.uint8)
    return np.unpackbits(octets, axis=-1, bitorder="little")[..., :count]


def add_image(counters: Words, image: Words) -> None:
    """Count one image more: entry j of `counters` (k, …) has the flags that are set in more than j images.

    `counters` is contiguous and changed in place; `image` has shape (…).
    """
    assert counters.flags.c_contiguous
    count_flags(counters.reshape(len(counters), -1), image.reshape(-1))


def add_counts(one: Words, other: Words) -> Words:
    """The sum of two counts of images as :func:`add_image` makes them, up to k; shape (k, …).

    (a + b ≥ l) = (a ≥ l) or (b ≥ l) or (a ≥ 1 and b ≥ l − 1) or … or (a ≥ l − 1 and b ≥ 1).
    """
    total = one | other
    for level in range(1, len(one)):
        for low in range(level):
            total[level] |= one[low] & other[level - 1 - low]
    return total


@kernel
def count_flags(counters: Words, more: Words) -> None:
    """As :func:`add_image`, for rows: shapes (k, w) and (w,)."""
    for w in range(counters.shape[1]):
        carry = more[w]
        for k in range(len(counters)):
            both = counters[k, w] & carry
            counters[k, w] |= carry
            carry = both


@kernel
def _count_bits(word: np.uint64) -> np.uint64:
    """Number of flags that are set in a word: bits of pairs, of fours, of bytes, then the sum of the bytes."""
    x = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@kernel
def word_weight(flags: np.uint64, word: int, masks: Words, factors: Int64) -> np.int64:
    """Sum of the factors of the flags that are set in `flags`, which is word number `word`.

    `masks` are the flags that share a factor, shape (groups, words); a flag in several counts with the sum of
    `factors`, shape (groups,).
    """
    total = np.int64(0)
    for g in range(len(factors)):
        total += factors[g] * np.int64(_count_bits(flags & masks[g, word]))
    return total


@kernel
def common_bits(left: Words, right: Words) -> np.int64:
    """Number of flags that are set in both of two rows of words."""
    total = np.uint64(0)
    for w in range(len(left)):
        total += _count_bits(left[w] & right[w])
    return np.int64(total)
