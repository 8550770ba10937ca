"""The patches that optimisation works on: the part cut to the pixel's footprint, and what the camera sees of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.mesh import Patches, TriangleMesh, estimate_patch_count, face_normals, refine
from lightopt.raycast import RayCaster
from lightopt.rendering._images import trace_posture
from lightopt.scene import PartView, Scene, pixel_footprint, project, view_from_part
from lightopt.transforms import Posture

__all__ = [
    "DEFAULT_PATCH_BUDGET",
    "PatchPixels",
    "PatchTable",
    "build_patches",
    "patch_pixels",
    "patch_positions",
    "visible_points",
]

Float64 = NDArray[np.float64]

DEFAULT_PATCH_BUDGET = 200_000
"""Patches visible in at least one posture, unless asked otherwise."""

# the geometry image holds patch numbers as float32, which counts no further
_MOST_PATCHES = 1 << 24


@dataclass(frozen=True, kw_only=True)
class PatchTable:
    """A part's patches and from which postures the camera sees them; part frame.

    Attributes
    ----------
    patches
        Of the scene's mesh.
    postures
        The postures that were looked at.
    visible
        Whether the camera sees a patch's centroid, from the front and in the image; shape (postures, p).
    max_edge
        Longest edge of a patch that the camera may see, unless the mesh was finer already [mm].
    footprint
        Side of a pixel's footprint on the part, where it is smallest [mm].
    """

    patches: Patches
    postures: tuple[Posture, ...]
    visible: NDArray[np.bool_]
    max_edge: float
    footprint: float

    @property
    def message(self) -> str:
        """What the refinement reached, for the person at the machine."""
        seen = int(self.visible.any(axis=0).sum())
        reached = (
            "the pixel's footprint"
            if self.max_edge <= self.footprint
            else f"{self.max_edge / self.footprint:.3g} times the pixel's footprint of {self.footprint:.3g} mm"
        )
        return f"{seen:,} visible patches of {len(self.patches):,}; edges up to {self.max_edge:.3g} mm ({reached})"

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """The table as named arrays for ``patches.npz``."""
        p = self.patches
        return {
            "vertices": p.vertices,
            "triangles": p.triangles,
            "centroids": p.centroids,
            "normals": p.normals,
            "areas": p.areas,
            "face": p.face,
            "roots": p.roots,
            "children": p.children,
            "cut_edge": p.cut_edge,
            "visible": self.visible,
            "postures_deg": np.array([[q.elevation_deg, q.rotation_deg] for q in self.postures]),
            "max_edge_mm": np.array(self.max_edge),
            "footprint_mm": np.array(self.footprint),
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, NDArray[Any]]) -> PatchTable:
        """The table that :meth:`arrays` described."""
        names = (
            "vertices",
            "triangles",
            "centroids",
            "normals",
            "areas",
            "face",
            "roots",
            "children",
            "cut_edge",
        )
        return PatchTable(
            patches=Patches(**{name: arrays[name] for name in names}),
            postures=tuple(Posture(float(e), float(r)) for e, r in arrays["postures_deg"]),
            visible=arrays["visible"],
            max_edge=float(arrays["max_edge_mm"]),
            footprint=float(arrays["footprint_mm"]),
        )


@dataclass(frozen=True)
class PatchPixels:
    """Which pixels show each patch.

    Attributes
    ----------
    start
        The pixels of patch i are ``pixels[start[i]:start[i + 1]]``; shape (p + 1,).
    pixels
        Raveled pixel indices, ascending within a patch.
    """

    start: NDArray[np.int64]
    pixels: NDArray[np.int64]

    def of(self, patch: int) -> NDArray[np.int64]:
        """Raveled indices of the pixels whose centre shows a patch; empty for a patch smaller than a pixel."""
        return self.pixels[self.start[patch] : self.start[patch + 1]]


def build_patches(scene: Scene, *, caster: RayCaster, budget: int = DEFAULT_PATCH_BUDGET) -> PatchTable:
    """Cut the faces that the camera sees towards the pixel's footprint, within a budget (paper, section 3.3).

    Parameters
    ----------
    scene
        With the postures to look from.
    caster
        Of the scene's part.
    budget
        About how many patches may be visible. A mesh that has more faces to begin with is not coarsened.
    """
    mesh = scene.mesh
    views = [view_from_part(scene, posture) for posture in scene.postures]
    footprint = min(_smallest_footprint(view, mesh) for view in views)
    seen = np.zeros(len(mesh.faces), np.bool_)
    for view in views:
        seen[trace_posture(mesh, view, caster).face] = True
    # a face too narrow for any pixel's centre, such as a wall seen at a grazing angle, shows by its centroid
    facets = face_normals(mesh)
    centroids = mesh.vertices[mesh.faces].mean(axis=1)
    for view in views:
        rest = np.flatnonzero(~seen)
        seen[rest] = visible_points(centroids[rest], facets[rest], view, caster)
    hidden, shown = int((~seen).sum()), int(seen.sum())
    edge = footprint
    if shown >= budget:
        # finer than the budget to begin with: every face is one patch
        edge = max(edge, _longest_edge(mesh, seen))
    limit = hidden + 16 * max(budget, shown) + 1  # beyond it the step below is the longest anyway
    while shown < budget and (
        cut := estimate_patch_count(mesh, edge, select=seen, limit=limit) - hidden - shown
    ) > (budget - shown):
        # what cutting adds goes with 1 / edge²
        edge *= max(1.02, min(4.0, math.sqrt(cut / (budget - shown))))
    patches = refine(mesh, max_edge_mm=edge, max_patches=_MOST_PATCHES, select=seen)
    visible = np.stack(
        [visible_points(patches.centroids, facets[patches.face], view, caster) for view in views]
    )
    return PatchTable(
        patches=patches, postures=scene.postures, visible=visible, max_edge=edge, footprint=footprint
    )


def patch_pixels(patch: NDArray[np.int32], count: int) -> PatchPixels:
    """Turn a geometry image's patch channel round: from which patch a pixel shows to which pixels show a patch.

    Parameters
    ----------
    patch
        Patch index of each pixel, −1 where none, shape (height, width).
    count
        Number of patches.
    """
    flat = patch.ravel()
    pixels = np.flatnonzero(flat >= 0)
    order = np.argsort(flat[pixels], kind="stable")
    per_patch = np.bincount(flat[pixels], minlength=count)
    return PatchPixels(np.concatenate([[0], np.cumsum(per_patch)]), pixels[order])


def patch_positions(table: PatchTable, scene: Scene, posture: Posture) -> tuple[Float64, Float64]:
    """Image points (columns, rows) [px] of the patches' centroids in a posture, each of shape (p,).

    For patches smaller than a pixel, which :func:`patch_pixels` may not list; NaN behind the camera. Says nothing of
    visibility.
    """
    columns, rows, _ = project(view_from_part(scene, posture).camera, table.patches.centroids)
    return columns, rows


def _longest_edge(mesh: TriangleMesh, faces: NDArray[np.bool_]) -> float:
    corners = mesh.vertices[mesh.faces[faces]]
    return float(np.sqrt(((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max()))


def _smallest_footprint(view: PartView, mesh: TriangleMesh) -> float:
    _, _, depth = project(view.camera, mesh.vertices)
    return pixel_footprint(view.camera, max(float(depth.min()), 1e-3))


def visible_points(points: Float64, normals: Float64, view: PartView, caster: RayCaster) -> NDArray[np.bool_]:
    """Whether the camera sees points of the surface: in the image, from the front, with nothing in between.

    Parameters
    ----------
    points, normals
        Points [mm] and normals of the facets that they lie on, part frame, shape (p, 3).
    view, caster
        The camera as the part sees it, and the part's ray caster.

    Returns
    -------
    numpy.ndarray
        Boolean, shape (p,).
    """
    camera = view.camera
    columns, rows, depth = project(camera, points)
    visible = (depth > 0.0) & (np.einsum("ij,ij->i", normals, camera.position - points) > 0.0)
    visible[visible] &= (
        (columns[visible] >= 0.0)
        & (columns[visible] < camera.width)
        & (rows[visible] >= 0.0)
        & (rows[visible] < camera.height)
    )
    index = np.flatnonzero(visible).astype(np.int32)
    blocked = caster.occluded(
        points,
        normals,
        camera.position[None, :],
        point_index=index,
        target_index=np.zeros(len(index), np.int32),
    )
    visible[index[blocked]] = False
    return visible
