"""Pairs of a patch and a planned defect on it: flags packed into words of 64, counted over images and weighted.

Planned are whole defects of the catalogue, long ones in several orientations. Word w of patch p holds the flags of 64
defects. A count of units of evidence (:mod:`lightopt.design.responses._evidence`) from 0 to k takes k words of each:
flag l − 1 says "l units or more". An image has up to 3 units of each pair, and images add up.

The *benefit* of a count is the sum of its flags, each times its pair's weight; the weight *covered* is that of the
pairs with the last flag.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, reduce
from typing import overload

import numpy as np

from lightopt.core.arrays import Bool, Int32, Int64, UInt8, UInt64, read_only
from lightopt.core.errors import InputError, refuse
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.defects import MAX_SLOPE, PLANNING_GRID, SHAPE_KINDS, CatalogueEntry, DefectHypotheses, defect_hypotheses

MOST_HYPOTHESES = 1024  # more are refused: each costs a few bits per patch and position of a light


@dataclass(frozen=True, kw_only=True)
class PlannedDefect:
    """A defect of the catalogue in one orientation, with its middle on a patch."""

    name: str  # of the catalogue's entry
    weight: int  # a whole number; those of each entry of the part's catalogue have the same sum of weights
    # of the length, in the tangent plane from the part's X axis, counterclockwise seen from outside [rad]; see
    # :func:`lightopt.defects.tangent_direction`. None for a round defect
    turn: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class PlannedCatalogue:
    entries: tuple[DefectHypotheses, ...]  # what pixels see of each of them; the same order as those of `defects`

    @cached_property
    def defects(self) -> tuple[PlannedDefect, ...]:
        """Entry after entry; the orientations of an entry are adjacent, evenly around half a turn."""
        # a kind may have several sizes and slopes
        members = Counter(own.entry.name for own in self.entries)
        most = reduce(math.lcm, (len(own.turns) * members[own.entry.name] for own in self.entries))
        found: list[PlannedDefect] = []
        for own in self.entries:
            name, weight = own.entry.name, most // (len(own.turns) * members[own.entry.name])
            turns = map(float, own.turns) if len(own.turns) > 1 else (None,)
            found += [PlannedDefect(name=name, weight=weight, turn=one) for one in turns]
        return tuple(found)


def planned_catalogue(catalogue: Sequence[CatalogueEntry]) -> PlannedCatalogue:
    """The defects to plan for.

    Raises InputError: No entry, a slope of 0 or above 60°, too many defects.
    """
    return _planned(tuple(catalogue))


@lru_cache(maxsize=4)
def _planned(catalogue: tuple[CatalogueEntry, ...]) -> PlannedCatalogue:
    # equal catalogues are one object, whose stencils are made once
    problems: list[str] = []
    if not catalogue:
        problems.append("defect catalogue: expected at least one kind of defect to plan for, found none")
    problems += [
        f"defect {entry.name}: expected a slope above 0° up to {math.degrees(MAX_SLOPE):g}°, found "
        f"{math.degrees(entry.shape.slope):g}°"
        for entry in catalogue
        if entry.shape.kind in SHAPE_KINDS and not 0.0 < entry.shape.slope <= MAX_SLOPE
    ]
    refuse(problems)
    entries = (one for entry in catalogue for one in entry.in_sizes_and_slopes())
    found = PlannedCatalogue(entries=tuple(defect_hypotheses(one, PLANNING_GRID) for one in entries))
    if len(found.defects) > MOST_HYPOTHESES:
        number = f"{len(found.defects)} hypotheses, more than {MOST_HYPOTHESES}"
        raise InputError(f"defect catalogue: {len(catalogue)} entries are {number}; plan for fewer kinds")
    return found


Words = UInt64
Counts = UInt64  # shape (k, p, words): flag l says that a pair has l + 1 units of evidence or more
Packed = tuple[Int32, UInt8]  # see pack_counts
Merit = tuple[int, int]  # weight covered, and benefit


def refuse_memory(what: str, size: float, room: float, remedy: str) -> None:
    """Refuse what needs more memory than there is room for [bytes]; fewer patches are another remedy."""
    if size > room:
        sizes = f"{size / 1e9:.2f} GB, and there is room for {room / 1e9:.2f} GB"
        raise InputError(f"{what} are {sizes}; {remedy} or lower option 'patch_budget'")


def pack_flags(rows: Bool) -> Words:
    """Rows of flags, also of patches, shape (n, p), as words of 64 flags, shape (n, ⌈p / 64⌉); unused bits are 0."""
    octets = np.packbits(rows, axis=1, bitorder="little")
    return widen_octets(octets, -(-octets.shape[1] // 8))


def unpack_flags(words: Words, count: int) -> UInt8:
    """Bits as flags 0 and 1: words of shape (…, ⌈t / 64⌉) to shape (…, t)."""
    octets = np.ascontiguousarray(words).astype("<u8", copy=False).view(np.uint8)
    return np.unpackbits(octets, axis=-1, bitorder="little")[..., :count]


def narrow_words(words: Words) -> UInt8:
    """Words as octets, without the last ones that are 0 in all of them: shape (…, w) to shape (…, n ≤ 8 w)."""
    octets = np.ascontiguousarray(words).astype("<u8", copy=False).view(np.uint8)
    used = np.flatnonzero(octets.reshape(-1, octets.shape[-1]).any(axis=0))
    return octets[..., : used.max(initial=-1) + 1].copy()


def widen_octets(octets: UInt8, width: int) -> Words:
    """The words of :func:`narrow_words`, so many of them in a row."""
    whole = np.zeros((*octets.shape[:-1], 8 * width), np.uint8)
    whole[..., : octets.shape[-1]] = octets
    return whole.view("<u8").astype(np.uint64, copy=False)


class PackedCounts(Sequence[Counts]):
    """Counts of as many candidates, each widened where it is read.

    Of each only the patches that have any are held, and of their flags the octets that are in use.
    """

    def __init__(self, packed: Sequence["Packed"], shape: tuple[int, int, int]) -> None:
        self._packed, self._shape = packed, shape  # the shape is that of a candidate's counts

    def __len__(self) -> int:
        return len(self._packed)

    @overload
    def __getitem__(self, index: int) -> Counts: ...
    @overload
    def __getitem__(self, index: slice) -> "PackedCounts": ...
    def __getitem__(self, index: int | slice) -> "Counts | PackedCounts":
        if isinstance(index, slice):
            return PackedCounts(self._packed[index], self._shape)
        patches, octets = self._packed[index]
        counts = np.zeros(self._shape, np.uint64)
        counts[:, patches] = widen_octets(octets, self._shape[2])
        return counts


def pack_counts(counts: Counts) -> "Packed":
    """The patches that have any units, and their counts as octets."""
    patches = np.flatnonzero(counts[0].any(axis=-1)).astype(np.int32)
    return patches, narrow_words(counts[:, patches])


def packed_bytes(patches: int, k: int, defects: int) -> int:
    """Most bytes of the packed counts, up to k, of so many patches that have any."""
    return patches * (4 + k * -(-defects // 8))


def add_units(total: Counts, more: Counts) -> None:
    """Add a count, or the units of an image, to a count, in place; shapes (k, …) and (m, …), `total` is contiguous.

    (a + b ≥ l) = (a ≥ l) or (b ≥ l) or (a ≥ 1 and b ≥ l − 1) or … or (a ≥ l − 1 and b ≥ 1).
    """
    assert total.flags.c_contiguous
    _add_units(total.reshape(len(total), -1), np.ascontiguousarray(more).reshape(len(more), -1))


def add_counts(one: Counts, other: Counts) -> Counts:
    """The sum of two counts up to k, as a new array; shapes (k, …) and (m, …) to (k, …)."""
    total = one.copy()
    add_units(total, other)
    return total


@kernel
def _add_units(total: Words, more: Words) -> None:
    # from the highest flag down, so that those below are still the old ones
    for level in range(len(total) - 1, -1, -1):
        if level < len(more):
            for w in range(total.shape[1]):
                total[level, w] |= more[level, w]
        for own in range(max(0, level - len(more)), level):
            for w in range(total.shape[1]):
                total[level, w] |= total[own, w] & more[level - 1 - own, w]


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


def weight_planes(hypotheses: Sequence[PlannedDefect]) -> tuple[Words, Int64]:
    """The hypotheses' weights in binary: masks of the hypotheses that have a bit, and the value of that bit.

    Returns masks, shape (planes, ⌈t / 64⌉), and factors, shape (planes,), powers of two; bits that no weight has are
    omitted.
    """
    weights = np.array([hypothesis.weight for hypothesis in hypotheses], np.int64)
    factors = 1 << np.arange(int(weights.max()).bit_length())
    flags = (weights & factors[:, None]) > 0
    some = flags.any(axis=1)
    return pack_flags(flags[some]), factors[some]


@kernel
def weighted_bits(words: Words, masks: Words, factors: Int64) -> Int64:
    """Sum of the weights of the hypotheses whose bits are set, of each row of words, shape (p,)."""
    sums = np.zeros(len(words), np.int64)
    for p in range(len(words)):
        for w in range(words.shape[1]):
            if words[p, w]:
                sums[p] += word_weight(words[p, w], w, masks, factors)
    return sums


@dataclass(frozen=True, eq=False, kw_only=True)
class PairWeights:
    """Weight of each pair of patch and hypothesis: the patch's area times the hypothesis's factor."""

    areas: Int64  # of the patches [µm²], shape (p,)
    masks: Words  # the hypotheses of one factor each, as flags; shape (groups, words)
    factors: Int64  # whole numbers, shape (groups,)

    def __post_init__(self) -> None:
        for name in ("areas", "masks", "factors"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def of(self, patches: slice | Bool) -> "PairWeights":
        return replace(self, areas=self.areas[patches])

    def sum_of(self, flags: Words) -> int:
        """Weight of the pairs whose flags are set, shape (p, words)."""
        return int(_added_weight(np.zeros_like(flags), flags, self.areas, self.masks, self.factors))

    @property
    def total(self) -> int:
        hypotheses = weighted_bits(np.bitwise_or.reduce(self.masks)[None], self.masks, self.factors)
        return int(self.areas.sum()) * int(hypotheses[0])

    def zero_counts(self, k: int) -> Counts:
        return np.zeros((k, len(self.areas), self.masks.shape[1]), np.uint64)

    def sum_counts(self, some: Iterable[Counts], k: int) -> Counts:
        """The sum of several counts, up to k, shape (k, p, words)."""
        total = self.zero_counts(k)
        for counts in some:
            add_units(total, counts)
        return total

    def benefit(self, counts: Counts) -> int:
        """Σ weight · min(k, count)."""
        return sum(map(self.sum_of, counts))

    def covered(self, counts: Counts) -> int:
        """Σ weight · [count ≥ k]."""
        return self.sum_of(counts[-1])

    def merit(self, counts: Counts) -> Merit:
        return self.covered(counts), self.benefit(counts)

    def gains(self, counts: Counts, more: Counts) -> Merit:
        """By how much :meth:`covered` and :meth:`benefit` grow when `more` is added to `counts`."""
        layers = zip(counts, add_counts(counts, more), strict=True)
        added = [int(_added_weight(*layer, self.areas, self.masks, self.factors)) for layer in layers]
        return added[-1], sum(added)

    def all_gains(
        self, counts: Counts, candidates: Sequence[Counts], some: Sequence[int], *, threads: int | None
    ) -> list[Merit]:
        """The gains of some of the candidates."""
        return in_threads(lambda one: self.gains(counts, candidates[one]), some, threads)


@kernel
def _added_weight(before: Words, after: Words, areas: Int64, masks: Words, factors: Int64) -> np.int64:
    # weight of the pairs whose flags are set in `after` alone; without branches, so that the processor takes several
    # patches at once
    total = np.int64(0)
    for w in range(after.shape[1]):
        for g in range(len(factors)):
            for p in range(len(after)):
                flags = after[p, w] & ~before[p, w] & masks[g, w]
                total += areas[p] * factors[g] * np.int64(_count_bits(flags))
    return total
