"""A part with a finish in one posture: what the patches predict of it, its pixels, and noise on their levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.design import Contrast, DefectHypothesis, DetectionModel, LuminanceMatrix, luminance_matrix
from lightopt.geometry import RayCaster
from lightopt.optics import expose, image_rng
from lightopt.rendering import PatchTable, SurfacePoints, trace_samples
from lightopt.scene import Scene, view_from_part

__all__ = ["MEANS", "SEED", "SEEN_IN", "Case", "Point", "noisy_levels", "trace"]

SEEN_IN = (1, 2)
MEANS = (1, 9)
"""Pixels whose mean level is compared."""
SEED = 7


@dataclass(frozen=True, kw_only=True)
class Point:
    """A prediction beside a measurement.

    Attributes
    ----------
    part, finish, kind
        What was looked at: a kind of the catalogue, ``all`` of it, or ``pits of …``.
    min_images
        Images that must show a defect.
    pixels
        Whose mean level is compared.
    predicted, measured
        Shares.
    """

    part: str
    finish: str
    kind: str
    min_images: int
    pixels: int
    predicted: float
    measured: float


@dataclass(frozen=True, eq=False)
class Case:
    """A part with a finish in one posture, and what the patches predict of it."""

    scene: Scene
    caster: RayCaster
    table: PatchTable
    contrast: Contrast

    @property
    def saturated_from(self) -> float:
        """Level of the good surface from which a pixel is saturated [grey level at exposure 1]."""
        sensor = self.scene.sensor
        scale = sensor.max_level / self.scene.reflectance.full_scale
        return (sensor.saturated_from - sensor.black_level) / scale

    def predict(self, trials: tuple[DefectHypothesis, ...]) -> LuminanceMatrix:
        """Which trials the patches are predicted to show, lights as the rig has them."""
        inspection = DetectionModel(hypotheses=trials, contrast=self.contrast)
        panels = [(light,) for light in self.scene.lights]
        posture = self.scene.postures[0]
        return luminance_matrix(self.scene, self.table, posture, panels, caster=self.caster, detection=inspection)


def trace(case: Case) -> tuple[NDArray[np.intp], SurfacePoints]:
    """The pixels whose centres see the part from the front, by number, and what they see."""
    camera = view_from_part(case.scene, case.scene.postures[0]).camera
    rows, columns = np.divmod(np.arange(camera.width * camera.height), camera.width)
    hits, surface = trace_samples(case.caster, case.scene.mesh, camera, columns + 0.5, rows + 0.5)
    front = np.flatnonzero(surface.front)
    return hits.ray[front].astype(np.intp), surface.take(front)


def noisy_levels(case: Case, level: NDArray[np.float64], *, light: int, trial: int) -> NDArray[np.float64]:
    """Levels as the sensor delivers them, of an image of any shape; other noise for other lights and trials."""
    rng = image_rng(SEED, light=light, posture=0, exposure=trial)
    full_scale = case.scene.reflectance.full_scale
    image = np.atleast_2d(level)
    delivered = expose(image, sensor=case.scene.sensor, exposure=1.0, full_scale=full_scale, rng=rng)
    return delivered.astype(np.float64)
