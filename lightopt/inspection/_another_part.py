"""Whether images show this part on this rig at all, and what they show where they do not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightopt.errors import InputError
from lightopt.inspection._photometry import some_pixels

__all__ = ["refuse_another_part"]

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

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
    places = some_pixels(mask)

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
