"""A rig, a part and images made ready: the scene as it was photographed, the part where it lies, the pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.config import PartConfig, RigConfig
from lightopt.estimate.reflectance._estimate import FreeParameters
from lightopt.estimate.reflectance._options import FitOptions, Points, Progress
from lightopt.estimate.reflectance._samples import OCTAVES, Samples, collect_samples
from lightopt.estimate.reflectance._search import least_squares_reflectance
from lightopt.estimate.registration import (
    Observation,
    PartFilePlacement,
    Placement,
    Registration,
    observed_postures,
    part_file_placement,
    place_part,
    read_observations,
    register,
)
from lightopt.geometry import RayCaster
from lightopt.images import ImageSet
from lightopt.optics import Reflectance
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene, build_scene

Float64 = NDArray[np.float64]

MOST_PER_OCTAVE = 20_000
PLACING_PER_OCTAVE = 800
PAPER_PIXELS = 150_000
"""Pixels per image that the paper's procedure counts."""


@dataclass(frozen=True)
class FitSetup:
    """What is fitted to what: a scene, the rays of its part, the images, and where the part was found to lie.

    part: The part file.
    scene, caster: With the part where it lies.
    observations: The images.
    registration, in_file: Where that is, as a move and in the words of the part file; None where the part was not
        registered.
    """

    part: PartConfig
    scene: Scene
    caster: RayCaster
    observations: tuple[Observation, ...]
    registration: Registration | None = None
    in_file: PartFilePlacement | None = None

    @property
    def placement(self) -> Placement | None:
        """Where the part was found; None where it was not registered."""
        return None if self.registration is None else self.registration.placement

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the registration, in words."""
        return () if self.registration is None else self.registration.warnings

    @property
    def held(self) -> Float64:
        """R_d, R_s and σ of the part file."""
        reflectance = self.scene.reflectance
        return np.array([reflectance.R_d, reflectance.R_s, reflectance.sigma])


def prepare_fit(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    points: Points | None,
    options: FitOptions,
    progress: Progress | None,
) -> FitSetup:
    observations = read_observations(image_set, rig, part, threads=options.threads)
    used = {o.light for o in observations}
    names = [light.name for light in rig.lights if light.name in used]
    scene = build_scene(
        rig, part, postures=observed_postures(image_set), lights=names, points=points, defects=False
    )
    setup = FitSetup(part, scene, cast_rays_at(scene), observations)
    if not options.shift:
        return setup
    return _registered(setup, options, progress)


def register_with_fit(
    scene: Scene,
    observations: Sequence[Observation],
    *,
    caster: RayCaster,
    freed: FreeParameters | None = None,
    reduced: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Registration:
    """Register the part, its place refined with a first fit of the reflectance.

    reduced: Whether a part of the pixels is enough.
    """

    def first_reflectance(moved: Scene) -> Reflectance:
        samples = collect_samples(
            moved, observations, caster=cast_rays_at(moved), budget=PLACING_PER_OCTAVE, threads=threads
        )
        return least_squares_reflectance(samples, moved.reflectance, freed=freed, threads=threads)

    return register(
        scene,
        observations,
        caster=caster,
        reflectance_at=first_reflectance,
        reduced=reduced,
        threads=threads,
        progress=progress,
    )


def _registered(setup: FitSetup, options: FitOptions, progress: Progress | None = None) -> FitSetup:
    """The same images, with the part where they show it; its place refined with a first fit of the reflectance."""
    found = register_with_fit(
        setup.scene,
        setup.observations,
        caster=setup.caster,
        freed=FreeParameters(gain=options.gain, dark=options.dark),
        threads=options.threads,
        progress=progress,
    )
    moved = place_part(setup.scene, found.placement)
    placement = setup.part.placement
    in_file = part_file_placement(
        setup.scene.mesh.vertices,
        found.placement,
        anchor=placement.anchor,
        rotate_deg=placement.rotate_deg,
        translate_mm=placement.translate_mm,
        pivot=setup.scene.pivot,
    )
    return replace(setup, scene=moved, caster=cast_rays_at(moved), registration=found, in_file=in_file)


def collect(
    setup: FitSetup, options: FitOptions, progress: Progress | None, *, uniform: bool = False
) -> Samples:
    pairs = len({(o.light, o.posture) for o in setup.observations})
    budget = max(20, min(MOST_PER_OCTAVE, options.pixels // (pairs * OCTAVES)))
    return collect_samples(
        setup.scene,
        setup.observations,
        caster=setup.caster,
        budget=PAPER_PIXELS if uniform else budget,
        uniform=uniform,
        threads=options.threads,
        progress=None if progress is None else lambda share: progress("geometry", share),
    )
