"""Which pairs of patch and defect are shown by images with given lights, postures and exposures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lightopt.core.arrays import Index
from lightopt.core.transforms import Posture
from lightopt.design.postures._counts import Counts, PairWeights, counts_of_images
from lightopt.design.responses._detection import DetectionModel
from lightopt.design.responses._luminance_matrix import LuminanceMatrix, area_units
from lightopt.design.responses._matrix_computation import MOST_BYTES, luminance_matrices, matrix_bytes
from lightopt.design.responses._packed_bits import Words
from lightopt.geometry import RayCaster
from lightopt.rendering import PatchTable
from lightopt.scene import PanelLight, Scene

DRAWN_PATCHES = 20_000
"""Patches that represent all where much is tried: the first iterations of the search, and tolerances."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ImageEvaluator:
    """A part, its patches, and the defects that its images are tested for.

    scene: Its lights are ignored.
    table: The patches; their pairs with the hypotheses are counted.
    detection: The hypotheses, and when one is visible; None where levels alone are wanted.
    shadows: Whether the part casts shadows on itself.
    exposures: That an image may be taken with: it shows what it shows with any of them.
    """

    scene: Scene
    table: PatchTable
    caster: RayCaster
    detection: DetectionModel | None
    shadows: bool = True
    threads: int | None = None
    exposures: tuple[float, ...] = (1.0,)

    @cached_property
    def patches(self) -> Index:
        """Indices of the patches that are inspectable in one posture or more, ascending, shape (p,)."""
        return np.flatnonzero(self.table.inspectable_anywhere)

    @property
    def weights(self) -> PairWeights:
        """Weights of the pairs of these patches and the hypotheses."""
        assert self.detection is not None
        units = area_units(self.table.patches.areas[self.patches])
        return PairWeights.of_hypotheses(self.detection.hypotheses, units)

    def table_of(self, postures: Sequence[Posture]) -> PatchTable:
        """The same patches in some of the postures."""
        rows = [self.table.postures.index(posture) for posture in postures]
        table = self.table
        visible, grazing = table.visible[rows], table.grazing[rows]
        return replace(table, postures=tuple(postures), visible=visible, grazing=grazing)

    def matrices(
        self, posture: Posture, panels: Sequence[Sequence[PanelLight]], *, exposures: Sequence[float] = (1.0,)
    ) -> tuple[LuminanceMatrix, ...]:
        """Levels and visible hypotheses of a posture's images for all positions of each light, per exposure."""
        return luminance_matrices(
            self.scene,
            self.table,
            posture,
            panels,
            exposures=exposures,
            caster=self.caster,
            detection=self.detection,
            shadows=self.shadows,
            threads=self.threads,
        )

    def positions_at_once(self, posture: Posture, exposures: Sequence[float]) -> int:
        """How many positions of lights :meth:`matrices` has memory for."""
        seen = len(self.table.inspectable(posture))
        return max(1, MOST_BYTES // max(1, matrix_bytes(self.scene, seen, len(exposures), self.detection)))

    def in_batches(
        self, posture: Posture, places: Sequence[PanelLight], *, exposures: Sequence[float] = (1.0,)
    ) -> Iterator[tuple[LuminanceMatrix, ...]]:
        """As :meth:`matrices` of one light, for as many of its positions at a time as memory allows."""
        # what was given out before is held while the next is made
        most = max(1, self.positions_at_once(posture, exposures) // 2)
        if len(places) <= 2 * most:
            most = len(places)
        for start in range(0, len(places), most):
            yield self.matrices(posture, [places[start : start + most]], exposures=exposures)

    def flags(self, posture: Posture, panels: Sequence[Sequence[PanelLight]]) -> tuple[Words, ...]:
        """Which pairs the images show: of each light an array of shape (positions, p, words)."""
        patches = self.patches
        if sum(map(len, panels)) <= self.positions_at_once(posture, self.exposures):
            matrices = self.matrices(posture, panels, exposures=self.exposures)
            return tuple(
                np.stack([scattered_flags(matrices, patches, light=light, place=at) for at in range(len(some))])
                for light, some in enumerate(panels)
            )
        return tuple(
            np.stack(
                [
                    scattered_flags(matrices, patches, light=0, place=at)
                    for matrices in self.in_batches(posture, some, exposures=self.exposures)
                    for at in range(len(matrices[0].levels[0]))
                ]
            )
            for some in panels
        )

    def counts(self, posture: Posture, panels: Sequence[PanelLight], *, min_images: int) -> Counts:
        """In how many images of a posture, one of each light, each pair is seen, up to `min_images`."""
        images = self.flags(posture, [[panel] for panel in panels])
        return counts_of_images([layer[0] for layer in images], min_images)


def scattered_flags(matrices: Sequence[LuminanceMatrix], patches: Index, *, light: int, place: int) -> Words:
    """An image's visible hypotheses in another numbering of the patches, shape (p, words).

    `matrices` have the visibility of some of the patches, one for each exposure of the image, which shows what any of
    them shows. `patches` are the ascending indices of the patches that count, shape (p,).
    """
    first = matrices[0].visibility
    assert first is not None
    flags = np.zeros((len(patches), first.words[light].shape[2]), np.uint64)
    rows = np.searchsorted(patches, first.patch)
    for matrix in matrices:
        assert matrix.visibility is not None
        flags[rows] |= matrix.visibility.words[light][place]
    return flags


def drawn_patches(table: PatchTable, count: int) -> PatchTable:
    """A sample of the patches, every part of the surface by its area; the others become invisible.

    Along the running sum of the inspectable patches' areas, `count` marks stand at equal distances; a patch with marks
    represents their share of the area. The order of patches is that of the mesh, so that marks spread over the surface.
    With `count` inspectable patches or fewer, all stay as they are.
    """
    seen = np.flatnonzero(table.inspectable_anywhere)
    if len(seen) <= count:
        return table
    areas = table.patches.areas[seen]
    each = areas.sum() / count
    ends = np.floor(np.cumsum(areas) / each + 0.5)
    marks = np.diff(ends, prepend=0.0)
    chosen = np.zeros(len(table.patches), np.bool_)
    chosen[seen[marks > 0.0]] = True
    drawn = np.zeros(len(table.patches))
    drawn[seen] = marks * each
    return replace(table, patches=replace(table.patches, areas=drawn), visible=table.visible & chosen)
