"""The pixels of a fit, with their geometry and measured levels: all that does not change during the fit."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lightopt import rendering
from lightopt.core.arrays import Bool, Float32, Float64, Index, Int32, UInt8
from lightopt.core.errors import InputError
from lightopt.core.run_context import Share, ignore
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, SurfaceLight
from lightopt.optics import DiffuseForm, Reflectance, Sensor, SpecularModel
from lightopt.rendering import LightLayer, PosturePixels, light_layer
from lightopt.scene import Scene, lens_share

# pixels are kept by octave of the least angle between normal and half vector: up to 1 mrad, 2 mrad, … so that a lobe of
# any width has pixels on its flanks
FIRST_OCTAVE_RAD, OCTAVES = 0.001, 11
# blocks along the longer side of the image: what the model gets wrong is taken as alike within each of them
BLOCKS = 24
WHOLE_IMAGE = slice(None), slice(None)
UNLIT_SHARE = 0.25  # pixels that no light reaches determine the dark level; this share of an octave's budget is plenty


@dataclass(frozen=True, kw_only=True)
class SampleGroup:
    """Pixels of one posture under one light."""

    light: int
    posture: Posture
    layer: LightLayer | None  # their light per unit of reflectance; None for pixels that no light reaches
    row: Int32
    column: Int32
    weight: Float64  # pixels of the image that each stands for, shape (n,)
    passed: Float64 | float = 1.0

    def __len__(self) -> int:
        return len(self.row)

    @property
    def diffuse(self) -> Float64:
        """Light per unit of R_d, shape (n,)."""
        return np.zeros(len(self)) if self.layer is None else self.passed * self.layer.diffuse

    @property
    def deflection(self) -> Float64:
        """Least angle between normal and half vector [rad], shape (n,)."""
        return np.full(len(self), np.pi) if self.layer is None else self.layer.deflection


class ImageFacts(NamedTuple):
    """Per image, for the kernels; arrays of shape (images,)."""

    factor: Float64  # sensor levels per grey level: exposure times the sensor's full scale over the reflectance's
    light: Int32
    half_width: Float64  # how far from a level the signal may have been [sensor level]
    frames: Float64  # number of frames that the image is the mean of, as float64


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Pixels (n) and what was measured there (N observations: a pixel has one per exposure)."""

    groups: tuple[SampleGroup, ...]
    diffuse: Float64  # light per unit of R_d, 0 where none arrives, shape (n,)
    deflection: Float64  # least angle between normal and half vector [rad], π where no light arrives, shape (n,)
    weight: Float64  # pixels of the image that each stands for, shape (n,)
    block: Int32  # block of the image that each pixel lies in, one number per posture and block, shape (n,)
    sample: Int32  # pixel of each observation, shape (N,)
    image: Int32  # image of each observation, shape (N,)
    level: Float32  # sensor level, shape (N,)
    saturated: Bool  # where `level` is only a lower bound, shape (N,)
    images: tuple[Observation, ...]
    facts: ImageFacts
    lights: tuple[str, ...]  # names of the scene's lights
    sensor: Sensor
    model: SpecularModel  # of the specular lobe
    threads: int | None = None  # number of threads that work on them; no result depends on it

    def select(self, where: Bool | Index) -> "Samples":
        """Only the observations that `where` marks, shape (N,), or lists; the pixels stay."""
        fields = ("sample", "image", "level", "saturated")
        return replace(self, **{name: getattr(self, name)[where] for name in fields})

    def with_images(self, images: Sequence[Observation], flip: tuple[slice, slice] = WHOLE_IMAGE) -> "Samples":
        """The same pixels of other images of the same lights, postures and exposures, as `images` are, or flipped."""
        place = (self.image, *self.places)
        levels, saturated = np.stack([o.levels[flip] for o in images]), np.stack([o.saturated[flip] for o in images])
        return replace(self, level=levels[place], saturated=saturated[place])

    @property
    def places(self) -> tuple[Int32, Int32]:
        """Row and column in the image of each observation, shape (N,) each."""
        rows, columns = (np.concatenate([getattr(g, name) for g in self.groups]) for name in ("row", "column"))
        return rows[self.sample], columns[self.sample]

    def specular(self, sigma: float) -> Float64:
        """Light per unit of R_s for a lobe of width σ [rad], shape (n,)."""
        layers = [group.layer for group in self.groups if group.layer is not None]
        reflectance = Reflectance(R_d=0.0, R_s=1.0, sigma=sigma, model=self.model)
        lit = iter(rendering.specular_of_layers(layers, reflectance, threads=self.threads))
        parts = [np.zeros(len(group)) if group.layer is None else group.passed * next(lit) for group in self.groups]
        return np.concatenate(parts)


