"""Further exposures of chosen postures: their images are looked at, and those that show enough more are planned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.design._plan_progress import Share
from lightopt.design.exposures._brackets import Brackets
from lightopt.design.exposures._selection import Images, Offer, pick_shots
from lightopt.design.postures._counts import Words
from lightopt.design.postures._pair_visibility import Survey, scattered_flags
from lightopt.scene import PanelLight

DEFAULT_EXPOSURE_GAIN = 1.0
"""Points (hundredths of the pairs) that a further exposure of a posture has to add, unless asked otherwise."""

MOST_IMAGE_BYTES = 1_500_000_000
"""Of what all postures' images show at all exposures, which is held at a time."""


def check_exposures(offered: Sequence[float], gain_points: float) -> list[str]:
    """What is wrong with exposures and the gain that is asked of them."""
    problems = [
        f"--exposures: expected numbers above 0, such as 1/16,1/4,1,4,16, found {exposure:g}"
        for exposure in offered
        if not (math.isfinite(exposure) and exposure > 0.0)
    ]
    if len(set(offered)) < len(offered):
        problems.append("--exposures: the same exposure was given twice")
    if not (math.isfinite(gain_points) and 0.0 <= gain_points <= 100.0):
        problems.append(f"--exposure-gain: expected points from 0 to 100, found {gain_points:g}")
    return problems


def plan_exposures(
    survey: Survey,
    postures: Sequence[Posture],
    lights: Sequence[Sequence[PanelLight]],
    offered: Sequence[float],
    *,
    least: int,
    gain_points: float = DEFAULT_EXPOSURE_GAIN,
    target: float | None = None,
    tell: Share | None = None,
) -> Brackets:
    """Plan a further exposure only where it shows more by at least a given gain, or where the target takes it.

    Parameters
    ----------
    survey
        The part.
    postures
        In the plan.
    lights
        Where they stand, posture by posture, world frame.
    offered
        Exposures; 1 is taken anyway.
    least
        Images that must show a pair, of all postures together.
    gain_points
        The least gain [hundredths of the pairs].
    target
        Share of the pairs that is to be shown; None for no matter.
    tell
        Called with the share that is done.

    Raises
    ------
    InputError
        More images than memory is meant for.
    """
    further = [exposure for exposure in offered if exposure != 1.0]
    kept = 1 if least == 1 else max(map(len, lights))
    size = len(postures) * (1 + len(further)) * kept * len(survey.patches) * survey.weights.masks.shape[1] * 8
    if size > MOST_IMAGE_BYTES:
        raise InputError(
            f"--exposures: {len(postures)} postures × {1 + len(further)} exposures × {kept} lights × "
            f"{len(survey.patches):,} patches are {size / 1e9:.2f} GB, and there is room for "
            f"{MOST_IMAGE_BYTES / 1e9:.2f} GB; offer fewer exposures, or take fewer --patches"
        )
    now: list[Images] = []
    offers: list[Offer] = []
    for index, (posture, panels) in enumerate(zip(postures, lights, strict=True)):
        matrices = survey.matrices(posture, [[panel] for panel in panels], exposures=(1.0, *further))
        first, *rest = (
            images_of(
                [
                    scattered_flags([matrix], survey.patches, light=light, place=0)
                    for light in range(len(panels))
                ],
                least,
            )
            for matrix in matrices
        )
        now.append(first)
        offers += [
            Offer(posture=index, exposure=exposure, images=images)
            for exposure, images in zip(further, rest, strict=True)
        ]
        if tell is not None:
            tell((index + 1) / len(postures))
    found = pick_shots(
        postures, now, offers, survey.weights, least=least, least_gain=gain_points / 100.0, target=target
    )
    return replace(found, grain=survey.table.grain)


def images_of(flags: Sequence[Words], least: int) -> Images:
    """The images of a posture's lights; where one image is enough, what they show together is all that matters."""
    return np.bitwise_or.reduce(flags, axis=0)[None] if least == 1 else np.stack(flags)
