"""The luminance matrix: what the camera would deliver for every patch under every candidate position of a light.

With it goes the evidence that the same images give of defects at the patches
(:mod:`lightopt.design.responses._evidence`). Bit t % 64 of word t // 64 of a patch is planned defect t. Patches are
addressed by their index in the refined mesh of the run (:class:`lightopt.rendering.PatchTable`), which is refined once
for all postures: the same index is the same patch in every posture.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float64, Int32, Int64, UInt8, read_only
from lightopt.core.errors import InputError
from lightopt.core.kernels import kernel
from lightopt.design.responses._pairs import Counts, PlannedDefect, Words, add_units, weight_planes, weighted_bits
from lightopt.optics import Sensor

Levels = NDArray[np.uint8 | np.uint16]

AREA_UNIT_MM2 = 1e-6  # areas are counted in whole square micrometres, so that sums are exact in any order


def flags_alike(units: UInt8, words: int) -> Words | None:
    """Flags of units of patches, shape (p,), alike for all defects: shape (most units, p, words); None for no unit."""
    if not units.any():
        return None
    flags = np.zeros((int(units.max()), len(units), words), np.uint64)
    for unit in range(len(flags)):
        flags[unit, units > unit] = ~np.uint64(0)
    return flags


@dataclass(frozen=True)
class Visibility:
    """Evidence of t planned defects on patches by the image of each light position in one posture."""

    defects: tuple[PlannedDefect, ...]
    words: tuple[Words, ...]  # flags of the units of each light, shape (candidates, units, p, ⌈t / 64⌉)
    patch: Int32  # indices of the inspectable patches among those of the run, ascending, shape (p,)
    grazing: Int32  # indices of the patches seen at a grazing angle, which are excluded, ascending
    # units that are not needed where fewer images than must show a defect are lit, shape (p,); None for none
    spare: UInt8 | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "patch", read_only(self.patch))
        object.__setattr__(self, "words", tuple(map(read_only, self.words)))

    @cached_property
    def planes(self) -> tuple[Words, Int64]:
        return weight_planes(self.defects)

    def rows(self, rows: Sequence[Int64]) -> "Visibility":
        """Some candidates of each light, given by ascending indices."""
        return replace(self, words=tuple(map(select_rows, self.words, rows)))

    def patches(self, start: int, end: int) -> "Visibility":
        words = tuple(layer[:, :, start:end] for layer in self.words)
        spare = None if self.spare is None else self.spare[start:end]
        return replace(self, words=words, patch=self.patch[start:end], spare=spare)

    @property
    def spare_flags(self) -> Words | None:
        """Flags of the spare units, alike for all defects, shape (units, p, ⌈t / 64⌉); None where there are none."""
        return None if self.spare is None else flags_alike(self.spare, self.words[0].shape[-1])

    @property
    def counted(self) -> tuple[Words, ...]:
        """The flags of each light, to be added up: those of the first light have the spare units, too."""
        spare, first = self.spare_flags, self.words[0]
        if spare is None:
            return self.words
        total = np.zeros((len(first), first.shape[1] + len(spare), *first.shape[2:]), np.uint64)
        total[:, : first.shape[1]] = first
        for counts in total:
            add_units(counts, spare)
        return total, *self.words[1:]

    def most_units(self, needed: int) -> Counts:
        """Units of evidence, up to `needed`, if each light takes for each defect the position that shows it best.

        Returns flags of shape (needed, p, words).
        """
        counts = np.zeros((needed, *self.words[0].shape[2:]), np.uint64)
        for layer in self.counted:
            add_units(counts, np.bitwise_or.reduce(layer, axis=0))
        return counts

    def weights(self, seen: Words) -> Int64:
        """Sum of the weights of the defects whose bits are set, shape (p,)."""
        return weighted_bits(seen, *self.planes)


def select_rows(layer: Any, some: Int64) -> Any:
    """Some rows of an array, ascending; a contiguous range without a copy."""
    if len(some) and some[-1] - some[0] == len(some) - 1:
        return layer[some[0] : some[-1] + 1]
    return layer[some]


@dataclass(frozen=True, kw_only=True)
class LevelThresholds:
    """Which delivered levels count as usable: ``shade ≤ level < saturation`` (paper, section 5.2, step 4).

    Raises InputError: No level is usable, or what is delivered without light would not be shaded.
    """

    shade: int  # levels below it are shaded [sensor level]
    saturation: int  # levels from it on are specular [sensor level]
    black: int = 0  # delivered without light; sums are of what is above it [sensor level]

    def __post_init__(self) -> None:
        if not 0 <= self.black <= self.shade < self.saturation:
            levels = f"black is {self.black}, shaded below {self.shade} and saturated from {self.saturation} on"
            raise InputError(f"thresholds: {levels}, which leaves none usable")

    @staticmethod
    def of_sensor(sensor: Sensor, *, shade_share: float) -> "LevelThresholds":
        """Thresholds of a sensor: shaded is what has less light than ``black + shade_share · full scale`` delivers.

        What is delivered without light is shaded whatever the share.
        """
        if not (math.isfinite(shade_share) and 0.0 <= shade_share <= 1.0):
            raise InputError(
                f"shade-below: expected a share of full scale from 0 to 1, such as 10/255, found {shade_share:g}"
            )
        # the least whole level that is not below the share; a share such as 10/255 must not round past its level
        shade = math.ceil(sensor.black_level + shade_share * sensor.max_level - 1e-9)
        black = math.floor(sensor.black_level + 0.5)
        return LevelThresholds(shade=max(shade, black + 1), saturation=math.ceil(sensor.saturated_from), black=black)


@dataclass(frozen=True, kw_only=True)
class LuminanceMatrix:
    """Delivered levels of the inspectable patches in one posture (paper, section 5.2, steps 1 and 2)."""

    levels: tuple[Levels, ...]  # of each light, at exposure 1 [sensor level], shape (candidates, p)
    areas: Float64  # of the patches [mm²], shape (p,)
    visibility: Visibility | None = None  # of defects; None where images are not tested for them
    grazing_mm2: float = 0.0  # area that the camera sees at a grazing angle, which is excluded [mm²]

    def __post_init__(self) -> None:
        for index, layer in enumerate(self.levels):
            if layer.ndim != 2 or layer.shape[1] != len(self.areas) or str(layer.dtype) not in ("uint8", "uint16"):
                raise InputError(
                    f"luminance matrix: light {index}: expected uint8 or uint16 of shape (candidates, "
                    f"{len(self.areas)}), found {layer.dtype} {layer.shape}"
                )
        object.__setattr__(self, "levels", tuple(map(read_only, self.levels)))
        object.__setattr__(self, "areas", read_only(self.areas))

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(layer) for layer in self.levels)

    def rows(self, rows: Sequence[Int64]) -> "LuminanceMatrix":
        levels, seen = tuple(map(select_rows, self.levels, rows)), self.visibility
        return replace(self, levels=levels, visibility=seen and seen.rows(rows))

    def combination(self, candidates: Sequence[int]) -> "LuminanceMatrix":
        return self.rows([np.array([index]) for index in candidates])

    def patches(self, start: int, end: int) -> "LuminanceMatrix":
        levels, seen = tuple(layer[:, start:end] for layer in self.levels), self.visibility
        return replace(self, levels=levels, areas=self.areas[start:end], visibility=seen and seen.patches(start, end))


def area_units(areas: Float64) -> Int64:
    """Areas [mm²] in whole units of :data:`AREA_UNIT_MM2`, shape (p,).

    Running sums are rounded, not single areas: any run of patches has its area to within one unit, so that patches far
    smaller than a unit still count, and patches that are split in place keep their sum.
    """
    ends = np.rint(np.cumsum(areas) / AREA_UNIT_MM2).astype(np.int64)
    return np.diff(ends, prepend=np.int64(0))


def usable_sums(layer: Levels, weights: Int64, thresholds: LevelThresholds) -> Int64:
    """Sum of a light's usable levels above black, each times its patch's weight, shape (candidates,)."""
    usable = ((row >= thresholds.shade) & (row < thresholds.saturation) for row in layer)
    pairs = zip(layer, usable, strict=True)
    return np.array([weights[some] @ (row[some] - np.int64(thresholds.black)) for row, some in pairs], np.int64)


@kernel
def level_range(layer: Levels, shade: int, saturation: int, start: int, end: int) -> tuple[Int64, Int64, Int64]:
    """Extremes of a light's levels over all its candidates, at the patches from `start` to `end`, each of shape (p,).

    Returns the greatest usable level (−1 where none is usable), the greatest and the least level.
    """
    usable = np.full(end - start, -1, np.int64)
    greatest = np.full(end - start, -1, np.int64)
    least = np.full(end - start, 1 << 16, np.int64)
    for a in range(len(layer)):
        for p in range(start, end):
            level = np.int64(layer[a, p])
            greatest[p - start] = max(greatest[p - start], level)
            least[p - start] = min(least[p - start], level)
            if shade <= level < saturation:
                usable[p - start] = max(usable[p - start], level)
    return usable, greatest, least
