"""Causes of a poor fit: the part displaced, images mirrored or turned, lights exchanged.

The fit is repeated for each, since a reflectance that was fitted to wrong images is another one.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.estimate.reflectance._estimate import Estimate
from lightopt.estimate.reflectance._fit_samples import fit_reflectance
from lightopt.estimate.reflectance._likelihood import clipped_levels, predicted
from lightopt.estimate.reflectance._quality import Quality, mean_levels
from lightopt.estimate.reflectance._samples import Samples, collect_samples, subsample
from lightopt.estimate.reflectance._setup import FitSetup, register_with_fit
from lightopt.estimate.registration import FLIPS, LEVEL_CAP, Observation, PoseFrame, agreement, place_part
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene

# a part is reported as displaced when moving it by half a pixel or more takes away half of the squared residual beyond
# the noise: a wrong reflectance is not blamed on the place
LEAST_SHIFT_PX, LEAST_EXPLAINED = 0.5, 0.5
LEAST_EXCESS = 0.1  # residuals beyond the noise count from this share of its variance on
LEAST_CERTAIN = 3.0  # a displacement counts from this many of its standard errors on
BUDGET = 250  # pixels per octave, light and posture that are compared at both places
TRIAL_LIGHTS = 6  # lights whose images a displaced part is searched in
FLIP_BUDGET = 150
MOST_LIGHTS = 8  # exchanged lights are only tried where there are no more than these


def refuse_unexplained_images(setup: FitSetup, samples: Samples, found: Estimate, quality: Quality) -> bool:
    """Refuse images that do not show this part on this rig at its file placement; the error says what fits better.

    Returns whether the placement is no reason for a poor fit: it was fitted, or no other explains the residual.
    """
    if quality.describes and not quality.poor:
        return setup.registration is not None
    excluded = True
    if setup.registration is None:
        shift, excluded = _better_placement(setup, samples, quality)
        if shift is not None:
            raise InputError(f"the images do not look like this part at its nominal placement: {shift}")
    level, model = clipped_levels(samples, mean_levels(samples, found))
    black, frames = samples.sensor.black_level, samples.facts.frames[samples.image]
    own = agreement(level - black, model - black, np.sqrt(samples.sensor.noise_variance(model - black, frames=frames)))
    if not own.mismatch:
        return excluded
    hint = _better_explanation(samples, quality.floor**2)
    hint = hint or "check that rig, part, placement and postures are those of the images"
    raise InputError(
        f"the images do not look like this part on this rig: {100.0 * quality.epsilon:.0f} % of the pixels are "
        f"outliers, and the residual is {own.residual:.3g} sensor levels rms, where the noise is {quality.floor:.2g} "
        f"and the model's levels are {own.level:.3g}; {hint}"
    )


def _better_placement(setup: FitSetup, samples: Samples, quality: Quality) -> tuple[str | None, bool]:
    """Another placement that explains the residual, if any, and whether all others are excluded by a converged search.

    Where no placement explains the images of all postures, those of the first are compared alone: a camera or a stage
    that is off moves the part in each posture another way.
    """
    moved, excluded = _displacement(setup.scene, setup.observations, samples, quality)
    if moved is not None:
        return f"{moved}. Register the part, or correct its placement or the camera", excluded
    first = setup.observations[0].posture
    mine = [o for o in setup.observations if o.posture == first]
    if len(mine) == len(setup.observations):
        return None, excluded
    same_posture = np.array([image.posture == first for image in samples.images])[samples.image]
    moved, _ = _displacement(setup.scene, mine, samples.select(same_posture), quality)
    if moved is None:
        return None, excluded
    text = (
        f"in posture {first}, {moved}, but no single placement explains the images of all postures: correct the "
        "camera's distance, angles or roll, or the zero of the stage's axes"
    )
    return text, excluded


def _displacement(
    scene: Scene, observations: Sequence[Observation], samples: Samples, quality: Quality
) -> tuple[str | None, bool]:
    # the part is registered, and the reflectance fitted again: one fitted to a misplaced part is another one
    # in lights picked at random, since rigs list rings of lights in turns: a place is found, not measured
    lights = list(dict.fromkeys(o.light for o in observations))
    few = np.random.default_rng(0).permutation(len(lights))[:TRIAL_LIGHTS]
    some, run = [o for o in observations if lights.index(o.light) in few], RunContext(threads=samples.threads)
    try:
        registration = register_with_fit(scene, some, caster=cast_rays_at(scene), reduced=True, run=run)
    except InputError:  # a trial: those few lights show nothing
        return None, False
    frame, place = PoseFrame.of(scene), registration.placement
    pose = frame.pose(place)
    turn = float(pose[2])
    mm = math.hypot(pose[0], pose[1])
    pixels = mm / frame.pixel
    certain = np.abs(pose) > LEAST_CERTAIN * np.array(registration.pose_errors)
    excluded = registration.converged
    if not certain.any() or max(pixels, abs(turn) / frame.pixel_steps[2]) < LEAST_SHIFT_PX:
        return None, excluded
    moved = place_part(scene, place)
    there = collect_samples(moved, observations, caster=cast_rays_at(moved), budget=BUDGET, threads=samples.threads)
    # the same fit at both places: what another reflectance explains is not blamed on the place
    here = subsample(samples, BUDGET)
    noise = quality.floor**2
    before, after = (_excess_residual(some, noise) for some in (here, there))
    explains = explained_share(before, after, noise)
    if explains <= LEAST_EXPLAINED:
        return None, excluded
    text = (
        f"with the part shifted by {pixels:.1f} px ({mm:.2f} mm) and rotated by {math.degrees(abs(turn)):.1f}°, "
        f"the model explains {100.0 * explains:.0f} % of the residual"
    )
    return text, False


def _excess_residual(samples: Samples, noise: float) -> Float64:
    """Mean square of residuals beyond the noise's [sensor level²], shape (2,).

    Each up to a cap, which dust does not move, and whole, which highlights of few pixels do. Fitted anew, since a
    reflectance that was fitted to misplaced or flipped images is another one. Not the likelihood: where a dark part has
    no highlight, that takes those of the images for dust. Over all pixels alike, since flipped images have their
    highlights where few pixels were chosen.
    """
    found = fit_reflectance(samples)
    weight = samples.weight[samples.sample]
    square = np.square(np.subtract(*clipped_levels(samples, mean_levels(samples, found))))
    none = np.zeros(len(samples.diffuse))
    dull = np.square(np.subtract(*clipped_levels(samples, predicted(samples, none, found.x))))
    cap = (LEVEL_CAP * samples.sensor.max_level) ** 2
    # a highlight that lies where the images have none is worse than none at all
    capped = min(float(np.average(np.minimum(some, cap), weights=weight)) for some in (square, dull))
    whole = min(float(np.average(some, weights=weight)) for some in (square, dull))
    return np.maximum(np.array([capped, whole]) - noise, 0.0)


def explained_share(before: Float64, after: Float64, noise: float) -> float:
    # share of the excess that is gone, by the measure that shows more; one that is lost in the noise shows nothing
    significant = before > LEAST_EXCESS * noise
    return float(np.max(1.0 - after[significant] / before[significant], initial=0.0))


def _better_explanation(samples: Samples, noise: float) -> str | None:
    few = subsample(samples, FLIP_BUDGET)
    own = _excess_residual(few, noise)
    gone = {
        f"{name}: {remedy}": explained_share(own, _excess_residual(few.with_images(few.images, flip), noise), noise)
        for name, (flip, remedy) in FLIPS.items()
    }
    swaps, share = _swaps(few, own, noise)
    if swaps:
        exchanged = " and ".join(f"{a} and {b} exchanged" for a, b in swaps)
        gone[f"with {exchanged}: check the wiring of the lights"] = share
    name = max(gone, key=lambda key: gone[key])
    return f"they fit far better {name}" if gone[name] > LEAST_EXPLAINED else None


def _swaps(samples: Samples, own: Float64, noise: float) -> tuple[list[tuple[str, str]], float]:
    # pairs of lights whose images fit better exchanged, the best first, and the share of the excess that is gone
    swaps: list[tuple[str, str]] = []
    gone = 0.0
    seen = {image.light for image in samples.images}
    lights = [light for light in samples.lights if light in seen]
    while 2 <= len(lights) <= MOST_LIGHTS:
        shares = {
            pair: explained_share(own, _excess_residual(_exchanged(samples, [*swaps, pair]), noise), noise)
            for pair in itertools.combinations(lights, 2)
        }
        best = max(shares, key=lambda pair: shares[pair])
        if shares[best] <= gone:
            break
        swaps.append(best)
        gone = shares[best]
        lights = [light for light in lights if light not in best]
    return swaps, gone


def _exchanged(samples: Samples, pairs: list[tuple[str, str]]) -> Samples:
    other = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
    by_key = {(image.light, image.posture, image.exposure): image for image in samples.images}
    keys = ((other.get(image.light, image.light), image.posture, image.exposure) for image in samples.images)
    return samples.with_images([by_key.get(key, image) for key, image in zip(keys, samples.images, strict=True)])
