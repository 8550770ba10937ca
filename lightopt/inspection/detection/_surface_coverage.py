"""The part's surface over all postures: what at least one of them inspected, and why the rest was not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from lightopt.core.transforms import Posture
from lightopt.geometry import face_areas
from lightopt.inspection.detection._coverage import (
    REFERENCE_DISC_PX,
    PostureCoverage,
    Shares,
    SurfaceState,
    class_areas,
)
from lightopt.inspection.prediction._predict import SurfaceMap
from lightopt.scene import Scene

REFERENCE_CONTRAST: Final = 0.2
REFERENCE_DEFECT: Final = (
    f"a disc of {REFERENCE_DISC_PX:g} px that changes the light by {100.0 * REFERENCE_CONTRAST:g} %"
)
"""A defect that is reported as found or not beside the share that was inspected."""


@dataclass(frozen=True, kw_only=True)
class SurfaceCoverage(Shares):
    """The surface of the part, each place counted once, by the posture that shows it best.

    area: of the whole surface, undersides and insides too [mm²]; `seen` of it by the camera in at least one posture,
        with images or without, not at a grazing angle.
    missing: of what is seen, not judged for want of images: what a posture without images shows, and those with
        images at an edge at most [mm²].
    """

    area: float
    missing: float = 0.0

    @property
    def finds(self) -> float:
        """Of what the camera sees, the share on which :data:`REFERENCE_DEFECT` is found half of the time."""
        return self.sensitivity.get(REFERENCE_CONTRAST, 0.0) / self.seen if self.seen > 0.0 else 0.0

    def as_dict(self) -> dict[str, Any]:
        """JSON form: shares of what the camera sees, and that as a share of the whole."""
        return {
            "area_mm2": round(self.area, 3),
            "seen": round(self.seen / max(self.area, 1e-9), 5),
            **self.shares(),
            "missing": round(self.missing / max(self.seen, 1e-9), 5),
        }


def surface_coverage(
    scene: Scene, coverages: Sequence[tuple[Posture, PostureCoverage]], surface: SurfaceMap | None
) -> SurfaceCoverage:
    """What was inspected of the surface over all postures of a set.

    surface: of these postures and those that images are missing of; None for a single posture of which none is, whose
        own pixels are counted.
    """
    area = float(face_areas(scene.mesh).sum())
    if surface is None:
        ((_, only),) = coverages
        return SurfaceCoverage(area=area, **{each.name: getattr(only, each.name) for each in fields(Shares)})
    state = np.full(len(surface.areas), SurfaceState.NO_PART, np.uint8)
    least = np.full(len(surface.areas), np.inf, np.float32)
    for posture, coverage in coverages:
        patch, pixel = surface.seen[posture]
        # a patch beside the last pixel that shows the part is at its edge
        judged = np.maximum(coverage.state.ravel()[pixel], SurfaceState.EDGE)
        here = np.where(pixel < 0, SurfaceState.GRAZING, judged)
        state[patch] = np.maximum(state[patch], here.astype(np.uint8))
        found = np.where(pixel < 0, np.inf, coverage.least_contrast.ravel()[pixel])
        least[patch] = np.minimum(least[patch], found.astype(np.float32))
    for posture in surface.seen.keys() - {posture for posture, _ in coverages}:
        patch, pixel = surface.seen[posture]
        here = np.where(pixel < 0, SurfaceState.GRAZING, SurfaceState.MISSING)
        state[patch] = np.maximum(state[patch], here.astype(np.uint8))
    return SurfaceCoverage(
        area=area,
        missing=float(surface.areas[state == SurfaceState.MISSING].sum()),
        **class_areas(surface.areas, state, least),
    )
