"""Further exposures of chosen postures: images that show enough more are planned."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.errors import InputError
from lightopt.core.run_context import Share
from lightopt.core.transforms import Posture
from lightopt.design.exposures._selection import Brackets, CandidateExposure, Images, select_exposures
from lightopt.design.postures._image_evaluator import ImageEvaluator, scattered_flags
from lightopt.design.responses._packed_bits import Words
from lightopt.scene import PanelLight

DEFAULT_EXPOSURE_GAIN = 1.0
"""Points (hundredths of the pairs) that a further exposure of a posture has to add by default."""

MOST_IMAGE_BYTES = 1_500_000_000  # of what all postures' images show at all exposures, which is held at a time


def check_exposures(exposures: Sequence[float], gain_points: float) -> list[str]:
    """What is wrong with exposures and the required gain."""
    problems = [
        f"option 'exposures': expected numbers above 0, such as 1/16,1/4,1,4,16, found {exposure:g}"
        for exposure in exposures
        if not (math.isfinite(exposure) and exposure > 0.0)
    ]
    if len(set(exposures)) < len(exposures):
        problems.append("option 'exposures': the same exposure was given twice")
    if not (math.isfinite(gain_points) and 0.0 <= gain_points <= 100.0):
        problems.append(f"option 'exposure_gain': expected points from 0 to 100, found {gain_points:g}")
    return problems


def plan_exposures(
    evaluator: ImageEvaluator,
    postures: Sequence[Posture],
    lights: Sequence[Sequence[PanelLight]],
    exposures: Sequence[float],
    *,
    min_images: int,
    gain_points: float = DEFAULT_EXPOSURE_GAIN,
    target: float | None = None,
    progress: Share | None = None,
) -> Brackets:
    """Plan a further exposure only where it shows more by at least a given gain, or where the target needs it.

    lights: The panels posture by posture, world frame.
    exposures: Further exposures to choose from; 1 is taken anyway.
    min_images: Images that must show a pair, of all postures together.
    gain_points: The least gain [hundredths of the pairs].
    target: Share of the pairs that is to be shown.
    Raises InputError: More images than memory is meant for.
    """
    further = [exposure for exposure in exposures if exposure != 1.0]
    layers = 1 if min_images == 1 else max(map(len, lights))
    pair_bytes = len(evaluator.patches) * evaluator.weights.masks.shape[1] * 8
    size = len(postures) * (1 + len(further)) * layers * pair_bytes
    if size > MOST_IMAGE_BYTES:
        raise InputError(
            f"option 'exposures': {len(postures)} postures × {1 + len(further)} exposures × {layers} lights × "
            f"{len(evaluator.patches):,} patches are {size / 1e9:.2f} GB, and there is room for "
            f"{MOST_IMAGE_BYTES / 1e9:.2f} GB; choose from fewer exposures, or lower option 'patch_budget'"
        )
    now: list[Images] = []
    candidates: list[CandidateExposure] = []
    for index, (posture, panels) in enumerate(zip(postures, lights, strict=True)):
        matrices = evaluator.matrices(posture, [[panel] for panel in panels], exposures=(1.0, *further))
        first, *rest = (
            images_of(
                [scattered_flags([matrix], evaluator.patches, light=light, place=0) for light in range(len(panels))],
                min_images,
            )
            for matrix in matrices
        )
        now.append(first)
        candidates += [
            CandidateExposure(posture=index, exposure=exposure, images=images)
            for exposure, images in zip(further, rest, strict=True)
        ]
        if progress is not None:
            progress((index + 1) / len(postures))
    found = select_exposures(
        postures,
        now,
        candidates,
        evaluator.weights,
        min_images=min_images,
        least_gain=gain_points / 100.0,
        target=target,
    )
    return replace(found, grain=evaluator.table.grain)


def images_of(flags: Sequence[Words], min_images: int) -> Images:
    """The flags of a posture's lights; where one image is enough, only what they show together matters."""
    return np.bitwise_or.reduce(flags, axis=0)[None] if min_images == 1 else np.stack(flags)
