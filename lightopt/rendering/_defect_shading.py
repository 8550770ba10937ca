"""The samples of an image that lie in defects, which are shaded again: with their own normals and reflectances.

Defects are microns deep. So a sample stays where it is, sees what it would see, and is in the shadows that it would be
in, on a surface without defects; only its normal, R_d, R_s and σ are others. Where a turned normal faces away from the
camera the sample keeps its diffuse light and has no highlight.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Index, Int32
from lightopt.defects import PlacedDefect, mark_surface
from lightopt.optics import Reflectance
from lightopt.rendering._surface import SurfacePoints


@dataclass(frozen=True, eq=False, kw_only=True)
class DefectSamples:
    """Samples of one reflectance that lie in defects, j of them."""

    index: Index  # of each among the samples of the surface, shape (j,)
    label: Int32  # index of the defect, shape (j,)
    surface: SurfacePoints  # the points with the normals of the disturbed surface
    reflectance: Reflectance  # of all of them


def defect_samples(
    defects: Sequence[PlacedDefect], surface: SurfacePoints, reflectances: Sequence[Reflectance]
) -> tuple[DefectSamples, ...]:
    """The samples of a surface that lie in defects, sorted by what they reflect; none without defects.

    reflectances: By the samples' materials
    """
    marks = mark_surface(defects, surface.points, surface.normals)
    if marks is None:
        return ()
    material = np.zeros(len(marks.index)) if surface.material is None else surface.material[marks.index]
    kinds = np.stack([material, marks.R_d_factor, marks.sigma_factor], axis=1)
    different, group = np.unique(kinds, axis=0, return_inverse=True)
    # the back of a face is black, and has no defects
    front = surface.front[marks.index]
    groups: list[DefectSamples] = []
    for number, (own_material, R_d_factor, sigma_factor) in enumerate(different.tolist()):
        own = np.flatnonzero((group.ravel() == number) & front)
        index, plain = marks.index[own], reflectances[int(own_material)]
        groups.append(
            DefectSamples(
                index=index,
                label=marks.label[own],
                surface=replace(surface.take(index), normals=marks.normals[own]),
                reflectance=plain.changed(R_d_factor=R_d_factor, sigma_factor=sigma_factor),
            )
        )
    return tuple(groups)