def collect_samples(
    scene: Scene,  # with the postures and lights of the images
    observations: Sequence[Observation],
    *,
    caster: RayCaster,
    budget: int,
    # whether `budget` is one for all octaves together, so that shares of the pixels are shares of the image
    uniform: bool = False,
    threads: int | None = None,
    progress: Share = ignore,
) -> Samples:
    """Choose pixels of the scene's first reflectance by their geometry alone and look up what was measured there."""
    names = [light.name for light in scene.lights]
    groups: list[SampleGroup] = []
    wanted = sorted({(scene.postures.index(o.posture), names.index(o.light)) for o in observations})
    pixels: PosturePixels | None = None
    verdicts: dict[int, UInt8] = {}
    draws: dict[tuple[int, int | str], int] = {}  # channels of a light take the same pixels
    for done, (posture, light) in enumerate(wanted):
        if pixels is None or pixels.posture != scene.postures[posture]:
            pixels = rendering.trace_pixels(scene, scene.postures[posture], caster, threads=threads)
            own = [number for at, number in wanted if at == posture]
            seen = rendering.visibility_of_lights(pixels, [pixels.view.lights[i] for i in own], caster, threads=threads)
            verdicts = dict(zip(own, seen, strict=True))
        panel, surface = pixels.view.lights[light], pixels.surface
        own = pixels.clean if surface.material is None else pixels.clean & (surface.material == 0)
        partly = own & (verdicts[light] == rendering.PARTLY)
        seen = np.flatnonzero(partly | own & (verdicts[light] == rendering.WHOLE))
        unlit = np.flatnonzero(own & (verdicts[light] == rendering.UNLIT))
        form, shadows = scene.reflectance.diffuse, bool(partly.any())
        layer = light_layer(surface.take(seen), panel, caster, form=form, shadows=shadows, threads=threads)
        angle = np.zeros(len(seen)) if uniform else layer.deflection
        draw = posture, draws.setdefault((posture, _entry(panel)), light)
        lit, lit_share = _by_octave(angle, budget, draw)
        few, few_share = _by_octave(np.full(len(unlit), np.pi), max(1, int(UNLIT_SHARE * budget)), draw)
        passed = lens_share(pixels.view.camera, pixels.column + 0.5, pixels.row + 0.5)
        groups += [
            SampleGroup(
                light=light,
                posture=pixels.posture,
                layer=of_light,
                row=pixels.row[index],
                column=pixels.column[index],
                weight=1.0 / share,
                passed=1.0 if passed is None else passed[index],
            )
            for of_light, index, share in ((layer.take(lit), seen[lit], lit_share), (None, unlit[few], few_share))
            if len(index)
        ]
        progress((done + 1) / len(wanted))
    return _assemble(scene, groups, tuple(observations), threads)


def subsample(samples: Samples, budget: int) -> Samples:
    """At most `budget` of the pixels per octave, light and posture, with the observations that there are of them."""
    groups: list[SampleGroup] = []
    indices: list[Index] = []
    draws: dict[tuple[Posture, int | str], tuple[int, int]] = {}
    start = 0
    for group in samples.groups:
        draw = len(groups), group.light
        if group.layer is not None:
            draw = draws.setdefault((group.posture, _entry(group.layer.light)), draw)
        keep, share = _by_octave(samples.deflection[start : start + len(group)], budget, draw)
        indices.append(start + keep)
        start += len(group)
        groups.append(
            replace(
                group,
                layer=None if group.layer is None else group.layer.take(keep),
                row=group.row[keep],
                column=group.column[keep],
                weight=group.weight[keep] / share,
                passed=group.passed[keep] if isinstance(group.passed, np.ndarray) else group.passed,
            )
        )
    pixels = np.concatenate(indices)
    place = np.full(start, -1, np.int32)
    place[pixels] = np.arange(len(pixels), dtype=np.int32)
    left = samples.select(place[samples.sample] >= 0)
    return replace(
        left,
        groups=tuple(groups),
        diffuse=samples.diffuse[pixels],
        deflection=samples.deflection[pixels],
        weight=np.concatenate([group.weight for group in groups]),
        block=samples.block[pixels],
        sample=place[left.sample],
    )


