"""Refuse images that do not show this part on this rig, or nothing useful, and report what is wrong with them.

The criterion of :func:`refuse_mismatch` is the residual against noise, beyond what a model of the right part with a
wrong reflectance leaves. The share of variance that the model explains would be no criterion: of an evenly lit plate
there is no variance to explain.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Index
from lightopt.core.errors import InputError, counted
from lightopt.core.transforms import Posture
from lightopt.estimate.registration._observations import Observation
from lightopt.estimate.registration._placement import PixelSet, Placement, light_at, sensor_scale, view_of_placed
from lightopt.geometry import RayCaster
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene, screen_window, view_from_part

Array = NDArray[np.floating]
# the coarse search: pixels per posture, and lights
PIXELS, MOST_LIGHTS = 6000, 8
MARGIN_MM = 3.0  # pixels up to this far around the part's nominal outline are used
# images are black where fewer pixels than this share are this many standard deviations of noise above black
LEAST_BRIGHT_SHARE, CLEAR = 1e-3, 3.5
# a residual beyond the noise of more than this share of the predicted levels (root mean squares) is that of another
# part, another place or another rig: a wrong reflectance of the right part leaves less once the lights' gains are
# adjusted
MISMATCH_SHARE = 0.45
SUSPICIOUS = 0.15  # from this share on, the images of a nearly symmetric part may be mirrored or turned …
BETTER_SHARE = 0.5  # … and are where that leaves less than this share of the squared residual
LEVEL_CAP = 0.15
"""Residuals count as at most this share of the camera's range where models are compared: a defect or dust decides
nothing."""
DARK_MARGIN = 2.0  # black images are predicted where no level is brighter than so many times what is clearly not black
MOST_OF_DEFECTS = 0.05  # share of pixels whose light does not count where black is predicted
BLACK_SHARE = 0.02  # images with less than this share of the light that is predicted are black
MOST_SATURATED = 0.5  # images of which more pixels than this share are saturated are refused for that
_ALL, _REVERSED = slice(None), slice(None, None, -1)
_NO_TURN = "flip the images; a rotation, or another roll of the camera, does not undo this"
FLIPS: dict[str, tuple[tuple[slice, slice], str]] = {
    "mirrored left to right": ((_ALL, _REVERSED), _NO_TURN),
    "mirrored top to bottom": ((_REVERSED, _ALL), _NO_TURN),
    "rotated by 180°": ((_REVERSED, _REVERSED), "rotate them, or correct the camera's roll in the rig file"),
}
"""Flips of images: by name, the rows and columns that undo it, and the remedy."""


def refuse_useless_images(
    scene: Scene, observations: Sequence[Observation], *, caster: RayCaster, threads: int | None = None
) -> list[PixelSet]:
    """Refuse images that cannot show where the part is; returns pixels on and around it.

    Raises InputError: the part is outside the view, or all images are saturated or black where it is expected.
    """
    where = observations[0].source.parent
    images = counted(len(observations), "image")
    sets = _coarse_pixels(scene, observations)
    lit, _ = _coarse_prediction(scene, sets, caster, (), threads)
    if not any(pixels.any() for pixels in lit.values()):
        raise InputError(f"{where}: no pixel of the {images} shows the part lit; check placement, postures and lights")
    at = {p.posture: (p.row[lit[p.posture]], p.column[lit[p.posture]]) for p in sets}
    expected = [o for o in observations if o.posture in at]
    if all(bool(o.saturated[at[o.posture]].all()) for o in expected):
        raise InputError(f"{where}: every pixel of the part is saturated in each of {images}; expose shorter")
    seen = (o.levels[at[o.posture]] for o in expected)
    if _all_black(seen, scene.sensor.black_level + _least_bright(scene)):
        raise InputError(f"{where}: the {images} are black where the part is expected; check lens cap and lights")
    return sets


def dark_as_predicted(scene: Scene, observations: Sequence[Observation], *, threads: int | None = None) -> bool:
    """Whether all images are black where the part is, and are predicted to be, as in dark field on a polished part.

    Such images show defects, but not where the part is.
    """
    bright = _least_bright(scene)
    if not _all_black((o.levels for o in observations), scene.sensor.black_level + bright):
        return False
    sets, caster = _coarse_pixels(scene, observations), cast_rays_at(scene)
    lit, predicted = _coarse_prediction(scene, sets, caster, (scene.reflectance.sigma,), threads)
    there = [posture for posture, pixels in lit.items() if pixels.any()]
    return bool(there) and _all_black((predicted[own][:, lit[own]] for own in there), DARK_MARGIN * bright)


def shows_diffuse_light(
    scene: Scene, sets: Sequence[PixelSet], *, caster: RayCaster, threads: int | None = None
) -> bool:
    """Whether most of what is lit would be clearly brighter than black by its diffuse light alone, in some image."""
    lit, levels = _coarse_prediction(scene, sets, caster, (), threads)
    # a light from one side leaves the other dark
    own = [levels[posture][:, pixels].max(axis=0) for posture, pixels in lit.items()]
    return bool(np.median(np.concatenate(own)) > _least_bright(scene)) if any(map(len, own)) else False


def _least_bright(scene: Scene) -> float:
    # level above black from which a pixel is clearly not black
    return CLEAR * math.sqrt(scene.sensor.noise_variance(0.0)) + 0.5


def _all_black(levels: Iterable[Array], bright: float) -> bool:
    return all(not own.size or float(np.mean(own > bright)) < LEAST_BRIGHT_SHARE for own in levels)


def _coarse_prediction(
    scene: Scene, sets: Sequence[PixelSet], caster: RayCaster, sigmas: Sequence[float], threads: int | None
) -> tuple[dict[Posture, Bool], dict[Posture, Array]]:
    # by posture which pixels show the part lit at its nominal place, and their levels above black under each light,
    # shape (images, n): diffuse light, and lobes of these widths
    reflectance = scene.reflectance
    lit: dict[Posture, Bool] = {}
    levels: dict[Posture, Array] = {}
    for pixels in sets:
        view = view_of_placed(scene, pixels.posture, Placement())
        diffuse, specular = light_at(scene, pixels, view, caster, sigmas=sigmas, threads=threads)
        lit[pixels.posture] = np.any(~np.isfinite(diffuse) | (diffuse > 0.0), axis=0)
        scales = np.array([[sensor_scale(scene, image)] for image in pixels.images])
        level = reflectance.R_d * diffuse + reflectance.R_s * specular.sum(axis=0)
        levels[pixels.posture] = scales * np.nan_to_num(level)
    return lit, levels


def _coarse_pixels(scene: Scene, observations: Sequence[Observation]) -> list[PixelSet]:
    # a grid on and around the part in each posture, under the longest exposure of up to eight lights
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
        grid = np.meshgrid(np.arange(left, right, step), np.arange(top, bottom, step))
        column, row = (a.ravel().astype(np.int32) for a in grid)
        mine = sorted((o for o in observations if o.posture == posture), key=lambda o: o.exposure)
        longest = list({o.light: o for o in mine}.values())
        longest = longest[:: math.ceil(len(longest) / MOST_LIGHTS)]
        sets.append(PixelSet.look_up(posture, row, column, longest, scene.sensor.black_level))
    return sets


@dataclass(frozen=True)
class Agreement:
    """How far images are off a model: root mean squares of residual, noise and predicted level, in one unit."""

    residual: float
    noise: float
    level: float

    @property
    def excess(self) -> float:
        """Mean squared residual that the noise does not explain."""
        return max(self.residual**2 - self.noise**2, 0.0)

    @property
    def share(self) -> float:
        """Residual beyond the noise as a share of the predicted level."""
        # a level below the noise predicts nothing that the residual could be a share of
        return float(np.sqrt(self.excess)) / max(self.level, self.noise, 1e-12)

    @property
    def mismatch(self) -> bool:
        """Whether the images show something else than the model."""
        return self.share > MISMATCH_SHARE


def agreement(measured: Array, predicted: Array, noise: Array) -> Agreement:
    """Compare levels above black with a model's, both clipped where the camera clips; `noise` [standard deviation]."""
    if not measured.size:
        return Agreement(0.0, 0.0, 0.0)
    return Agreement(_rms(measured - predicted), _rms(noise), _rms(predicted))


