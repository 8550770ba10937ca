"""Render a posture: blocks of image rows on a pool of threads, every light per block."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, Index, Int32, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.run_context import Share, WorkCounter
from lightopt.core.threads import available_processors, run_all
from lightopt.core.transforms import Posture
from lightopt.core.vectors import dot, vector_at
from lightopt.geometry import Hits, Patches, RayCaster
from lightopt.rendering._bounced_images import ALIKE, bounced_bands
from lightopt.rendering._converged_panel import (
    ConvergedPanel,
    PanelVisibility,
    Shaded,
    channel_groups,
    panel_to_shade,
    shade_changed,
    shade_together,
    shadow_targets,
)
from lightopt.rendering._defect_shading import DefectSamples, defect_samples
from lightopt.rendering._direct_view import direct_levels
from lightopt.rendering._interreflection import PartLight
from lightopt.rendering._lens_means import TYPICAL_VIEWS, Images, Sums, added, lens_means
from lightopt.rendering._motion import exposure_instants
from lightopt.rendering._penumbra_squares import SIDES
from lightopt.rendering._surface import PointRows, SurfacePoints, trace_samples
from lightopt.scene import Scene, lens_share, screen_window, through_lens, view_from_part

_log = logging.getLogger("lightopt.rendering")

# image samples that a thread works on at once: bounds the memory, whose most is in the processor's cache then, and is
# large enough to hide Python's overhead
BLOCK_SAMPLES = 49_152

ERROR_WINDOW = 5  # rows and columns of pixels, of whose errors each has the greatest

# Means over pixels take so many rays a side, where second and fourth differences of neighbouring levels are above the
# camera's noise. Elsewhere a twenty-fourth of the second differences is the mean's, to a few hundredths of the noise.
RAYS_ACROSS = 3


TILE = 4  # rows and columns of the tiles of an image whose rays are cast together

_Places = tuple[Int32, Int32, Int32]  # numbers of rays, and rows and columns of their pixels


@dataclass(frozen=True, kw_only=True)
class LightImage:
    """The part under one light at exposure 1."""

    light: str
    level: Float32  # linear, unclipped, noise-free [grey level], shape (height, width)
    diffuse: Float32 | None = None  # diffuse component [grey level], or None without `layers`
    specular: Float32 | None = None  # specular component [grey level], or None without `layers`
    # level of a pixel's centre minus the mean over the pixel, shape (height, width); None without `averaged`, and with
    # a lens of finite aperture, whose images are means over pixels
    inside: Float32 | None = None
    # error of the light from the part and its surroundings, which is estimated from few rays: standard deviation of
    # independent pixels that would be as large over the size of a defect [grey level], shape (height, width); None
    # without such light, and without `layers`
    error: Float32 | None = None


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """What each pixel's centre looks at; world frame, zero where a ray misses the part."""

    points: Float32  # [mm], shape (height, width, 3)
    normals: Float32  # interpolated unit normals of the surface without its defects, shape (height, width, 3)
    distance: Float32  # from the pinhole along the ray [mm], shape (height, width)
    patch: Int32  # patch seen, −1 where none; all −1 without patches; shape (height, width)
    hit: Bool  # whether the ray meets the part, shape (height, width)
    # index among the scene's defects of the one seen, −1 where none, shape (height, width); None for a part without
    # defects
    defect: Int32 | None = None
    # number of the reflectance seen, shape (height, width); None for a part without regions
    material: UInt8 | None = None


@dataclass(frozen=True, kw_only=True)
class PostureImages:
    """A part in one posture under each light."""

    posture: Posture
    lights: tuple[LightImage, ...]
    geometry: Geometry
    back_faces: int  # number of pixels whose centre sees the back of a face; they are black
    rays: int


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelLevels:
    """Some pixels of the images of a posture, k of them: means over their area."""

    diffuse: Float64  # diffuse part of the direct light of each light [grey level], shape (lights, k)
    specular: Float64  # specular part of the direct light of each light [grey level], shape (lights, k)
    defect: Float64  # share of each pixel that each of the scene's defects takes, shape (defects, k)


