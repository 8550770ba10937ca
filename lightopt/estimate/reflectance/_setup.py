"""What a fit is made from: its options, and rig, part and images made ready."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lightopt.config import PartConfig, RigConfig
from lightopt.estimate.reflectance._estimate import FreeParameters
from lightopt.estimate.reflectance._paper import PaperOptions
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

Points: TypeAlias = "int | Literal['auto']"
Progress = Callable[[str, float], None]
"""Called with what is going on and the share of it that is done, 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """How to fit.

    method: ``"likelihood"`` or ``"paper"``.
    joint: Whether a specular fit fits R_d along instead of keeping the part file's.
    gain, dark, shift: What else is freed; `shift` is the part's place on the stage.
    points: Point lights per panel to try; the rig's own where empty.
    pixels: About how many pixels to look at, over all images.
    validate: Whether to leave each light out in turn.
    write_noise: Whether the noise that the images show belongs into the rig file.
    paper: Of the paper's procedure.
    """

    method: Literal["likelihood", "paper"] = "likelihood"
    joint: bool = False
    gain: bool = False
    dark: bool = False
    shift: bool = False
    points: tuple[Points, ...] = ()
    pixels: int = 1_500_000
    validate: bool = True
    write_noise: bool = False
    paper: PaperOptions = field(default_factory=PaperOptions)
    threads: int | None = None

    @property
    def freed(self) -> FreeParameters:
        """What a specular fit may change."""
        return FreeParameters(diffuse=self.joint, gain=self.gain, dark=self.dark)


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
        return least_squares_reflectance(samples, moved.reflectance, freed=freed)

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
