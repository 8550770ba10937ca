"""Stripes of a display that the camera sees, mirrored, too fine to resolve: the image shows moiré instead."""

import math
from collections.abc import Iterator

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.lights import SurfaceLight
from lightopt.preflight._fields import light_entries
from lightopt.preflight._findings import CheckedScene, Finding, PostureSamples, percent
from lightopt.rendering import CREASE_COSINE, SurfacePoints, mirrored_places, trace_samples
from lightopt.scene import Scene, screen_window

POINTS = 4000  # pixels of a posture that are tried
LEAST_PERIOD_PX = 2.0  # finer stripes are aliased
LEAST_CONTRAST = 0.05  # stripes that the lobe blurs to less are not seen, however fine


def check_stripes(checked: CheckedScene) -> Iterator[Finding]:
    """How much of the surface that mirrors a display's stripes shows them finer than two pixels."""
    striped = [
        (name, channels[0], pattern)
        for name, channels in light_entries(checked.rig.lights)
        if (pattern := checked.rig.lights[channels[0]].pattern) is not None and pattern.periods_mm
    ]
    for sample in checked.samples if striped else ():
        pixels = _neighbours(checked, sample)
        for name, at, pattern in striped:
            own = sample.view.lights[at]
            assert isinstance(own, SurfaceLight)
            cycles = _cycles(checked.scene, own, min(pattern.periods_mm), pattern.directions, pixels)
            if not len(cycles):
                continue
            share, least = float(np.mean(cycles > 1.0 / LEAST_PERIOD_PX)), 1.0 / float(cycles.max())
            text = f"posture {sample.posture}: mirrored stripes of {name} have periods of at least {least:.3g} px, "
            text += f"below {LEAST_PERIOD_PX:g} px on {percent(share)} of the surface that mirrors them"
            if share > 0.0:
                text += ", where the image is moiré and the phase is wrong: take a longer period or larger images"
            values = {"light": name, "posture": sample.posture.as_dict(), "share": share, "least_px": least}
            level = "warning" if share > 0.0 else "ok"
            yield Finding(level, "stripes", text, checked.rig.source.at("lights", at, "pattern"), values)


def _neighbours(checked: CheckedScene, sample: PostureSamples) -> list[SurfacePoints]:
    # surface at pixels, and at their neighbours to the right and below, where all see one smooth piece of the part
    left, top, right, bottom = screen_window(sample.view.camera, checked.scene.mesh)
    step = max(1, math.ceil(math.sqrt((right - left) * (bottom - top) / POINTS)))
    across, down = (np.arange(*ends, step, dtype=np.float64) + 0.5 for ends in ((left, right), (top, bottom)))
    columns, rows = (a.ravel() for a in np.meshgrid(across, down))
    found: list[SurfacePoints] = []
    place = np.full((3, len(columns)), -1)
    for k, (right_by, down_by) in enumerate(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))):
        camera = sample.view.camera
        hits, surface = trace_samples(checked.caster, checked.scene.mesh, camera, columns + right_by, rows + down_by)
        place[k, hits.ray] = np.arange(len(hits.ray))
        found.append(surface)
    place = place[:, (place >= 0).all(axis=0)]
    some = [surface.take(index) for surface, index in zip(found, place, strict=True)]
    smooth = np.ones(len(some[0]), np.bool_)
    for one in some:
        smooth &= one.front & (np.einsum("ij,ij->i", one.normals, some[0].normals) > CREASE_COSINE)
    return [one.take(np.flatnonzero(smooth)) for one in some]


def _cycles(
    scene: Scene, light: SurfaceLight, period: float, directions: tuple[str, ...], pixels: list[SurfacePoints]
) -> Float64:
    # periods per pixel, along the steeper of image rows and columns, of the pixels that show stripes
    places = [mirrored_places(surface, light) for surface in pixels]
    u, v, distance = places[0]
    inside = (np.abs(u) < 0.5 * light.size[0]) & (np.abs(v) < 0.5 * light.size[1])
    # M = exp(−2(πσ|∇u|/P)²), ∇u the change of the place per tilt of the half vector, 2d where the light is met squarely
    blur = math.pi * scene.sharpest.sigma * 2.0 * distance / period
    with np.errstate(invalid="ignore"):
        shown = inside & (np.exp(-2.0 * blur**2) > LEAST_CONTRAST)
    steps = [
        np.abs(places[k]["uv".index(direction)] - places[0]["uv".index(direction)])[shown]
        for direction in directions
        for k in (1, 2)
    ]
    cycles = np.max(steps, axis=0) / period
    return cycles[np.isfinite(cycles)]
