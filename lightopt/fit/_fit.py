"""From a rig, a part and images to fitted reflectance: the two fits that the command line has."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lightopt.align import (
    Observation,
    Placement,
    find_placement,
    observed_postures,
    place_part,
    read_observations,
    refine_placement,
)
from lightopt.config import PartConfig, RigConfig
from lightopt.errors import InputError
from lightopt.fit._estimate import Estimate, Freed
from lightopt.fit._highlights import LEAST_R_S, WIDENINGS, diffuse_only
from lightopt.fit._likelihood import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D
from lightopt.fit._paper import PaperDiffuse, PaperOptions, PaperSpecular, paper_diffuse, paper_specular
from lightopt.fit._quality import appraise, poor_fit, words
from lightopt.fit._regions import PointsRow, compare_regions
from lightopt.fit._result import FitResult, FittedValue, fitted_values
from lightopt.fit._samples import OCTAVES, Samples, collect_samples
from lightopt.fit._search import estimate
from lightopt.fit._strangers import refuse_strangers
from lightopt.fit._validate import leave_lights_out, unseen
from lightopt.images import ImageSet
from lightopt.raycast import RayCaster
from lightopt.rendering import cast_rays_at
from lightopt.scene import Scene, build_scene, coarse_points

__all__ = ["FitOptions", "fit_diffuse", "fit_specular"]

Float64 = NDArray[np.float64]
Points: TypeAlias = "int | Literal['auto']"
Progress = Callable[[str, float], None]
"""Called with what is going on and the share of it that is done, 0 to 1."""
KeepImage = Callable[[Observation, NDArray[np.float32]], None]

MOST_PER_OCTAVE = 20_000
PLACING_PER_OCTAVE = 800
PAPER_PIXELS = 150_000
"""Pixels per image that the paper's procedure counts."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """How to fit.

    Attributes
    ----------
    method
        ``"likelihood"`` or ``"paper"``.
    joint
        Whether a specular fit fits R_d along instead of keeping the part file's.
    gain, dark, shift
        What else is freed; `shift` is the part's place on the stage.
    points
        Point lights per panel to try; the rig's own where empty.
    pixels
        About how many pixels to look at, over all images.
    validate
        Whether to leave each light out in turn.
    paper
        Of the paper's procedure.
    threads
        Number of threads; all the machine's by default. The result does not depend on it.
    """

    method: Literal["likelihood", "paper"] = "likelihood"
    joint: bool = False
    gain: bool = False
    dark: bool = False
    shift: bool = False
    points: tuple[Points, ...] = ()
    pixels: int = 1_500_000
    validate: bool = True
    paper: PaperOptions = field(default_factory=PaperOptions)
    threads: int | None = None


@dataclass(frozen=True)
class _World:
    scene: Scene
    caster: RayCaster
    observations: tuple[Observation, ...]
    placement: Placement | None = None


def fit_diffuse(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: FitOptions = FitOptions(),
    progress: Progress | None = None,
) -> FitResult:
    """Fit R_d to the pixels that are away from every highlight.

    Where the highlights are is found by a fit of the whole model first.

    Parameters
    ----------
    rig, part
        What the images show.
    image_set
        Rendered or captured.
    options
        How to fit; the first number of points counts.
    progress
        Called as the fit goes on.

    Raises
    ------
    InputError
        Images that are not the rig's or not the part's, or that do not tell R_d.
    """
    points = options.points[0] if options.points else None
    world = _world(rig, part, image_set, points, options, progress)
    if options.method == "paper":
        samples = _collect(world, options, progress, uniform=True)
        record = paper_diffuse(samples, options.paper)
        return _paper_result("diffuse", world, samples, record.R_d, None, options, paper=record)
    samples = _collect(world, options, progress)
    freed = Freed(gain=options.gain, dark=options.dark)
    whole = estimate(samples, freed=freed, threads=options.threads, progress=progress)
    shifted = refuse_strangers(
        samples, whole, appraise(samples, whole), placed=world.placement is not None, threads=options.threads
    )
    plain, widening = diffuse_only(samples, whole.x)
    held = np.array([whole.R_d, LEAST_R_S, whole.sigma])
    found = estimate(
        plain, freed=replace(freed, specular=False), held=held, threads=options.threads, progress=progress
    )
    quality = appraise(plain, found)
    said = [*shifted, *poor_fit(quality)]
    if widening < max(WIDENINGS):
        said.append(
            f"few pixels are away from the highlights: R_d comes from those beyond {widening:g} times the width of "
            "the lobe that was found, and heavier tails than a Gaussian's would raise it"
        )
    values = fitted_values(found, weight=1.0, full_scale=world.scene.reflectance.full_scale)[:1]
    kept = (
        FittedValue(name="R_s", value=world.scene.reflectance.R_s),
        FittedValue(name="sigma_rad", value=world.scene.reflectance.sigma),
    )
    return FitResult(
        kind="diffuse",
        method="likelihood",
        points=world.scene.lights[0].points,
        values=(*values, *kept),
        fitted=("R_d",),
        gains=_gains(world, found) if options.gain else None,
        dark=float(world.scene.sensor.black_level + found.x[DARK]) if options.dark else None,
        placement=world.placement,
        observations=len(plain.sample),
        pixels=len(np.unique(plain.sample)),
        quality=quality,
        words=tuple(said),
        estimate=replace(found, scan=whole.scan),
    )


def fit_specular(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    *,
    options: FitOptions = FitOptions(),
    progress: Progress | None = None,
    keep: KeepImage | None = None,
) -> FitResult:
    """Fit R_s and σ, and R_d along where asked.

    Parameters
    ----------
    rig, part, image_set, options, progress
        As in :func:`fit_diffuse`. With several numbers of points each is fitted, and the one under which
        the images are likeliest is kept.
    keep
        Called with each image that validation predicted without having seen it, and its prediction.

    Raises
    ------
    InputError
        Images that are not the rig's or not the part's, or that do not tell R_s and σ.
    """
    tried: list[tuple[FitResult, _World, Samples, PointsRow | None]] = []
    choices: tuple[Points | None, ...] = options.points or (None,)
    for points in choices:
        world = _world(rig, part, image_set, points, options, progress)
        result, samples = _fit_one(world, options, progress)
        row = None
        if len(choices) > 1 and result.estimate is not None:
            row = compare_regions(
                world.scene,
                result.estimate,
                world.observations,
                points=world.scene.lights[0].points,
                caster=world.caster,
                threads=options.threads,
            )
        tried.append((result, world, samples, row))
    best = max(tried, key=lambda t: t[3].likelihood if t[3] is not None else 0.0)
    result, world, samples, _ = best
    result = replace(result, rows=tuple(t[3] for t in tried if t[3] is not None))
    if options.validate and result.estimate is not None:
        left_out = leave_lights_out(
            world.scene,
            samples,
            result.estimate,
            caster=world.caster,
            threads=options.threads,
            keep=keep,
            progress=None if progress is None else lambda share: progress("validating", share),
        )
        result = replace(
            result, left_out=left_out, words=(*result.words, *unseen(left_out, world.scene.sensor))
        )
    return result


def _world(
    rig: RigConfig,
    part: PartConfig,
    image_set: ImageSet,
    points: Points | None,
    options: FitOptions,
    progress: Progress | None,
) -> _World:
    observations = read_observations(image_set, rig, part)
    used = {o.light for o in observations}
    names = [light.name for light in rig.lights if light.name in used]
    scene = build_scene(rig, part, postures=observed_postures(image_set), lights=names, points=points)
    world = _World(scene, cast_rays_at(scene), observations)
    return _placed(world, options, progress) if options.shift else world


def _placed(world: _World, options: FitOptions, progress: Progress | None) -> _World:
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
    return _World(moved, cast_rays_at(moved), world.observations, placement)


def _collect(
    world: _World, options: FitOptions, progress: Progress | None, *, uniform: bool = False
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


def _fit_one(world: _World, options: FitOptions, progress: Progress | None) -> tuple[FitResult, Samples]:
    reflectance = world.scene.reflectance
    if options.method == "paper":
        samples = _collect(world, options, progress, uniform=True)
        record = paper_specular(
            samples,
            options.paper,
            R_d=reflectance.R_d,
            threads=options.threads,
            progress=None if progress is None else lambda share: progress("sweeping σ", share),
        )
        pair = record.R_s, record.sigma
        return _paper_result("specular", world, samples, None, pair, options, paper=record), samples
    samples = _collect(world, options, progress)
    freed = Freed(diffuse=options.joint, gain=options.gain, dark=options.dark)
    held = np.array([reflectance.R_d, reflectance.R_s, reflectance.sigma])
    found = estimate(samples, freed=freed, held=held, threads=options.threads, progress=progress)
    quality = appraise(samples, found)
    shifted = refuse_strangers(
        samples, found, quality, placed=world.placement is not None, threads=options.threads
    )
    _refuse_no_highlight(samples, found)
    values = fitted_values(found, weight=1.0, full_scale=reflectance.full_scale)
    low, high = next(v.interval for v in values if v.name == "R_s") or (found.R_s, found.R_s)
    exposures = {o.exposure for o in world.observations}
    said = [*shifted, *words(found, quality, low, high, shorter=len(exposures) > 1), *_held_r_d(found)]
    panels = (coarse_points(light, found.sigma) for light in world.scene.lights)
    said += [text for text in panels if text is not None]
    result = FitResult(
        kind="specular",
        method="likelihood",
        points=world.scene.lights[0].points,
        values=values,
        fitted=("R_d", "R_s", "sigma_rad") if options.joint else ("R_s", "sigma_rad"),
        gains=_gains(world, found) if options.gain else None,
        dark=float(world.scene.sensor.black_level + found.x[DARK]) if options.dark else None,
        placement=world.placement,
        correlation=found.correlation(LOG_R_S, LOG_SIGMA),
        observations=len(samples.sample),
        pixels=len(samples.diffuse),
        quality=quality,
        words=tuple(said),
        estimate=found,
    )
    return result, samples


def _paper_result(
    kind: Literal["diffuse", "specular"],
    world: _World,
    samples: Samples,
    r_d: float | None,
    specular: tuple[float, float] | None,
    options: FitOptions,
    paper: PaperDiffuse | PaperSpecular,
) -> FitResult:
    if options.gain or options.dark or options.shift or options.joint:
        raise InputError(
            "--method paper knows no --free and no --joint: it fits what sections 4.2 and 4.3 fit"
        )
    own = world.scene.reflectance
    r_s, sigma = specular or (own.R_s, own.sigma)
    values = (("R_d", own.R_d if r_d is None else r_d), ("R_s", r_s), ("sigma_rad", sigma))
    return FitResult(
        kind=kind,
        method="paper",
        points=world.scene.lights[0].points,
        values=tuple(FittedValue(name=name, value=value) for name, value in values),
        fitted=("R_d",) if kind == "diffuse" else ("R_s", "sigma_rad"),
        observations=len(samples.sample),
        pixels=len(samples.diffuse),
        paper=paper,
    )


def _refuse_no_highlight(samples: Samples, found: Estimate) -> None:
    light = found.R_s * samples.specular(found.sigma)
    if float(light.max()) < 1.0:
        raise InputError(
            "no highlight in any image: nothing tells R_s and σ. Add images under lights that the surface mirrors "
            "into the camera, or at a longer exposure"
        )


def _held_r_d(found: Estimate) -> list[str]:
    # where R_d was held, the slope of the likelihood says what it wants to be
    if R_D in found.free:
        return []
    here = found.maximum.evaluation
    curvature = float(here.curvature[R_D, R_D])
    step = float(here.gradient[R_D]) / max(curvature, 1e-300)
    if abs(step) < 0.02 * max(found.R_d, 1e-9) or abs(step) * math.sqrt(curvature) < 5.0:
        return []
    wanted = max(found.R_d + step, 0.0)
    text = (
        f"R_d is held at {found.R_d:.4g}, but these images want about {wanted:.4g}: run fit-diffuse first, or use "
        "--joint"
    )
    return [text]


def _gains(world: _World, found: Estimate) -> dict[str, float]:
    return {
        light.name: light.gain * math.exp(found.x[FIRST_GAIN + i])
        for i, light in enumerate(world.scene.lights)
    }
