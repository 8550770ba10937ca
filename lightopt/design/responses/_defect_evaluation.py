"""Images looked at for defects: which trials each of them shows on the patches of a posture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import Posture
from lightopt.defects import tangent_references
from lightopt.design.responses._contrast import Contrast
from lightopt.design.responses._defect_hypotheses import Trial
from lightopt.design.responses._packed_bits import Words
from lightopt.design.responses._pixel_filling import Fillings, fillings_of
from lightopt.geometry import RayCaster
from lightopt.rendering import SurfacePoints, converged_panel, shade_variants, surface_variants
from lightopt.scene import PanelLight, Scene, pixel_footprint, view_from_part


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """What the images are looked at for.

    Attributes
    ----------
    trials
        The defects.
    contrast
        When one is visible.
    fillings
        How far the defects fill a pixel.
    """

    trials: tuple[Trial, ...]
    contrast: Contrast
    fillings: Fillings = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "fillings", fillings_of(self.trials))


class Inspected:
    """The visible patches of a posture, looked at for defects."""

    def __init__(
        self, scene: Scene, surface: SurfacePoints, posture: Posture, inspection: Inspection
    ) -> None:
        self.inspection = inspection
        self.reflectance = scene.reflectance
        self.cosines = np.einsum("ij,ij->i", surface.normals, surface.views)
        camera = view_from_part(scene, posture).camera
        self._footprint = pixel_footprint(camera, 1.0)
        self._depths = (surface.points - camera.position) @ camera.forward
        # the mesh file's axes in the part's frame
        axes = scene.placement.rotation
        self._references = tangent_references(surface.normals, x_axis=axes[:, 0], y_axis=axes[:, 1])
        trials = inspection.trials
        self._variants = surface_variants(
            slope=np.array([trial.slope for trial in trials]),
            direction=np.array([trial.direction for trial in trials]),
            R_d_factor=np.array([trial.R_d_factor for trial in trials]),
            sigma_factor=np.array([trial.sigma_factor for trial in trials]),
            reflectance=scene.reflectance,
        )

    def look(
        self,
        block: SurfacePoints,
        panel: PanelLight,
        here: slice,
        caster: RayCaster,
        blocker: RayCaster | None,
        exposures: Sequence[float],
    ) -> tuple[NDArray[np.float32], list[Words]]:
        """Levels of a block of patches, and which trials an image of each exposure shows on them."""
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
            self.inspection.contrast.words(
                shaded.good,
                shaded.varied,
                fillings=self.inspection.fillings,
                footprints=self._footprint * self._depths[here],
                cosines=self.cosines[here],
                exposure=exposure,
            )
            for exposure in exposures
        ]
