"""A rig, a part and images made ready: the scene as it was photographed, the part where it lies, the pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lightopt.align import (
    Observation,
    Placement,
    PlacementInFile,
    find_placement,
    observed_postures,
    place_part,
    placement_in_file,
    read_observations,
    refine_placement,
)
from lightopt.config import PartConfig, RigConfig
from lightopt.fit._estimate import Freed
from lightopt.fit._options import FitOptions, Points, Progress
from lightopt.fit._samples import OCTAVES, Samples, collect_samples
from lightopt.fit._search import estimate
from lightopt.images import ImageSet
from lightopt.raycast import RayCaster
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene, build_scene

__all__ = ["World", "collect", "open_world"]

Float64 = NDArray[np.float64]

MOST_PER_OCTAVE = 20_000
PLACING_PER_OCTAVE = 800
PAPER_PIXELS = 150_000
"""Pixels per image that the paper's procedure counts."""


@dataclass(frozen=True)
class World:
    """What is fitted to what: a scene, the rays of its part, the images, and where the part was found to lie.

    Attributes
    ----------
    scene, caster
        With the part where it lies.
    observations
        The images.
    placement, in_file
        Where that is, as a move and in the words of the part file; None where it was not looked for.
    """

    scene: Scene
    caster: RayCaster
    observations: tuple[Observation, ...]
    placement: Placement | None = None
    in_file: PlacementInFile | None = None

    @property
    def held(self) -> Float64:
        """R_d, R_s and σ of the part file."""
        reflectance = self.scene.reflectance
        return np.array([reflectance.R_d, reflectance.R_s, reflectance.sigma])


def open_world(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    points: Points | None,
    options: FitOptions,
    progress: Progress | None,
) -> World:
    observations = read_observations(image_set, rig, part, threads=options.threads)
    used = {o.light for o in observations}
    names = [light.name for light in rig.lights if light.name in used]
    scene = build_scene(
        rig, part, postures=observed_postures(image_set), lights=names, points=points, defects=False
    )
    world = World(scene, cast_rays_at(scene), observations)
    if not options.shift:
        return world
    placed = _placed(world, options, progress)
    assert placed.placement is not None
    in_file = placement_in_file(
        scene.mesh.vertices,
        placed.placement,
        anchor=part.placement.anchor,
        rotate_deg=part.placement.rotate_deg,
        translate_mm=part.placement.translate_mm,
        pivot=scene.pivot,
    )
    return replace(placed, in_file=in_file)


def _placed(world: World, options: FitOptions, progress: Progress | None) -> World:
    # find the part by its outline, fit a first reflectance there, refine the place with it
    def stage(name: str) -> Callable[[float], None] | None:
        return None if progress is None else partial(progress, name)

    threads = options.threads
    scene = world.scene
    start = find_placement(
        scene, world.observations, caster=world.caster, threads=threads, progress=stage("finding the part")
    )
    moved = place_part(scene, start)
    caster = cast_rays_at(moved)
    samples = collect_samples(
        moved, world.observations, caster=caster, budget=PLACING_PER_OCTAVE, threads=threads
    )
    first = estimate(samples, freed=Freed(gain=options.gain, dark=options.dark), threads=threads)
    reflectance = replace(scene.reflectance, R_d=first.R_d, R_s=first.R_s, sigma=first.sigma)
    placement = refine_placement(
        replace(scene, reflectance=reflectance),
        world.observations,
        start,
        caster=world.caster,
        threads=threads,
        progress=stage("refining the part's place"),
    )
    moved = place_part(scene, placement)
    return World(moved, cast_rays_at(moved), world.observations, placement)


def collect(
    world: World, options: FitOptions, progress: Progress | None, *, uniform: bool = False
) -> Samples:
    pairs = len({(o.light, o.posture) for o in world.observations})
    budget = max(20, min(MOST_PER_OCTAVE, options.pixels // (pairs * OCTAVES)))
    return collect_samples(
        world.scene,
        world.observations,
        caster=world.caster,
        budget=PAPER_PIXELS if uniform else budget,
        uniform=uniform,
        threads=options.threads,
        progress=None if progress is None else lambda share: progress("geometry", share),
    )
