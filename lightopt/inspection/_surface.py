"""The part's surface over all postures: what was inspected in at least one of them, and why the rest was not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.inspection._coverage import CONTRASTS, Coverage, Reached
from lightopt.mesh import face_areas
from lightopt.raycast import RayCaster
from lightopt.rendering import LEAST_COS_VIEW, build_patches, patch_positions
from lightopt.scene import Scene, view_from_part
from lightopt.transforms import Posture

__all__ = ["SurfaceCoverage", "SurfaceMap", "map_surface", "surface_coverage"]

PATCHES = 50_000
"""About so many patches that the camera sees stand for the surface, whatever the resolution of the images."""


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """Patches of the surface, and the pixel that sees each in each posture.

    Attributes
    ----------
    areas
        Of the patches [mm²], shape (n,).
    seen
        By posture: indices of the patches that the camera sees, and raveled indices of the pixels that they lie in, −1
        where it sees them at a grazing angle.
    """

    areas: NDArray[np.float64]
    seen: dict[Posture, tuple[NDArray[np.intp], NDArray[np.intp]]]


@dataclass(frozen=True, kw_only=True)
class SurfaceCoverage:
    """The surface of the part, each place counted once however many postures show it.

    Attributes
    ----------
    area
        Of the whole surface, undersides and insides too [mm²].
    seen
        Of it, seen by the camera in at least one posture [mm²].
    inspected
        Of that, judged in at least one posture under as many lights as a defect must show under [mm²].
    saturated, shadow, edge
        Of what is seen, not judged in any posture, by what stood in the way in the posture that came nearest: saturated
        before dark, dark before an edge or a grazing view [mm²].
    sensitivity
        By contrast: the surface where a defect as :class:`Coverage` has it is found in the posture that shows it best
        [mm²].
    """

    area: float
    seen: float
    inspected: float
    saturated: float
    shadow: float
    edge: float
    sensitivity: dict[float, float]

    @property
    def share(self) -> float:
        """Of what the camera sees, the share that was inspected."""
        return self.inspected / self.seen if self.seen > 0.0 else 0.0

    def as_dict(self) -> dict[str, Any]:
        """JSON form: shares of what the camera sees, and that as a share of the whole."""
        whole = max(self.seen, 1e-9)
        return {
            "area_mm2": round(self.area, 3),
            "seen": round(self.seen / max(self.area, 1e-9), 5),
            "inspected": round(self.inspected / whole, 5),
            "saturated": round(self.saturated / whole, 5),
            "shadow": round(self.shadow / whole, 5),
            "edge": round(self.edge / whole, 5),
            "finds_contrast": {f"{c:g}": round(a / whole, 5) for c, a in self.sensitivity.items()},
        }


def map_surface(scene: Scene, caster: RayCaster) -> SurfaceMap:
    """Cut the surface into patches and look for them in the images of each posture.

    Parameters
    ----------
    scene
        With the part where it lies, and the postures that images were taken in.
    caster
        Of the scene's part.
    """
    table = build_patches(scene, caster=caster, budget=PATCHES)
    seen: dict[Posture, tuple[NDArray[np.intp], NDArray[np.intp]]] = {}
    for posture, visible in zip(table.postures, table.visible, strict=True):
        patch = np.flatnonzero(visible)
        columns, rows = (np.floor(a[patch]).astype(np.intp) for a in patch_positions(table, scene, posture))
        eye = view_from_part(scene, posture).camera.position - table.patches.centroids[patch]
        cosine = np.einsum("ij,ij->i", table.patches.normals[patch], eye) / np.linalg.norm(eye, axis=1)
        seen[posture] = patch, np.where(cosine >= LEAST_COS_VIEW, rows * scene.camera.width + columns, -1)
    return SurfaceMap(areas=table.patches.areas, seen=seen)


def surface_coverage(
    scene: Scene, coverages: Sequence[tuple[Posture, Coverage]], surface: SurfaceMap | None
) -> SurfaceCoverage:
    """What was inspected of the surface over all postures of a set.

    Parameters
    ----------
    scene
        With the part.
    coverages
        Of each posture.
    surface
        From :func:`map_surface`; None for a single posture, whose own pixels tell.
    """
    area = float(face_areas(scene.mesh).sum())
    if surface is None:
        ((_, only),) = coverages
        return SurfaceCoverage(
            area=area,
            seen=only.seen,
            inspected=only.inspected,
            saturated=only.saturated,
            shadow=only.shadow,
            edge=only.edge,
            sensitivity=only.sensitivity,
        )
    reached = np.full(len(surface.areas), -1, np.int8)
    least = np.full(len(surface.areas), np.inf, np.float32)
    for posture, coverage in coverages:
        patch, pixel = surface.seen[posture]
        # a patch beside the last pixel that shows the part is at its edge
        here = np.maximum(np.where(pixel < 0, Reached.EDGE, coverage.reached.ravel()[pixel]), Reached.EDGE)
        reached[patch] = np.maximum(reached[patch], here.astype(np.int8))
        found = np.where(pixel < 0, np.inf, coverage.least_contrast.ravel()[pixel])
        least[patch] = np.minimum(least[patch], found.astype(np.float32))

    def of(which: NDArray[np.bool_]) -> float:
        return float(surface.areas[which].sum())

    return SurfaceCoverage(
        area=area,
        seen=of(reached >= 0),
        inspected=of(reached == Reached.INSPECTED),
        saturated=of(reached == Reached.SATURATED),
        shadow=of(reached == Reached.SHADOW),
        edge=of(reached == Reached.EDGE),
        sensitivity={c: of((reached == Reached.INSPECTED) & (least <= c)) for c in CONTRASTS},
    )
