"""The first search for the part: by its outline and its diffuse light, whatever its reflectance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError, counted
from lightopt.estimate.registration._observations import Observation
from lightopt.estimate.registration._pixels import PixelSet, light_at, sensor_scale, view_of_placed
from lightopt.estimate.registration._placement import Placement
from lightopt.estimate.registration._pose import PoseFrame
from lightopt.geometry import RayCaster
from lightopt.scene import Scene, screen_window, view_from_part

Float64 = NDArray[np.float64]

PIXELS = 6000
"""Pixels per posture that the part is looked for with."""

MOST_LIGHTS = 8
"""And under so many lights."""

MARGIN_MM = 3.0
"""Pixels up to this far around the part's nominal outline are looked at."""

FIRST_SHIFT_MM = 2.5
"""The search begins at the best of the nominal place and of eight this far around it."""

TRUNCATED = 0.4
"""Residuals beyond this share of a typical lit level count alike: highlights are not modelled while searching."""

LEAST_DIFFUSE = 0.2
LEAST_LIT = 50
FIRST_STEP_MM, FIRST_STEP_RAD = 1.0, math.radians(1.0)
SEARCH_STEPS = 80
LIKELY_TURN_RAD = math.radians(2.0)
TURN_PULL = 1e-4
"""What a turn of so much adds to the misfit: it decides where images do not, of a turned part."""

CLEAR = 3.5
BLACK_SHARE = 1e-3
"""Images are black where fewer pixels than this share are this many standard deviations of noise above black."""


def coarse_pixels(scene: Scene, observations: Sequence[Observation]) -> list[PixelSet]:
    """A grid of pixels on and around the part in each posture, under the longest exposure of up to eight lights.

    Parameters
    ----------
    scene
        The part where its file has it.
    observations
        The images.
    """
    sets: list[PixelSet] = []
    for posture in dict.fromkeys(o.posture for o in observations):
        view = view_from_part(scene, posture)
        left, top, right, bottom = screen_window(view.camera, scene.mesh)
        distance = float(np.linalg.norm(view.camera.position))
        margin = math.ceil(MARGIN_MM * view.camera.image_distance / (view.camera.pixel_size * distance))
        left, top = max(0, left - margin), max(0, top - margin)
        right, bottom = min(view.camera.width, right + margin), min(view.camera.height, bottom + margin)
        if right <= left or bottom <= top:
            continue
        step = max(1, math.floor(math.sqrt((right - left) * (bottom - top) / PIXELS)))
        column, row = (
            a.ravel().astype(np.int32)
            for a in np.meshgrid(np.arange(left, right, step), np.arange(top, bottom, step))
        )
        mine = sorted((o for o in observations if o.posture == posture), key=lambda o: o.exposure)
        longest = list({o.light: o for o in mine}.values())
        longest = longest[:: math.ceil(len(longest) / MOST_LIGHTS)]
        sets.append(PixelSet.look_up(posture, row, column, longest, scene.sensor.black_level))
    return sets


def refuse_useless_images(
    scene: Scene,
    sets: Sequence[PixelSet],
    observations: Sequence[Observation],
    *,
    caster: RayCaster,
    threads: int | None = None,
) -> None:
    """Refuse images that cannot show where the part is.

    Parameters
    ----------
    scene
        The part where its file has it.
    sets
        From :func:`coarse_pixels`.
    observations
        The images.
    caster
        Of the scene's part.
    threads
        Number of threads; the result does not depend on it.

    Raises
    ------
    InputError
        The part is outside the view, or all images are saturated or black where it is expected.
    """
    where = observations[0].source.parent
    images = counted(len(observations), "image")
    shown: list[NDArray[np.bool_]] = []
    for pixels in sets:
        view = view_of_placed(scene, pixels.posture, 0.0, 0.0, 0.0)
        light, _ = light_at(scene, pixels, view, caster, threads=threads)
        shown.append(~np.isfinite(light) | (light > 0.0))
    if not any(lit.any() for lit in shown):
        raise InputError(
            f"{where}: no pixel of the {images} shows a lit surface of the part where its file has it; check the "
            "part's placement, the postures, and where the rig's camera and lights look"
        )
    lit = {p.posture: np.any(s, axis=0) for p, s in zip(sets, shown, strict=True)}
    at = {p.posture: (p.row[lit[p.posture]], p.column[lit[p.posture]]) for p in sets}
    expected = [o for o in observations if o.posture in at]
    if all(bool(o.saturated[at[o.posture]].all()) for o in expected):
        raise InputError(
            f"{where}: every pixel of the part is saturated in each of {images}: they show nothing; take them with a "
            "shorter exposure or less light"
        )
    sensor = scene.sensor
    above = sensor.black_level + CLEAR * math.sqrt(sensor.noise_variance(0.0)) + 0.5
    seen = [o.levels[at[o.posture]] for o in expected]
    if max(float(np.mean(levels > above)) if levels.size else 0.0 for levels in seen) < BLACK_SHARE:
        mean = float(np.mean([levels.mean() for levels in seen if levels.size])) - sensor.black_level
        raise InputError(
            f"{where}: the {images} are black where the part is expected: {max(mean, 0.0):.3g} sensor levels above the "
            "black level on the mean; check the lens cap, that the lights burn, and the exposure"
        )


