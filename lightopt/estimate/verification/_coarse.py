"""Images and predictions at a lower resolution: means over square blocks of pixels.

Blocks have less noise, and there are fewer rays to cast. A coarse image is that of a camera of larger pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, Int32
from lightopt.core.threads import in_threads
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation
from lightopt.estimate.verification._parameters import Parameters
from lightopt.geometry import RayCaster
from lightopt.rendering import mask_pixels, render_posture
from lightopt.scene import PinholeCamera, Scene

COARSE_WIDTH = 540  # about so many columns of a coarse image


@dataclass(frozen=True, kw_only=True)
class CoarseImage:
    """An observation in blocks of side² pixels.

    levels: Mean sensor levels, black level included, shape (h, w).
    saturated: Blocks with a saturated pixel, same shape.
    mostly: Blocks of which most pixels are saturated, same shape.
    top: Level from which a pixel is saturated, less what was subtracted, same shape.
    count: Frames and pixels that a level is the mean of.
    """

    source: Observation
    levels: Float32
    saturated: Bool
    mostly: Bool
    top: Float32
    count: int

    @property
    def key(self) -> tuple[str, Posture, float]:
        """Light, posture and exposure."""
        return self.source.light, self.source.posture, self.source.exposure


@dataclass(frozen=True, kw_only=True)
class CoarsePrediction:
    """What the model has in a posture; levels at exposure 1 [grey level], arrays of shape (h, w).

    levels: By light.
    hit: Of the part.
    clean: Off silhouettes, creases and grazing views.
    background: Well off the part.
    points, normals: World frame, shape (h, w, 3).
    """

    levels: dict[str, Float32]
    hit: Bool
    clean: Bool
    background: Bool
    points: Float32
    normals: Float32


def block_side(camera: PinholeCamera) -> int:
    """Side of the blocks [px]."""
    return max(1, round(camera.width / COARSE_WIDTH))


def coarse_camera(camera: PinholeCamera, side: int) -> PinholeCamera:
    """The camera with blocks of pixels as its pixels; what is left at the right and at the bottom is cut off."""
    column, row = camera.axis_px
    return replace(
        camera,
        width=camera.width // side,
        height=camera.height // side,
        pixel_size=camera.pixel_size * side,
        principal_point=(column / side, row / side),
    )


def coarse_images(
    scene: Scene, observations: Sequence[Observation], side: int, *, threads: int | None = None
) -> tuple[CoarseImage, ...]:
    """Block means of observations."""

    def one(number: int) -> CoarseImage:
        o = observations[number]
        share = _blocks(o.saturated.astype(np.float32), side)
        subtracted = _blocks(np.broadcast_to(np.float32(o.subtracted), o.levels.shape), side)
        levels = _blocks(o.levels, side)
        top = np.broadcast_to(np.float32(scene.sensor.saturated_from - subtracted), levels.shape)
        return CoarseImage(
            source=o, levels=levels, saturated=share > 0.0, mostly=share >= 0.5, top=top, count=o.frames * side**2
        )

    return tuple(in_threads(one, range(len(observations)), threads))


def predict_coarse(
    scene: Scene,
    parameters: Parameters,
    theta: Float64,
    posture: Posture,
    caster: RayCaster,
    *,
    side: int,
    threads: int | None = None,
) -> CoarsePrediction:
    """Render a posture of the rig with some faults; gains, exposure and black level are left out.

    scene: With the coarse camera.
    """
    view = parameters.view(scene, posture, theta)
    scale_s, scale_sigma = np.exp(theta[parameters.nuisance[:2]])
    own = scene.reflectance
    world = replace(
        scene,
        camera=view.camera.moved(view.rotation, view.translation),
        lights=tuple(light.moved(view.rotation, view.translation) for light in view.lights),
        reflectance=replace(own, R_s=own.R_s * scale_s, sigma=own.sigma * scale_sigma),
        defects=(),
        waviness=None,
    )
    images = render_posture(world, posture, caster=caster, threads=threads)
    masks = mask_pixels(world, posture, caster, threads=threads)
    near = np.asarray(ndimage.binary_dilation(images.geometry.hit, iterations=4), np.bool_)
    inner = np.asarray(ndimage.binary_erosion(masks.clean & images.geometry.hit, border_value=1), np.bool_)
    blur = math.sqrt(max(float(theta[parameters.nuisance[2]]), 0.0)) / side
    return CoarsePrediction(
        levels={i.light: i.level if blur == 0.0 else blurred(i.level, blur) for i in images.lights},
        hit=images.geometry.hit,
        clean=inner,
        background=~near,
        points=images.geometry.points,
        normals=images.geometry.normals,
    )


def some_blocks(mask: Bool, most: int) -> tuple[Int32, Int32]:
    """Rows and columns of so many blocks of a mask, at random but the same each time."""
    index = np.flatnonzero(mask)
    if len(index) > most:
        index = np.sort(np.random.default_rng(0).choice(index, most, replace=False))
    row, column = np.unravel_index(index, mask.shape)
    return row.astype(np.int32), column.astype(np.int32)


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
