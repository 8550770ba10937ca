"""Registration, step 1: search by outline and diffuse light, whatever the reflectance."""

import math
from collections.abc import Sequence

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.run_context import Share
from lightopt.estimate.registration._observations import Observation
from lightopt.estimate.registration._pixels import PixelSet, light_at, sensor_scale, view_of_placed
from lightopt.estimate.registration._placement import Placement, PoseFrame
from lightopt.geometry import RayCaster
from lightopt.scene import Scene, screen_window, view_from_part

PIXELS = 6000
MOST_LIGHTS = 8  # pixels per posture, and lights, that are searched with
MARGIN_MM = 3.0  # pixels up to this far around the part's nominal outline are used
FIRST_SHIFT_MM = 2.5  # the search begins at the best of the nominal place and of eight this far around it

# residuals beyond this share of a typical lit level count alike: highlights are not modelled while searching
TRUNCATED = 0.4

LEAST_DIFFUSE = 0.2
LEAST_LIT = 50
FIRST_STEP_MM, FIRST_STEP_RAD = 1.0, math.radians(1.0)
SEARCH_STEPS = 80
LIKELY_TURN_RAD = math.radians(2.0)
TURN_PULL = 1e-4  # penalty of a rotation by this much: it decides where the images do not, for a body of revolution


def coarse_pixels(scene: Scene, observations: Sequence[Observation]) -> list[PixelSet]:
    """A grid of pixels on and around the part in each posture, under the longest exposure of up to eight lights."""
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
            a.ravel().astype(np.int32) for a in np.meshgrid(np.arange(left, right, step), np.arange(top, bottom, step))
        )
        mine = sorted((o for o in observations if o.posture == posture), key=lambda o: o.exposure)
        longest = list({o.light: o for o in mine}.values())
        longest = longest[:: math.ceil(len(longest) / MOST_LIGHTS)]
        sets.append(PixelSet.look_up(posture, row, column, longest, scene.sensor.black_level))
    return sets


def search_placement(
    scene: Scene,
    sets: Sequence[PixelSet],
    *,
    caster: RayCaster,
    threads: int | None = None,
    progress: Share | None = None,
) -> Placement:
    """Search the part by its outline and its diffuse light, to about a pixel, without knowing its reflectance.

    A simplex search (Nelder and Mead 1965, doi:10.1093/comjnl/7.4.308) within the greatest shift and turn.
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

    around = [FIRST_SHIFT_MM * np.array([math.cos(a), math.sin(a), 0.0]) for a in np.arange(8) * (math.pi / 4.0)]
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
