"""Whether images show this part on this rig at all, and what they show where they do not.

The criterion is the residual against noise, beyond what a model of the right part with a wrong reflectance leaves. The
share of variance that the model explains is none: of an evenly lit plate there is no variance to explain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError

Array = NDArray[np.floating]

FOREIGN = 0.45
"""A residual beyond the noise of more than this share of the predicted levels (root mean squares) is that of another
part, another place or another rig: a wrong reflectance of the right part leaves less once the lights' gains are
adjusted."""

SUSPICIOUS = 0.15
"""From this share on, the images of a nearly symmetric part may be mirrored or turned …"""

FAR_BETTER = 0.5
"""… and are where that leaves less than this share of the squared residual."""

BLACK_SHARE = 0.02
"""Images with less than this share of the light that is predicted are black."""

MOST_FULL = 0.5
"""Images of which more pixels than this share are saturated are refused for that."""

_ALL, _BACK = slice(None), slice(None, None, -1)

FLIPS: dict[str, tuple[tuple[slice, slice], str]] = {
    "mirrored left to right": (
        (_ALL, _BACK),
        "flip the images; turning them, or the camera's roll, undoes no mirror",
    ),
    "mirrored top to bottom": (
        (_BACK, _ALL),
        "flip the images; turning them, or the camera's roll, undoes no mirror",
    ),
    "turned by 180°": ((_BACK, _BACK), "turn them, or correct the camera's roll in the rig"),
}
"""What may have been done to images: by its name, rows and columns that undo it, and what to do."""


@dataclass(frozen=True)
class Agreement:
    """How far images are off a model; root mean squares, all in the same unit.

    Attributes
    ----------
    residual
        Measured minus predicted.
    noise
        Of the sensor.
    level
        Predicted.
    """

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
    def foreign(self) -> bool:
        """Whether the images show something else than the model."""
        return self.share > FOREIGN


def agreement(measured: Array, predicted: Array, noise: Array) -> Agreement:
    """Compare levels above black with those of a model.

    Parameters
    ----------
    measured, predicted
        Clipped where the camera clips, of one shape.
    noise
        Standard deviation of the sensor's noise, same shape.
    """
    if not measured.size:
        return Agreement(0.0, 0.0, 0.0)
    return Agreement(_rms(measured - predicted), _rms(noise), _rms(predicted))


def refuse_mismatch(
    level: Array, predicted: Array, limit: Array, deviation: Array, pixels: NDArray[np.intp], where: str
) -> None:
    """Refuse images that do not show this part as the model has it.

    Parameters
    ----------
    level, predicted, limit, deviation
        Levels measured and predicted, those from which a pixel is saturated, and the standard deviation of the noise,
        shape (images, H, W).
    pixels
        Flat indices of the pixels to compare.
    where
        The set and posture, for the message.

    Raises
    ------
    InputError
        The residual is too large; says what would fit better.
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
    flipped = {name: agreement(measured(flip), model, noise) for name, (flip, _) in FLIPS.items()}
    best = min(flipped, key=lambda name: flipped[name].residual)
    if not flipped[best].foreign and flipped[best].excess < FAR_BETTER * own.excess:
        hint = f"they fit far better {best}: {FLIPS[best][1]}"
    elif own.foreign:
        hint = _what_they_show(seen, model, picked(level) >= full)
    else:
        return
    raise InputError(
        f"{where}: the images do not look like this part on this rig: measured minus predicted is {own.residual:.3g} "
        f"grey levels rms where noise makes {own.noise:.2g} and the prediction is {own.level:.3g}; {hint}"
    )


def _what_they_show(seen: Array, model: Array, full: NDArray[np.bool_]) -> str:
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


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
