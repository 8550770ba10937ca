"""Refuse images that do not show this part on this rig, and say what would fit better."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.align import FLIPS, Agreement, Observation, PoseFrame, agreement, place_part
from lightopt.errors import InputError
from lightopt.fit._estimate import Estimate
from lightopt.fit._likelihood import clipped_levels, predicted
from lightopt.fit._quality import Quality
from lightopt.fit._samples import Samples, collect_samples, thinned
from lightopt.fit._search import estimate
from lightopt.fit._world import World, find_part
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene
from lightopt.transforms import Posture

__all__ = ["refuse_other_images"]

Float64 = NDArray[np.float64]

LEAST_SHIFT_PX = 0.5
LEAST_EXPLAINED = 0.5
"""A part is said to be displaced when moving it by half a pixel or more takes away half of the squared residual beyond
the noise: a wrong reflectance is not blamed on the place."""

LEAST_CERTAIN = 3.0
"""And when the displacement is so many of its standard errors."""

BUDGET = 250
"""Pixels per octave, light and posture that are compared at both places."""

LEVEL_CAP = 0.15
"""Residuals count as at most this share of the sensor's full scale, dust and all."""

LEAST_IMPROVEMENT = 1.0
FLIP_BUDGET = 150
MOST_LIGHTS = 8
"""Lights are only exchanged with each other, in trials, where there are no more than these."""


@dataclass(frozen=True, kw_only=True)
class Displacement:
    """Where else the part may lie.

    Attributes
    ----------
    pixels, mm, turn
        Shift of its middle, in the image [px] and on the stage [mm], and its turn [rad].
    explains
        Share of the mean squared residual beyond the noise that is gone with the part there.
    posture
        Whose images alone say so; None where those of all postures do.
    """

    pixels: float
    mm: float
    turn: float
    explains: float
    posture: Posture | None = None

    @property
    def words(self) -> str:
        """What is displaced, by how much, and what to do."""
        moved = (
            f"with the part shifted by {self.pixels:.1f} px ({self.mm:.2f} mm) and turned by "
            f"{math.degrees(self.turn):.1f}°, the model explains {100.0 * self.explains:.0f} % of what the fit misses"
        )
        if self.posture is None:
            return f"{moved}. Use --free shift, or correct the part's placement or the camera"
        return (
            f"in posture {self.posture}, {moved}, but no one place on the stage explains the images of all postures: "
            "correct the camera's distance, angles or roll, or the zero of the stage's axes"
        )


def refuse_other_images(
    world: World,
    samples: Samples,
    found: Estimate,
    quality: Quality,
    *,
    threads: int | None = None,
) -> bool:
    """Refuse images that do not show this part on this rig where its file has it.

    Parameters
    ----------
    world
        What was fitted to what.
    samples, found, quality
        The fit.
    threads
        Number of threads; the result does not depend on it.

    Returns
    -------
    bool
        Whether the part's place is no reason for a poor fit: it was fitted, or no other place explains what is missed.

    Raises
    ------
    InputError
        With what would fit better: the part displaced, mirrored or turned images, exchanged lights.
    """
    if not quality.poor:
        return world.registration is not None
    if world.registration is None:
        shift = find_displacement(world, samples, quality, threads=threads)
        if shift is not None:
            raise InputError(f"the images do not look like this part where its file has it: {shift.words}")
    own = _agreement(samples, found, threads)
    if not own.foreign:
        return True
    hint = (
        _what_fits_better(samples, threads)
        or "check that rig, part, placement and postures are those of the images"
    )
    raise InputError(
        f"the images do not look like this part on this rig: {100.0 * quality.epsilon:.0f} % of the pixels are "
        f"unexplained, and the residual is {own.residual:.3g} sensor levels rms where noise makes {quality.floor:.2g} "
        f"and the model {own.level:.3g}; {hint}"
    )


def find_displacement(
    world: World, samples: Samples, quality: Quality, *, threads: int | None = None
) -> Displacement | None:
    """Where else the part may lie; None where that explains too little of the residual, or nothing for certain.

    Where no place explains the images of all postures, those of the first are looked at alone: a camera or a stage that
    is off moves the part in each posture another way. Parameters as for :func:`refuse_other_images`.
    """
    found = _displacement(world.scene, world.observations, samples, quality, threads)
    postures = list(dict.fromkeys(o.posture for o in world.observations))
    if found is not None or len(postures) < 2:
        return found
    mine = [o for o in world.observations if o.posture == postures[0]]
    alike = np.array([image.posture == postures[0] for image in samples.images])[samples.image]
    found = _displacement(world.scene, mine, samples.keep(alike), quality, threads)
    return None if found is None else replace(found, posture=postures[0])


