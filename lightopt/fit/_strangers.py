"""Refuse images that do not show this part on this rig, and say what would fit better."""

from __future__ import annotations

import itertools
import math

from lightopt.errors import InputError
from lightopt.fit._estimate import Estimate
from lightopt.fit._quality import POOR_NOISE, Quality
from lightopt.fit._samples import Samples, thinned
from lightopt.fit._search import estimate
from lightopt.fit._shift import ImageShift, find_shift

__all__ = ["refuse_strangers"]

STRANGER_EPSILON = 0.12
STRANGER_R2 = 0.6
"""Images of whose unsaturated pixels less than this share of the variance is explained, for more than a share of
unexplained pixels or for residuals far beyond the noise, are not taken for images of this part on this rig."""

LEAST_SHIFT_PX = 0.5
LEAST_EXPLAINED = 0.5
"""Images that fit badly, and half of whose residual a shift of half a pixel explains, are of a part elsewhere,
and R_s and σ of the wrong order. Shifts of 1 to 12 px and of 1 mm explain 96 % and more; of heavy tails, meshes with
guessed normals and garbage they explain less than 10 %."""

LEAST_IMPROVEMENT = 1.0
MIRROR_BUDGET = 150


def refuse_strangers(
    samples: Samples, found: Estimate, quality: Quality, *, placed: bool = False, threads: int | None = None
) -> tuple[str, ...]:
    """Refuse images that do not show this part on this rig; what to say where they only lie a little off.

    Parameters
    ----------
    samples, found, quality
        A fit.
    placed
        Whether the part was looked for already.
    threads
        Number of threads; the result does not depend on it.

    Raises
    ------
    InputError
        With what would fit better: shifted, mirrored or turned images.
    """
    if not quality.poor:
        return ()
    shift = find_shift(samples, found, noise=quality.floor, threads=threads)
    if shift.explains > LEAST_EXPLAINED and shift.pixels >= LEAST_SHIFT_PX:
        if placed:
            return (f"the images still fit better shifted by {_shifted(shift)}",)
        raise InputError(
            f"the images do not look like this part where its file has it: shifted by {_shifted(shift)} Use --free "
            "shift, or correct the part's placement or the camera"
        )
    far = quality.epsilon > STRANGER_EPSILON or quality.typical > POOR_NOISE * quality.floor
    if quality.explained > STRANGER_R2 or not far:
        return ()
    few = thinned(samples, MIRROR_BUDGET)
    own = _value_per_pixel(few, threads)
    flips = {
        "mirrored left to right": (slice(None), slice(None, None, -1)),
        "mirrored top to bottom": (slice(None, None, -1), slice(None)),
        "turned by 180°": (slice(None, None, -1), slice(None, None, -1)),
    }
    better = {
        f"{name}: turn them, or correct the camera's roll and azimuth in the rig": _value_per_pixel(
            _flipped(few, flip), threads
        )
        - own
        for name, flip in flips.items()
    }
    swaps, gain = _swaps(few, own, threads)
    if swaps:
        exchanged = " and ".join(f"{a} and {b} exchanged" for a, b in swaps)
        better[f"with {exchanged}: check which light is plugged in where"] = gain
    name = max(better, key=lambda key: better[key])
    hint = (
        f"; they fit far better {name}"
        if better[name] > LEAST_IMPROVEMENT
        else "; check that rig, part, placement and postures are those of the images, or try --free shift where the "
        "part lies a little off"
    )
    raise InputError(
        f"the images do not look like this part on this rig: {100.0 * quality.epsilon:.0f} % of the pixels are "
        f"unexplained, and the residual of the others is {quality.rms:.3g} sensor levels rms where noise makes "
        f"{quality.floor:.2g}{hint}"
    )


def _shifted(shift: ImageShift) -> str:
    return (
        f"{shift.pixels:.1f} px and turned by {math.degrees(shift.turn):.1f}°, they would be explained far better "
        f"({100.0 * shift.explains:.0f} % of what the fit misses)."
    )


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
    while len(lights) >= 2:
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
