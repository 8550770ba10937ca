"""The inverse pattern: the picture on a display whose reflection in a good part is a regular one.

A camera pixel's level is linear in the picture D: W·D, W the response to each pixel of the display. The picture is the
least-squares solution of W·D = T, 0 ≤ D ≤ 1, T the target in the camera's image. In an image of a part, less T, only
what differs from the good part is left. Shadows are left out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.optimize import minimize

from lightopt import rendering
from lightopt.config import RigConfig
from lightopt.core.arrays import Bool, Float64, Index, Int32, UInt8
from lightopt.core.errors import InputError
from lightopt.core.transforms import rotation_x, rotation_y
from lightopt.defects import SHAPE_KINDS, mark_surface
from lightopt.lights import SurfaceLight, picture_light
from lightopt.optics import farthest_exponent
from lightopt.scene import Scene, move_part

MOST_CAMERA_PIXELS = 20_000  # that the picture is fitted to; of more, every second or third row and column
TARGET_SHARE = 0.5  # mean of the target, as a share of the level under the display all on
TARGET_CONTRAST = 0.5  # of the target's stripes in both directions together
REFLECTING_SHARE = 0.9  # of the brightest level under the display all on: pixels with less see something else
LEAST_EXPONENT = 18.0  # of the lobe where it ends on the display, 6 σ of a Gaussian one
MOST_HALF = math.radians(30.0)  # by which half vectors lean at most where a lobe has long tails
DIFFUSE_BLOCKS = 8  # of the display along each side, of which the diffuse response is known
ITERATIONS = 300


@dataclass(frozen=True)
class InversePattern:
    """A picture and what its reflection in the good part looks like."""

    # shares of the full radiance, shape (rows, columns), as :func:`lightopt.lights.picture_light` has them
    picture: Float64
    light: SurfaceLight  # the display, world frame
    # camera pixels that it was fitted to, shape (k,)
    row: Int32
    column: Int32
    target: Float64  # T at these [grey level], shape (k,)
    # root mean square of the rendered reflection less the target, as a share of the target's mean
    residual: float = math.nan

    @property
    def levels(self) -> UInt8:
        """The picture for a display of linear levels, shape (rows, columns)."""
        return np.round(255.0 * self.picture).astype(np.uint8)


@dataclass(frozen=True)
class ShownDefect:
    name: str
    change: float  # the greatest at a pixel, as a share of the target's mean
    over_noise: float  # the same in standard deviations of a pixel's noise at exposure 1


def display_of(rig: RigConfig, scene: Scene, name: str) -> SurfaceLight:
    names = {light.name: light.entry_name for light in rig.lights if light.kind == "display"}
    for light in scene.lights:
        if isinstance(light, SurfaceLight) and names.get(light.name) == name:
            return light
    there = ", ".join(dict.fromkeys(names.values()))
    raise InputError(f'no display "{name}" in {rig.source.path}; it has {there or "none"}')


def inverse_pattern(
    scene: Scene, display: SurfaceLight, *, pixels: tuple[int, int], period_px: float | None
) -> InversePattern:
    """Compute the picture for a good part in the scene's first posture.

    display: One of the scene's lights
    pixels: Columns and rows of the picture
    period_px: Of the target's stripes in the camera's image, along rows and along columns [px]; None for a flat target
    Raises InputError: Too few pixels reflect the display, or the part has regions of other reflectances
    """
    if scene.regions:
        raise InputError("the inverse pattern is of a part of one reflectance; remove the regions from the part file")
    scene, posture = replace(scene, defects=()), scene.postures[0]
    seen = _seen(scene)
    surface = seen.surface
    own = _in_part_frame(seen, scene, display)
    shape = (pixels[1], pixels[0])
    full = _levels(surface, picture_light(own, np.ones(shape)), scene)
    u, v, _ = rendering.mirrored_places(surface, own)
    inside = (np.abs(u) < 0.5 * own.size[0]) & (np.abs(v) < 0.5 * own.size[1])
    reflecting = np.flatnonzero(inside & (full >= REFLECTING_SHARE * full.max(initial=0.0)))
    if len(reflecting) < pixels[0] * pixels[1] // 100 + 10:
        shows = f"{len(reflecting)} of {len(full)} pixels of the part reflect the display in posture {posture}"
        raise InputError(f"{display.name}: {shows}; move the display or tilt the part")
    surface = surface.take(reflecting)
    row, column = seen.row[reflecting], seen.column[reflecting]
    target = TARGET_SHARE * float(np.median(full[reflecting])) * _stripes(row, column, period_px)
    response = _responses(surface, own, shape, scene)
    diffuse, blocks = _diffuse_responses(surface, own, shape, scene)

    def misfit(picture: Float64) -> tuple[float, Float64]:
        means = blocks @ picture
        rest = response @ picture + diffuse @ means - target
        return 0.5 * float(rest @ rest), response.T @ rest + blocks.T @ (diffuse.T @ rest)

    start = np.full(pixels[0] * pixels[1], TARGET_SHARE)
    bounds = [(0.0, 1.0)] * len(start)
    found = minimize(misfit, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": ITERATIONS})
    pattern = InversePattern(np.clip(found.x, 0.0, 1.0).reshape(shape), display, row, column, target)
    return replace(pattern, residual=_rms(_residuals(scene, pattern)))


def tilt_residuals(scene: Scene, pattern: InversePattern, tilts: Sequence[float]) -> list[float]:
    """The pattern's residual after tilting the good part by angles [rad], about X or Y, whichever is more."""
    found: list[float] = []
    for tilt in tilts:
        turns = rotation_x(tilt), rotation_y(tilt)
        moved = (move_part(replace(scene, defects=()), turn, np.zeros(3)) for turn in turns)
        found.append(max(_rms(_residuals(one, pattern)) for one in moved))
    return found


