"""What the images of chosen lights, postures and exposures show of the part's surface, in one numbering of patches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import Posture
from lightopt.design.postures._counts import Counts, PairWeights, Words, counts_of_images
from lightopt.design.responses._defect_evaluation import Inspection
from lightopt.design.responses._luminance import MOST_BYTES, luminance_matrices, matrix_bytes
from lightopt.design.responses._luminance_matrix import LuminanceMatrix, area_units
from lightopt.geometry import RayCaster
from lightopt.rendering import PatchTable
from lightopt.scene import PanelLight, Scene

Int64 = NDArray[np.int64]

DRAWN_PATCHES = 20_000
"""Patches that stand for all where much is tried: turns of postures and lights, and what tolerances cost."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Survey:
    """A part, its patches, and what the images are looked at for.

    Attributes
    ----------
    scene
        Its lights do not matter.
    table
        The patches; their pairs with the trials are what is counted.
    caster
        Of the scene's part.
    inspection
        The trials, and when one is visible; None where levels alone are wanted.
    shadows
        Whether the part casts shadows on itself.
    threads
        All the machine's by default; the results do not depend on it.
    exposures
        That an image may be taken with: it shows what it shows with one of them.
    """

    scene: Scene
    table: PatchTable
    caster: RayCaster
    inspection: Inspection | None
    shadows: bool = True
    threads: int | None = None
    exposures: tuple[float, ...] = (1.0,)

    @cached_property
    def patches(self) -> NDArray[np.intp]:
        """Indices of the patches that are inspectable in one posture or more, ascending, shape (p,)."""
        return np.flatnonzero(self.table.inspectable_anywhere)

    @property
    def weights(self) -> PairWeights:
        """Weights of the pairs of these patches and the trials."""
        assert self.inspection is not None
        units = area_units(self.table.patches.areas[self.patches])
        return PairWeights.of_trials(self.inspection.trials, units)

    def table_of(self, postures: Sequence[Posture]) -> PatchTable:
        """The same patches in some of the postures."""
        rows = [self.table.postures.index(posture) for posture in postures]
        table = self.table
        visible, grazing = table.visible[rows], table.grazing[rows]
        return replace(table, postures=tuple(postures), visible=visible, grazing=grazing)

    def matrices(
        self,
        posture: Posture,
        panels: Sequence[Sequence[PanelLight]],
        *,
        exposures: Sequence[float] = (1.0,),
        progress: Callable[[float, int], None] | None = None,
    ) -> tuple[LuminanceMatrix, ...]:
        """Levels and visible trials of a posture's images under places of each light, one matrix per exposure."""
        return luminance_matrices(
            self.scene,
            self.table,
            posture,
            panels,
            exposures=exposures,
            caster=self.caster,
            inspection=self.inspection,
            shadows=self.shadows,
            threads=self.threads,
            progress=progress,
        )

    def places_at_once(self, posture: Posture, exposures: Sequence[float]) -> int:
        """How many places of lights :meth:`matrices` has room for."""
        seen = len(self.table.inspectable(posture))
        return max(1, MOST_BYTES // max(1, matrix_bytes(self.scene, seen, len(exposures), self.inspection)))

    def in_pieces(
        self, posture: Posture, places: Sequence[PanelLight], *, exposures: Sequence[float] = (1.0,)
    ) -> Iterator[tuple[LuminanceMatrix, ...]]:
        """As :meth:`matrices` of one light, of as many of its places at a time as there is room for."""
        # what was given out before is held while the next is made
        most = max(1, self.places_at_once(posture, exposures) // 2)
        if len(places) <= 2 * most:
            most = len(places)
        for start in range(0, len(places), most):
            yield self.matrices(posture, [places[start : start + most]], exposures=exposures)

    def flags(self, posture: Posture, panels: Sequence[Sequence[PanelLight]]) -> tuple[Words, ...]:
        """Which pairs the images show: of each light an array of shape (places, p, words)."""
        patches = self.patches
        if sum(map(len, panels)) <= self.places_at_once(posture, self.exposures):
            matrices = self.matrices(posture, panels, exposures=self.exposures)
            return tuple(
                np.stack(
                    [scattered_flags(matrices, patches, light=light, place=at) for at in range(len(some))]
                )
                for light, some in enumerate(panels)
            )
        return tuple(
            np.stack(
                [
                    scattered_flags(matrices, patches, light=0, place=at)
                    for matrices in self.in_pieces(posture, some, exposures=self.exposures)
                    for at in range(len(matrices[0].levels[0]))
                ]
            )
            for some in panels
        )

    def counts(self, posture: Posture, panels: Sequence[PanelLight], *, least: int) -> Counts:
        """In how many images of a posture, one of each light where it stands, each pair is seen, up to `least`."""
        images = self.flags(posture, [[panel] for panel in panels])
        return counts_of_images([layer[0] for layer in images], least)


def scattered_flags(
    matrices: Sequence[LuminanceMatrix], patches: NDArray[np.intp], *, light: int, place: int
) -> Words:
    """An image's visible trials in another numbering of the patches, shape (p, words).

    Parameters
    ----------
    matrices
        With visibility, of some of the patches; one for each exposure of the image, which shows what one of them does.
    patches
        Ascending indices of the patches that count, shape (p,).
    light, place
        Of the image.
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
    """Some of the patches for all, every part of the surface by its area: the others are seen from nowhere.

    Along the running sum of the inspectable patches' areas a mark stands at every so much area; a patch with marks
    stands for as much area as it has marks. The order of patches is that of the mesh, so that marks spread over the
    surface.

    Parameters
    ----------
    table
        All patches.
    count
        Number of marks; with as many inspectable patches or fewer, all stay as they are.
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
    return replace(
        table,
        patches=replace(table.patches, areas=drawn),
        visible=table.visible & chosen,
    )
