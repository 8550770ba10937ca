"""Defects on noisy images: the pixels that each touches, and their levels without and with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pieces import Piece, piece_of

from lightopt.core.transforms import Posture
from lightopt.defects import PlacedDefect
from lightopt.geometry import Patches, RayCaster
from lightopt.scene import PartView, Scene, pixel_footprint, project, view_from_part

__all__ = ["Touched", "touched"]

Float64 = NDArray[np.float64]

AT_ONCE = 200_000
"""Rays that are traced at once."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Touched:
    """Pixels of a posture's image that touch defects, n of them.

    Attributes
    ----------
    posture
        Of the part.
    defect
        Index of the defect, shape (n,).
    patch
        That the pixel's centre sees, shape (n,).
    wall
        To which of the eight directions the surface leans there where it has its steepest slope; −1 elsewhere, 0 for
        stains and hazes; shape (n,).
    """

    posture: Posture
    defect: NDArray[np.intp]
    patch: NDArray[np.int32]
    wall: NDArray[np.int32]
    pieces: tuple[Piece, ...]

    def levels(self, scene: Scene, caster: RayCaster) -> tuple[Float64, Float64]:
        """Levels without and with the defects under each light of a scene [grey level], shape (lights, n) each."""
        lights = view_from_part(scene, self.posture).lights
        both = [[piece.levels(scene, panel, caster) for piece in self.pieces] for panel in lights]
        good, bad = (np.stack([np.concatenate([one[which] for one in light]) for light in both]) for which in (0, 1))
        return good, bad


def touched(
    scene: Scene,
    posture: Posture,
    defects: Sequence[PlacedDefect],
    *,
    caster: RayCaster,
    patches: Patches,
    samples: int = 1,
    thin_from_px: float = math.inf,
    stretch_px: float = math.inf,
) -> Touched:
    """Trace the defects' pixels, n × n rays each.

    Parameters
    ----------
    scene, posture
        What is looked at.
    defects
        Part frame.
    caster, patches
        Of the part.
    samples
        n.
    thin_from_px
        Of defects of this width and more only every second pixel of every second row.
    stretch_px
        Of each defect only the pixels that are no further along it from its middle.
    """
    view = view_from_part(scene, posture)
    pieces = tuple(
        piece_of(scene, view, defects, pixels, labels, caster, patches, samples, stretch_px)
        for pixels, labels in _around(view, defects, thin_from_px, stretch_px, max(1, AT_ONCE // samples**2))
    )
    return Touched(
        posture=posture,
        defect=np.concatenate([p.defect for p in pieces]),
        patch=np.concatenate([p.patch for p in pieces]),
        wall=np.concatenate([p.wall for p in pieces]),
        pieces=pieces,
    )


def _around(
    view: PartView, defects: Sequence[PlacedDefect], thin_from_px: float, stretch_px: float, at_once: int
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    # pixels (column, row) around each defect, and whose they are
    camera = view.camera
    pixels: list[NDArray[np.intp]] = [np.zeros((0, 2), np.intp)]
    labels: list[NDArray[np.intp]] = [np.zeros(0, np.intp)]
    for index, defect in enumerate(defects):
        column, row, depth = (float(x[0]) for x in project(camera, defect.position[None]))
        footprint = pixel_footprint(camera, depth)
        wide = 0.5 * defect.shape.width / footprint
        half = math.ceil(min(defect.reach / footprint, stretch_px + 1.0 + wide))
        step = 2 if defect.shape.width >= thin_from_px * footprint else 1
        columns, rows = np.meshgrid(
            np.arange(int(column) - half, int(column) + half + 1, step),
            np.arange(int(row) - half, int(row) + half + 1, step),
        )
        inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        pixels.append(np.stack([columns[inside], rows[inside]], axis=1))
        labels.append(np.full(int(inside.sum()), index))
    everything, owners = np.concatenate(pixels), np.concatenate(labels)
    for start in range(0, max(1, len(owners)), at_once):
        yield everything[start : start + at_once], owners[start : start + at_once]
