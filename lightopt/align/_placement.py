"""Where on the stage the part really lies: shifted by a millimetre, turned by a degree.

A shifted and turned part is not a shifted and turned image: its normals turn under lights that stay. So the part is
moved, and its pixels are traced anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.align._observations import Observation
from lightopt.align._pixels import PixelSet, light_at, sensor_scale, view_of_placed
from lightopt.raycast import RayCaster
from lightopt.rendering import trace_pixels
from lightopt.scene import Scene, move_part, screen_window, view_from_part
from lightopt.transforms import rotation_z

__all__ = ["Placement", "find_placement", "place_part", "refine_placement"]

Float64 = NDArray[np.float64]

COARSE_PIXELS = 6000
FINE_PIXELS = 12_000
"""Pixels per posture that the part is looked for with, and that its place is refined with."""

REACH_MM = 3.0
"""Pixels up to this far around the part's nominal outline are looked at."""

TRUNCATED = 0.4
"""Residuals beyond this share of a typical lit level count alike: highlights are not modelled while searching."""

LEAST_DIFFUSE = 0.2
FIRST_STEP_MM, FIRST_STEP_RAD = 1.0, math.radians(1.0)
SEARCH_STEPS = 70
REFINE_STEPS = 8
TUKEY = 4.685
LEAST_SPREAD = 0.3
LIKELY_TURN_RAD = math.radians(2.0)
"""A part lies about this far turned from where its file has it. It decides where images do not: of a turned part."""

TURN_PULL = 1e-4
"""What a turn of so much adds to the misfit while searching."""

CLEAR = 3.5
"""Only pixels are looked at that the model has this many standard deviations clear of black and of saturation."""

_DIFFERENCES = (0.01, 0.01, math.radians(0.01))


@dataclass(frozen=True, kw_only=True)
class Placement:
    """How a part lies on the stage, from where rig and part file have it.

    Attributes
    ----------
    x, y
        Shift in the plane of the stage's plate, world axes at posture (0, 0) [mm].
    turn
        About the stage's own axis [rad].
    errors
        Standard errors of the three, in the same order; 0 where not known.
    """

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0
    errors: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def as_dict(self) -> dict[str, float]:
        """JSON form."""
        return {
            "x_mm": float(f"{self.x:.6g}"),
            "y_mm": float(f"{self.y:.6g}"),
            "turn_deg": float(f"{math.degrees(self.turn):.6g}"),
            "x_error_mm": float(f"{self.errors[0]:.3g}"),
            "y_error_mm": float(f"{self.errors[1]:.3g}"),
            "turn_error_deg": float(f"{math.degrees(self.errors[2]):.3g}"),
        }


def place_part(scene: Scene, placement: Placement) -> Scene:
    """The scene with its part where it really lies."""
    turn = rotation_z(placement.turn)
    shift = scene.pivot - turn @ scene.pivot + np.array([placement.x, placement.y, 0.0])
    return move_part(scene, turn, shift)


