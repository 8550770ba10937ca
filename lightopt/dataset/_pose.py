"""A pose, rendered once, and the images of the samples that share it.

Images are linear in R_d, R_s and the gains of lights, and defects and dust change small areas. So a sample is the
pose's own images with these factors, what its few defects change, particles, and noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightopt import inspection
from lightopt.core.arrays import Float32, Float64, Index, UInt8
from lightopt.core.transforms import Posture
from lightopt.dataset._draws import FUSED, STACK, PoseDraw, SampleDraw, Setup
from lightopt.dataset._visibility import Visibility, thresholds, visibility_in_images, visibility_of_change
from lightopt.defects import CatalogueEntry, PlacedDefect, defect_hypotheses, surface_coordinates
from lightopt.estimate.registration import Observation, Placement
from lightopt.geometry import RayCaster
from lightopt.optics import expose, image_rng, saturated
from lightopt.rendering import PostureImages, PosturePixels, cast_rays_at, render_pixels, render_posture, trace_pixels
from lightopt.scene import Scene, surface_footprint, typical_blur

MARGIN_PX = 2.0  # around the outline of a defect pixels may show some of it

NOISE = 4.0  # standard deviations above the good part's levels that fused images show as grey

Levels = UInt8 | NDArray[np.uint16]


@dataclass(frozen=True, eq=False, kw_only=True)
class LabelledDefect:
    placed: PlacedDefect
    pixels: Index  # that show any of it, raveled indices, ascending, shape (k,)
    # in all images together (:data:`STACK`), under each light, and in the fused image where there is one
    visibility: Mapping[str, Visibility]


@dataclass(frozen=True, eq=False, kw_only=True)
class SampleImages:
    """What the camera delivers of a sample: levels by light, each of shape (H, W), the fused image, and its defects."""

    levels: tuple[Levels, ...]
    fused: UInt8 | None
    defects: tuple[LabelledDefect, ...]
    omitted: int  # number of defects for which there was no place


@dataclass(frozen=True, eq=False, kw_only=True)
class PostureLimits:
    """What the samples of a posture have in common, of the nominal pose."""

    thresholds: Mapping[str, float]  # by name of an entry of the catalogue
    picture: inspection.GreyPicture | None  # how fused images become grey; None for none


@dataclass(frozen=True, eq=False)
class PoseImages:
    setup: Setup
    scene: Scene  # with the part where it lies, good and smooth
    view: inspection.PostureView  # the images of this part, without noise, and how far levels of good parts scatter
    actual: PostureImages  # images of the good part, wavy where the part file says so
    waved: Scene  # the scene with that surface
    pixels: PosturePixels  # what pixel centres look at
    caster: RayCaster
    exposures: tuple[float, ...]
    fused: inspection.SyntheticImage | None  # the images of `view` without highlights; None for none

    @cached_property
    def deviation(self) -> Float32:
        """Standard deviation of the good part's levels, shape (lights, H, W)."""
        return inspection.expected_deviation(self.view)

    @cached_property
    def footprint(self) -> float:
        """Side of a pixel [mm]."""
        return surface_footprint(self.pixels.view.camera, self.pixels.surface.points)

    @cached_property
    def blur(self) -> float:
        """Diameter of the lens' disc [px]."""
        return typical_blur(self.pixels.view.camera, self.pixels.surface.points)

    @cached_property
    def flat(self) -> Index:
        """Raveled index of each of `pixels`, shape (k,)."""
        return self.pixels.row.astype(np.intp) * self.pixels.shape[1] + self.pixels.column

    @cached_property
    def white(self) -> Float64:
        """Level under each light of a diffuse surface of R_d 1 in each pixel of the image, shape (lights, H·W)."""
        material = self.actual.geometry.material
        R_d = np.array([one.R_d for one in self.waved.reflectances])
        of_pixels = R_d[0] if material is None else R_d[material].ravel()
        return np.stack([_layer(image.diffuse).ravel() / of_pixels for image in self.actual.lights])


def render_pose(setup: Setup, draw: PoseDraw) -> PoseImages:
    """Render the good part in a pose, under all lights."""
    options, threads = setup.options, setup.threads
    scene = draw.scene(setup.scene)
    caster = cast_rays_at(scene)
    names = tuple(light.name for light in scene.lights)
    prediction = inspection.predict(scene, draw.posture, caster, lights=names, edges=True, threads=threads)
    exposures = tuple(setup.rig.exposures(name, (options.exposure,))[0] for name in names)
    waved, actual = scene, prediction.images
    if scene.waviness is not None:
        waved = replace(scene, waviness=replace(scene.waviness, seed=draw.waviness_seed))
        whole = np.ones(prediction.clean.shape, np.bool_)
        actual = render_posture(waved, draw.posture, caster=caster, layers=True, averaged=whole, threads=threads)
    still = [
        expose(image.level, sensor=scene.sensor, exposure=exposure, full_scale=scene.reflectance.full_scale)
        for image, exposure in zip(prediction.images.lights, exposures, strict=True)
    ]
    seen = _observations(scene, draw.posture, exposures, still)
    view = inspection.posture_view(scene, seen, prediction, where=f"pose {draw.number}", exact=False, threads=threads)
    pixels = trace_pixels(scene, draw.posture, caster, threads=threads)
    fused = None if options.fusion is None else inspection.synthetic_image(view, options.fusion, threads=threads)
    return PoseImages(setup, scene, view, actual, waved, pixels, caster, exposures, fused)


