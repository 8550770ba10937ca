"""The samples of an image that are shaded again, with their own normals or reflectances: in defects and in regions.

Defects are microns deep. So a sample stays where it is, sees what it would see, and is in the shadows that it would be
in, on a surface without defects; only its normal, R_d, R_s and σ are others. Where a turned normal faces away from the
camera the sample keeps its diffuse light and has no highlight.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64, Index, Int32
from lightopt.defects import PlacedDefect, mark_surface
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight
from lightopt.optics import Reflectance
from lightopt.rendering._converged_panel import ConvergedPanel, PanelVisibility, shade_changed_points, shade_light
from lightopt.rendering._surface import SurfacePoints


@dataclass(frozen=True, eq=False, kw_only=True)
class ChangedSamples:
    """Samples of one reflectance that lie in defects or in a region of the part, j of them.

    index: Of each among the samples of the surface, shape (j,)
    label: Index of the defect, shape (j,); −1 for none
    surface: The points with the normals of the disturbed surface
    reflectance: Of all of them
    """

    index: Index
    label: Int32
    surface: SurfacePoints
    reflectance: Reflectance

    def light(
        self,
        panel: PanelLight | ConvergedPanel,
        visibility: PanelVisibility | None,
        *,
        sample: Index,
        shape: tuple[int, int],
        caster: RayCaster | None,
    ) -> tuple[Float64, Float64]:
        """Diffuse and specular levels under a panel [grey level], two arrays of shape (j,).

        panel: Part frame
        visibility: What the surface without defects sees of a converged panel, from :func:`shade_converged`
        sample, shape: As :func:`shade_converged` takes them, of all samples of the surface
        """
        r = self.reflectance
        if isinstance(panel, ConvergedPanel):
            assert visibility is not None
            diffuse, specular = shade_changed_points(
                self.surface,
                panel,
                index=self.index,
                visibility=visibility,
                sample=sample,
                shape=shape,
                reflectance=r,
                caster=caster,
            )
        else:
            diffuse, specular = shade_light(self.surface, panel, reflectance=r, caster=caster)
        return r.R_d * diffuse, r.R_s * specular


def changed_samples(
    defects: Sequence[PlacedDefect], surface: SurfacePoints, reflectances: Sequence[Reflectance]
) -> tuple[ChangedSamples, ...]:
    """The samples of a surface that lie in defects or are not of material 0, sorted by what they reflect."""
    marks = mark_surface(defects, surface.points, surface.normals)
    if marks is None and surface.material is None:
        return ()
    count = len(surface)
    normals, label = surface.normals, np.full(count, -1, np.int32)
    kind, different = np.zeros((count, 3)), np.zeros(count, np.bool_)
    kind[:, 1:] = 1.0
    if marks is not None:
        normals = normals.copy()
        normals[marks.index], label[marks.index], different[marks.index] = marks.normals, marks.label, True
        kind[marks.index, 1:] = np.stack([marks.R_d_factor, marks.sigma_factor], axis=1)
    if surface.material is not None:
        kind[:, 0] = surface.material
        different |= surface.material > 0
    # the back of a face is black, and has no defects
    index = np.flatnonzero(different & surface.front)
    own_kinds, group = np.unique(kind[index], axis=0, return_inverse=True)
    groups: list[ChangedSamples] = []
    for number, (material, R_d_factor, sigma_factor) in enumerate(own_kinds.tolist()):
        own = index[group.ravel() == number]
        plain = reflectances[int(material)]
        groups.append(
            ChangedSamples(
                index=own,
                label=label[own],
                surface=replace(surface.take(own), normals=normals[own]),
                reflectance=plain.changed(R_d_factor=R_d_factor, sigma_factor=sigma_factor),
            )
        )
    return tuple(groups)
