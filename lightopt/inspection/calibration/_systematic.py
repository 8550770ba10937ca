"""Systematic deviations: common deviations of good parts from the model, learned place by place."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Int32, UInt8
from lightopt.defects import SCALES_PX
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._residual_score import smoothed_deviations
from lightopt.inspection.prediction._posture_view import PostureView

LEAST_SHARE = 0.5  # at least this share of the good sets must show a pixel, else nothing is learned of it

# the spread of a pixel is that of its surroundings, Gaussian of this width: few sets determine little of one pixel
POOLED_PX = 3.0

GREATEST_Z = 100.0  # deviations are clipped here: a single outlier does not outweigh the other sets


@dataclass(frozen=True, kw_only=True)
class SystematicDeviations:
    """Common deviations of good parts, in the image of the part at its nominal placement."""

    mean: Float32  # of the deviations of good parts, in standard deviations of the noise model, shape (lights, H, W)
    # by how much sums of deviations scatter around that more than noise makes them, at least 1, same shape
    spread: Float32

    def where_known(self) -> "SystematicDeviations":
        """The same, with a mean of NaN where too few sets show a place, and only there the spread is 1."""
        return replace(self, mean=np.where(self.spread > 1.0, self.mean, np.float32(np.nan)))


@dataclass(frozen=True)
class PackedDeviations:
    """Deviations of one set in one posture, at the evaluable pixels: small enough to store those of all sets."""

    shape: tuple[int, int]
    # flat index of each pixel in the set's images, and in those of the part where its file has it (−1 outside of them),
    # shape (n,)
    own: Int32
    nominal: Int32
    z: NDArray[np.float16]  # shape (lights, n)
    usable: UInt8  # bits along the second axis, shape (lights, n / 8)
    lit: UInt8
    correlation: float = 0.0

    @staticmethod
    def of(found: Deviations, nominal: Int32, *, greatest: float = GREATEST_Z) -> "PackedDeviations":
        """Those of a posture up to the `greatest`, `nominal` from :func:`nominal_pixels`."""
        own = np.flatnonzero(found.usable.any(axis=0)).astype(np.int32)
        lights, rows, columns = found.z.shape
        z = np.clip(found.z.reshape(lights, -1)[:, own], -greatest, greatest)
        usable, lit = (np.packbits(flags.reshape(lights, -1)[:, own], axis=1) for flags in (found.usable, found.lit))
        packed = z.astype(np.float16)
        return PackedDeviations((rows, columns), own, nominal.ravel()[own], packed, usable, lit, found.correlation)

    def at_pixels(self, to: Int32) -> Deviations:
        """In an image that has them at the pixels `own` or `nominal`; scales are not stored."""
        which, whole = to >= 0, (len(self.z), *self.shape)

        def image(values: NDArray[Any]) -> NDArray[Any]:
            flat = np.zeros((len(values), self.shape[0] * self.shape[1]), values.dtype)
            flat[:, to[which]] = values[:, which]
            return flat.reshape(whole)

        usable, lit = (np.unpackbits(bits, axis=1, count=len(to)).astype(np.bool_) for bits in (self.usable, self.lit))
        z = np.where(usable, self.z, 0.0).astype(np.float32)
        return Deviations(image(z), np.ones(whole, np.float32), image(usable), image(lit), self.correlation)

    def nominal_image(self) -> Int32:
        """Flat index as :func:`nominal_pixels` gives it, shape (H, W); −1 where nothing was usable."""
        height, width = self.shape
        index = np.full(height * width, -1, np.int32)
        index[self.own] = self.nominal
        return index.reshape(height, width)


def subtract_systematic(found: Deviations, systematic: SystematicDeviations, nominal: Int32) -> Deviations:
    """Deviations without the common deviations of good parts in that posture, under the same lights."""
    z = np.where(found.usable, found.z - _at_pixels(systematic.mean, nominal, 0.0), np.float32(0.0))
    return divide_spread(replace(found, z=z), systematic, nominal)


def subtract_mean(found: Deviations, systematic: SystematicDeviations, nominal: Int32) -> Deviations:
    """Deviations from the mean of good parts; a place that has none, from :meth:`where_known`, is not usable."""
    off = found.z - _at_pixels(systematic.mean, nominal, np.nan)
    usable = found.usable & np.isfinite(off)
    return replace(found, z=np.where(usable, off, np.float32(0.0)), usable=usable, lit=found.lit & usable)


def divide_spread(found: Deviations, systematic: SystematicDeviations, nominal: Int32) -> Deviations:
    """Deviations in units of the scatter of good parts."""
    spread = _at_pixels(systematic.spread, nominal, 1.0)
    return replace(found, z=found.z / spread, scale=found.scale * spread)


def learned_view(view: PostureView, found: Deviations, systematic: SystematicDeviations, nominal: Int32) -> PostureView:
    """A view with the levels of good parts, given the deviations `found` from the model."""
    level = view.predicted + np.nan_to_num(_at_pixels(systematic.mean, nominal, 0.0)) * found.scale
    return replace(view, predicted=np.where(view.predicted > 0.0, np.maximum(level, np.float32(1e-6)), np.float32(0.0)))


def _at_pixels(images: Float32, nominal: Int32, unknown: float) -> Float32:
    # images of the part at its nominal placement, at the pixels of a set
    known = nominal >= 0
    values = images.reshape(len(images), -1)[:, np.where(known, nominal, 0)]
    return np.where(known, values, np.float32(unknown))


class SystematicSums:
    """Sums over good sets, from which their common deviations follow, with or without one of them."""

    def __init__(self) -> None:
        self.sets = 0
        self._sums: list[Float32] = []  # of counts, of deviations, and by scale of their sums and these squared

    def add(self, one: PackedDeviations) -> None:
        self._sums = self._with(one, 1.0)
        self.sets += 1

    def systematic(self, *, but: PackedDeviations | None = None) -> SystematicDeviations:
        """The common deviations of the sets, without `but`, a set that was added."""
        sets = self.sets if but is None else self.sets - 1
        count, total, *by_scale = self._sums if but is None else self._with(but, -1.0)
        sums, squares = by_scale[: len(SCALES_PX)], by_scale[len(SCALES_PX) :]
        known = count >= max(2.0, LEAST_SHARE * sets)
        n = np.where(known, count, 2.0)
        variance = np.zeros_like(total)
        for own, square in zip(sums, squares, strict=True):
            scatter = (np.maximum(square - own * own / n, 0.0) / (n - 1.0)).astype(np.float32)
            np.maximum(variance, _around(scatter, known), out=variance)
        # of the mean of so many sets, too
        spread = np.sqrt(np.maximum(variance, 1.0) * (1.0 + 1.0 / n))
        return SystematicDeviations(
            mean=np.where(known, total / n, 0.0).astype(np.float32),
            spread=np.where(known, spread, 1.0).astype(np.float32),
        )

    def _with(self, one: PackedDeviations, sign: float) -> list[Float32]:
        found = one.at_pixels(one.nominal)
        smooth = [smoothed_deviations(found, scale)[0] for scale in SCALES_PX]
        new = [found.usable.astype(np.float32), found.z, *smooth, *(np.square(s) for s in smooth)]
        return [a + np.float32(sign) * b for a, b in zip(self._sums, new, strict=True)] if self._sums else new


def _around(values: Float32, mask: Bool) -> Float32:
    # mean of the surroundings of each pixel, light by light
    result = np.zeros_like(values)
    for i, (own, known) in enumerate(zip(values, mask, strict=True)):
        share = ndimage.gaussian_filter(known.astype(np.float32), POOLED_PX)
        result[i] = ndimage.gaussian_filter(np.where(known, own, 0.0), POOLED_PX) / np.maximum(share, 1e-3)
    return result
