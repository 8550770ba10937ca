"""Which way a surface is brushed: a field of directions in the part's frame, and the tangents across it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lightopt.core.arrays import Float64, Int32, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.vectors import dot, minus, scaled, vector_at

LEAST_SINE = 0.02
"""Sine of the angle between brushing and normal below which a point has no direction of brushing."""


class Brushing(Protocol):
    """A field of directions; their lengths and signs do not count."""

    def along(self, points: Float64) -> Float64:
        """Vectors along the brushing at points [mm], both of shape (k, 3); 0 where there is no direction."""
        ...

    def moved(self, rotation: Float64, translation: Float64, /) -> Brushing:
        """The field of a part after the rigid motion p' = R·p + t."""
        ...


@dataclass(frozen=True, eq=False)
class StraightBrushing:
    """Brushed along a line, as sheet metal is: a direction of shape (3,)."""

    direction: Float64

    def along(self, points: Float64) -> Float64:
        return np.broadcast_to(self.direction, points.shape)

    def moved(self, rotation: Float64, _translation: Float64) -> StraightBrushing:
        return StraightBrushing(rotation @ self.direction)


@dataclass(frozen=True, eq=False)
class RoundBrushing:
    """Brushed around an axis, as turned parts are: a point [mm] and a direction of it, shape (3,) each."""

    point: Float64
    axis: Float64

    def along(self, points: Float64) -> Float64:
        # none on the axis itself
        return np.cross(self.axis, points - self.point)

    def moved(self, rotation: Float64, translation: Float64) -> RoundBrushing:
        return RoundBrushing(rotation @ self.point + translation, rotation @ self.axis)


@dataclass(frozen=True, eq=False)
class CurvedBrushing:
    """Brushed along a curve, as it runs where it is nearest: its corners [mm], shape (n, 3), n ≥ 2.

    At a corner it runs half as before and half as after it, and turns evenly from one corner to the next.
    """

    corners: Float64

    def along(self, points: Float64) -> Float64:
        pieces = np.diff(self.corners, axis=0)
        pieces /= np.linalg.norm(pieces, axis=1, keepdims=True)
        at_corners = np.concatenate([pieces[:1], pieces[:-1] + pieces[1:], pieces[-1:]])
        # the curve may turn back on itself
        size = np.linalg.norm(at_corners, axis=1, keepdims=True)
        at_corners /= np.where(size > 0.0, size, 1.0)
        piece, share = _nearest_place(self.corners, np.ascontiguousarray(points))
        return (1.0 - share[:, None]) * at_corners[piece] + share[:, None] * at_corners[piece + 1]

    def moved(self, rotation: Float64, translation: Float64) -> CurvedBrushing:
        return CurvedBrushing(self.corners @ rotation.T + translation)


@kernel
def _nearest_place(corners: Float64, points: Float64) -> tuple[Int32, Float64]:
    # number of the nearest piece of a curve, and the share of it before the nearest place
    piece, share = np.zeros(len(points), np.int32), np.zeros(len(points))
    for i in range(len(points)):
        least = np.inf
        for j in range(len(corners) - 1):
            start = vector_at(corners, j)
            side, away = minus(vector_at(corners, j + 1), start), minus(vector_at(points, i), start)
            along = min(max(dot(away, side) / dot(side, side), 0.0), 1.0)
            left = minus(away, scaled(side, along))
            if dot(left, left) < least:
                piece[i], share[i], least = j, along, dot(left, left)
    return piece, share


def vectors_across(
    brushing: tuple[Brushing | None, ...], material: UInt8 | None, points: Float64, normals: Float64
) -> Float64:
    """Unit tangents across the brushing; 0 where nothing is brushed or the brushing has no direction; shape (k, 3).

    brushing: Of each material
    material: Number of each point's, shape (k,); None for number 0
    points, normals: [mm] and unit normals, shape (k, 3)
    """
    across = np.zeros(points.shape)
    for number, own in enumerate(brushing):
        if own is None:
            continue
        index = slice(None) if material is None else np.flatnonzero(material == number)
        along = own.along(points[index])
        size = np.linalg.norm(along, axis=1, keepdims=True)
        aside = np.cross(normals[index], along / np.where(size > 0.0, size, 1.0))
        sine = np.linalg.norm(aside, axis=1, keepdims=True)
        across[index] = np.where(sine >= LEAST_SINE, aside / np.maximum(sine, LEAST_SINE), 0.0)
    return across