def _displacement(
    scene: Scene, observations: Sequence[Observation], samples: Samples, quality: Quality, threads: int | None
) -> Displacement | None:
    # the part is registered, and the reflectance fitted again: one fitted to a misplaced part is another one
    registration = find_part(
        scene,
        observations,
        caster=cast_rays_at(scene),
        # images of something else cost most, and no place explains them
        worth_refining=lambda some, first: not _agreement(some, first, threads).foreign,
        threads=threads,
    )
    if not registration.converged and not registration.iterations:
        return None
    frame, place = PoseFrame.of(scene), registration.placement
    pose = frame.pose(place)
    turn = float(pose[2])
    mm = math.hypot(pose[0], pose[1])
    pixels = mm / frame.pixel
    certain = np.abs(pose) > LEAST_CERTAIN * np.array(registration.pose_errors)
    if not certain.any() or max(pixels, abs(turn) / frame.pixel_steps[2]) < LEAST_SHIFT_PX:
        return None
    moved = place_part(scene, place)
    there = collect_samples(moved, observations, caster=cast_rays_at(moved), budget=BUDGET, threads=threads)
    # the same fit at both places: what another reflectance explains is not blamed on the place
    here = thinned(samples, BUDGET)
    noise = quality.floor**2
    before, after = (
        _misfit(some, estimate(some, threads=threads), threads) - noise for some in (here, there)
    )
    explains = 1.0 - after / before if before > 0.0 else 0.0
    if explains <= LEAST_EXPLAINED:
        return None
    return Displacement(pixels=pixels, mm=mm, turn=abs(turn), explains=min(explains, 1.0))


def _levels(samples: Samples, found: Estimate, threads: int | None) -> tuple[Float64, Float64]:
    # measured and predicted, clipped where the camera clips
    return clipped_levels(
        samples, predicted(samples, samples.specular(found.sigma, threads=threads), found.x)
    )


def _misfit(samples: Samples, found: Estimate, threads: int | None) -> float:
    level, model = _levels(samples, found, threads)
    return float(np.mean(np.minimum(np.square(level - model), (LEVEL_CAP * samples.sensor.max_level) ** 2)))


def _agreement(samples: Samples, found: Estimate, threads: int | None) -> Agreement:
    level, model = _levels(samples, found, threads)
    black = samples.sensor.black_level
    frames = samples.facts.frames[samples.image]
    noise = np.sqrt(samples.sensor.noise_variance(model - black, frames=frames))
    return agreement(level - black, model - black, noise)


def _what_fits_better(samples: Samples, threads: int | None) -> str | None:
    # each fitted again: the reflectance that was fitted to flipped images is another one
    few = thinned(samples, FLIP_BUDGET)
    own = _value_per_pixel(few, threads)
    better = {
        f"{name}: {remedy}": _value_per_pixel(_flipped(few, flip), threads) - own
        for name, (flip, remedy) in FLIPS.items()
    }
    swaps, gain = _swaps(few, own, threads)
    if swaps:
        exchanged = " and ".join(f"{a} and {b} exchanged" for a, b in swaps)
        better[f"with {exchanged}: check which light is plugged in where"] = gain
    name = max(better, key=lambda key: better[key])
    return f"they fit far better {name}" if better[name] > LEAST_IMPROVEMENT else None


def _value_per_pixel(samples: Samples, threads: int | None) -> float:
    return estimate(samples, threads=threads).mean_log_likelihood


def _flipped(samples: Samples, flip: tuple[slice, slice]) -> Samples:
    levels = [image.levels[flip] for image in samples.images]
    saturated = [image.saturated[flip] for image in samples.images]
    return samples.remeasured(levels, saturated)


def _swaps(samples: Samples, own: float, threads: int | None) -> tuple[list[tuple[str, str]], float]:
    # pairs of lights whose images fit better exchanged, the best first, and what all of them gain
    swaps: list[tuple[str, str]] = []
    gain = 0.0
    seen = {image.light for image in samples.images}
    lights = [light for light in samples.lights if light in seen]
    while 2 <= len(lights) <= MOST_LIGHTS:
        values = {
            pair: _value_per_pixel(_exchanged(samples, [*swaps, pair]), threads) - own
            for pair in itertools.combinations(lights, 2)
        }
        best = max(values, key=lambda pair: values[pair])
        if values[best] <= gain:
            break
        swaps.append(best)
        gain = values[best]
        lights = [light for light in lights if light not in best]
    return swaps, gain


def _exchanged(samples: Samples, pairs: list[tuple[str, str]]) -> Samples:
    other = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
    by_key = {(image.light, image.posture, image.exposure): image for image in samples.images}
    taken = [
        by_key.get((other.get(image.light, image.light), image.posture, image.exposure), image)
        for image in samples.images
    ]
    return samples.remeasured([image.levels for image in taken], [image.saturated for image in taken])