def refuse_mismatch(level: Array, predicted: Array, limit: Array, deviation: Array, pixels: Index, where: str) -> None:
    """Refuse images that do not show this part as the model has it.

    level, predicted, limit, deviation: Levels measured and predicted, those from which a pixel is saturated, and the
        standard deviation of the noise, shape (images, H, W).
    pixels: Flat indices of the pixels to compare.
    where: The set and posture, for the message.
    Raises InputError: the residual is too large; the message names what would fit better.
    """

    def picked(images: Array) -> Array:
        return images.reshape(len(images), -1)[:, pixels].astype(np.float64)

    full = picked(limit)
    model, noise = np.clip(picked(predicted), 0.0, full), picked(deviation)

    def measured(flip: tuple[slice, slice]) -> Array:
        return np.minimum(picked(level[(slice(None), *flip)]), full)

    seen = measured((_ALL, _ALL))
    own = agreement(seen, model, noise)
    if own.share < SUSPICIOUS:
        return
    if own.level < CLEAR * own.noise:
        # in dark field, defects and dust are all the light that there is
        off = np.abs(seen - model)
        most = off <= np.quantile(off, 1.0 - MOST_OF_DEFECTS)
        if agreement(seen[most], model[most], noise[most]).share < SUSPICIOUS:
            return
    flipped = {name: agreement(measured(flip), model, noise) for name, (flip, _) in FLIPS.items()}
    best = min(flipped, key=lambda name: flipped[name].residual)
    if not flipped[best].mismatch and flipped[best].excess < BETTER_SHARE * own.excess:
        hint = f"they fit far better {best}: {FLIPS[best][1]}"
    elif own.mismatch:
        hint = _other_cause(seen, model, picked(level) >= full)
    else:
        return
    raise InputError(
        f"{where}: the images do not look like this part on this rig: measured minus predicted is {own.residual:.3g} "
        f"grey levels rms, where the noise is {own.noise:.2g} and the prediction is {own.level:.3g}; {hint}"
    )


def _other_cause(seen: Array, model: Array, full: Bool) -> str:
    # why images that are not flipped may be so far from the model
    mean, expected = float(seen.mean()), float(model.mean())
    if mean < BLACK_SHARE * expected:
        return f"they are black: {max(mean, 0.0):.3g} grey levels, predicted {expected:.3g}; check lens cap and lights"
    share = float(full.mean())
    if share > MOST_SATURATED:
        return f"{100.0 * share:.0f} % of their evaluable pixels are saturated; capture them with a shorter exposure"
    same = "check that rig, part, placement and postures are those of the images"
    return f"{same}, and fit the reflectance first (lightopt fit-specular)"


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
