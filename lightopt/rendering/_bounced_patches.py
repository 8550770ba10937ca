"""Light of the part on itself at patches: worked out at some of them, each of which stands for those around it.

An image has a level for each pixel (:mod:`lightopt.rendering._bounced_images`). Plans look at many images, and want to
know where the part's light saturates them and adds noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from lightopt.core.arrays import Float64, Index
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight
from lightopt.rendering._bounced_images import ALIKE
from lightopt.rendering._caustics import ENOUGH, landed_light
from lightopt.rendering._interreflection import PartLight
from lightopt.rendering._patches import marks_by_area
from lightopt.rendering._surface import SurfacePoints
from lightopt.scene import PartView, Scene

MOST = 4_000  # patches at which it is worked out
SPACINGS_PER_RAD = 10.0  # a turn of the normal is as far as so many spacings of these
LANDED_RAYS = 1 << 16  # of each light
OF_NEAR = 2.0  # greatest error of the pixels around one, in its own: what an inspection takes
REACH = 2.0  # sides of a patch, within which light that lands belongs to it


@dataclass(frozen=True, eq=False)
class BouncedPatches:
    """The patches that the camera sees in a posture, and the part's light on them."""

    scene: Scene
    view: PartView  # whose housings are mirrored
    surface: SurfacePoints  # k patches, part frame
    areas: Float64  # [mm²], shape (k,)
    caster: RayCaster
    shadows: bool = True

    def levels(self, light: PanelLight, threads: int | None = None) -> Float64:
        """What light from the part, or its surroundings, adds under a light, and the error of that, shape (2, k).

        In grey levels; the error is that of :class:`lightopt.rendering.LightImage`.

        light: Part frame
        """
        if not len(self.surface):
            return np.zeros((2, 0))
        part = PartLight.of_scene(self.scene, (light,), self.caster, housings=self.view.housings, shadows=self.shadows)
        some = self.surface.take(self._chosen)
        part.map_blockers(len(some), threads)
        added, error = np.zeros((2, len(some)))
        for means, own, glints in (part.diffuse(some, threads)[:, 0], part.specular(some, threads)[:, 0]):
            added += means + glints.mean()
            error = np.hypot(error, OF_NEAR * own)
        for landed in landed_light(part, self.view.camera.position, LANDED_RAYS, threads):
            away, patch = _nearest_of(self._tree, landed.points)
            near = away <= REACH * np.sqrt(self.areas[patch])
            alike = np.einsum("ij,ij->i", landed.facets, self.surface.facets[patch]) > 0.0
            own = np.flatnonzero(near & alike)
            caustics = np.bincount(self._nearest[patch[own]], landed.light[own], len(added)) / self._areas
            added, error = added + caustics, np.hypot(error, caustics / math.sqrt(ENOUGH))
        return np.stack([added, ALIKE * error])[:, self._nearest]

    @cached_property
    def _chosen(self) -> Index:
        # every part of the surface by its area, in the order of the mesh
        if len(self.areas) <= MOST:
            return np.arange(len(self.areas))
        return np.flatnonzero(marks_by_area(self.areas, MOST) > 0.0)

    @cached_property
    def _nearest(self) -> Index:
        # of each patch the place in `_chosen` of the one that stands for it
        surface, spacing = self.surface, np.sqrt(self.areas.sum() / max(1, len(self._chosen)))
        places = [surface.points / spacing, SPACINGS_PER_RAD * surface.normals]
        if surface.material is not None:
            places.append(1e3 * surface.material[:, None].astype(np.float64))
        stacked = np.concatenate(places, axis=1)
        return _nearest_of(KDTree(stacked[self._chosen]), stacked)[1]

    @cached_property
    def _areas(self) -> Float64:
        # what stands for nothing lies where another one does, and shows no light
        return np.maximum(np.bincount(self._nearest, self.areas, len(self._chosen)), 1e-12)

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.surface.points)


def _nearest_of(tree: KDTree, places: Float64) -> tuple[Float64, Index]:
    distance, index = tree.query(places)
    return np.asarray(distance), np.asarray(index, np.intp)