def defects_shown(scene: Scene, pattern: InversePattern) -> list[ShownDefect]:
    """What each of the scene's defects of shape changes by itself."""
    mean, sensor = float(pattern.target.mean()), scene.sensor
    good = _residuals(replace(scene, defects=()), pattern)
    level = mean * sensor.max_level / scene.reflectance.full_scale
    shot = 0.0 if sensor.electrons_per_level is None else level / sensor.electrons_per_level
    noise = math.sqrt(sensor.read_noise_levels**2 + shot + 1.0 / 12.0)
    found: list[ShownDefect] = []
    for defect in (one for one in scene.defects if one.shape.kind in SHAPE_KINDS):
        changed = np.abs(_residuals(replace(scene, defects=(defect,)), pattern) - good)
        change = float(np.nanmax(changed))
        found.append(ShownDefect(defect.name, change, change * level / noise))
    return found


def _residuals(scene: Scene, pattern: InversePattern) -> Float64:
    # rendered image of the part as it is less the target, as a share of its mean, shape (k,); NaN where it is no more
    wanted = np.zeros((scene.camera.height, scene.camera.width), np.bool_)
    wanted[pattern.row, pattern.column] = True
    seen = _seen(scene, wanted)
    light = picture_light(_in_part_frame(seen, scene, pattern.light), pattern.picture)
    image = np.full(seen.shape, np.nan)
    image[seen.row, seen.column] = _levels(seen.surface, light, scene)
    return (image[pattern.row, pattern.column] - pattern.target) / pattern.target.mean()


def _rms(values: Float64) -> float:
    return math.sqrt(float(np.nanmean(values**2)))


def _seen(scene: Scene, wanted: Bool | None = None) -> rendering.PosturePixels:
    # clean pixels: those wanted, or those of a regular grid where they are many; defects turn their normals
    seen = rendering.trace_pixels(scene, scene.postures[0], rendering.cast_rays_at(scene))
    step = math.ceil(math.sqrt(len(seen.row) / MOST_CAMERA_PIXELS))
    chosen = (seen.row % step == 0) & (seen.column % step == 0) if wanted is None else wanted[seen.row, seen.column]
    keep = np.flatnonzero(seen.clean & chosen)
    surface = seen.surface.take(keep)
    if (marks := mark_surface(scene.defects, surface.points, surface.normals)) is not None:
        normals = surface.normals.copy()
        normals[marks.index] = marks.normals
        surface = replace(surface, normals=normals)
    return replace(seen, row=seen.row[keep], column=seen.column[keep], clean=seen.clean[keep], surface=surface)


