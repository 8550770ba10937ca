"""Systematic deviations: what good parts have in common and the model lacks, learned place by place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._score import SCALES_PX, smoothed_deviations

Float32 = NDArray[np.float32]
Bool = NDArray[np.bool_]

LEAST_SHARE = 0.5
"""Of the good sets so many must tell of a pixel, else nothing is learned of it."""

POOLED_PX = 3.0
"""The spread of a pixel is that of its surroundings, Gaussian of this width: few sets tell little of one pixel."""

GREATEST_Z = 100.0
"""Deviations beyond this say no more; a single wild pixel does not drown what the other sets say."""


@dataclass(frozen=True, kw_only=True)
class Systematic:
    """What good parts have in common, in the image of the part where its file has it.

    Attributes
    ----------
    mean
        Of the deviations of good parts, in standard deviations of the noise model, shape (lights, H, W).
    spread
        By how much sums of deviations scatter around that more than noise makes them, at least 1, same shape.
    """

    mean: Float32
    spread: Float32


@dataclass(frozen=True)
class Residuals:
    """Deviations of one set in one posture, at the pixels that can be judged: small enough to keep those of all sets.

    Attributes
    ----------
    shape
        Of the images.
    own, nominal
        Flat index of each pixel in the set's images, and in those of the part where its file has it (−1 outside of
        them), shape (n,).
    z
        float16, shape (lights, n).
    usable, lit
        Same shape.
    """

    shape: tuple[int, int]
    own: NDArray[np.int32]
    nominal: NDArray[np.int32]
    z: NDArray[np.float16]
    usable: Bool
    lit: Bool

    @staticmethod
    def of(found: Deviations, nominal: NDArray[np.int32]) -> Residuals:
        """Those of a posture, `nominal` from :func:`nominal_pixels`."""
        own = np.flatnonzero(found.usable.any(axis=0)).astype(np.int32)
        lights, rows, columns = found.z.shape
        z = np.clip(found.z.reshape(lights, -1)[:, own], -GREATEST_Z, GREATEST_Z)
        usable, lit = (flags.reshape(lights, -1)[:, own] for flags in (found.usable, found.lit))
        return Residuals((rows, columns), own, nominal.ravel()[own], z.astype(np.float16), usable, lit)

    def in_own_image(self) -> Deviations:
        """As they were, scales apart."""
        return self._spread_out(self.own, np.ones(len(self.own), np.bool_))

    def in_nominal_image(self) -> Deviations:
        """Each at the pixel that shows its place where the part's file has it."""
        return self._spread_out(self.nominal, self.nominal >= 0)

    def _spread_out(self, to: NDArray[np.int32], kept: Bool) -> Deviations:
        flat = (len(self.z), self.shape[0] * self.shape[1])
        z = np.zeros(flat, np.float32)
        usable, lit = np.zeros(flat, np.bool_), np.zeros(flat, np.bool_)
        z[:, to[kept]] = np.where(self.usable, self.z, 0.0)[:, kept]
        usable[:, to[kept]] = self.usable[:, kept]
        lit[:, to[kept]] = self.lit[:, kept]
        whole = (len(self.z), *self.shape)
        return Deviations(
            z.reshape(whole), np.ones(whole, np.float32), usable.reshape(whole), lit.reshape(whole)
        )

    def nominal_image(self) -> NDArray[np.int32]:
        """Flat index as :func:`nominal_pixels` gives it, shape (H, W); −1 where nothing was usable."""
        height, width = self.shape
        index = np.full(height * width, -1, np.int32)
        index[self.own] = self.nominal
        return index.reshape(height, width)


def without_systematic(found: Deviations, systematic: Systematic, nominal: NDArray[np.int32]) -> Deviations:
    """Deviations of which what good parts have in common is taken out.

    Parameters
    ----------
    found
        Of a posture.
    systematic
        Of good parts in that posture, under the same lights.
    nominal
        From :func:`nominal_pixels`.
    """
    known = nominal >= 0
    at = np.where(known, nominal, 0)
    lights = len(found.z)
    mean = np.where(known, systematic.mean.reshape(lights, -1)[:, at], np.float32(0.0))
    spread = np.where(known, systematic.spread.reshape(lights, -1)[:, at], np.float32(1.0))
    z = np.where(found.usable, (found.z - mean) / spread, np.float32(0.0))
    return Deviations(z, found.scale * spread, found.usable, found.lit)


class SystematicSums:
    """Sums over good sets, from which what they have in common follows, with or without one of them."""

    def __init__(self) -> None:
        self.sets = 0
        self._count: Float32 | None = None
        self._total: Float32 | None = None
        self._sums: list[Float32] = []
        self._squares: list[Float32] = []

    def add(self, one: Residuals) -> None:
        """Count a set in."""
        self._count, self._total, self._sums, self._squares = self._with(one, 1.0)
        self.sets += 1

    def systematic(self, *, but: Residuals | None = None) -> Systematic:
        """What the sets have in common.

        Parameters
        ----------
        but
            A set that was added and does not count.
        """
        if but is None:
            sets, (count, total, sums, squares) = self.sets, self._state()
        else:
            sets, (count, total, sums, squares) = self.sets - 1, self._with(but, -1.0)
        known = count >= max(2.0, LEAST_SHARE * sets)
        n = np.where(known, count, 2.0)
        variance = np.zeros_like(total)
        for own, square in zip(sums, squares, strict=True):
            scatter = (np.maximum(square - own * own / n, 0.0) / (n - 1.0)).astype(np.float32)
            np.maximum(variance, _around(scatter, known), out=variance)
        # of the mean of so many sets, too
        spread = np.sqrt(np.maximum(variance, 1.0) * (1.0 + 1.0 / n))
        return Systematic(
            mean=np.where(known, total / n, 0.0).astype(np.float32),
            spread=np.where(known, spread, 1.0).astype(np.float32),
        )

    def _state(self) -> tuple[Float32, Float32, list[Float32], list[Float32]]:
        assert self._count is not None
        assert self._total is not None
        return self._count, self._total, self._sums, self._squares

    def _with(self, one: Residuals, sign: float) -> tuple[Float32, Float32, list[Float32], list[Float32]]:
        found = one.in_nominal_image()
        smooth = [smoothed_deviations(found, scale)[0] for scale in SCALES_PX]
        new = (
            found.usable.astype(np.float32),
            found.z,
            smooth,
            [np.square(s) for s in smooth],
        )
        if self._count is None:
            return new
        count, total, sums, squares = self._state()
        factor = np.float32(sign)
        return (
            count + factor * new[0],
            total + factor * new[1],
            [a + factor * b for a, b in zip(sums, new[2], strict=True)],
            [a + factor * b for a, b in zip(squares, new[3], strict=True)],
        )


def _around(values: Float32, mask: Bool) -> Float32:
    # mean of the surroundings of each pixel, light by light
    result = np.zeros_like(values)
    for i, (own, known) in enumerate(zip(values, mask, strict=True)):
        share = ndimage.gaussian_filter(known.astype(np.float32), POOLED_PX)
        result[i] = ndimage.gaussian_filter(np.where(known, own, 0.0), POOLED_PX) / np.maximum(share, 1e-3)
    return result
