"""Registration, step 2: the least-squares problem of inner pixels and of the outline."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64, Int32
from lightopt.core.least_squares import Limits
from lightopt.estimate.registration import _placement
from lightopt.estimate.registration._observations import Observation
from lightopt.estimate.registration._placement import PixelSet, Placement, PoseFrame, light_at, shares_seen
from lightopt.geometry import RayCaster
from lightopt.lights import SurfaceLight
from lightopt.rendering import MARGIN_PX, STEADY, mask_pixels
from lightopt.scene import Scene

# pixels per posture: away from silhouettes and creases, also in the first stage, and across silhouettes
INNER_PIXELS, FIRST_INNER_PIXELS, OUTLINE_PIXELS = 12_000, 3_000, 800
MOST_ENTRIES = 15_000_000  # entries of the Jacobian; with many images fewer pixels of each are used
OUTLINE_HALF_WIDTH_PX = 2
OUTLINE_RAYS = 9  # rays of a pixel that the outline crosses
# an edge pixel is this share of the contrast off its prediction, since images are sampled at points or blurred
OUTLINE_SHARE = 0.3
OUTLINE_PX = 0.3  # accuracy of what the outline alone determines, however many pixels it crosses: they are off together
LEAST_CORRELATION = 0.5  # an outline is used where predicted and measured levels across it correlate by more than this
CLEAR = 3.5  # only pixels are used that the model has this many standard deviations clear of black and of saturation
GAIN_SPREAD, DARK_SPREAD = 0.3, 3.0
"""Lights are about as bright as the rig says, within this share, and black is as black within these sensor levels: only
images that show it move them."""
LYING = (1.0, math.radians(1.0), math.radians(1.0))
"""A part lies within this of its place in height [mm] and in both tilts [rad]."""
# parameters: ln R_d, ln R_s, ln σ, ln of each light's gain, dark level [sensor level], after the pose
R_D, R_S, SIGMA, GAINS = 0, 1, 2, 3
# differences are taken so far to both sides [px]: an outline must cross some rays; and over much less, the facets of a
# round part would seem to determine its turn
_INNER_STEP, _OUTLINE_STEP = 0.5, 0.7
_SIGMA_STEP = 0.003
# derivatives by pose and σ, which take two evaluations each, are reused for parameters so near to where they were taken
_CACHE_PX, _CACHE_LOG_SIGMA = 0.1, 0.02


def choose_pixels(
    scene: Scene,
    images: Sequence[Observation],
    placement: Placement,
    *,
    outline: bool,
    reduced: bool = False,  # whether fewer pixels are enough, for the first stage or a rough placement
    threads: int | None = None,
) -> tuple[list[PixelSet], list[PixelSet]]:
    """Inner pixels, and pixels across the outline where `outline`; one set per posture that shows any."""
    placed = _placement.place_part(scene, placement)
    caster = RayCaster(placed.mesh.vertices, placed.mesh.faces)
    inner: list[PixelSet] = []
    edges: list[PixelSet] = []
    most = FIRST_INNER_PIXELS if reduced else INNER_PIXELS
    budget = max(200, min(most, MOST_ENTRIES // (len(images) * (len(scene.lights) + GAINS + 4))))
    for posture in dict.fromkeys(o.posture for o in images):
        mine = [o for o in images if o.posture == posture]
        masks = mask_pixels(placed, posture, caster, threads=threads)
        row, column = random_pixels(masks.clean, budget)
        if len(row):
            inner.append(PixelSet.look_up(posture, row, column, mine, scene.sensor.black_level))
        if outline:
            row, column = _across_outline(masks.hit)
            if len(row):
                edges.append(PixelSet.look_up(posture, row, column, mine, scene.sensor.black_level, rays=OUTLINE_RAYS))
    return inner, edges


def random_pixels(mask: Bool, most: int) -> tuple[Int32, Int32]:
    """Rows and columns of so many pixels of a mask, the same each time, or of all where they are fewer."""
    index = _placement.random_some(np.flatnonzero(mask), most)
    row, column = np.unravel_index(index, mask.shape)
    return row.astype(np.int32), column.astype(np.int32)


def _across_outline(hit: Bool) -> tuple[Int32, Int32]:
    from scipy import ndimage  # takes long to load, and a capture seldom needs it

    reach = OUTLINE_HALF_WIDTH_PX
    wide: Bool = np.asarray(ndimage.binary_dilation(hit, iterations=reach), np.bool_)
    # the image's border is no outline
    narrow: Bool = np.asarray(ndimage.binary_erosion(hit, iterations=reach, border_value=1), np.bool_)
    return random_pixels(wide & ~narrow, OUTLINE_PIXELS)


class RefinementProblem:
    """The problem that :func:`lightopt.core.least_squares.solve` solves in each stage.

    Which pixels count is decided once, by what the model predicts at the `start`, shape (K,).
    """

    def __init__(
        self,
        scene: Scene,
        frame: PoseFrame,
        inner: Sequence[PixelSet],
        edges: Sequence[PixelSet],
        start: Float64,
        *,
        caster: RayCaster,
        threads: int | None = None,
    ) -> None:
        self._scene, self._frame, self._caster, self._threads = scene, frame, caster, threads
        self._poses = frame.freedoms
        self._sets = [*inner, *edges]
        names = [light.name for light in scene.lights]
        lights = [_per_observation(p, [names.index(o.light) for o in p.images]) for p in self._sets]
        self._light = _joined(lights).astype(np.intp)
        scales = [[_placement.sensor_scale(scene, o) for o in p.images] for p in self._sets]
        self._scale = _joined([_per_observation(*one) for one in zip(self._sets, scales, strict=True)])
        self._measured = _joined([p.levels.ravel() for p in self._sets])
        frames = _joined([_per_observation(p, [float(o.frames) for o in p.images]) for p in self._sets])
        parts = ((np.broadcast_to(o.subtracted, o.levels.shape), p) for p in self._sets for o in p.images)
        subtracted = _joined([image[p.row, p.column].astype(np.float64) for image, p in parts])
        self.correlated = _joined([np.full(p.levels.size, p.rays > 1) for p in self._sets], np.bool_)
        self.weight = np.ones(len(self._measured))
        self._derivative_cache: tuple[Placement, float, list[Float64]] | None = None
        # Inner pixels see of the lights what they see at the start: the cost jumps where a pixel is lost on the way.
        # Those that will see less are few, and outliers.
        sigma = math.exp(start[self._poses + SIGMA])
        held = [self._shares_seen(pixels, start, sigma=sigma) for pixels in inner]
        self._shares: list[Float64 | None] = [*held, *[None] * len(edges)]
        self._light_cache = start.copy(), self._layers(start)
        self._used = np.ones(len(self._measured), np.bool_)
        self._noise = np.ones(len(self._measured))
        sensor = scene.sensor
        self._top = sensor.saturated_from - sensor.black_level - subtracted
        here = self._levels(start)
        noise = np.sqrt(sensor.noise_variance(np.where(np.isfinite(here), here, 0.0), frames=frames))
        full = _joined([p.saturated.ravel() for p in self._sets], np.bool_)
        inside = (here + CLEAR * noise < self._top) & (here + sensor.black_level > CLEAR * noise)
        lost = np.zeros(len(here), np.bool_)
        lost[: sum(pixels.levels.size for pixels in inner)] = self._beside_shadows(inner, held, start)
        self._used = np.isfinite(here) & ~full & (self.correlated | (inside & ~lost))
        self._noise = noise
        if len(edges):
            self._weigh_outline(start, here)

    def residuals(self, x: Float64) -> Float64:
        """Measured minus predicted in standard deviations, shape (n,); NaN where nothing is predicted."""
        return np.where(self._used, (self._measured - self._levels(x)) / self._noise, np.nan)

    def slopes(self, x: Float64) -> Float64:
        """Derivatives of the predictions, in standard deviations, shape (n, K)."""
        own = x[self._poses :]
        light, spread = self._light_at(x), np.exp(own[[R_D, R_S]])
        gain = self._scale * np.exp(own[GAINS:-1])[self._light]
        found = np.zeros((len(self._measured), len(x)))
        of_light = found[:, self._poses :]
        of_light[:, R_D] = gain * spread[0] * light[0]
        of_light[:, R_S] = gain * spread[1] * light[1]
        of_light[np.arange(len(found)), GAINS + self._light] = of_light[:, R_D] + of_light[:, R_S]
        of_light[:, -1] = 1.0
        *of_pose, of_sigma = self._light_derivatives(x)
        of_light[:, SIGMA] = gain * spread[1] * of_sigma[1]
        for axis, change in enumerate(of_pose):
            found[:, axis] = gain * (spread[0] * change[0] + spread[1] * change[1])
        return found / self._noise[:, None]

    def _light_derivatives(self, x: Float64) -> list[Float64]:
        # of the light per unit of R_d and of R_s with each of the pose, and with ln σ, of shape (2, n)
        place, log_sigma = self._frame.placement(x[: self._poses]), float(x[self._poses + SIGMA])
        if self._derivative_cache is not None:
            at, before, known = self._derivative_cache
            moved = self._frame.distance_px(at, place)
            if moved < _CACHE_PX and abs(log_sigma - before) < _CACHE_LOG_SIGMA:
                return known
        steps = self._frame.pixel_steps
        width = np.where(self.correlated, _OUTLINE_STEP, _INNER_STEP)
        found: list[Float64] = []
        for axis, off in enumerate(np.eye(self._poses)):
            ahead, behind = (self._layers(x, off=sign * off * steps) for sign in (1.0, -1.0))
            found.append((ahead - behind) / (2.0 * width * steps[axis]))
        _, wider, narrower = self._layers(x, wider=(_SIGMA_STEP, -_SIGMA_STEP))
        found.append(np.stack([np.zeros_like(wider), (wider - narrower) / (2.0 * _SIGMA_STEP)]))
        self._derivative_cache = place, log_sigma, found
        return found

    def _levels(self, x: Float64) -> Float64:
        light, own = self._light_at(x), x[self._poses :]
        gain = self._scale * np.exp(own[GAINS:-1])[self._light]
        return np.minimum(gain * (math.exp(own[R_D]) * light[0] + math.exp(own[R_S]) * light[1]) + own[-1], self._top)

    def _light_at(self, x: Float64) -> Float64:
        # per unit of R_d and of R_s, shape (2, n)
        if not np.array_equal(self._light_cache[0], x):
            self._light_cache = x.copy(), self._layers(x)
        return self._light_cache[1]

    def _layers(self, x: Float64, *, off: Float64 | None = None, wider: Sequence[float] = (0.0,)) -> Float64:
        # per unit of R_d, and of R_s for so much more ln σ each, shape (1 + len(wider), n), moved by `off` pixels
        sigmas = [math.exp(x[self._poses + SIGMA] + more) for more in wider]
        parts = [np.zeros((1 + len(sigmas), 0))]
        for pixels, shares in zip(self._sets, self._shares, strict=True):
            width = _OUTLINE_STEP if pixels.rays > 1 else _INNER_STEP
            place = self._frame.placement(x[: self._poses] + (0.0 if off is None else width * off))
            view = _placement.view_of_placed(self._scene, pixels.posture, place)
            diffuse, specular = light_at(
                self._scene, pixels, view, self._caster, sigmas=sigmas, shares=shares, threads=self._threads
            )
            parts.append(np.concatenate([diffuse[None], specular]).reshape(1 + len(sigmas), -1))
        return np.concatenate(parts, axis=1)

    def _shares_seen(self, pixels: PixelSet, x: Float64, *, sigma: float | None = None) -> Float64:
        place = self._frame.placement(x[: self._poses])
        view = _placement.view_of_placed(self._scene, pixels.posture, place)
        return shares_seen(self._scene, pixels, view, self._caster, sigma=sigma, threads=self._threads)

    def _beside_shadows(self, inner: Sequence[PixelSet], held: Sequence[Float64], start: Float64) -> Bool:
        # whether a pixel that lies a little further sees another share of a light: beside the edge of a shadow a level
        # has no slope. Shadows of panels have sharp edges; those of other lights may be wide, and are held all the same
        panels = {light.name for light in self._scene.lights if not isinstance(light, SurfaceLight)}
        found = [np.zeros(0, np.bool_)]
        for pixels, (seen, _) in zip(inner, held, strict=True):
            of_panel = np.array([[image.light in panels] for image in pixels.images])
            differs = np.zeros(seen.shape, np.bool_)
            for own, reach in ((of_panel, _INNER_STEP), (~of_panel, MARGIN_PX)):
                if not own.any():
                    continue
                here = seen if own is of_panel else self._shares_seen(pixels, start)[0]
                for step in np.diag(reach * self._frame.pixel_steps):
                    for sign in (1.0, -1.0):
                        moved = start.copy()
                        moved[: self._poses] += sign * step
                        there = self._shares_seen(pixels, moved)[0]
                        off = np.abs(there - here) > STEADY * np.maximum(there, here)
                        differs |= own & (off | np.isnan(there))
            found.append(differs.ravel())
        return np.concatenate(found)

    def _weigh_outline(self, start: Float64, here: Float64) -> None:
        # an outline that the images show counts as much as one that is known to OUTLINE_PX
        edge = self.correlated & self._used
        contrast = np.zeros(len(here))
        begin = 0
        for pixels in self._sets:
            size = pixels.levels.size
            if pixels.rays > 1:
                mine = here[begin : begin + size].reshape(pixels.levels.shape)
                bright = [float(np.median(row[row > 0.0])) if np.any(row > 0.0) else 0.0 for row in mine]
                contrast[begin : begin + size] = _per_observation(pixels, bright)
            begin += size
        edge &= contrast > CLEAR * self._noise
        self._noise = np.where(edge, np.hypot(OUTLINE_SHARE * contrast, self._noise), self._noise)
        self._used &= edge | ~self.correlated
        self.weight = np.where(self.correlated, 0.0, 1.0)
        if not edge.any():
            return
        predicted, seen = here[edge] / contrast[edge], self._measured[edge] / contrast[edge]
        seen = np.clip(seen, 0.0, 3.0)
        spread = float(np.std(predicted) * np.std(seen))
        covariance = float(np.mean((predicted - predicted.mean()) * (seen - seen.mean())))
        if spread <= 0.0 or covariance < LEAST_CORRELATION * spread:
            self._used &= ~self.correlated
            return
        slopes = np.where(edge[:, None], self.slopes(start)[:, :2], 0.0) * self._frame.pixel
        slopes = np.where(np.isfinite(slopes), slopes, 0.0)
        most = float(np.linalg.eigvalsh(slopes.T @ slopes)[-1])
        if most > 0.0:
            self.weight = np.where(self.correlated, min(1.0, 1.0 / (OUTLINE_PX**2 * most)), 1.0)


def _joined(parts: Sequence[NDArray[Any]], dtype: type[np.generic] = np.float64) -> NDArray[Any]:
    return np.concatenate([np.zeros(0, dtype), *parts])


def _per_observation(pixels: PixelSet, values: Sequence[float]) -> Float64:
    return np.repeat(np.asarray(values, np.float64), len(pixels.row))


def start_parameters(scene: Scene, frame: PoseFrame, placement: Placement) -> Float64:
    """Parameters with the scene's reflectance, gains of 1 and no dark level, shape (K,)."""
    own = scene.reflectance
    r_d, r_s = max(own.R_d, _placement.LEAST_R_D), max(own.R_s, _placement.LEAST_R_S)
    of_surface = map(math.log, (r_d, r_s, own.sigma))
    return np.array([*frame.pose(placement), *of_surface, *np.zeros(len(scene.lights)), 0.0])


def parameter_limits(scene: Scene, frame: PoseFrame, start: Float64) -> Limits:
    """Where the parameters may go: around nominal poses, around the reflectance at the start."""
    lights = len(scene.lights)
    poses = frame.freedoms
    nominal = start.copy()
    nominal[:poses] = 0.0
    nominal[poses + GAINS :] = 0.0
    steps = 3.0 * frame.pixel_steps
    return Limits(
        nominal=nominal,
        reach=np.array([*frame.reach, 4.0, 6.0, 1.5, *[math.log(4.0)] * lights, 10.0 * DARK_SPREAD]),
        step=np.array([*steps, 0.5, 1.0, 0.3, *[0.3] * lights, DARK_SPREAD]),
        prior=np.array([*[np.inf] * 3, *LYING[: poses - 3], 2.0, 3.0, 1.0, *[GAIN_SPREAD] * lights, DARK_SPREAD]),
        resolution=np.array([*frame.resolution, *[np.inf] * (lights + 4)]),
    )