def posture_limits(setup: Setup, posture: Posture) -> PostureLimits:
    at_rest = PoseDraw(
        number=0, posture=posture, split="", placement=Placement(), sigma_factor=1.0, waviness_seed=0, samples=range(0)
    )
    pose = render_pose(setup, at_rest)
    picture = None
    if pose.fused is not None:
        # with room for noise, which is all that a mirror scatters
        brighter = pose.fused.level + NOISE * pose.fused.deviation
        picture = inspection.grey_picture(brighter.astype(np.float32), pose.fused.mask)
    pixels = int(pose.view.clean.sum())
    found = thresholds(setup.catalogue, pixels, pose.footprint, pose.blur, setup.options.false_alarms)
    return PostureLimits(thresholds=found, picture=picture)


def sample_images(pose: PoseImages, draw: SampleDraw, limits: PostureLimits) -> SampleImages:
    fusion = pose.setup.options.fusion
    kinds: list[CatalogueEntry] = []
    placed: list[PlacedDefect] = []
    for kind in draw.kinds:
        one = inspection.place_in_image(pose.scene, kind, pose.pixels, placed, draw.rng)
        if one is not None:
            kinds.append(kind)
            placed.append(one)
    change = _change_of(pose, placed)
    fused_change = _fused_change(pose, change) if placed else None
    labels = [_label(pose, kind, change, fused_change, i, limits.thresholds[kind.name]) for i, kind in enumerate(kinds)]
    dust = _dust(pose, draw)
    levels = tuple(_level(pose, draw, change, dust, light) for light in range(len(pose.actual.lights)))
    fused = None
    if fusion is not None and limits.picture is not None:
        where = f"sample {draw.number}"
        seen = _observations(pose.scene, pose.view.posture, pose.exposures, levels)
        view = inspection.posture_view(pose.scene, seen, pose.view.prediction, where=where, exact=False, threads=1)
        image = inspection.synthetic_image(view, fusion, probes=0, threads=1)
        fused = inspection.grey_picture(image.level, image.mask, like=limits.picture).grey
    shown = tuple(one for one in labels if len(one.pixels))
    return SampleImages(levels=levels, fused=fused, defects=shown, omitted=len(draw.kinds) - len(shown))


@dataclass(frozen=True, eq=False)
class _Change:
    placed: Sequence[PlacedDefect]  # the defects
    shown: Index  # numbers among the pose's pixels of those that show any of them, shape (s,)
    share: Float64  # of each such pixel that each defect takes, shape (defects, s)
    pixels: Index  # raveled indices of pixels that change, shape (n,); those of `shown` are the first s
    # by how much, shape (lights, n)
    diffuse: Float64
    specular: Float64


def _change_of(pose: PoseImages, placed: Sequence[PlacedDefect]) -> _Change:
    points, posture = pose.pixels.surface.points, pose.view.posture
    margin = (MARGIN_PX + 0.5 * pose.blur) * pose.footprint
    near = np.zeros(len(points), np.bool_)
    for one in placed:
        near |= np.einsum("ij,ij->i", points - one.position, points - one.position) <= (one.reach + margin) ** 2
    spoilt = replace(pose.waved, defects=tuple(placed))
    around = np.flatnonzero(near)
    bad = render_pixels(spoilt, posture, pose.flat[around], caster=pose.caster)
    inside = bad.defect.any(axis=0)
    shown, pixels = around[inside], pose.flat[around[inside]]
    good = render_pixels(pose.waved, posture, pixels, caster=pose.caster)
    diffuse, specular = bad.diffuse[:, inside] - good.diffuse, bad.specular[:, inside] - good.specular
    if pose.scene.camera.lens is not None and placed:
        # the lens blurs them, which takes whole images
        pixels = np.concatenate([pixels, pose.flat[around[~inside]]])
        images = render_posture(spoilt, posture, caster=pose.caster, layers=True, threads=1)
        pairs = list(zip(images.lights, pose.actual.lights, strict=True))
        diffuse, specular = (
            np.stack([(_layer(a) - _layer(b)).ravel()[pixels] for a, b in layers], dtype=np.float64)
            for layers in ([(a.diffuse, b.diffuse) for a, b in pairs], [(a.specular, b.specular) for a, b in pairs])
        )
    return _Change(placed, shown, bad.defect[:, inside], pixels, diffuse, specular)


