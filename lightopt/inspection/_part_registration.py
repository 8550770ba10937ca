"""Where the part of a set of images lies: the good part where its file has it, and where the images show it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lightopt.config import PartConfig, RigConfig
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import (
    Observation,
    Registration,
    observed_postures,
    place_part,
    read_observations,
    register,
)
from lightopt.images import ImageSet
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
