"""``points: auto``: what it costs against m = 4, and how near it comes to a panel of 64 × 64 points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks._case import Size, case_scene, chrome, resized, spout_scene
from benchmarks._reference import equally_spaced, gauss_legendre, sum_of_points
from benchmarks._report import Report, Table, ratio_text, ratios, rounds
from benchmarks.bare import THREADS
from lightopt.geometry import RayCaster
from lightopt.rendering import SurfacePoints, cast_rays_at, render_posture, trace_samples
from lightopt.scene import Scene, screen_window

TARGET = 4.0
NEAR_HIGHLIGHT = 0.01
"""Pixels whose specular light is above this [grey level] are near a highlight."""

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """One set of levels against another, on the pixels of all lights.

    Attributes
    ----------
    unsaturated
        Number of pixels that neither calls saturated.
    p999, largest
        99.9th percentile and maximum of the absolute difference on those [grey level].
    over
        Share of those that differ by more than 0.1 level and 0.1 %.
    area
        Ratio of the saturated areas; NaN where the second has none.
    """

    unsaturated: int
    p999: float
    largest: float
    over: float
    area: float


def compare(levels: Float64, against: Float64, saturation: float) -> Comparison:
    """Compare levels, arrays of the same shape [grey level]; `saturation` is the sensor's saturation level."""
    first, second = levels >= saturation - 0.5, against >= saturation - 0.5  # round half up
    both = ~first & ~second
    difference = np.abs(levels - against)[both]
    if not len(difference):
        return Comparison(0, 0.0, 0.0, 0.0, float("nan"))
    over = difference > np.maximum(0.1, 1e-3 * against[both])
    return Comparison(
        len(difference),
        float(np.percentile(difference, 99.9)),
        float(difference.max()),
        float(over.mean()),
        float(first.sum() / second.sum()) if second.any() else float("nan"),
    )


def converged(scene: Scene) -> Scene:
    """The scene with ``points: auto`` in every light."""
    return replace(scene, lights=tuple(replace(light, points="auto") for light in scene.lights))


def run(size: Size) -> Report:
    """Time and exactness on the cover knob, glossy and as in the paper, and on the spout that shades itself."""
    knob, spout = case_scene(size), spout_scene(size)
    scenes = {"knob, σ = 0.003": chrome(knob), "knob, σ = 0.0475": knob, "spout, σ = 0.003": chrome(spout)}
    timed = {**scenes, "spout, σ = 0.0475": spout}
    seconds = _times(timed, size.repeats)
    # exactness is that of the rendering, not of the mesh: the images are reduced, the mesh is not
    found: list[tuple[str, str, Comparison]] = []
    for name, scene in scenes.items():
        reduced = replace(scene, camera=resized(scene.camera, size.reference_width))
        found += exactness(f"{name}, {size.reference_width} px wide", reduced, size.reference_points, near=False)
    name = "knob, σ = 0.003"
    found += exactness(f"{name}, near highlights", scenes[name], size.reference_points, near=True)
    return Report(
        "auto",
        [_time_table(timed, seconds), _exactness_table(found, size)],
        {
            "seconds": seconds,
            "ratios": {name: ratios(seconds[f"{name}: auto"], seconds[f"{name}: m = 4"]) for name in timed},
            "exactness": [
                {"scene": scene, "comparison": what, **vars(comparison)} for scene, what, comparison in found
            ],
        },
        [
            f"{knob.camera.width} × {knob.camera.height} px, {len(knob.lights)} lights of 60 × 60 mm, shadows",
            f"{THREADS} threads, {size.repeats} rounds",
            f"knob of {len(knob.mesh.faces):,}, spout of {len(spout.mesh.faces):,} triangles",
            f"σ = 0.003: R_s = {chrome(knob).reflectance.R_s:,.0f}; σ = 0.0475: R_s = {knob.reflectance.R_s:,.0f}",
        ],
    )


def _times(scenes: dict[str, Scene], repeats: int) -> dict[str, list[float]]:
    tasks: dict[str, Callable[[], object]] = {}
    for name, scene in scenes.items():
        caster = cast_rays_at(scene)
        for points, variant in (("m = 4", scene), ("auto", converged(scene))):
            tasks[f"{name}: {points}"] = lambda variant=variant, caster=caster: render_posture(
                variant, variant.postures[0], caster=caster, threads=THREADS
            )
    for task in tasks.values():
        task()  # compiles
    return rounds(tasks, repeats)


