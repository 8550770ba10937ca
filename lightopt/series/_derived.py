"""Images derived from the images of one light in a posture: by its kind and its pattern.

Levels are those of the longest exposure that is not saturated; pixels saturated in every exposure are NaN.

Sine stripes move by steps of a period: image k of N of a direction with coordinate u on the display shows
cos(2πu/P − δ_k), δ_k = 2πk/N, so that the phase grows with u. (For stripes that move the other way, cos(φ + δ_k), the
sine's sum has a minus.)

Deflectometry: the camera sees, at a point of the surface, the place X of the display whose light is mirrored there. The
normal that does this bisects the directions to X and to the camera. The surface's points are the model's: an error h of
its height turns the result by about h·sinθ/d, θ the angle of incidence and d the distance to the display.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lightopt.config import LightConfig, PartConfig, RigConfig, input_hashes
from lightopt.core.arrays import Float64
from lightopt.core.errors import counted
from lightopt.core.provenance import provenance
from lightopt.core.transforms import Posture
from lightopt.images import ImageEntry, ImageSet, ResultFolder, posture_folder, write_exr, write_png
from lightopt.lights import PanelLight
from lightopt.rendering import cast_rays_at, render_posture, trace_pixels
from lightopt.scene import Scene, build_scene

DERIVED_FOLDER = "derived"
LEAST_TANGENT = 0.1  # share of the X axis in the tangent plane, from which on it is a direction of the slope
LEAST_SIGNAL = 5.0  # in standard deviations of its noise: phases, ratios and the like of less are unknown
LEAST_MODULATION = 0.05  # stripes with less are those of scattered light, whose phase is of no place on the display
DARK_SHARE = 0.1  # pixels count as dark below this share of the brightest level of their series, on a good part
_PREVIEW_PERCENTILES = 1.0, 99.0  # values that a preview shows as black and as white

Channels = dict[str, Float64]


@dataclass(frozen=True)
class Stripes:
    """What N images of stripes say of each pixel, shape (H, W)."""

    phase: Float64  # φ = atan2(Σ I sin δ, Σ I cos δ), from −π to π [rad]
    modulation: Float64  # M = 2 |Σ I e^{iδ}| / Σ I: 1 for a mirror, 0 where all is scattered
    mean: Float64  # Σ I / N
    amplitude: Float64  # B = 2 |Σ I e^{iδ}| / N


def demodulate(images: Float64) -> Stripes:
    """Phase, modulation, mean and amplitude of stripes.

    images: In the order of their steps, shape (N, H, W), N ≥ 3 [grey level]; NaN where a pixel is unknown
    """
    steps = 2.0 * math.pi * np.arange(len(images)) / len(images)
    cosine, sine = (np.tensordot(f(steps), images, axes=1) for f in (np.cos, np.sin))
    mean, amplitude = images.mean(axis=0), 2.0 * np.hypot(cosine, sine) / len(images)
    with np.errstate(divide="ignore", invalid="ignore"):
        modulation = np.where(mean > 0.0, amplitude / mean, np.nan)
    return Stripes(np.arctan2(sine, cosine), modulation, mean, amplitude)


def phase_noise(amplitude: Float64, noise: Float64 | float, images: int) -> Float64:
    """Standard deviation of the phase [rad], √(2/N)·σ_I/B, of images with noise σ_I in the unit of the amplitude B."""
    with np.errstate(divide="ignore"):
        return math.sqrt(2.0 / images) * noise / amplitude


def phase_gradient(phase: Float64) -> tuple[Float64, Float64]:
    """Change of the phase per pixel to the right and down [rad/px], shape (H, W) each; steps of 2π do not count."""
    across, along = (_wrapped(np.diff(phase, axis=axis)) for axis in (1, 0))
    right, down = np.full(phase.shape, np.nan), np.full(phase.shape, np.nan)
    # mean of the steps on both sides; NaN at the image's edge
    right[:, 1:-1] = 0.5 * (across[:, 1:] + across[:, :-1])
    down[1:-1] = 0.5 * (along[1:] + along[:-1])
    return right, down


def absolute_place(phase: Float64, second_phase: Float64, periods: tuple[float, float], size: float) -> Float64:
    """Coordinate on the display from the phases of two periods [mm], from its middle, shape (H, W).

    The first phase gives it but for a whole number of periods: the number with which the second agrees best.

    phase, second_phase: Of the two periods [rad]
    periods: [mm]
    size: Of the display along the coordinate [mm]
    """
    place = phase * (periods[0] / (2.0 * math.pi))
    most = math.ceil(0.5 * size / periods[0]) + 1
    best, error = np.full(phase.shape, np.nan), np.full(phase.shape, np.inf)
    for number in range(-most, most + 1):
        at = place + number * periods[0]
        off = np.abs(_wrapped(second_phase - 2.0 * math.pi * at / periods[1]))
        # half a period beyond the edge, for noise
        better = (off < error) & (np.abs(at) <= 0.5 * size + 0.5 * periods[0])
        best, error = np.where(better, at, best), np.where(better, off, error)
    return best


def _wrapped(angle: Float64) -> Float64:
    return np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi


def slope_map(
    points: Float64, normals: Float64, u: Float64, v: Float64, *, camera: Float64, display: PanelLight
) -> tuple[Float64, Float64]:
    """Slopes of a mirror surface against its model; everything in one frame, the part's or the world's.

    How far the measured normals lean from the model's, shape (...); NaN where unknown: towards the X axis as projected
    onto the model's tangent plane, and towards the direction 90° counterclockwise of it, seen from outside [deg].

    points, normals: Of the model, where each pixel's ray meets it: [mm] and of unit length, shape (..., 3)
    u, v: Place on the display that each pixel sees, from its middle along `across` and `along` [mm], shape (...)
    camera: Position of the camera [mm], shape (3,)
    """
    places = display.centre + u[..., None] * display.across + v[..., None] * display.along
    measured = _unit(_unit(places - points) + _unit(camera - points))
    x_axis = np.array([1.0, 0.0, 0.0]) - normals[..., :1] * normals
    length = np.linalg.norm(x_axis, axis=-1, keepdims=True)
    x_axis = _unit(np.where(length >= LEAST_TANGENT, x_axis, np.nan))
    axes = x_axis, np.cross(normals, x_axis)
    x, y = (np.degrees(np.arctan2(_dot(measured, axis), _dot(measured, normals))) for axis in axes)
    return x, y


def _unit(vectors: Float64) -> Float64:
    return vectors / np.sqrt(_dot(vectors, vectors))[..., None]


def _dot(a: Float64, b: Float64) -> Float64:
    return np.sum(a * b, axis=-1)


@dataclass(frozen=True, kw_only=True)
class DerivedImages:
    light: str
    posture: Posture
    channels: Channels  # by name, shape (H, W) each; NaN where unknown
    saturated: int  # number of pixels that are saturated in an image of the light at every exposure


@dataclass(frozen=True)
class _Series:
    light: LightConfig  # its first channel
    images: Float64  # of all channels, shape (K, H, W) [grey level at exposure 1]
    level: float  # a sensor level at the longest exposure [grey level]
    good: Scene  # the good part under the channels, in the posture

    def noise(self, levels: Float64 | float) -> Float64:
        """Standard deviation of an image's noise at some levels [grey level]."""
        sensor = self.good.sensor
        shot = 0.0 if sensor.electrons_per_level is None else np.maximum(levels, 0.0) / sensor.electrons_per_level
        return self.level * np.sqrt(sensor.read_noise_levels**2 + 1.0 / 12.0 + shot / self.level)

    @property
    def least(self) -> float:
        """Level above the noise of the dark [grey level]."""
        return LEAST_SIGNAL * float(self.noise(0.0))


