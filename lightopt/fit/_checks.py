"""What speaks against a fit of R_s and σ: no highlight, an R_d that the images do not want."""

from __future__ import annotations

import math

from lightopt.errors import InputError
from lightopt.fit._estimate import Estimate
from lightopt.fit._criterion import R_D
from lightopt.fit._samples import Samples

__all__ = ["held_r_d", "refuse_no_highlight"]


def refuse_no_highlight(samples: Samples, found: Estimate) -> None:
    """Refuse images that tell nothing of R_s and σ.

    Raises
    ------
    InputError
        No pixel is brighter by a level for a highlight.
    """
    light = found.R_s * samples.specular(found.sigma)
    if float(light.max()) < 1.0:
        raise InputError(
            "no highlight in any image: nothing tells R_s and σ. Add images under lights that the surface mirrors "
            "into the camera, or at a longer exposure"
        )


def held_r_d(found: Estimate) -> list[str]:
    """What to say where R_d was held at a value that the slope of the likelihood is against."""
    if R_D in found.free:
        return []
    here = found.maximum.evaluation
    curvature = float(here.curvature[R_D, R_D])
    step = float(here.gradient[R_D]) / max(curvature, 1e-300)
    if abs(step) < 0.02 * max(found.R_d, 1e-9) or abs(step) * math.sqrt(curvature) < 5.0:
        return []
    text = (
        f"R_d is held at {found.R_d:.4g}, but these images want a {'larger' if step > 0.0 else 'smaller'} one, and R_s "
        "and σ suffer from it: run fit-diffuse first, or use --joint"
    )
    return [text]