def _fused_change(pose: PoseImages, change: _Change) -> Float32 | None:
    # by how many standard deviations defects change the fused image; None where there is none
    fusion = pose.setup.options.fusion
    if fusion is None or pose.fused is None:
        return None
    level = pose.view.level.copy()
    flat, limit = level.reshape(len(level), -1), pose.view.limit.reshape(len(level), -1)
    varied = flat[:, change.pixels] + change.diffuse + change.specular
    flat[:, change.pixels] = np.clip(varied, 0.0, limit[:, change.pixels])
    varied = inspection.synthetic_image(replace(pose.view, level=level), fusion, probes=0, threads=1).level
    return ((varied - pose.fused.level) / np.maximum(pose.fused.deviation, 1e-6)).astype(np.float32)


def _label(
    pose: PoseImages, kind: CatalogueEntry, change: _Change, fused: Float32 | None, number: int, threshold: float
) -> LabelledDefect:
    one, view = change.placed[number], pose.view
    own = np.flatnonzero(change.share[number] > 0.0)
    judged = own[pose.pixels.clean[change.shown[own]]]
    pixels, points = change.pixels[judged], change.shown[judged]
    deviation, _ = inspection.entry_deviation(defect_hypotheses(kind), view, pose.deviation)
    good, noise, limit = (
        a.reshape(len(a), -1)[:, pixels].astype(np.float64) for a in (view.predicted, deviation, view.limit)
    )
    surface = pose.pixels.surface
    along, _, _ = surface_coordinates(one, surface.points[points], surface.normals[points])
    whole, alone = visibility_in_images(
        kind,
        threshold,
        good,
        good + change.diffuse[:, judged] + change.specular[:, judged],
        deviation=noise,
        limit=limit,
        along=along,
    )
    found = {STACK: whole, **dict(zip(view.lights, alone, strict=True))}
    if fused is not None:
        found[FUSED] = visibility_of_change(kind, threshold, fused.ravel()[pixels].astype(np.float64), along)
    return LabelledDefect(placed=one, pixels=np.sort(change.pixels[own]), visibility=found)


def _dust(pose: PoseImages, draw: SampleDraw) -> list[tuple[Index, Float64, float]]:
    # of each particle the pixels that it covers, the share of each, and its R_d
    height, width = pose.pixels.shape
    found: list[tuple[Index, Float64, float]] = []
    for (size, R_d), (place, right, down) in zip(draw.dust.tolist(), draw.places.tolist(), strict=True):
        middle = int(pose.flat[int(place * len(pose.flat))])
        radius = 0.5 * size / pose.footprint
        reach = int(radius + 1.5)
        row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        cover = np.clip(radius + 0.5 - np.hypot(row + 0.5 - down, column + 0.5 - right), 0.0, min(1.0, 4.0 * radius**2))
        row, column = row + middle // width, column + middle % width
        on = (cover > 0.0) & (row >= 0) & (row < height) & (column >= 0) & (column < width)
        index = row[on] * width + column[on]
        seen = pose.view.part.ravel()[index]
        found.append((index[seen], cover[on][seen], R_d))
    return found


def _level(
    pose: PoseImages, draw: SampleDraw, change: _Change, dust: list[tuple[Index, Float64, float]], light: int
) -> Levels:
    image, scene = pose.actual.lights[light], pose.scene
    diffuse, specular = _layer(image.diffuse), _layer(image.specular)
    level = image.level + np.float32(draw.R_d - 1.0) * diffuse + np.float32(draw.R_s - 1.0) * specular
    flat = level.reshape(-1)
    flat[change.pixels] += (draw.R_d * change.diffuse[light] + draw.R_s * change.specular[light]).astype(np.float32)
    for pixels, cover, R_d in dust:
        flat[pixels] = (1.0 - cover) * flat[pixels] + cover * R_d * pose.white[light, pixels]
    level *= np.float32(draw.gains[light])
    return expose(
        level,
        sensor=scene.sensor,
        exposure=pose.exposures[light],
        full_scale=scene.reflectance.full_scale,
        rng=image_rng(pose.setup.options.seed, light=light, posture=draw.number, exposure=0),
    )


def _observations(
    scene: Scene, posture: Posture, exposures: Sequence[float], levels: Sequence[Levels]
) -> list[Observation]:
    return [
        Observation(
            light=light.name,
            posture=posture,
            exposure=exposure,
            levels=one.astype(np.float32),
            saturated=saturated(one, scene.sensor),
            half_width=0.5,
            source=Path(light.name),
        )
        for light, exposure, one in zip(scene.lights, exposures, levels, strict=True)
    ]


def _layer(layer: Float32 | None) -> Float32:
    assert layer is not None  # images of poses have layers
    return layer