def search_placement(
    scene: Scene,
    sets: Sequence[PixelSet],
    *,
    caster: RayCaster,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Placement:
    """Look for the part by its outline and its diffuse light; good to about a pixel, without knowing its reflectance.

    A simplex search (Nelder and Mead 1965, doi:10.1093/comjnl/7.4.308) within the greatest shift and turn.

    Parameters
    ----------
    scene
        With the lights and postures of the pixels; its reflectance is not used.
    sets
        From :func:`coarse_pixels`.
    caster
        Of the scene's part.
    threads
        Number of threads; the result does not depend on it.
    progress
        Called as the search goes on.
    """
    from scipy import optimize  # takes long to load, and a capture seldom needs it

    frame = PoseFrame.of(scene)
    done = 0

    def misfit(pose: Float64) -> float:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(1.0, done / SEARCH_STEPS))
        place = frame.placement(pose)
        lit: list[Float64] = []
        seen: list[Float64] = []
        for pixels in sets:
            view = view_of_placed(scene, pixels.posture, place.x, place.y, place.turn)
            diffuse, _ = light_at(scene, pixels, view, caster, threads=threads)
            scales = np.array([sensor_scale(scene, image) for image in pixels.images])
            known = np.isfinite(diffuse)
            lit.append((diffuse * scales[:, None])[known])
            seen.append(pixels.levels[known])
        light, level = np.concatenate(lit), np.concatenate(seen)
        bright = light > LEAST_DIFFUSE * max(float(light.max(initial=0.0)), 1e-9)
        if np.count_nonzero(bright) < LEAST_LIT:
            return 1e3
        r_d = float(np.median(level[bright] / light[bright]))
        typical = max(r_d * float(np.median(light[bright])), 1.0)
        off = float(np.mean(np.minimum(np.abs(level - r_d * light), TRUNCATED * typical))) / typical
        return off + TURN_PULL * float(pose[2] / LIKELY_TURN_RAD) ** 2

    around = [
        FIRST_SHIFT_MM * np.array([math.cos(a), math.sin(a), 0.0]) for a in np.arange(8) * (math.pi / 4.0)
    ]
    values = [misfit(np.zeros(3)), *(misfit(pose) for pose in around)]
    best = [np.zeros(3), *around][int(np.argmin(values))]
    size = np.array([FIRST_STEP_MM, FIRST_STEP_MM, FIRST_STEP_RAD])
    reach = frame.reach
    # in units of the first steps, so that one tolerance serves shifts and turn
    found = optimize.minimize(
        lambda u: misfit(u * size),
        best / size,
        method="Nelder-Mead",
        bounds=list(zip(-reach / size, reach / size, strict=True)),
        options={
            "initial_simplex": [best / size, *(best / size + step for step in np.eye(3))],
            "xatol": 0.02,
            "fatol": np.inf,
            "maxfev": SEARCH_STEPS - len(values),
        },
    )
    pose = np.asarray(found.x, np.float64) * size if float(found.fun) < values[0] else np.zeros(3)
    return frame.placement(pose)
