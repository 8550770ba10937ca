"""Images and predictions at a lower resolution: means over square blocks of pixels.

Blocks have less noise, and there are fewer rays to cast. A coarse image is that of a camera of larger pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.run_context import RunContext
from lightopt.core.threads import in_threads
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation
from lightopt.estimate.verification._parameters import Parameters
from lightopt.rendering import cast_rays_at, mask_pixels, render_posture
from lightopt.scene import Scene, project, with_reflectances

COARSE_WIDTH = 540  # about so many columns of a coarse image

PANEL_MM = 10.0  # a panel that has moved by this is as bad as a part that has moved by a block
# rigs that differ by less have the same images: in place [block], reflectance and blur [px²]
SAME_BLOCKS, SAME_SHARE, SAME_BLUR = 0.02, 0.005, 0.2


@dataclass(frozen=True, kw_only=True)
class CoarseImage:
    """An observation in blocks of side² pixels."""

    source: Observation
    levels: Float32  # mean sensor levels, black level included, shape (h, w)
    saturated: Bool  # blocks with a saturated pixel, same shape
    mostly: Bool  # blocks of which most pixels are saturated, same shape
    top: Float32  # level from which a pixel is saturated, less what was subtracted, same shape
    count: int  # frames and pixels that a level is the mean of


@dataclass(frozen=True, kw_only=True)
class CoarsePrediction:
    """What the model has in a posture; levels at exposure 1 [grey level], arrays of shape (h, w).

    points, normals: World frame, shape (h, w, 3).
    """

    levels: dict[str, Float32]  # by light
    hit: Bool  # of the part
    clean: Bool  # off silhouettes, creases and grazing views
    points: Float32
    normals: Float32


class Work:
    """What is the same for all sets of a scene.

    side: Of the blocks [px].
    coarse: The scene with blocks as the camera's pixels; what is left at the right and at the bottom is cut off.
    """

    def __init__(self, scene: Scene, parameters: Parameters, run: RunContext) -> None:
        self.scene, self.parameters, self.run = scene, parameters, run
        camera = scene.camera
        self.side = max(1, round(camera.width / COARSE_WIDTH))
        column, row = camera.axis_px
        coarse = replace(
            camera,
            width=camera.width // self.side,
            height=camera.height // self.side,
            pixel_size=camera.pixel_size * self.side,
            principal_point=(column / self.side, row / self.side),
        )
        self.coarse = replace(scene, camera=coarse)
        self.caster = cast_rays_at(scene)
        self._kept: list[tuple[Float64, dict[Posture, CoarsePrediction]]] = []

    def blocks(self, observations: Sequence[Observation]) -> tuple[CoarseImage, ...]:
        """Block means of images."""

        def one(number: int) -> CoarseImage:
            o, side = observations[number], self.side
            share = _blocks(o.saturated.astype(np.float32), side)
            subtracted = _blocks(np.broadcast_to(np.float32(o.subtracted), o.levels.shape), side)
            return CoarseImage(
                source=o,
                levels=_blocks(o.levels, side),
                saturated=share > 0.0,
                mostly=share >= 0.5,
                top=(self.scene.sensor.saturated_from - subtracted).astype(np.float32),
                count=o.frames * side**2,
            )

        return tuple(in_threads(one, range(len(observations)), self.run.threads))

    def predict(self, theta: Float64) -> dict[Posture, CoarsePrediction]:
        """Images of the rig with some faults; those that were rendered before if they hardly differ."""
        for there, kept in self._kept:
            *lobe, blur = np.abs(theta - there)[self.parameters.nuisance]
            if max(lobe) < SAME_SHARE and blur < SAME_BLUR and self.moved_blocks(theta, there) <= SAME_BLOCKS:
                return kept
        found = {posture: self._render(theta, posture) for posture in self.scene.postures}
        self._kept.append((theta, found))
        return found

    def _render(self, theta: Float64, posture: Posture) -> CoarsePrediction:
        scene, threads = self.coarse, self.run.threads
        view = self.parameters.view(scene, posture, theta)
        log_s, log_sigma, blur = theta[self.parameters.nuisance]
        changed = [
            replace(one, R_s=one.R_s * math.exp(log_s), sigma=one.sigma * math.exp(log_sigma))
            for one in scene.reflectances
        ]
        world = replace(
            with_reflectances(scene, changed),
            camera=view.camera.moved(view.rotation, view.translation),
            lights=tuple(light.moved(view.rotation, view.translation) for light in view.lights),
            defects=(),
            waviness=None,
        )
        images = render_posture(world, posture, caster=self.caster, threads=threads)
        masks = mask_pixels(world, posture, self.caster, threads=threads)
        hit = images.geometry.hit
        width = math.sqrt(max(float(blur), 0.0)) / self.side
        return CoarsePrediction(
            levels={i.light: blurred(i.level, width) if width else i.level for i in images.lights},
            hit=hit,
            clean=np.asarray(ndimage.binary_erosion(masks.clean & hit, border_value=1), np.bool_),
            points=images.geometry.points,
            normals=images.geometry.normals,
        )

    def moved_blocks(self, a: Float64, b: Float64) -> float:
        """By how much the images of two rigs differ, at most [block]: of the part, or of what it mirrors."""
        p = self.parameters
        panels = [g for g in p.groups if g.kind == "panel_shift"]
        most = max(float(np.abs(a - b)[g.where].max()) / PANEL_MM for g in panels)
        vertices = self.scene.mesh.vertices
        some = vertices[:: max(1, len(vertices) // 500)]
        for posture in self.scene.postures:
            (x, y, _), (u, v, _) = (project(p.view(self.coarse, posture, t).camera, some) for t in (a, b))
            most = max(most, float(np.nanmax(np.hypot(x - u, y - v))))
        return most


def blurred(image: Float32, width: float) -> Float32:
    """An image after a Gaussian blur of this standard deviation [pixel of the image]."""
    return np.asarray(ndimage.gaussian_filter(image, width), np.float32)


def _blocks(image: Float32, side: int) -> Float32:
    height, width = image.shape[0] // side, image.shape[1] // side
    # by whole slices: a mean over axes of so few elements takes long
    total = np.zeros((height, width), np.float32)
    for y in range(side):
        for x in range(side):
            total += image[y : height * side : side, x : width * side : side]
    total *= np.float32(1.0 / side**2)
    return total