def cast_rays_at(scene: Scene, *, rays: float = math.inf) -> RayCaster:
    """The ray caster of a scene's part, in the part's frame; serves all postures.

    rays: About how many will be cast, where that is known
    """
    return RayCaster(scene.mesh.vertices, scene.mesh.faces, rays=rays)


def rays_of_images(scene: Scene, *, supersample: int = 1) -> float:
    """About how many rays the images of all postures take, of a part that fills the view."""
    mean = scene.camera.lens is not None or scene.motion is not None
    if mean or any(light.points == "auto" for light in scene.lights):
        return math.inf
    # blocker maps leave about as many shadow rays as there are camera rays
    return 2.0 * len(scene.postures) * scene.camera.width * scene.camera.height * supersample**2


def render(
    scene: Scene,
    *,
    shadows: bool = True,
    supersample: int = 1,
    layers: bool = False,
    patches: Patches | None = None,
    threads: int | None = None,
) -> Iterator[PostureImages]:
    """Render all postures of a scene under all its lights, one posture after the other; its defects are shown.

    A part that moves is blurred as during exposure 1. A lens of finite aperture averages over its area and that of each
    pixel: then `supersample` only says from how many rays at least, n².

    scene: From :func:`lightopt.scene.build_scene`
    shadows: Whether the part casts shadows on itself
    supersample: n² rays per pixel on a regular n × n grid, averaged
    layers: Whether to keep the diffuse and the specular component apart as well
    patches: Of the scene's mesh, for the patch that each pixel sees

    Examples
    --------
    >>> from lightopt import build_scene, render
    >>> scene = build_scene("configs/rigs/four-panel.yaml", "configs/parts/cover-knob.yaml")  # doctest: +SKIP
    >>> for images in render(scene):  # doctest: +SKIP
    ...     print(images.posture, images.lights[0].level.max())
    """
    caster = cast_rays_at(scene, rays=rays_of_images(scene, supersample=supersample))
    for posture in scene.postures:
        yield render_posture(
            scene,
            posture,
            caster=caster,
            shadows=shadows,
            supersample=supersample,
            layers=layers,
            patches=patches,
            exposure=1.0,
            threads=threads,
        )


def render_posture(
    scene: Scene,
    posture: Posture,
    *,
    caster: RayCaster,
    shadows: bool = True,
    supersample: int = 1,
    layers: bool = False,
    patches: Patches | None = None,
    averaged: Bool | None = None,
    exposure: float | None = None,
    threads: int | None = None,
    progress: Share | None = None,
) -> PostureImages:
    """Render one posture of a scene under all its lights.

    Parameters as in :func:`render`, and any posture, not only one of the scene's.

    averaged: Pixels, shape (height, width), that get the mean over their area, to a small share of the camera's noise,
        from a ray at each centre and more rays only where levels are not smooth; with `supersample` 1
    exposure: Of the images, whose levels are at exposure 1: a part that moves is blurred as during this exposure; None
        for a part at rest
    """
    before = caster.rays_cast
    how: dict[str, Any] = {"shadows": shadows, "supersample": supersample, "layers": layers, "averaged": averaged}
    images, job = _render(
        scene, posture, caster, patches=patches, exposure=exposure, threads=threads, progress=progress, **how
    )
    assert job.geometry is not None
    return PostureImages(
        posture=posture,
        lights=images,
        geometry=job.geometry,
        back_faces=int(job.back.sum()),
        rays=caster.rays_cast - before,
    )


def render_lights(
    scene: Scene,
    posture: Posture,
    *,
    caster: RayCaster,
    averaged: Bool | None = None,
    exposure: float | None = None,
    threads: int | None = None,
) -> tuple[LightImage, ...]:
    """The images of :func:`render_posture` alone, without what each pixel looks at."""
    how: dict[str, Any] = {"averaged": averaged, "geometry": False}
    return _render(scene, posture, caster, exposure=exposure, threads=threads, **how)[0]


