"""What the surface in view mirrors: lights, their camera holes, the part itself, stripes too fine for the camera."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from lightopt.config import LightConfig
from lightopt.core.arrays import Bool, Float64
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, SurfaceLight, surface_mesh
from lightopt.preflight._findings import CheckedScene, Finding, PostureSamples, percent
from lightopt.rendering import CREASE_COSINE, SurfacePoints, mirrored_places, trace_samples
from lightopt.scene import Scene, build_lights, screen_window

POINTS = 4000  # surface points or pixels of a posture that are tried: shares are good to a percent
LOBE_SIGMAS = 2.0  # a normal that is off by so many σ from the mirror's still shows most of a light
_SIDES = 6  # directions that normals are tilted to
_SHARES_ACROSS = (0.25, 0.5, 0.75)  # of the tilt across the brushing, that are tried as well
_HOLE_SHARE = 0.01  # of the surface in view, above which a mirrored camera hole is worth a note
NOTED_SHARE, WARNED_SHARE = 0.01, 0.05  # of the surface in view


def check_fields(checked: CheckedScene) -> Iterator[Finding]:
    """How much of the surface in view has each light in bright field, in dark field, or not at all."""
    names = ["bright field", "dark field", "unlit"]
    entries = list(light_entries(checked.rig.lights))
    for sample, (name, channels) in itertools.product(checked.samples, entries):
        some, ends = _mirrored(checked, sample, LOBE_SIGMAS * checked.scene.sharpest.sigma)
        if not len(some):
            continue
        lights = _distinct([sample.view.lights[i] for i in channels])
        bright = np.any(_meets(lights, some, ends), axis=0)
        targets = np.concatenate([p.targets if isinstance(p, SurfaceLight) else p.centre[None] for p in lights])
        above = np.einsum("ik,jk->ji", some.normals, targets) > np.einsum("ik,ik->i", some.normals, some.points)
        lit = np.any(checked.caster.visible(some.points, some.facets, targets, candidates=above), axis=0)
        shares = [float(np.mean(a)) for a in (bright, lit & ~bright, ~lit & ~bright)]
        text = f"posture {sample.posture}: of the surface in view {name} has {percent(shares[0])} in bright field "
        text += f"(mirrored to the camera, within {LOBE_SIGMAS:g}σ) and {percent(shares[1])} in dark field; "
        text += f"{percent(shares[2])} is unlit"
        values = {"light": name, "posture": sample.posture.as_dict(), **dict(zip(names, shares, strict=True))}
        yield Finding("ok", "bright field", text, checked.rig.source.at("lights", channels[0]), values)


def check_camera_hole(checked: CheckedScene) -> Iterator[Finding]:
    """How much of the surface in view mirrors the hole or slot of a light that the camera looks through."""
    for name, channels in light_entries(checked.rig.lights):
        light = checked.rig.lights[channels[0]]
        if light.camera_hole_mm is None and light.slot_mm is None:
            continue
        where = checked.rig.source.at("lights", channels[0])
        camera = checked.scene.camera.position
        if light.kind == "dome" and light.radius_mm is not None:
            away = float(np.linalg.norm(camera - checked.scene.lights[channels[0]].centre))
            if away < light.radius_mm:
                text = f"the camera stands inside {name}, {away:.4g} mm from the centre of its sphere of "
                text += f"{light.radius_mm:g} mm, so that it does not look through the hole: move the camera away, or "
                text += "take a smaller dome"
                yield Finding("warning", "camera hole", text, where, {"light": name, "camera_mm": away})
                continue
        closed = {"camera_hole_mm": None, "slot_mm": None, "segments": None, "leak": None}
        (filled,) = build_lights(checked.rig.model_copy(update={"lights": (light.model_copy(update=closed),)}))
        for sample in checked.samples:
            some, ends = _mirrored(checked, sample, 0.0)
            if not len(some):
                continue
            own = _distinct([sample.view.lights[i] for i in channels])
            whole = filled.moved(sample.view.rotation.T, -sample.view.rotation.T @ sample.view.translation)
            share = float(np.mean(_meets([whole], some, ends)[0] & ~_meets(own, some, ends)[0]))
            text = f"posture {sample.posture}: {percent(share)} of the surface in view mirrors the opening of {name} "
            text += "that the camera looks through, which is a dark spot on a glossy part"
            values = {"light": name, "posture": sample.posture.as_dict(), "share": share}
            yield Finding("note" if share > _HOLE_SHARE else "ok", "camera hole", text, where, values)


def check_mirrored_part(checked: CheckedScene) -> Iterator[Finding]:
    """Share of the surface in view that mirrors the part, in place of the lights and the dark box; none if it is 0."""
    if all(one.R_s == 0.0 for one in checked.scene.shown):
        return
    shares: list[float] = []
    for sample in checked.samples:
        front = np.flatnonzero(sample.surface.front)
        some = sample.surface.take(front[:: max(1, len(front) // POINTS)])
        mirrored = 2.0 * np.einsum("ik,ik->i", some.normals, some.views)[:, None] * some.normals - some.views
        meets = checked.caster.next_hit(some.points, some.facets, mirrored) >= 0
        seen = checked.glossy(some) & meets & (np.einsum("ik,ik->i", mirrored, some.facets) > 0.0)
        shares.append(float(np.mean(seen)) if len(front) else 0.0)
    worst = max(range(len(shares)), key=shares.__getitem__)
    share, sample = shares[worst], checked.samples[worst]
    if share == 0.0:
        return
    others = f", the most of {len(shares)} postures (the least: {percent(min(shares))})" if len(shares) > 1 else ""
    text = f"{percent(share)} of the surface in view mirrors the part itself{others}"
    if share > NOTED_SHARE:
        text += ". Images without its light are too dark there: use render --bounces 1, virtual_bench.bounces and "
        text += "inspection.bounces, which plans use too. Fits leave this light out"
    level = "warning" if share > WARNED_SHARE else "note" if share > NOTED_SHARE else "ok"
    of_postures = [
        {"posture": s.posture.as_dict(), "share": own} for s, own in zip(checked.samples, shares, strict=True)
    ]
    yield checked.of_posture(sample, level, "mirrored part", text, share=share, postures=of_postures)


def light_entries(lights: Sequence[LightConfig]) -> Iterator[tuple[str, list[int]]]:
    """Name of each light of the file, and the numbers of its channels."""
    for _, channels in itertools.groupby(range(len(lights)), key=lambda i: lights[i].entry):
        some = list(channels)
        first = lights[some[0]]
        yield first.name.rpartition("-")[0] if first.channels > 1 else first.name, some


def _distinct(lights: Sequence[PanelLight]) -> list[PanelLight]:
    # with each piece of surface once: channels share them where patterns or leaks differ
    first = lights[0]
    if not isinstance(first, SurfaceLight):
        return list(lights)
    rows = np.concatenate([light.elements for light in lights if isinstance(light, SurfaceLight)])
    return [replace(first, elements=rows[np.unique(rows[:, :21], axis=0, return_index=True)[1]])]


def _mirrored(checked: CheckedScene, sample: PostureSamples, tilt: float) -> tuple[SurfacePoints, Float64]:
    # points of the surface, and far ends of mirrored view rays, shape (rays, k, 3): of the normal, and of normals
    # tilted from it. Rays that the part stops end where they begin
    front = np.flatnonzero(sample.surface.front)
    some = sample.surface.take(front[:: max(1, len(front) // POINTS)])
    n, v = some.normals, some.views
    side = np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turns = [2.0 * math.pi * k / _SIDES for k in range(_SIDES)] if tilt > 0.0 else []
    ways = [(math.cos(t), math.sin(t)) for t in turns]
    wider = np.ones((len(some), 1))
    if some.across is not None and ways:
        # across the brushing the lobe reaches farther
        brushed = some.across.any(axis=1)
        side[brushed] = some.across[brushed]
        ratios = np.array([own.model.across_ratio for own in checked.scene.reflectances])
        of_points = ratios[0] if some.material is None else ratios[some.material]
        wider = np.where(brushed, of_points, 1.0)[:, None]
        ways += [(share * sign, 0.0) for share in _SHARES_ACROSS for sign in (1.0, -1.0)]
    leaning = [wider * a * side + b * np.cross(n, side) for a, b in ways]
    normals = np.stack([n, *(_tilted(n, way, tilt) for way in leaning)])
    mirrored = 2.0 * np.einsum("rik,ik->ri", normals, v)[..., None] * normals - v
    ends = some.points + 1e2 * checked.caster.radius * mirrored
    blocked = _blocked(checked.caster, some, ends) | (np.einsum("rik,ik->ri", mirrored, some.facets) <= 0.0)
    blocked |= ~checked.glossy(some)
    return some, np.where(blocked[..., None], some.points, ends)


def _tilted(normals: Float64, ways: Float64, tilt: float) -> Float64:
    # normals turned towards tangents, by the tilt times their lengths
    length = np.linalg.norm(ways, axis=1, keepdims=True)
    return np.cos(tilt * length) * normals + np.sin(tilt * length) * ways / length


def _meets(lights: Sequence[PanelLight], some: SurfacePoints, ends: Float64) -> Bool:
    # whether rays meet one of the lights, shape (rays, k)
    found = np.zeros(ends.shape[:2], np.bool_)
    for light in lights:
        found |= _blocked(RayCaster(*surface_mesh(light)), some, ends)
    return found


def _blocked(caster: RayCaster, some: SurfacePoints, ends: Float64) -> Bool:
    point = np.tile(np.arange(len(some), dtype=np.int32), len(ends))
    ways = {"point_index": point, "target_index": np.arange(len(point), dtype=np.int32)}
    return caster.occluded(some.points, some.facets, ends.reshape(-1, 3), **ways).reshape(len(ends), -1)


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