def exactness(name: str, scene: Scene, side: int, *, near: bool) -> list[tuple[str, str, Comparison]]:
    """How far `auto` and m = 4 are from panels of side² points, per region: (region, what is compared, result).

    On all pixels that see the part, or on those near highlights alone; apart where a shadow's edge crosses the panel.
    """
    caster = cast_rays_at(scene)
    auto = render_posture(converged(scene), scene.postures[0], caster=caster, layers=near, threads=THREADS)
    four = render_posture(scene, scene.postures[0], caster=caster, threads=THREADS)
    pixels, surface = _surface(scene, caster)
    columns: dict[str, list[Float64]] = {"auto": [], "m = 4": [], "grid": [], "Gauss": []}
    edges: list[NDArray[np.bool_]] = []
    for index, light in enumerate(scene.lights):
        chosen = np.arange(len(pixels), dtype=np.intp)
        if near:
            specular = auto.lights[index].specular
            assert specular is not None
            chosen = np.flatnonzero(specular.ravel()[pixels] > NEAR_HIGHLIGHT)
        some = surface.take(chosen)
        for key, images in (("auto", auto), ("m = 4", four)):
            columns[key].append(images.lights[index].level.ravel()[pixels[chosen]].astype(np.float64))
        crossed = np.zeros(len(some), np.bool_)
        for key, rule in (("grid", equally_spaced), ("Gauss", gauss_legendre)):
            level, edge = sum_of_points(
                some, rule(light, side), reflectance=scene.reflectance, caster=caster, threads=THREADS
            )
            columns[key].append(level)
            crossed |= edge
        edges.append(crossed)
    levels = {key: np.concatenate(values) for key, values in columns.items()}
    penumbra = np.concatenate(edges)
    saturation = scene.sensor.saturation_level
    found: list[tuple[str, str, Comparison]] = []
    for where, mask in (("", ~penumbra), (", penumbra", penumbra)):
        if not mask.any():
            continue
        for a, b in (("auto", "Gauss"), ("auto", "grid"), ("grid", "Gauss"), ("m = 4", "Gauss")):
            found.append((name + where, f"{a} – {b}", compare(levels[a][mask], levels[b][mask], saturation)))
    return found


def _surface(scene: Scene, caster: RayCaster) -> tuple[NDArray[np.intp], SurfacePoints]:
    # the pixels that see the part, as raveled indices, and what they see; part frame and world agree here
    left, top, right, bottom = screen_window(scene.camera, scene.mesh)
    column, row = (a.ravel() for a in np.meshgrid(np.arange(left, right), np.arange(top, bottom)))
    hits, surface = trace_samples(caster, scene.mesh, scene.camera, column + 0.5, row + 0.5)
    return (row * scene.camera.width + column)[hits.ray], surface


def _time_table(scenes: dict[str, Scene], seconds: dict[str, list[float]]) -> Table:
    rows: list[tuple[str, ...]] = []
    for name in scenes:
        four, auto = seconds[f"{name}: m = 4"], seconds[f"{name}: auto"]
        rows.append((name, f"{min(four):.2f}", f"{min(auto):.2f}", *ratio_text(auto, four)))
    return Table(
        f"time of the images, tree built beforehand (target ≤ {TARGET:g} at σ = 0.003)",
        ("", "m = 4, least s", "auto, least s", "ratio of least", "median ratio"),
        rows,
    )


def _exactness_table(found: list[tuple[str, str, Comparison]], size: Size) -> Table:
    side = size.reference_points
    return Table(
        f"differences on unsaturated pixels [grey level]; grid and Gauss: {side} × {side} points, equally spaced and "
        "Gauss–Legendre",
        ("", "", "pixels", "p99.9", "max", "over 0.1 + 0.1 %", "saturated area"),
        [
            (
                name,
                what,
                f"{c.unsaturated:,}",
                f"{c.p999:.4f}",
                f"{c.largest:.4f}",
                f"{100 * c.over:.3f} %",
                f"{c.area:.4f}",
            )
            for name, what, c in found
        ],
    )
