"""Measured and predicted levels of single pixels, under any placement and reflectance of the part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int32
from lightopt.core.threads import available_processors, in_threads
from lightopt.core.transforms import Posture
from lightopt.estimate.registration._observations import Observation
from lightopt.estimate.registration._placement import Placement
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, SurfaceLight
from lightopt.optics import Reflectance
from lightopt.rendering import (
    UNLIT,
    WHOLE,
    PosturePixels,
    SurfacePoints,
    channel_groups,
    light_layer,
    light_of_channels,
    trace_samples,
    visibility_of_lights,
)
from lightopt.scene import PartView, Scene, lens_share, view_from_part

LEAST_R_D, LEAST_R_S = 0.1, 1e-3
"""What R_d and R_s of almost nothing count as, so that they can be changed by factors."""

_LATTICE = np.array([0.7548776662466927, 0.5698402909980532])
# additive recurrences that fill a pixel evenly: Roberts's R₂, by the plastic number, and quadratic irrationals
_OFFSETS = np.array([0.6180339887498949, 0.4142135623730951])


@dataclass(frozen=True, kw_only=True)
class PixelSet:
    """Pixels of one posture, shape (n,), and what was measured there."""

    posture: Posture
    row: Int32
    column: Int32
    images: tuple[Observation, ...]
    levels: Float64  # sensor levels above black, one row per image, shape (images, n)
    saturated: Bool  # where those are lower bounds, same shape
    rays: int = 1  # per pixel: 1 for one at its centre, more for a mean over its area

    @staticmethod
    def look_up(
        posture: Posture, row: Int32, column: Int32, images: Sequence[Observation], black: float, *, rays: int = 1
    ) -> PixelSet:
        """Look up some pixels in the images of a posture."""
        return PixelSet(
            posture=posture,
            row=row,
            column=column,
            images=tuple(images),
            levels=np.stack([image.levels[row, column] - black for image in images]).astype(np.float64),
            saturated=np.stack([image.saturated[row, column] for image in images]),
            rays=rays,
        )

    @property
    def positions(self) -> tuple[Float64, Float64]:
        """Columns and rows of the rays [px], pixel after pixel; shape (n · rays,)."""
        if self.rays == 1:
            return self.column.astype(np.float64) + 0.5, self.row.astype(np.float64) + 0.5
        # a lattice shifted from pixel to pixel: an edge along rows meets its rays one after another and not in threes
        x, y = (np.arange(self.rays)[:, None] * _LATTICE).T
        along, down = (np.arange(len(self.row))[:, None] * _OFFSETS).T[:, :, None]
        return (self.column[:, None] + (x + along) % 1.0).ravel(), (self.row[:, None] + (y + down) % 1.0).ravel()


def view_of_placed(scene: Scene, posture: Posture, placement: Placement) -> PartView:
    """Camera and lights as a part sees them that was moved on the stage.

    The part's own frame stays, so that one ray caster serves all placements.
    """
    view = view_from_part(scene, posture)
    # x_placed = R·x + t, inverted
    back = placement.rotation.T
    shift = -back @ placement.shift(scene.pivot)
    lights = tuple(light.moved(back, shift) for light in view.lights)
    return replace(view, camera=view.camera.moved(back, shift), lights=lights)


def _layers(
    surface: SurfacePoints,
    group: Sequence[PanelLight],
    caster: RayCaster,
    reflectances: Sequence[Reflectance],
    sigmas: Sequence[float],
    threads: int,
) -> Float64:
    # diffuse light, and specular light for each σ, of channels of a light or of one panel, shape (1 + σ, lights, n)
    first = reflectances[0]
    channels = [light for light in group if isinstance(light, SurfaceLight)]
    layers = np.empty((1 + len(sigmas), len(group), len(surface)))
    for index, some, own in surface.by_material(reflectances):
        lobes = [replace(own, sigma=sigma * (own.sigma / first.sigma)) for sigma in sigmas]
        if channels:
            parts = [light_of_channels(some, channels, own.diffuse, threads=threads)[0]]
            parts += [light_of_channels(some, channels, lobe, diffuse=False, threads=threads)[1] for lobe in lobes]
        else:
            layer = light_layer(some, group[0], caster, form=own.diffuse, threads=1)
            parts = [layer.diffuse[None], *(layer.specular(lobe, threads=1)[None] for lobe in lobes)]
        shares = own.R_d / max(first.R_d, LEAST_R_D), own.R_s / max(first.R_s, LEAST_R_S)
        for place, part in enumerate(parts):
            layers[place][:, index] = part if own is first else shares[place > 0] * part
    return layers


def light_at(
    scene: Scene,
    pixels: PixelSet,
    view: PartView,
    caster: RayCaster,
    *,
    sigmas: Sequence[float] = (),
    threads: int | None = None,
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of each pixel under the light of each image, per unit of R_d and R_s.

    These, and σ, are those of the scene's first reflectance; where they change, those of regions change with them by
    the same factors. A first R_d or R_s of almost nothing counts as `LEAST_R_D` or `LEAST_R_S`.

    Arrays of shape (images, n) and (sigmas, images, n); 0 where a ray misses the part or no light arrives, NaN where
    only some of a panel is seen.
    """
    columns, rows = pixels.positions
    hits, surface = trace_samples(caster, scene.mesh, view.camera, columns, rows, neighbours=True)
    some = PosturePixels(
        posture=pixels.posture,
        view=view,
        row=np.floor(rows[hits.ray]).astype(np.int32),
        column=np.floor(columns[hits.ray]).astype(np.int32),
        surface=surface,
        clean=surface.front,
        shape=(scene.camera.height, scene.camera.width),
    )
    light = np.zeros((1 + len(sigmas), len(pixels.images), len(columns)))
    names = list(dict.fromkeys(image.light for image in pixels.images))
    panels = {panel.name: panel for panel in view.lights}

    groups = channel_groups([panels[name] for name in names])
    threads = threads or available_processors()
    threads_of_group = max(1, threads // max(1, len(groups)))

    def shade(number: int) -> None:
        group = [panels[names[i]] for i in groups[number]]
        verdicts = visibility_of_lights(some, group, caster, moving=True, threads=1)
        whole = verdicts == WHOLE
        found = np.stack([np.where(whole | (verdicts == UNLIT), 0.0, np.nan)] * (1 + len(sigmas)))
        seen = np.flatnonzero(whole.any(axis=0))
        layers = _layers(surface.take(seen), group, caster, scene.reflectances, sigmas, threads_of_group)
        for place, level in enumerate(layers):
            found[place][:, seen] = np.where(whole[:, seen], level, found[place][:, seen])
        for i, image in enumerate(pixels.images):
            for panel, own in zip(group, found.swapaxes(0, 1), strict=True):
                if image.light == panel.name:
                    light[:, i, hits.ray] = own

    in_threads(shade, range(len(groups)), threads)
    passed = lens_share(view.camera, columns, rows)
    if passed is not None:
        light *= passed
    if pixels.rays > 1:
        light = light.reshape(*light.shape[:2], len(pixels.row), -1).mean(axis=3)
    return light[0], light[1:]


def sensor_scale(scene: Scene, image: Observation) -> float:
    """Sensor levels per grey level at exposure 1."""
    return image.exposure * scene.sensor.max_level / scene.reflectance.full_scale