def render_pixels(scene: Scene, posture: Posture, pixels: Index, *, caster: RayCaster) -> PixelLevels:
    """Render some pixels of a posture's images, raveled indices, from a few rays in each.

    What defects change is the difference between two calls, with and without them: both cast the same rays. Light from
    the part to itself and a lens of finite aperture are left out.
    """
    job = _PostureJob(scene, posture, caster, layers=True, geometry=False)
    step = max(1, BLOCK_SAMPLES // RAYS_ACROSS**2)
    parts = [job.levels_of(pixels[start : start + step]) for start in range(0, max(1, len(pixels)), step)]
    names = ("diffuse", "specular", "defect")
    return PixelLevels(**{name: np.concatenate([getattr(one, name) for one in parts], axis=1) for name in names})


def _render(
    scene: Scene,
    posture: Posture,
    caster: RayCaster,
    *,
    exposure: float | None,
    patches: Patches | None = None,
    geometry: bool = True,
    supersample: int = 1,
    averaged: Bool | None = None,
    threads: int | None = None,
    progress: Share | None = None,
    **how: Any,
) -> tuple[tuple[LightImage, ...], _PostureJob]:
    # images, and the job that knows what pixels look at through the middle of the lens in the middle of the exposure
    lens, motion = scene.camera.lens, None if exposure is None else scene.motion
    how |= {} if lens else {"supersample": supersample, "averaged": averaged}
    if lens is None and motion is None:
        job = _PostureJob(scene, posture, caster, patches=patches, geometry=geometry, **how)
        return job.run(threads, progress), job
    job = _PostureJob(replace(scene, lights=()), posture, caster, patches=patches)
    if geometry or motion is not None:
        job.run(threads)
    instants, seconds = np.zeros(1), 0.0
    if motion is not None and exposure is not None:
        assert job.geometry is not None
        points = (job.geometry.points[job.geometry.hit] - job.view.translation) @ job.view.rotation
        instants, seconds = exposure_instants(scene, posture, points, exposure=exposure), exposure * motion.exposure_s
    counter = WorkCounter(TYPICAL_VIEWS if lens else len(instants), progress)

    def render_at(after: float, seen: Scene = scene, offset: Float64 | None = None) -> Images:
        images = _PostureJob(seen, posture, caster, geometry=False, seconds=after, offset=offset, **how).run(threads)
        counter.add(1)
        counter.report()
        names = ("level", "diffuse", "specular", "inside", "error")
        return [{name: own for name in names if (own := getattr(image, name)) is not None} for image in images]

    def render_view(place: Float64, offset: Float64, share: float) -> Images:
        return render_at(share * seconds, replace(scene, camera=through_lens(scene.camera, place)), offset)

    if lens is None:
        sums: Sums = []
        for after in instants.tolist():
            sums = added(sums, render_at(after))
        means = [{name: (total / len(instants)).astype(np.float32) for name, total in one.items()} for one in sums]
    else:
        means = lens_means(render_view, scene, least=max(supersample**2, len(instants)))
    return tuple(LightImage(light=light.name, **mean) for light, mean in zip(scene.lights, means, strict=True)), job


class _RaysInside(NamedTuple):
    # rays through places all over some pixels, and what they meet
    pixels: int  # how many they are
    pixel: Int32  # of each ray that meets the part, its number among these pixels
    surface: SurfacePoints
    sample: Index
    grid: tuple[int, int]
    passed: Float64 | None
    marked: tuple[DefectSamples, ...]


class _PostureJob:
    """The images of one posture while they are being made; blocks write to rows of their own."""

    def __init__(
        self,
        scene: Scene,
        posture: Posture,
        caster: RayCaster,
        *,
        shadows: bool = True,
        supersample: int = 1,
        layers: bool = False,
        patches: Patches | None = None,
        averaged: Bool | None = None,
        geometry: bool = True,
        offset: Float64 | None = None,  # of the samples from their pixels' centres, to the right and down [px]
        seconds: float = 0.0,  # after the middle of the exposure, for a part that moves [s]
    ) -> None:
        self.scene, self.posture, self.caster = scene, posture, caster
        self.view = view = view_from_part(scene, posture, seconds=seconds)
        self.offset = np.zeros(2) if offset is None else offset
        self.shadow_caster = caster if shadows else None
        self.supersample, self.patches = supersample, patches
        self.window = screen_window(view.camera, scene.mesh)
        shape = (scene.camera.height, scene.camera.width)
        self.images = [
            LightImage(
                light=light.name,
                level=np.zeros(shape, np.float32),
                diffuse=np.zeros(shape, np.float32) if layers else None,
                specular=np.zeros(shape, np.float32) if layers else None,
                inside=None if averaged is None else np.zeros(shape, np.float32),
                error=np.zeros(shape, np.float32) if layers and (scene.bounces or scene.is_surrounded) else None,
            )
            for light in scene.lights
        ]
        self.averaged = averaged
        self.rough: dict[int, Index] = {}
        self.geometry = _no_hit(shape, defects=bool(scene.defects), regions=bool(scene.regions)) if geometry else None
        self.back = np.zeros(shape, np.bool_)
        self.panels = [panel_to_shade(light, caster) for light in view.lights]
        self.together = channel_groups(self.panels)
        # neighbouring samples show where penumbrae are, so that blocks then overlap by a row
        self.halo = int(shadows and any(isinstance(panel, ConvergedPanel) for panel in self.panels))

    def run(self, threads: int | None, progress: Share | None = None) -> tuple[LightImage, ...]:
        """Render all images."""
        caster, view = self.caster, self.view
        before, free, begun = caster.rays_cast, caster.rays_free, monotonic()
        if self.shadow_caster is not None:
            left, top, right, bottom = self.window
            targets = np.concatenate([shadow_targets(light) for light in view.lights] or [np.zeros((0, 3))])
            samples = max(0, right - left) * max(0, bottom - top) * self.supersample**2
            caster.map_blockers(targets, rays=samples, threads=threads)
        blocks = self.blocks()
        counter = WorkCounter(len(blocks), progress)

        def done() -> None:
            counter.add(1)
            counter.report()

        threads = threads or available_processors()
        run_all(((self.block, rows) for rows in blocks), threads=threads, done=done)
        if self.averaged is not None:
            run_all(((self.find_rough, (number,)) for number in range(len(self.images))), threads=threads)
            run_all(((self.average, chunk) for chunk in self.rough_chunks()), threads=threads)
            for image in self.images:
                assert image.inside is not None
                image.inside[:] -= image.level
        if self.images and (self.scene.bounces or self.scene.is_surrounded):
            self.add_bounces(threads)
        for number, level in direct_levels(view, self.scene.mesh, caster, threads=threads):
            self.images[number].level[:] += level
        rays, free, seconds = caster.rays_cast - before, caster.rays_free - free, monotonic() - begun
        text = "posture %s: %.2f million rays in %.2f s; %.2f million shadow rays proven free"
        _log.info(text, self.posture, rays / 1e6, seconds, free / 1e6)
        return tuple(self.images)

    def blocks(self) -> list[tuple[int, int]]:
        """Rows [top, bottom) of each block."""
        left, top, right, bottom = self.window
        samples_per_row = max(1, right - left) * self.supersample**2
        step = max(1, BLOCK_SAMPLES // samples_per_row)
        if self.halo:
            # with the rows that overlap, whole squares of the penumbrae
            step = max(1, step * self.supersample // SIDES[0] * SIDES[0] - 1) // self.supersample or 1
        return [(row, min(row + step, bottom)) for row in range(top, bottom, step)]

    def block(self, top: int, bottom: int) -> None:
        """Render rows [top, bottom) under every light."""
        n = self.supersample
        left, _, right, _ = self.window
        rows = _centres(top * n - self.halo, bottom * n + self.halo) / n + self.offset[1]
        columns = _centres(left * n, right * n) / n + self.offset[0]
        hits, smooth = self._trace(columns, rows)
        surface = self._wavy(smooth)
        marked = self._in_defects(surface)
        grid = (len(rows), len(columns))
        own = slice(self.halo, grid[0] - self.halo)
        target = (slice(top, bottom), slice(left, right))
        places = None
        if n == 1:
            places = _places(hits.ray, grid[1], own.start, own.stop, top, left)
            self._store_geometry(hits, smooth, marked, places)
        else:
            centre_hits, centres = self._trace(_centres(left, right), _centres(top, bottom))
            centre_places = _places(centre_hits.ray, right - left, 0, bottom - top, top, left)
            self._store_geometry(centre_hits, centres, self._in_defects(centres), centre_places)
        sample = hits.ray.astype(np.intp)
        passed = None
        if self.view.camera.dims:
            passed = lens_share(self.view.camera, columns[sample % len(columns)], rows[sample // len(columns)])
        for numbers in self.together:
            lights = self._shade(surface, numbers, sample, grid)
            for number, light in zip(numbers, lights, strict=True):
                for pixels, values in self._light(marked, number, light, sample, grid, passed):
                    if places is None:
                        pixels[target] = self._means(values, hits, grid, own)
                    else:
                        _store_values(places, values, pixels)

    def _light(
        self,
        marked: tuple[DefectSamples, ...],
        number: int,
        light: Shaded,
        sample: Index,
        grid: tuple[int, int],
        passed: Float64 | None,
    ) -> Iterator[tuple[Float32, Float64]]:
        # the arrays of an image, and what its light, from `_shade`, makes of the samples for each [grey level]
        image, panel = self.images[number], self.panels[number]
        diffuse, specular, seen = light
        for some in marked:
            own: dict[str, Any] = {"index": some.index, "seen": seen, "sample": sample, "shape": grid}
            changed = shade_changed(some.surface, panel, some.reflectance, self.shadow_caster, **own)
            diffuse[some.index], specular[some.index] = changed
        if passed is not None:
            diffuse, specular = passed * diffuse, passed * specular
        yield image.level, diffuse + specular
        if image.diffuse is not None and image.specular is not None:
            yield from ((image.diffuse, diffuse), (image.specular, specular))

    def find_rough(self, number: int) -> None:
        """Turn smooth levels of a light into means over the pixel; find the pixels that need more rays for that."""
        image, sensor = self.images[number], self.scene.sensor
        assert self.averaged is not None
        assert image.inside is not None
        image.inside[:] = image.level
        scale = sensor.max_level / self.scene.reflectance.full_scale
        still = sensor.noise_variance(0.0)
        rough = _rough(
            image.level, self.averaged, scale, float(sensor.max_level), still, sensor.noise_variance(1.0) - still
        )
        # what is narrower than a pixel may show in the next one only
        rough = np.logical_and(ndimage.binary_dilation(rough, np.ones((3, 3))), self.averaged)
        self.rough[number] = np.flatnonzero(rough)
        for pixels in (image.level, image.diffuse, image.specular):
            if pixels is not None:
                _add_curvature(pixels.copy(), self.averaged & ~rough, pixels)

    def rough_chunks(self) -> Iterator[tuple[list[int], Index]]:
        """Numbers of lights that are shaded together and some of the pixels rough in any, for :meth:`average`."""
        step = max(1, BLOCK_SAMPLES // RAYS_ACROSS**2)
        for numbers in self.together:
            pixels = np.unique(np.concatenate([self.rough[number] for number in numbers]))
            for start in range(0, len(pixels), step):
                yield numbers, pixels[start : start + step]

    def average(self, numbers: list[int], pixels: Index) -> None:
        """Render means over those of some pixels, raveled indices, that are rough in each light."""
        for number, light in self._means_inside(self._rays_inside(pixels), numbers):
            own = np.isin(pixels, self.rough[number], assume_unique=True)
            for target, means in light:
                target.ravel()[pixels[own]] = means[own]

    def levels_of(self, pixels: Index) -> PixelLevels:
        """Means over some pixels, raveled indices."""
        inside = self._rays_inside(pixels)
        diffuse, specular = np.zeros((2, len(self.images), len(pixels)))
        for numbers in self.together:
            for number, light in self._means_inside(inside, numbers):
                _, (_, diffuse[number]), (_, specular[number]) = light
        share = np.zeros((len(self.scene.defects), len(pixels)))
        for some in inside.marked:
            np.add.at(share, (some.label, inside.pixel[some.index]), 1.0 / RAYS_ACROSS**2)
        return PixelLevels(diffuse=diffuse, specular=specular, defect=share)

    def _rays_inside(self, pixels: Index) -> _RaysInside:
        n = RAYS_ACROSS
        row, column = np.divmod(pixels, self.scene.camera.width)
        columns, rows = _inner_points(column, row)
        hits, surface = trace_samples(self.caster, self.scene.mesh, self.view.camera, columns, rows, neighbours=True)
        surface = self._wavy(surface)
        pixel = hits.ray // n**2
        return _RaysInside(
            pixels=len(pixels),
            pixel=pixel,
            surface=surface,
            # to the shadows' refinement the rays of a pixel are neighbours, those of two pixels are not
            sample=hits.ray.astype(np.intp) + pixel * n,
            grid=(len(pixels) * (n + 1), n),
            passed=lens_share(self.view.camera, columns[hits.ray], rows[hits.ray]),
            marked=self._in_defects(surface),
        )

    def _means_inside(
        self, inside: _RaysInside, numbers: list[int]
    ) -> Iterator[tuple[int, list[tuple[Float32, Float64]]]]:
        # of each light its arrays, and the means over the pixels for each
        shaded = self._shade(inside.surface, numbers, inside.sample, inside.grid)
        for number, light in zip(numbers, shaded, strict=True):
            found = self._light(inside.marked, number, light, inside.sample, inside.grid, inside.passed)
            yield (
                number,
                [(target, np.bincount(inside.pixel, each, inside.pixels) / RAYS_ACROSS**2) for target, each in found],
            )

    def add_bounces(self, threads: int) -> None:
        """Add the light that reaches the camera from the part, or its surroundings, by way of the part."""
        around: dict[str, Any] = {"housings": self.view.housings, "shadows": self.shadow_caster is not None}
        light = PartLight.of_scene(self.scene, self.view.lights, self.caster, **around)

        def trace(columns: Float64, rows: Float64) -> tuple[Hits, SurfacePoints]:
            hits, surface = self._trace(columns, rows)
            return hits, self._wavy(surface)

        bands = bounced_bands(
            light,
            self.view.camera,
            self.window,
            trace,
            supersample=self.supersample,
            offset=self.offset,
            threads=threads,
        )
        for band in bands:
            own = (slice(band.top, band.bottom), slice(band.left, band.left + band.diffuse.shape[2]))
            bounced = band.diffuse, band.specular, band.error
            for image, diffuse, specular, error in zip(self.images, *bounced, strict=True):
                image.level[own] += diffuse + specular
                if image.error is not None:
                    image.error[own] = error
                if image.diffuse is not None and image.specular is not None:
                    image.diffuse[own] += diffuse
                    image.specular[own] += specular
        for image in self.images:
            if image.error is not None:
                # of few pixels, single ones have missed what others beside them met
                image.error[:] = ALIKE * ndimage.maximum_filter(image.error, ERROR_WINDOW)

    def _trace(self, columns: Float64, rows: Float64) -> tuple[Hits, SurfacePoints]:
        order, *at = _tiles(columns, rows)
        hits, surface = trace_samples(self.caster, self.scene.mesh, self.view.camera, *at, neighbours=True)
        return hits._replace(ray=order[hits.ray]), surface

    def _wavy(self, surface: SurfacePoints) -> SurfacePoints:
        waviness, place = self.scene.waviness, self.scene.placement
        if waviness is None or waviness.seed is None:
            return surface
        points = (surface.points - place.translation) @ place.rotation
        normals = waviness.normals(points, surface.normals @ place.rotation) @ place.rotation.T
        return replace(surface, normals=normals)

    def _in_defects(self, surface: SurfacePoints) -> tuple[DefectSamples, ...]:
        return defect_samples(self.scene.defects, surface, self.scene.reflectances)

    def _shade(self, surface: SurfacePoints, numbers: list[int], sample: Index, grid: tuple[int, int]) -> list[Shaded]:
        # diffuse and specular levels of lights that are shaded together, and what the samples see of them
        lights, caster = [self.panels[number] for number in numbers], self.shadow_caster
        parts = [
            (index, shade_together(some, lights, own, caster, sample=sample[index], shape=grid))
            for index, some, own in surface.by_material(self.scene.reflectances)
        ]
        if surface.material is None:
            return parts[0][1]
        count, merged = len(surface), list[Shaded]()
        for i, light in enumerate(lights):
            diffuse, specular = np.empty(count), np.empty(count)
            seen = None
            if isinstance(light, ConvergedPanel):
                seen = PanelVisibility(np.empty(count, np.uint8), np.empty(count, np.bool_))
            for index, found in parts:
                diffuse[index], specular[index], own_seen = found[i]
                if seen is not None and own_seen is not None:
                    seen.coarse[index], seen.penumbra[index] = own_seen.coarse, own_seen.penumbra
            merged.append((diffuse, specular, seen))
        return merged

    def _means(self, values: Float64, hits: Hits, grid: tuple[int, int], own: slice) -> Float64:
        # over the samples of each pixel; 0 where a ray misses the part
        samples, n = np.zeros(grid), self.supersample
        samples.ravel()[hits.ray] = values
        samples = samples[own]
        rows, columns = samples.shape
        return samples.reshape(rows // n, n, columns // n, n).mean(axis=(1, 3))

    def _store_geometry(
        self, hits: Hits, surface: SurfacePoints, marked: tuple[DefectSamples, ...], places: _Places
    ) -> None:
        g = self.geometry
        if g is None:
            return
        pose, images = (self.view.rotation, self.view.translation), (g.points, g.normals, g.distance, g.hit, self.back)
        _store_surface(places, surface.rows, hits.distance, pose, images)
        if self.patches is not None:
            _store_values(places, self.patches.patch_at(hits.face, hits.u, hits.v), g.patch)
        if g.material is not None and surface.material is not None:
            _store_values(places, surface.material, g.material)
        if g.defect is not None:
            label = np.full(len(surface), -1, np.int32)
            for some in marked:
                label[some.index] = some.label
            _store_values(places, label, g.defect)


def _no_hit(shape: tuple[int, int], *, defects: bool, regions: bool) -> Geometry:
    # of an image that shows no part
    return Geometry(
        points=np.zeros((*shape, 3), np.float32),
        normals=np.zeros((*shape, 3), np.float32),
        distance=np.zeros(shape, np.float32),
        patch=np.full(shape, -1, np.int32),
        hit=np.zeros(shape, np.bool_),
        defect=np.full(shape, -1, np.int32) if defects else None,
        material=np.zeros(shape, np.uint8) if regions else None,
    )


@kernel
def _tiles(columns: Float64, rows: Float64) -> tuple[Int32, Float64, Float64]:
    # the raveled grid, tile by tile, so that rays that go nearly the same way follow each other: index in the grid,
    # column and row
    count = len(rows) * len(columns)
    order, x, y = np.empty(count, np.int32), np.empty(count), np.empty(count)
    k = 0
    for top in range(0, len(rows), TILE):
        for left in range(0, len(columns), TILE):
            for row in range(top, min(top + TILE, len(rows))):
                for column in range(left, min(left + TILE, len(columns))):
                    order[k] = row * len(columns) + column
                    x[k], y[k] = columns[column], rows[row]
                    k += 1
    return order, x, y


@kernel
def _rough(level: Float32, averaged: Bool, scale: float, top: float, still: float, shot: float) -> Bool:
    # pixels to average whose levels bend by more than noise within a pixel. Above `top` noise is that of an exposure
    # that is just short enough
    rough = np.zeros(level.shape, np.bool_)
    for y in range(2, level.shape[0] - 2):
        for x in range(2, level.shape[1] - 2):
            if not averaged[y, x]:
                continue
            here = float(level[y, x])
            signal = here * scale
            noise = math.sqrt(still + shot * min(signal, top)) * max(signal / top, 1.0) / scale
            for down, right in ((0, 1), (1, 0)):
                near = float(level[y - down, x - right]) + float(level[y + down, x + right])
                far = float(level[y - 2 * down, x - 2 * right]) + float(level[y + 2 * down, x + 2 * right])
                if min(abs(near - 2.0 * here), abs(far - 4.0 * near + 6.0 * here)) > noise:
                    rough[y, x] = True
    return rough


@kernel
def _add_curvature(level: Float32, smooth: Bool, mean: Float32) -> None:
    # the mean over a pixel of a quadratic is that of its middle and 1/24 of its second derivatives
    for y in range(1, level.shape[0] - 1):
        for x in range(1, level.shape[1] - 1):
            here = level[y, x]
            if smooth[y, x] and here > 0.0:
                bend = level[y - 1, x] + level[y + 1, x] + level[y, x - 1] + level[y, x + 1] - np.float32(4.0) * here
                mean[y, x] = max(here + bend / np.float32(24.0), np.float32(0.5) * here)


def _inner_points(column: Index, row: Index) -> tuple[Float64, Float64]:
    # image points of the rays through pixels, a pixel's n² one after the other: a grid that is sheared, so that no two
    # share a row or a column, and an edge along either is where it is to 1/n² of a pixel
    n = RAYS_ACROSS
    down, right = (np.ravel(a) for a in np.divmod(np.arange(n * n), n))
    x = (right + (down + 0.5) / n) / n
    y = (down + (n - 0.5 - right) / n) / n
    return (column[:, None] + x).ravel(), (row[:, None] + y).ravel()


@kernel
def _places(ray: Int32, columns: int, own_start: int, own_end: int, top: int, left: int) -> _Places:
    # which of the rays of a grid belong to its own rows, and the rows and columns of their pixels
    index, row, column = np.empty(len(ray), np.int32), np.empty(len(ray), np.int32), np.empty(len(ray), np.int32)
    k = 0
    for i in range(len(ray)):
        y = ray[i] // columns
        if own_start <= y < own_end:
            index[k], row[k], column[k] = i, top + y - own_start, left + ray[i] - y * columns
            k += 1
    return index[:k], row[:k], column[:k]


@kernel
def _store_surface(
    places: _Places,
    surface: PointRows,
    distance: Float64,
    pose: tuple[Float64, Float64],
    images: tuple[Float32, Float32, Float32, Bool, Bool],
) -> None:
    # turned into the world's frame
    (index, row, column), (points, frames, _, _, front), (rotation, translation) = places, surface, pose
    point_image, normal_image, distance_image, hit_image, back_image = images
    for j in range(len(index)):
        i, y, x = index[j], row[j], column[j]
        p, n = vector_at(points, i), vector_at(frames, i)
        for axis in range(3):
            turned = vector_at(rotation, axis)
            point_image[y, x, axis] = dot(turned, p) + translation[axis]
            normal_image[y, x, axis] = dot(turned, n)
        distance_image[y, x] = distance[i]
        hit_image[y, x] = True
        back_image[y, x] = not front[i]


@kernel
def _store_values(places: _Places, values: Any, image: Any) -> None:
    index, row, column = places
    for j in range(len(index)):
        image[row[j], column[j]] = values[index[j]]


def _centres(first: int, end: int) -> Float64:
    return np.arange(first, end, dtype=np.float64) + 0.5
