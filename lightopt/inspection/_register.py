"""Laying the model over the images of a set: where the part lies, how bright lights are, whether it is this part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lightopt.align import (
    Observation,
    Placement,
    find_placement,
    observed_postures,
    place_part,
    read_observations,
    refine_placement,
)
from lightopt.config import PartConfig, RigConfig
from lightopt.errors import InputError
from lightopt.images import ImageSet
from lightopt.kernels import kernel
from lightopt.rendering import cast_rays_at, in_threads
from lightopt.scene import Scene, build_scene
from lightopt.transforms import Posture

__all__ = [
    "DARK_SPREAD",
    "GAIN_SPREAD",
    "Photometry",
    "fit_photometry",
    "good_part",
    "lay_over",
    "refuse_another_part",
]

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]
Progress = Callable[[str, float], None]
"""Called with what is going on and the share of it that is done, 0 to 1."""

PIXELS_PER_IMAGE = 40_000
HUBER = 1.5
ROUNDS = 12
GAIN_SPREAD = 0.3
DARK_SPREAD = 3.0
"""Lights are about as bright as the rig says, within this share, and black is as black within these sensor levels: only
images that say so move them."""

MOST_GAIN = 4.0
"""Lights that seem to be further from what the rig says, up or down, are not believed."""

STRANGER_R2 = 0.6
"""Images of which the model explains less than this share of the variance do not show this part as it lies here."""

SURE_R2 = 0.95
"""Of images of which the model explains less than this, those of a nearly symmetric part may be mirrored or turned …"""

FAR_BETTER = 0.5
"""… and are where that leaves less than this share of what the model does not explain."""

TURNED = "turned by 180°"

BLACK_SHARE = 0.02
"""Images with less than this share of the light that is predicted are black."""

MOST_FULL = 0.5
"""Images of which more pixels than this share are saturated are refused for that."""

LEAST_RELIEF = 4.0
"""Images whose levels vary by less than so many standard deviations of noise say nothing of which part they show."""


@dataclass(frozen=True, kw_only=True)
class Photometry:
    """Brightness of the lights and of black, as the images have them.

    Attributes
    ----------
    gains
        By name of the light: measured over predicted brightness.
    dark
        Above the rig's black level [sensor level].
    """

    gains: dict[str, float]
    dark: float


def good_part(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    known: dict[tuple[tuple[Posture, ...], tuple[str, ...]], Scene] | None = None,
    threads: int | None = None,
) -> tuple[Scene, tuple[Observation, ...]]:
    """The part without defects where its file has it, under the lights and in the postures of a set, and the images.

    Parameters
    ----------
    rig, part, image_set
        What the images show.
    known
        Scenes of the same rig and part by postures and lights, to take and to add to: reading a mesh takes its time.
    threads
        Number of threads; the result does not depend on it.
    """
    observations = read_observations(image_set, rig, part, threads=threads)
    used = {o.light for o in observations}
    names = tuple(light.name for light in rig.lights if light.name in used)
    key = observed_postures(image_set), names
    known = {} if known is None else known
    if key not in known:
        known[key] = build_scene(rig, part, postures=key[0], lights=names, defects=False)
    return known[key], observations


def lay_over(
    scene: Scene,
    observations: Sequence[Observation],
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> tuple[Scene, Placement]:
    """The scene with its part where the images show it, and how far that is from where its file has it.

    Parameters
    ----------
    scene, observations
        From :func:`good_part`.
    threads
        Number of threads; the result does not depend on it.
    progress
        Called as the search goes on.
    """

    def stage(name: str) -> Callable[[float], None] | None:
        return None if progress is None else partial(progress, name)

    caster = cast_rays_at(scene)
    start = find_placement(
        scene, observations, caster=caster, threads=threads, progress=stage("finding the part")
    )
    found = refine_placement(
        scene,
        observations,
        replace(start, errors=(0.0, 0.0, 0.0)),
        caster=caster,
        threads=threads,
        progress=stage("refining the part's place"),
    )
    return place_part(scene, found), found


def fit_photometry(
    observations: Sequence[Observation],
    predicted: Sequence[Float32],
    clean: Bool,
    scene: Scene,
    *,
    threads: int | None = None,
) -> Photometry:
    """Gain of each light and a common dark level, by robust least squares over pixels that are neither black nor full.

    Parameters
    ----------
    observations
        The images, of one posture.
    predicted
        Of each, levels of the good part [grey level at exposure 1], shape (H, W).
    clean
        The pixels to look at, shape (H, W).
    scene
        For the sensor and the names of the lights.
    threads
        Number of threads; the result does not depend on it.
    """
    names = [light.name for light in scene.lights]
    n = len(names)

    def sample(number: int) -> tuple[int, Float64, Float64, Float64]:
        o = observations[number]
        return names.index(o.light), *_sample(scene, o, predicted[number], clean)

    rows = in_threads(sample, range(len(observations)), threads)
    x = np.append(np.ones(n), 0.0)
    held = np.append(np.full(n, 1.0 / GAIN_SPREAD**2), 1.0 / DARK_SPREAD**2)
    nominal = x.copy()
    for _ in range(ROUNDS):
        normal, right = np.diag(held), held * nominal
        for light, model, level, noise in rows:
            if not len(model):
                continue
            off = np.abs(level - x[light] * model - x[n]) / noise
            spread = max(1.4826 * float(np.median(off)), 1.0)
            square, both, count, seen, total = _huber_sums(off, model, level, noise, HUBER * spread)
            normal[light, light] += square
            normal[n, n] += count
            normal[light, n] += both
            normal[n, light] += both
            right[light] += seen
            right[n] += total
        x = np.linalg.solve(normal, right)
    if not np.all((x[:n] >= 1.0 / MOST_GAIN) & (x[:n] <= MOST_GAIN)):
        x = nominal  # not these lights, or not this part: what is told of the images must not hide that
    return Photometry(gains={name: float(g) for name, g in zip(names, x[:n], strict=True)}, dark=float(x[n]))


def _sample(
    scene: Scene, o: Observation, predicted: Float32, clean: Bool
) -> tuple[Float64, Float64, Float64]:
    # predicted and measured levels above black and the noise, at pixels that are neither black nor full
    sensor = scene.sensor
    index = np.flatnonzero(clean & ~o.saturated)
    index = index[:: max(1, len(index) // PIXELS_PER_IMAGE)]
    scale = np.float32(o.exposure * sensor.max_level / scene.reflectance.full_scale)
    model = (predicted.ravel()[index] * scale).astype(np.float64)
    noise = np.sqrt(sensor.noise_variance(model, frames=o.frames))
    taken = np.broadcast_to(np.float32(o.subtracted), predicted.shape).reshape(-1)[index]
    top = sensor.saturated_from - sensor.black_level - taken
    usable = (model + 4.0 * noise < top) & (model > 4.0 * noise)
    level = o.levels.ravel()[index].astype(np.float64) - sensor.black_level
    return model[usable], level[usable], noise[usable]


@kernel
def _huber_sums(
    off: Float64, model: Float64, level: Float64, noise: Float64, reach: float
) -> tuple[float, float, float, float, float]:
    # with Huber's weights w: sums of w·m², w·m, w, w·m·level, w·level
    square, both, count, seen, total = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(off)):
        weight = min(1.0, reach / max(off[i], 1e-9)) / (noise[i] * noise[i])
        weighted = weight * model[i]
        square += weighted * model[i]
        both += weighted
        count += weight
        seen += weighted * level[i]
        total += weight * level[i]
    return square, both, count, seen, total


def refuse_another_part(
    level: Float32, predicted: Float32, limit: Float32, deviation: Float32, mask: Bool, where: str
) -> None:
    """Refuse images that do not show this part as the model has it.

    Parameters
    ----------
    level, predicted, limit, deviation
        Levels measured and predicted, those from which a pixel is saturated, and the standard deviation of the noise,
        shape (images, H, W).
    mask
        Pixels that show the part, shape (H, W).
    where
        The set and posture, for the message.

    Raises
    ------
    InputError
        The model explains too little; says what would fit better.
    """
    places = np.flatnonzero(mask)
    places = places[:: max(1, len(places) // PIXELS_PER_IMAGE)]

    def picked(images: Float32) -> Float64:
        return images.reshape(len(images), -1)[:, places].astype(np.float64)

    # both are clipped where the camera clips
    model = np.clip(picked(predicted), 0.0, picked(limit))

    def measured(flip: tuple[slice, slice]) -> Float64:
        turned = (slice(None), *flip)
        return np.minimum(picked(level[turned]), picked(limit[turned]))

    def explained(flip: tuple[slice, slice]) -> float:
        seen = measured(flip)
        spread = float(np.var(seen))
        return 1.0 - float(np.mean((seen - model) ** 2)) / spread if spread > 0.0 else 0.0

    if not model.size:
        return
    if float(np.std(model)) < LEAST_RELIEF * float(np.median(picked(deviation))):
        return
    as_it_is = (slice(None), slice(None))
    own = explained(as_it_is)
    if own >= SURE_R2:
        return
    back = slice(None, None, -1)
    flips = {
        "mirrored left to right": (slice(None), back),
        "mirrored top to bottom": (back, slice(None)),
        TURNED: (back, back),
    }
    values = {name: explained(flip) for name, flip in flips.items()}
    best = max(values, key=lambda name: values[name])
    turned = values[best] >= STRANGER_R2 and 1.0 - values[best] <= FAR_BETTER * (1.0 - own)
    if own >= STRANGER_R2 and not turned:
        return
    rms = float(np.sqrt(np.mean((measured(as_it_is) - model) ** 2)))
    if turned:
        undo = (
            "turn them, or correct the camera's roll in the rig"
            if best == TURNED
            else "flip the images; turning them, or the camera's roll, undoes no mirror"
        )
        hint = f"they fit far better {best} ({100.0 * values[best]:.0f} %): {undo}"
    else:
        hint = _what_they_show(measured(as_it_is), model, picked(level) >= picked(limit))
    expected = "" if own >= STRANGER_R2 else f", expected {100.0 * STRANGER_R2:.0f} % or more"
    raise InputError(
        f"{where}: the images do not look like this part on this rig: the model explains {max(100.0 * own, 0.0):.0f} % "
        f"of their variance{expected}; measured minus predicted is {rms:.3g} grey levels rms; {hint}"
    )


def _what_they_show(seen: Float64, model: Float64, full: Bool) -> str:
    # why images, in no way flipped, may be so far from the model
    mean, expected = float(seen.mean()), float(model.mean())
    if mean < BLACK_SHARE * expected:
        return (
            f"they are black: {max(mean, 0.0):.3g} grey levels on the mean, predicted {expected:.3g}; check the lens "
            "cap, that the lights burn, and the exposure"
        )
    share = float(full.mean())
    if share > MOST_FULL:
        return (
            f"{100.0 * share:.0f} % of their pixels that can be judged are saturated; take them with a shorter "
            "exposure or less light"
        )
    return (
        "check that rig, part, placement and postures are those of the images, and fit the reflectance first "
        "(lightopt fit-specular)"
    )
