"""The images of a posture compared with the reference of the inspection."""

from dataclasses import replace

import numpy as np

from lightopt.defects import DARK
from lightopt.inspection.detection._deviation import Deviations, deviations
from lightopt.inspection.detection._texture import whiten_texture
from lightopt.inspection.prediction._neighbourhood import neighbourhood_view
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._reference import ReferenceName

# deviations from a model that is not exact are clipped here: good parts teach them to half a standard deviation at most
GREATEST_LEARNED_Z = 1000.0


def compare(
    view: PostureView, reference: ReferenceName, neighbourhood_px: float, *, threads: int | None = None
) -> tuple[PostureView, Deviations]:
    """A view with the levels of the reference, and the deviations from them.

    Those from good parts are the model's still: a calibration has what good parts have in common beyond it.

    neighbourhood_px: Width of the neighbourhood of a place.
    """
    if reference == "model":
        return view, deviations(view, threads=threads)
    if reference == "good-parts":
        found = deviations(view, local=False, threads=threads)
        np.clip(found.z, -GREATEST_LEARNED_Z, GREATEST_LEARNED_Z, out=found.z)
        return view, found
    view, known = neighbourhood_view(view, neighbourhood_px, threads=threads)
    found = deviations(view, local=False, threads=threads)
    found.z[~known] = 0.0
    found = Deviations(found.z, found.scale, found.usable & known, found.lit & known)
    return view, whiten_texture(found, threads=threads)


def evaluable(found: Deviations, view: PostureView) -> Deviations:
    """Deviations that count where the levels of a view, and not the model's, are dark or saturated."""
    full = view.saturated & (view.predicted + view.deviation >= view.limit)
    usable = found.usable & ~full
    return replace(found, usable=usable, lit=usable & (view.predicted >= np.float32(DARK) * view.deviation))