def derive_images(rig: RigConfig, part: PartConfig, image_set: ImageSet) -> Iterator[DerivedImages]:
    """Derived images of all lights and postures of a set that have any; see docs/how-to/image-series.md."""
    groups: dict[int, dict[int, tuple[str, float, LightConfig]]] = {}
    for light in rig.lights:
        parts = light.mixture or ((light, 1.0),)
        if len(parts) == 1:
            channel, weight = parts[0]
            groups.setdefault(channel.entry, {}).setdefault(channel.channel, (light.name, weight, channel))
    postures = tuple(dict.fromkeys(entry.posture for entry in image_set.images))
    good = build_scene(rig.without_programme(), part, postures=postures, defects=False)
    for posture in postures:
        for group in groups.values():
            first = next(iter(group.values()))[2]
            if len(group) < first.channels:
                continue
            channels = [group[k] for k in range(first.channels)]
            entries = [[e for e in image_set.images if (e.light, e.posture) == (c[0], posture)] for c in channels]
            names = [channel.name for _, _, channel in channels]
            lights = tuple(light for light in good.lights if light.name in names)
            if all(entries):
                yield from _derive(image_set, replace(good, postures=(posture,), lights=lights), channels, entries)


def _derive(
    image_set: ImageSet, good: Scene, group: list[tuple[str, float, LightConfig]], entries: list[list[ImageEntry]]
) -> Iterator[DerivedImages]:
    # entries: exposures of each channel of a light in a posture
    merged = [longest_unsaturated(image_set, own) for own in entries]
    images = np.stack([levels / weight for (levels, _), (_, weight, _) in zip(merged, group, strict=True)])
    first, several = group[0][2], len(group) > 1
    exposure = max(e.held_exposure for own in entries for e in own)
    level = image_set.manifest.full_scale / (image_set.manifest.max_level * exposure)
    channels: Channels = {}
    for (name, _, _), own, levels in zip(group, entries, merged, strict=True):
        if len(own) > 1:
            label = name if several else "longest_unsaturated"
            channels |= {label: levels[0], f"{label}.exposure": levels[1]}
    if (recipe := _RECIPES.get(_recipe(first))) is not None:
        channels |= recipe(_Series(first, images, level, good))
    if channels:
        name = first.entry_name if several else group[0][0]
        saturated = int(np.isnan(images).any(axis=0).sum())
        yield DerivedImages(light=name, posture=good.postures[0], channels=channels, saturated=saturated)


