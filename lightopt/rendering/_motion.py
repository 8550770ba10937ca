"""The instants of an exposure at which images of a part that moves are rendered; their mean is the image."""

import math

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.scene import Scene, motion_blur

# Between two instants the part moves by no more in the image [px], and turns by no more than σ of its sharpest lobe:
# the sum of Gaussian lobes so far apart is flat to 1e-8
STEP_PX = 0.5
MOST_INSTANTS = 256


def exposure_instants(scene: Scene, posture: Posture, points: Float64, *, exposure: float) -> Float64:
    """Times of the instants from the middle of an exposure on [s], in the middles of equal shares of it.

    points: Of the surface seen, part frame [mm], shape (k, 3)
    exposure: Relative exposure
    Raises InputError: The part moves too far
    """
    motion = scene.motion
    assert motion is not None
    seconds = exposure * motion.exposure_s
    path = exposure * float(motion_blur(scene, posture, points).max(initial=0.0))
    turn = seconds * abs(math.radians(scene.stage.rotary_scale * motion.turn_deg_per_s))
    count = max(1, math.ceil(max(path / STEP_PX, turn / scene.sharpest.sigma) - 1e-6))
    if count > MOST_INSTANTS:
        raise InputError(
            f"posture {posture}: the part moves {path:.4g} px and turns {math.degrees(turn):.3g}° in the "
            f"{1e3 * seconds:.4g} ms of exposure {exposure:g}, which takes images at {count:,} instants, expected at "
            f"most {MOST_INSTANTS}; shorten camera.exposure_us or the exposure"
        )
    return seconds * ((np.arange(count) + 0.5) / count - 0.5)
