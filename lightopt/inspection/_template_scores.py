"""The image without highlights of a posture, and the scores by the detector that was chosen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lightopt.inspection._detection_score import SCALES_PX, score_deviations
from lightopt.inspection._deviation import Deviations
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._pixel_weights import trust_weights
from lightopt.inspection._posture_view import PostureView
from lightopt.inspection._synthetic import PROBES, SyntheticImage, fuse_images
from lightopt.inspection._template import TEMPLATES, score_templates


def synthetic_image(view: PostureView, options: InspectOptions, *, probes: int = PROBES) -> SyntheticImage:
    """The image of a posture without highlights, by the rule of `options`; `probes` as :func:`fuse_images` takes it."""
    assert options.fusion is not None
    weights = trust_weights(
        view.saturated,
        view.predicted,
        view.specular,
        view.deviation,
        view.limit,
        threads=options.threads,
    )
    return fuse_images(
        view.level,
        view.deviation,
        weights,
        view.clean,
        fusion=options.fusion,
        predicted=view.predicted,
        specular=view.specular,
        probes=probes,
        threads=options.threads,
    )


def score_posture(
    found: Deviations, options: InspectOptions, synthetic: Callable[[], SyntheticImage] | None
) -> tuple[NDArray[np.float32], int]:
    """The scores of a posture by the detector that was chosen, and how many scores each is the greatest of.

    Parameters
    ----------
    found
        Deviations from the good part, which the residual detector looks at.
    options
        How to inspect.
    synthetic
        Makes the image without highlights, which the template detector looks at; the other does not call it.

    Returns
    -------
    tuple
        −log₁₀ of the probability that noise alone looks as much like a defect, shape (H, W); number of tests.
    """
    if options.detector == "template":
        assert synthetic is not None
        return score_templates(synthetic()), TEMPLATES
    return score_deviations(found, seen_by=options.seen_by, threads=options.threads), len(SCALES_PX)