def _in_part_frame(seen: rendering.PosturePixels, scene: Scene, display: SurfaceLight) -> SurfaceLight:
    rotation, translation = scene.stage.transform(seen.posture)
    return display.moved(rotation.T, -rotation.T @ translation)


def _levels(surface: rendering.SurfacePoints, light: SurfaceLight, scene: Scene) -> Float64:
    (diffuse,), (specular,) = rendering.light_of_channels(surface, [light], scene.reflectance)
    return scene.reflectance.R_d * diffuse + scene.reflectance.R_s * specular


def _stripes(row: Int32, column: Int32, period_px: float | None) -> Float64:
    if period_px is None:
        return np.ones(len(row))
    waves = [np.cos(2.0 * math.pi * at / period_px) for at in (row, column)]
    return 1.0 + 0.5 * TARGET_CONTRAST * (waves[0] + waves[1])


def _responses(
    surface: rendering.SurfacePoints, light: SurfaceLight, shape: tuple[int, int], scene: Scene
) -> sparse.csr_array:
    # specular level of each camera pixel per display pixel: of those in reach of the lobe about the mirrored place
    u, v, distance = rendering.mirrored_places(surface, light)
    wide, high = light.size[0] / shape[1], light.size[1] / shape[0]
    exponent = farthest_exponent(LEAST_EXPONENT, scene.reflectance.lobe)
    half = min(math.sqrt(exponent / scene.reflectance.lobe.inverse), MOST_HALF)
    reach = 2.0 * distance * math.tan(half)
    order = np.argsort(u)
    columns: list[Index] = []
    points: list[Index] = []
    values: list[Float64] = []
    one = np.zeros(shape)
    most = float(np.nanmax(reach, initial=0.0))
    for i, j in np.ndindex(shape):
        at_u, at_v = 0.5 * light.size[0] - (j + 0.5) * wide, 0.5 * light.size[1] - (i + 0.5) * high
        ends = np.searchsorted(u[order], [at_u - most - wide, at_u + most + wide])
        near = order[ends[0] : ends[1]]
        near = near[np.hypot(u[near] - at_u, v[near] - at_v) <= reach[near] + math.hypot(wide, high)]
        if len(near):
            one[i, j] = 1.0
            own = [picture_light(light, one)]
            _, (specular,) = rendering.light_of_channels(surface.take(near), own, scene.reflectance)
            one[i, j] = 0.0
            columns.append(np.full(len(near), i * shape[1] + j))
            points.append(near)
            values.append(scene.reflectance.R_s * specular)
    places = (np.concatenate(points), np.concatenate(columns))
    return sparse.csr_array((np.concatenate(values), places), shape=(len(u), shape[0] * shape[1]))


def _diffuse_responses(
    surface: rendering.SurfacePoints, light: SurfaceLight, shape: tuple[int, int], scene: Scene
) -> tuple[Float64, sparse.csr_array]:
    # diffuse level of each camera pixel per block of the display, shape (k, blocks), and the blocks' means of a picture
    rows, columns = (np.arange(count) * min(DIFFUSE_BLOCKS, count) // count for count in shape)
    block = (rows[:, None] * DIFFUSE_BLOCKS + columns[None, :]).ravel()
    numbers, block = np.unique(block, return_inverse=True)
    found = np.zeros((len(surface.points), len(numbers)))
    for number in range(len(numbers)):
        own = picture_light(light, (block == number).reshape(shape).astype(np.float64))
        found[:, number] = (
            scene.reflectance.R_d * rendering.light_of_channels(surface, [own], scene.reflectance.diffuse)[0][0]
        )
    share = 1.0 / np.bincount(block)[block]
    means = sparse.csr_array((share, (block, np.arange(len(block)))), shape=(len(numbers), len(block)))
    return found, means
