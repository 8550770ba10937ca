"""A set of images with its part registered: for each posture the images beside the predicted good part."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.config import PartConfig, RigConfig
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import (
    Observation,
    Placement,
    Registration,
    observed_postures,
    place_part,
    read_observations,
    register,
)
from lightopt.images import ImageSet
from lightopt.inspection._options import InspectOptions
from lightopt.inspection.prediction._posture_view import PostureView, posture_view
from lightopt.inspection.prediction._prediction_cache import Predictions, lights_of
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene, build_scene

Progress = Callable[[str, float], None]
"""Called with what is going on and the share of it that is done, 0 to 1."""


def good_part(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    known: dict[tuple[tuple[Posture, ...], tuple[str, ...]], Scene] | None = None,
    threads: int | None = None,
) -> tuple[Scene, tuple[Observation, ...]]:
    """The part without defects where its file has it, under the lights and in the postures of a set, and the images.

    Parameters
    ----------
    rig, part, image_set
        What the images show.
    known
        Scenes of the same rig and part by postures and lights, to take and to add to: reading a mesh takes its time.
    threads
        Number of threads; the result does not depend on it.
    """
    observations = read_observations(image_set, rig, part, threads=threads)
    used = {o.light for o in observations}
    names = tuple(light.name for light in rig.lights if light.name in used)
    key = observed_postures(image_set), names
    known = {} if known is None else known
    if key not in known:
        known[key] = build_scene(rig, part, postures=key[0], lights=names, defects=False)
    return known[key], observations


def lay_over(
    scene: Scene,
    observations: Sequence[Observation],
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> tuple[Scene, Registration]:
    """The scene with its part where the images show it, and how far that is from where its file has it.

    Parameters
    ----------
    scene, observations
        From :func:`good_part`.
    threads
        Number of threads; the result does not depend on it.
    progress
        Called as the search goes on.
    """
    found = register(scene, observations, caster=cast_rays_at(scene), threads=threads, progress=progress)
    return place_part(scene, found.placement), found


Shots = dict[str, tuple[tuple[float, int], ...]]
"""By light the exposures and the numbers of frames of its images."""


def shots_of(observations: Sequence[Observation], lights: Sequence[str]) -> Shots:
    """Exposures and numbers of frames of the images of a posture, by light in the order given."""
    return {
        light: tuple(sorted((o.exposure, o.frames) for o in observations if o.light == light))
        for light in lights
    }


def shots_text(shots: Shots) -> str:
    """As a message has them."""

    def one(exposure: float, frames: int) -> str:
        return f"×{exposure:g}" + (f" of {frames} frames" if frames > 1 else "")

    return "; ".join(f"{light} {', '.join(one(*shot) for shot in own)}" for light, own in shots.items())


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
