"""Detection of defects: which hypotheses the images of a posture show on its patches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lightopt.core.arrays import Float32
from lightopt.core.transforms import Posture
from lightopt.defects import tangent_references
from lightopt.design.responses._contrast import Contrast, PixelFill, pixel_fill
from lightopt.design.responses._defect_hypotheses import DefectHypothesis
from lightopt.design.responses._packed_bits import Words
from lightopt.geometry import RayCaster
from lightopt.rendering import SurfacePoints, converged_panel, shade_variants, surface_variants
from lightopt.scene import PanelLight, Scene, pixel_footprint, view_from_part


@dataclass(frozen=True, kw_only=True)
class DetectionModel:
    """The defect hypotheses that images are tested for, and the contrast at which one is visible."""

    hypotheses: tuple[DefectHypothesis, ...]
    contrast: Contrast

    @cached_property
    def pixel_fill(self) -> PixelFill:
        """How far the defects fill a pixel."""
        return pixel_fill(self.hypotheses)


class PatchDetection:
    """The inspectable patches of a posture, tested for defects."""

    def __init__(
        self, scene: Scene, surface: SurfacePoints, posture: Posture, detection: DetectionModel
    ) -> None:
        self.detection = detection
        self.reflectance = scene.reflectance
        self.cosines = np.einsum("ij,ij->i", surface.normals, surface.views)
        camera = view_from_part(scene, posture).camera
        self._footprint = pixel_footprint(camera, 1.0)
        self._depths = (surface.points - camera.position) @ camera.forward
        # the mesh file's axes in the part's frame
        axes = scene.placement.rotation
        self._references = tangent_references(surface.normals, x_axis=axes[:, 0], y_axis=axes[:, 1])
        hypotheses = detection.hypotheses
        self._variants = surface_variants(
            slope=np.array([hypothesis.slope for hypothesis in hypotheses]),
            direction=np.array([hypothesis.direction for hypothesis in hypotheses]),
            R_d_factor=np.array([hypothesis.R_d_factor for hypothesis in hypotheses]),
            sigma_factor=np.array([hypothesis.sigma_factor for hypothesis in hypotheses]),
            reflectance=scene.reflectance,
        )

    def evaluate(
        self,
        block: SurfacePoints,
        panel: PanelLight,
        here: slice,
        caster: RayCaster,
        blocker: RayCaster | None,
        exposures: Sequence[float],
    ) -> tuple[Float32, list[Words]]:
        """Levels of a block of patches, and which hypotheses an image at each exposure shows on them."""
        shaded = shade_variants(
            block,
            self._references[here],
            converged_panel(panel, centre=caster.centre, radius=caster.radius)
            if panel.points == "auto"
            else panel,
            self._variants,
            reflectance=self.reflectance,
            caster=blocker,
        )
        return shaded.plain, [
            self.detection.contrast.words(
                shaded.good,
                shaded.varied,
                pixel_fill=self.detection.pixel_fill,
                footprints=self._footprint * self._depths[here],
                cosines=self.cosines[here],
                exposure=exposure,
            )
            for exposure in exposures
        ]