def _entry(light: PanelLight) -> int | str:
    # the same for channels of one light
    return light.entry if isinstance(light, SurfaceLight) else light.name


def relit(samples: Samples, caster: RayCaster, *, form: DiffuseForm | None = None, evenly_lit: bool = False) -> Samples:
    """The same pixels with another diffuse form, or lit evenly instead of by point lights; no ray is cast again."""

    def again(layer: LightLayer) -> LightLayer:
        light = replace(layer.light, points="auto") if evenly_lit else layer.light
        own = layer.form if form is None else form
        shadows = layer.caster is not None
        return light_layer(layer.surface, light, caster, form=own, shadows=shadows, threads=samples.threads)

    groups = tuple(g if g.layer is None else replace(g, layer=again(g.layer)) for g in samples.groups)
    return replace(samples, groups=groups, diffuse=np.concatenate([group.diffuse for group in groups]))


def _by_octave(deflection: Float64, budget: int, seed: tuple[int, int]) -> tuple[Index, Float64]:
    # at most `budget` of each octave, by a draw that only depends on light and posture, and the share that was drawn
    octave = np.clip(np.ceil(np.log2(np.maximum(deflection, 1e-9) / FIRST_OCTAVE_RAD)), 0, OCTAVES).astype(int)
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=seed))
    chosen: list[Index] = []
    shares = np.ones(OCTAVES + 1)
    for value in range(OCTAVES + 1):
        index = np.flatnonzero(octave == value)
        chosen.append(index if len(index) <= budget else rng.choice(index, budget, replace=False))
        shares[value] = len(chosen[-1]) / max(1, len(index))
    kept = np.sort(np.concatenate(chosen))
    return kept, shares[octave[kept]]


def _assemble(
    scene: Scene, groups: Sequence[SampleGroup], images: tuple[Observation, ...], threads: int | None
) -> Samples:
    lights = tuple(light.name for light in scene.lights)
    if not any(group.layer is not None for group in groups):
        raise InputError("no pixel shows a surface that a panel lights wholly; check placement and lights")
    scale = scene.sensor.max_level / scene.reflectance.full_scale
    facts = ImageFacts(
        factor=np.array([scale * o.exposure for o in images]),
        light=np.array([lights.index(o.light) for o in images], dtype=np.int32),
        half_width=np.array([o.half_width for o in images]),
        frames=np.array([float(o.frames) for o in images]),
    )
    rows: list[tuple[Int32, Int32, Float32, Bool]] = []
    start = 0
    for group in groups:
        index = np.arange(start, start + len(group), dtype=np.int32)
        start += len(group)
        for number, seen in enumerate(images):
            if seen.posture == group.posture and facts.light[number] == group.light:
                place = group.row, group.column
                rows.append((index, np.full(len(group), number, np.int32), seen.levels[place], seen.saturated[place]))
    sample, image, level, saturated = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Samples(
        groups=tuple(groups),
        diffuse=np.concatenate([group.diffuse for group in groups]),
        deflection=np.concatenate([group.deflection for group in groups]),
        weight=np.concatenate([group.weight for group in groups]),
        block=_blocks(groups, images),
        sample=sample,
        image=image,
        level=level,
        saturated=saturated,
        images=images,
        facts=facts,
        lights=lights,
        sensor=scene.sensor,
        model=scene.reflectance.model,
        threads=threads,
    )


def _blocks(groups: Sequence[SampleGroup], images: Sequence[Observation]) -> Int32:
    postures = list(dict.fromkeys(image.posture for image in images))
    rows, columns = images[0].levels.shape
    side = max(1, math.ceil(max(rows, columns) / BLOCKS))
    numbers = [(postures.index(g.posture) * BLOCKS + g.row // side) * BLOCKS + g.column // side for g in groups]
    return np.concatenate(numbers).astype(np.int32)
