"""A set of images with the model laid over it: of each posture the images beside what the good part would look like."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.config import PartConfig, RigConfig
from lightopt.estimate.registration import Observation, Placement, Registration
from lightopt.images import ImageSet
from lightopt.inspection._acquisition import Shots, shots_of
from lightopt.inspection._options import InspectOptions
from lightopt.inspection._part_registration import Progress, good_part, lay_over
from lightopt.inspection._posture_view import PostureView, posture_view
from lightopt.inspection._prediction_cache import Predictions, lights_of
from lightopt.scene import Scene


@dataclass(frozen=True)
class LaidSet:
    """A set of images over which the model was laid.

    Attributes
    ----------
    nominal
        The scene with the part where its file has it.
    placement
        Where it lies from there.
    scene
        That the model is predicted from: the part lies where it was found, or nearly there.
    views
        Of each posture, in the set's order, made one at a time; with the exposures of its images.
    registration
        That found the part, or the part that it lies near; None where it was not looked for.
    """

    nominal: Scene
    placement: Placement
    scene: Scene
    views: Iterator[tuple[PostureView, Shots]]
    registration: Registration | None = None


def lay_set(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: InspectOptions,
    predictions: Predictions,
    progress: Progress | None = None,
) -> LaidSet:
    """Look for the part of a set, and lay the good part over its images; takes what :func:`inspect_set` takes."""
    nominal, observations = good_part(
        rig, part, image_set, known=predictions.nominal, threads=options.threads
    )
    scene, placement, off = _find(nominal, observations, predictions, options, progress)

    def views() -> Iterator[tuple[PostureView, Shots]]:
        for number, posture in enumerate(scene.postures):
            if progress is not None:
                progress(f"posture {posture}", number / len(scene.postures))
            mine = [o for o in observations if o.posture == posture]
            lights = lights_of(scene, mine)
            prediction = predictions.of(scene, posture, lights, threads=options.threads)
            if off is not None:
                prediction = predictions.shifted(scene, posture, lights, off, threads=options.threads)
            where = str(image_set.folder)
            view = posture_view(scene, mine, prediction, where=where, threads=options.threads)
            yield view, shots_of(mine, view.lights)
        if options.shift and off is None:
            predictions.measure_misfit(scene, observations)

    return LaidSet(nominal, placement, scene, views(), predictions.registration if options.shift else None)


def _find(
    nominal: Scene,
    observations: Sequence[Observation],
    predictions: Predictions,
    options: InspectOptions,
    progress: Progress | None,
) -> tuple[Scene, Placement, NDArray[np.float64] | None]:
    # the scene to predict with, where the part lies, and how many node steps off that scene
    if not options.shift:
        return *predictions.moved_to(nominal, Placement()), None
    near = predictions.nearby(nominal, observations, threads=options.threads)
    if near is None:
        scene, found = lay_over(nominal, observations, threads=options.threads, progress=progress)
        scene, placement = predictions.moved_to(scene, found.placement)
        predictions.registration = found
        return scene, placement, None
    scene, placement, off = near
    return scene, placement, off