def longest_unsaturated(image_set: ImageSet, entries: list[ImageEntry]) -> tuple[Float64, Float64]:
    """Levels of each pixel at its longest exposure that is not saturated, and that exposure; NaN where all are.

    entries: Exposures of one light in one posture
    Returns: [grey level at exposure 1] and relative exposure, shape (H, W) each
    """
    levels = exposure = np.zeros(0)
    for number, entry in enumerate(sorted(entries, key=lambda e: e.held_exposure)):
        image = image_set.load(entry)
        if not number:
            levels = exposure = np.full(image.levels.shape, np.nan)
        levels = np.where(image.saturated, levels, image.levels)
        exposure = np.where(image.saturated, exposure, entry.held_exposure)
    return levels, exposure


def _recipe(light: LightConfig) -> str:
    if light.pattern is not None:
        return light.pattern.kind
    return "quadrants" if light.segments == 4 else light.kind


def _stripes(series: _Series) -> Channels:
    pattern, size = series.light.pattern, series.light.size_mm
    assert pattern is not None
    periods, found = pattern.periods_mm, Channels()
    shape = len(pattern.directions), max(1, len(periods)), pattern.phases
    blocks = series.images.reshape(*shape, *series.images.shape[1:])
    for direction, block in zip(pattern.directions, blocks, strict=True):
        first = demodulate(block[0])
        phase, noise = _phase(series, first, pattern.phases)
        right, down = phase_gradient(phase)
        found |= {
            f"{direction}.phase": phase,
            f"{direction}.phase_noise": np.where(np.isnan(phase), np.nan, noise),
            f"{direction}.modulation": np.where(first.mean >= series.least, first.modulation, np.nan),
            f"{direction}.mean": first.mean,
            f"{direction}.curvature.x": right,
            f"{direction}.curvature.y": down,
        }
        if len(periods) == 2:
            assert size is not None
            far, _ = _phase(series, demodulate(block[1]), pattern.phases)
            along = size["uv".index(direction)]
            found[f"{direction}.place_mm"] = absolute_place(phase, far, (periods[0], periods[1]), along)
    if {"u.place_mm", "v.place_mm"} <= found.keys():
        found |= _slopes(series, found["u.place_mm"], found["v.place_mm"])
    return found


def _phase(series: _Series, stripes: Stripes, phases: int) -> tuple[Float64, Float64]:
    # the phase where there is one, and its noise
    noise = phase_noise(stripes.amplitude, series.noise(stripes.mean), phases)
    known = (noise * LEAST_SIGNAL <= 1.0) & (stripes.modulation >= LEAST_MODULATION)
    return np.where(known, stripes.phase, np.nan), noise