def find_placement(
    scene: Scene,
    observations: Sequence[Observation],
    *,
    caster: RayCaster,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Placement:
    """Look for the part by its outline and its diffuse light; good to about a pixel, without knowing its reflectance.

    Parameters
    ----------
    scene
        With the lights and postures of the observations; its reflectance is not used.
    observations
        The images.
    caster
        Of the scene's part.
    threads
        Number of threads; the result does not depend on it.
    progress
        Called as the search goes on.
    """
    sets = [_around_part(scene, images) for images in _postures(observations)]

    def misfit(p: Float64) -> float:
        lit: list[Float64] = []
        seen: list[Float64] = []
        for pixels in sets:
            view = view_of_placed(scene, pixels.posture, p[0], p[1], p[2])
            diffuse, _ = light_at(scene, pixels, view, caster, sigma=None, threads=threads)
            scales = np.array([sensor_scale(scene, image) for image in pixels.images])
            known = np.isfinite(diffuse)
            lit.append((diffuse * scales[:, None])[known])
            seen.append(pixels.levels[known])
        light, level = np.concatenate(lit), np.concatenate(seen)
        bright = light > LEAST_DIFFUSE * max(float(light.max()), 1e-9)
        if np.count_nonzero(bright) < 50:
            return math.inf
        r_d = float(np.median(level[bright] / light[bright]))
        typical = max(r_d * float(np.median(light[bright])), 1.0)
        off = float(np.mean(np.minimum(np.abs(level - r_d * light), TRUNCATED * typical))) / typical
        return off + TURN_PULL * float(p[2] / LIKELY_TURN_RAD) ** 2

    found = _simplex(misfit, np.array([FIRST_STEP_MM, FIRST_STEP_MM, FIRST_STEP_RAD]), progress)
    return Placement(x=float(found[0]), y=float(found[1]), turn=float(found[2]))


def refine_placement(
    scene: Scene,
    observations: Sequence[Observation],
    start: Placement,
    *,
    caster: RayCaster,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Placement:
    """Refine a placement by the light of the part's inner pixels, highlights included; to a small part of a pixel.

    R_d, R_s and σ are adjusted along, since those of a misplaced part are never quite right. Where the images do not
    tell the turn, as of a part that is a body of revolution, it is about 0, and its error says so. A pixel counts by
    the sensor's variance of its level. Which pixels count at all is told by the model and not by what noise made of
    them: those just below saturation that are not saturated are the darker ones.

    Parameters
    ----------
    scene
        The part where its file has it, with a reflectance that is about right.
    observations
        The images.
    start
        From :func:`find_placement`.
    caster
        Of the scene's part.
    threads
        Number of threads; the result does not depend on it.
    progress
        Called as the refinement goes on.
    """
    placed = place_part(scene, start)
    placed_caster = RayCaster(placed.mesh.vertices, placed.mesh.faces)
    sets = [_inner(placed, placed_caster, images, threads) for images in _postures(observations)]
    own = scene.reflectance
    p = np.array([start.x, start.y, start.turn, own.R_d, math.log(max(own.R_s, 1e-6)), math.log(own.sigma)])
    steps = np.array([*_DIFFERENCES, 0.01 * max(own.R_d, 1.0), 0.01, 0.003])
    top = scene.sensor.saturated_from - scene.sensor.black_level
    measured = np.concatenate([pixels.levels.ravel() for pixels in sets])
    full = np.concatenate([pixels.saturated.ravel() for pixels in sets])

    def predict(q: Float64) -> Float64:
        parts: list[Float64] = []
        for pixels in sets:
            view = view_of_placed(scene, pixels.posture, q[0], q[1], q[2])
            d, s = light_at(scene, pixels, view, caster, sigma=math.exp(q[5]), threads=threads)
            scales = np.array([sensor_scale(scene, image) for image in pixels.images])
            parts.append((scales[:, None] * (q[3] * d + math.exp(q[4]) * s)).ravel())
        return np.concatenate(parts)

    errors = (0.0, 0.0, 0.0)
    sensor = scene.sensor
    for done in range(REFINE_STEPS):
        here = predict(p)
        noise = np.sqrt(sensor.noise_variance(here))
        slopes = np.stack(
            [(predict(p + h) - predict(p - h)) / (2.0 * h[i]) for i, h in enumerate(np.diag(steps))], axis=1
        )
        usable = np.isfinite(here) & np.isfinite(slopes).all(axis=1) & ~full
        usable &= (here + CLEAR * noise < top) & (here + sensor.black_level > CLEAR * noise)
        residual, jacobian = ((measured - here) / noise)[usable], slopes[usable] / noise[usable, None]
        spread = max(1.4826 * float(np.median(np.abs(residual))), LEAST_SPREAD)
        off = np.square(residual / (TUKEY * spread))
        weight = np.square(np.clip(1.0 - off, 0.0, None))
        scale = np.sqrt(np.maximum(np.sum(weight[:, None] * jacobian**2, axis=0), 1e-12))
        normal = (jacobian * weight[:, None]).T @ jacobian / np.outer(scale, scale)
        normal += 1e-9 * np.eye(len(p))
        pull = jacobian.T @ (weight * residual) / scale
        held = (spread / (LIKELY_TURN_RAD * scale[2])) ** 2
        normal[2, 2] += held
        pull[2] -= held * scale[2] * p[2]
        change = np.linalg.solve(normal, pull) / scale
        change[3:] = np.clip(change[3:], [-0.3 * p[3] - 1e-9, -1.0, -0.3], [0.3 * p[3] + 1e-9, 1.0, 0.3])
        p = p + change
        deviations = _deviations(jacobian, weight * residual, _bend(off))
        errors = (float(deviations[0]), float(deviations[1]), float(deviations[2]))
        if progress is not None:
            progress((done + 1) / REFINE_STEPS)
        if np.all(np.abs(change[:3]) < 0.05 * deviations[:3]):
            break
    return Placement(x=float(p[0]), y=float(p[1]), turn=float(p[2]), errors=errors)


def _bend(off: Float64) -> Float64:
    # slope of Tukey's ψ(r) = r·(1 − off)², off = (r / c)²
    return np.where(off < 1.0, (1.0 - off) * (1.0 - 5.0 * off), 0.0)


def _deviations(jacobian: Float64, pull: Float64, bend: Float64) -> Float64:
    # of an M-estimate: Huber 1973, doi:10.1214/aos/1176342503, each pixel with the variance that it shows
    scale = np.sqrt(np.maximum(np.sum(jacobian**2, axis=0), 1e-12))
    unit = jacobian / scale
    inner = np.linalg.inv((unit * bend[:, None]).T @ unit + 1e-9 * np.eye(len(scale)))
    middle = (unit * np.square(pull)[:, None]).T @ unit
    return np.sqrt(np.maximum(np.diag(inner @ middle @ inner), 0.0)) / scale


def _postures(observations: Sequence[Observation]) -> list[Sequence[Observation]]:
    return [
        [o for o in observations if o.posture == posture]
        for posture in dict.fromkeys(o.posture for o in observations)
    ]


def _around_part(scene: Scene, images: Sequence[Observation]) -> PixelSet:
    # a grid of pixels on and around the part
    posture = images[0].posture
    view = view_from_part(scene, posture)
    left, top, right, bottom = screen_window(view.camera, scene.mesh)
    distance = float(np.linalg.norm(view.camera.position))
    margin = math.ceil(REACH_MM * view.camera.image_distance / (view.camera.pixel_size * distance))
    left, top = max(0, left - margin), max(0, top - margin)
    right, bottom = min(view.camera.width, right + margin), min(view.camera.height, bottom + margin)
    step = max(1, math.floor(math.sqrt((right - left) * (bottom - top) / COARSE_PIXELS)))
    column, row = (
        a.ravel().astype(np.int32)
        for a in np.meshgrid(np.arange(left, right, step), np.arange(top, bottom, step))
    )
    # one image per light, that of the longest exposure
    longest = {o.light: o for o in sorted(images, key=lambda o: o.exposure)}
    return PixelSet.look_up(posture, row, column, list(longest.values()), scene.sensor.black_level)


def _inner(
    scene: Scene,
    caster: RayCaster,
    images: Sequence[Observation],
    threads: int | None,
) -> PixelSet:
    # pixels away from silhouettes and creases
    pixels = trace_pixels(scene, images[0].posture, caster, threads=threads)
    clean = np.flatnonzero(pixels.clean)
    if len(clean) > FINE_PIXELS:
        clean = np.sort(np.random.default_rng(0).choice(clean, FINE_PIXELS, replace=False))
    return PixelSet.look_up(
        images[0].posture, pixels.row[clean], pixels.column[clean], images, scene.sensor.black_level
    )


def _simplex(
    misfit: Callable[[Float64], float], size: Float64, progress: Callable[[float], None] | None
) -> Float64:
    # Nelder and Mead 1965, doi:10.1093/comjnl/7.4.308, from the nominal place
    corners = [np.zeros(3), *np.diag(size)]
    values = [misfit(corner) for corner in corners]
    done = len(corners)
    while True:
        order = np.argsort(values)
        corners, values = [corners[i] for i in order], [values[i] for i in order]
        extent = np.max(np.abs(np.array(corners[1:]) - corners[0]) / size)
        if done >= SEARCH_STEPS or extent < 0.005:
            return corners[0]
        middle = np.mean(corners[:-1], axis=0)
        reflected = 2.0 * middle - corners[-1]
        value = misfit(reflected)
        if value < values[0]:
            further = 3.0 * middle - 2.0 * corners[-1]
            beyond = misfit(further)
            corners[-1], values[-1] = (further, beyond) if beyond < value else (reflected, value)
        elif value < values[-2]:
            corners[-1], values[-1] = reflected, value
        else:
            inner = 0.5 * (middle + (reflected if value < values[-1] else corners[-1]))
            closer = misfit(inner)
            if closer < min(value, values[-1]):
                corners[-1], values[-1] = inner, closer
            else:
                corners = [corners[0], *(0.5 * (corner + corners[0]) for corner in corners[1:])]
                values = [values[0], *(misfit(corner) for corner in corners[1:])]
        done += 1
        if progress is not None:
            progress(min(1.0, done / SEARCH_STEPS))