def _slopes(series: _Series, u: Float64, v: Float64) -> Channels:
    pixels = trace_pixels(series.good, series.good.postures[0], cast_rays_at(series.good))
    at, surface, view = (pixels.row, pixels.column), pixels.surface, pixels.view
    display = view.lights[0]
    slopes = slope_map(surface.points, surface.normals, u[at], v[at], camera=view.camera.position, display=display)
    found = {name: np.full(pixels.shape, np.nan) for name in ("slope.x_deg", "slope.y_deg")}
    for image, values in zip(found.values(), slopes, strict=True):
        image[at] = values
    return found


def _moving(series: _Series) -> Channels:
    images = render_posture(series.good, series.good.postures[0], caster=cast_rays_at(series.good))
    good = np.stack([image.level for image in images.lights])
    dark = good < DARK_SHARE * good.max(axis=0)
    field = np.where(dark.any(axis=0), np.where(dark, series.images, -np.inf).max(axis=0), np.nan)
    return {"max_minus_min": np.ptp(series.images, axis=0), "dark_field": field}


def _array(series: _Series) -> Channels:
    found = _moving(series)
    brightest = np.argmax(np.nan_to_num(series.images), axis=0) + 1.0
    return {**found, "brightest": np.where(found["max_minus_min"] >= series.least, brightest, np.nan)}


def _quadrants(series: _Series) -> Channels:
    # their middles are at 45°, 135°, 225° and 315° from the light's own x
    ne, nw, sw, se = series.images
    total = series.images.sum(axis=0)
    total = np.where(total >= 2.0 * series.least, total, np.nan)  # the sum has twice the noise
    return {
        "east_minus_west": (ne + se - nw - sw) / total,
        "north_minus_south": (ne + nw - se - sw) / total,
        "residual": (ne + sw - nw - se) / total,
        "sum": total,
    }


_RECIPES: Mapping[str, Callable[[_Series], Channels]] = {
    "sine": _stripes,
    "bars": _moving,
    "led_array": _array,
    "quadrants": _quadrants,
}


def write_derived(
    rig: RigConfig, part: PartConfig, image_set: ImageSet, folder: Path, *, force: bool = False
) -> tuple[str, ...]:
    """Write derived images below a folder: for each light and posture an EXR, and a PNG preview of each channel.

    Returns: What was written, and how many pixels are unknown because they are saturated
    Raises InputError: The folder holds derived images of other inputs, and `force` is False
    """
    made_from = provenance({**input_hashes(rig, part), "images": image_set.fingerprint}, {})
    kind = {"name": "derived.json", "format": "lightopt-derived/1", "what": "derived images"}
    out = ResultFolder(folder, made_from, **kind, force=force)
    said: list[str] = []
    listed: list[dict[str, object]] = []
    for one in derive_images(rig, part, image_set):
        name = f"{posture_folder(one.posture)}/{one.light}"
        facts = {"light": one.light, "posture": one.posture.as_dict(), "saturated_pixels": one.saturated}
        pixels = {channel: values.astype(np.float32) for channel, values in one.channels.items()}
        write_exr(out.place(f"{name}.exr"), pixels, metadata=facts)
        for channel, values in one.channels.items():
            _write_preview(out.place(f"{name}.{channel}.png"), channel, values)
        listed.append({**facts, "exr": f"{name}.exr", "channels": sorted(one.channels)})
        unknown = f", {counted(one.saturated, 'saturated pixel')} unknown (NaN)" if one.saturated else ""
        said.append(f"{one.light}, posture {one.posture}: {counted(len(one.channels), 'derived image')}{unknown}")
    told = {str(one["light"]) for one in listed}
    if left := sorted({light.entry_name for light in rig.channels if light.channels > 1} - told):
        said.append(
            f"no derived images of {', '.join(left)}: not all channels are in the set, each alone, or none exist"
        )
    if not listed:
        return ("no derived images: no light of the set has a series of images that gives any",)
    return (*said, str(out.finish({"images": listed})))


def _write_preview(path: Path, channel: str, values: Float64) -> None:
    known = values[np.isfinite(values)]
    low, high = (-np.pi, np.pi) if channel.endswith(".phase") else (0.0, 1.0)
    if known.size and not channel.endswith((".phase", ".modulation")):
        low, high = np.percentile(known, _PREVIEW_PERCENTILES)
    shown = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0)
    levels = np.round(255.0 * np.nan_to_num(shown)).astype(np.uint8)
    write_png(path, levels, metadata={"channel": channel, "black": float(low), "white": float(high)})
