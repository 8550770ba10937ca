"""Does ``detectability`` tell the truth: its predicted share of defects seen against noisy renders, counted plainly.

``python -m benchmarks.truth [PART.yaml …] [--out DIR] [--plot PNG]``; the sample parts by default. For each part,
finish and number of images, two countings, both with noise and with a test that knows nothing of patches: a pixel shows
a defect where its level is off the noise-free image of the good part by the threshold times the noise there.

*Walls*: the whole surface leans by each slope of the catalogue to each direction (or is stained, or hazed), every
fourth pixel of every fourth row is shaded and exposed with noise, and pixels count by the area that they see. Compared
with the share of surface × defects that the objective predicts from its patches; of what the camera sees at less than
80° to its normal, beyond which nothing counts as visible. Counted twice: one pixel at a time, where noise takes some of
those just below the threshold across it, and by the mean of nine pixels.

*Pits*: cones of known slope are strewn over the part by the function behind ``lightopt defects``, rendered by
``render_posture``, exposed with noise, and the pixels on their walls counted. Compared with what the patches under
those pixels predict of walls that lean to the eight directions. Defects of about a pixel are for
``python -m benchmarks.narrow``.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks._strewn import off, strew
from lightopt import build_scene, load_part, load_rig
from lightopt.config import CatalogueEntryConfig, PartConfig, RigConfig
from lightopt.defects import (
    CatalogueEntry,
    PlacedDefect,
    radial_place,
    surface_coordinates,
    tangent_references,
)
from lightopt.optimize import (
    GRAZING_COSINE,
    Contrast,
    Inspection,
    LuminanceMatrix,
    Trial,
    flags_of,
    luminance_matrix,
    unroll,
)
from lightopt.raycast import RayCaster
from lightopt.rendering import (
    PatchTable,
    SurfacePoints,
    build_patches,
    cast_rays_at,
    render_posture,
    shade_points,
    trace_samples,
)
from lightopt.report._chart import ChartPanel, draw_chart
from lightopt.scene import PanelLight, Scene, build_catalogue, view_from_part
from lightopt.sensor import expose, image_rng

__all__ = ["FINISHES", "PARTS", "Point", "compare", "main", "table"]

ROOT = Path(__file__).resolve().parents[1]
RIG = ROOT / "configs" / "rigs" / "four-panel.yaml"
PARTS = tuple(ROOT / "configs" / "parts" / f"{name}.yaml" for name in ("cover-knob", "spout"))

FINISHES = {"glossy": {}, "satin": {"R_s": 1500.0, "sigma": 0.14}}
"""As the part file says, and a satin surface."""

SEEN_IN = (1, 2)
MEANS = (1, 9)
"""Pixels whose mean level is compared."""
EVERY = 4
"""Pixel and row that is looked at where the whole surface leans."""

FILLS_MM = 1000.0
"""Defects of this size fill every pixel."""

PITS = 60
PIT_SLOPES = (4.0, 8.0)
PIT_MM = 1.5
WALL = 0.25, 0.75
"""From the middle to the rim: where a cone has its full slope."""
SEED = 7


@dataclass(frozen=True, kw_only=True)
class Point:
    """A prediction beside a measurement.

    Attributes
    ----------
    part, finish, kind
        What was looked at: a kind of the catalogue, ``all`` of it, or ``pits``.
    seen_in
        Images that must show a defect.
    pixels
        Whose mean level is compared.
    predicted, measured
        Shares.
    """

    part: str
    finish: str
    kind: str
    seen_in: int
    pixels: int
    predicted: float
    measured: float


@dataclass(frozen=True, eq=False)
class _Case:
    """A part with a finish in one posture, and what the patches predict of it."""

    scene: Scene
    caster: RayCaster
    table: PatchTable
    contrast: Contrast

    def predict(self, trials: tuple[Trial, ...]) -> LuminanceMatrix:
        inspection = Inspection(trials=trials, contrast=self.contrast)
        panels = [(light,) for light in self.scene.lights]
        posture = self.scene.postures[0]
        return luminance_matrix(
            self.scene, self.table, posture, panels, caster=self.caster, inspection=inspection
        )


def compare(rig: RigConfig, part: PartConfig, *, patches: int, pits: int = PITS) -> Iterator[Point]:
    """Predict and measure a part in its first posture, lights as the rig has them, for both finishes."""
    for finish, changes in FINISHES.items():
        scene = build_scene(rig, part, defects=False)
        scene = replace(scene, postures=scene.postures[:1], reflectance=replace(scene.reflectance, **changes))
        caster = cast_rays_at(scene)
        table = build_patches(scene, caster=caster, budget=patches)
        contrast = Contrast(sensor=scene.sensor, full_scale=scene.reflectance.full_scale)
        case = _Case(scene, caster, table, contrast)
        yield from _walls(case, part, finish)
        if pits:
            yield from _pits(case, rig, part, finish, pits)


def _walls(case: _Case, part: PartConfig, finish: str) -> Iterator[Point]:
    # walls that fill the pixel, whatever the size of the defect: how far it does is for benchmarks.narrow
    trials = tuple(replace(trial, length=FILLS_MM, width=FILLS_MM) for trial in unroll(build_catalogue(part)))
    visibility = case.predict(trials).visibility
    assert visibility is not None
    surface, areas = _pixels(case)
    references = _references(case.scene, surface)
    lights = view_from_part(case.scene, case.scene.postures[0]).lights
    good = [_level(case, surface, light) for light in lights]
    counts = {pixels: np.zeros((len(trials), len(surface)), np.uint8) for pixels in MEANS}
    for t, trial in enumerate(trials):
        lean = math.cos(trial.direction) * references
        lean += math.sin(trial.direction) * np.cross(surface.normals, references)
        turned = replace(
            surface, normals=math.cos(trial.slope) * surface.normals + math.sin(trial.slope) * lean
        )
        for k, light in enumerate(lights):
            level = _level(case, turned, light, trial)
            noisy = _noisy(case, np.tile(level, (max(MEANS), 1)), light=k, trial=t)
            for pixels, own in counts.items():
                own[t] += off(noisy[:pixels].mean(axis=0), good[k], case.scene, case.contrast.threshold)
    weights = np.array([trial.weight for trial in trials])
    names = [trial.name for trial in trials]
    for seen_in, pixels in itertools.product(SEEN_IN, MEANS):
        measured = (counts[pixels] >= seen_in) @ areas / areas.sum()
        flags = flags_of(visibility.seen((0,) * len(lights), seen_in), len(trials))
        seen = np.where(visibility.cosines >= GRAZING_COSINE, visibility.areas, 0.0)
        predicted = seen @ flags / seen.sum()
        for kind in (*dict.fromkeys(names), "all"):
            own = weights * np.array([kind in (name, "all") for name in names])
            shares = (float(own @ values / own.sum()) for values in (predicted, measured))
            yield Point(
                part=part.name, finish=finish, kind=kind, seen_in=seen_in, pixels=pixels,
                predicted=next(shares), measured=next(shares),
            )  # fmt: skip


def _trace(case: _Case) -> tuple[NDArray[np.intp], SurfacePoints]:
    # the pixels whose centres see the part from the front, and what they see
    camera = view_from_part(case.scene, case.scene.postures[0]).camera
    rows, columns = np.divmod(np.arange(camera.width * camera.height), camera.width)
    hits, surface = trace_samples(case.caster, case.scene.mesh, camera, columns + 0.5, rows + 0.5)
    front = np.flatnonzero(surface.front)
    return hits.ray[front].astype(np.intp), surface.take(front)


def _pixels(case: _Case) -> tuple[SurfacePoints, NDArray[np.float64]]:
    # what the pixels of the image see, and the area of surface that each stands for [mm²]
    camera = view_from_part(case.scene, case.scene.postures[0]).camera
    pixels, surface = _trace(case)
    rows, columns = np.divmod(pixels, camera.width)
    surface = surface.take(np.flatnonzero((rows % EVERY == 0) & (columns % EVERY == 0)))
    cosines = np.einsum("ij,ij->i", surface.normals, surface.views)
    surface = surface.take(np.flatnonzero(cosines >= GRAZING_COSINE))
    depth = (surface.points - camera.position) @ camera.forward
    # a pixel's solid angle goes with cos³ off the axis, its footprint with the squared distance
    distance = np.linalg.norm(surface.points - camera.position, axis=1)
    solid = (depth / distance) ** 3 * (camera.pixel_size / camera.image_distance) ** 2
    return surface, solid * distance**2 / np.einsum("ij,ij->i", surface.facets, surface.views)


def _references(scene: Scene, surface: SurfacePoints) -> NDArray[np.float64]:
    axes = scene.placement.rotation
    return tangent_references(surface.normals, x_axis=axes[:, 0], y_axis=axes[:, 1])


def _level(
    case: _Case, surface: SurfacePoints, light: PanelLight, trial: Trial | None = None
) -> NDArray[np.float64]:
    assert light.points != "auto"
    own = case.scene.reflectance
    if trial is not None:
        own = own.changed(R_d_factor=trial.R_d_factor, sigma_factor=trial.sigma_factor)
    diffuse, specular = shade_points(surface, light, points=light.points, sigma=own.sigma, caster=case.caster)
    return own.R_d * diffuse + own.R_s * specular


def _noisy(case: _Case, level: NDArray[np.float64], *, light: int, trial: int) -> NDArray[np.float64]:
    rng = image_rng(SEED, light=light, posture=0, exposure=trial)
    full_scale = case.scene.reflectance.full_scale
    image = np.atleast_2d(level)
    delivered = expose(image, sensor=case.scene.sensor, exposure=1.0, full_scale=full_scale, rng=rng)
    return delivered.astype(np.float64)


def _pits(case: _Case, rig: RigConfig, part: PartConfig, finish: str, count: int) -> Iterator[Point]:
    posture = case.scene.postures[0]
    patches = case.table.patches
    good = render_posture(case.scene, posture, caster=case.caster, patches=patches)
    shown = good.geometry.patch.ravel()
    for slope in PIT_SLOPES:
        entry = CatalogueEntryConfig(kind="pit", name="pit", size_mm=PIT_MM, slope_deg=slope)
        visibility = case.predict(unroll([CatalogueEntry("pit", entry.shape)])).visibility
        assert visibility is not None
        placed = strew(rig, part, case.scene, count=count, seed=SEED, catalogue=[entry])
        bad = render_posture(
            replace(case.scene, defects=placed), posture, caster=case.caster, patches=patches
        )
        row_of = np.full(len(patches), -1)
        row_of[visibility.patch] = np.arange(len(visibility.patch))
        pixels = _on_walls(placed, case)
        pixels = pixels[row_of[shown[pixels]] >= 0]
        rows = row_of[shown[pixels]]
        counts = np.zeros(len(pixels), np.int64)
        for k, (one, other) in enumerate(zip(good.lights, bad.lights, strict=True)):
            level = other.level.ravel()[pixels].astype(np.float64)
            noisy = _noisy(case, level, light=k, trial=1000 + int(slope))
            plain = one.level.ravel()[pixels].astype(np.float64)
            counts += off(noisy[0], plain, case.scene, case.contrast.threshold)
        for seen_in in SEEN_IN:
            flags = flags_of(visibility.seen((0,) * len(good.lights), seen_in), len(visibility.trials))
            yield Point(
                part=part.name, finish=finish, kind=f"pits of {slope:g}°", seen_in=seen_in, pixels=1,
                predicted=float(flags[rows].mean()), measured=float((counts >= seen_in).mean()),
            )  # fmt: skip


def _on_walls(placed: tuple[PlacedDefect, ...], case: _Case) -> NDArray[np.intp]:
    # pixels whose centres see the walls of cones where they have their full slope
    pixels, surface = _trace(case)
    found: list[NDArray[np.intp]] = []
    for defect in placed:
        near = np.flatnonzero(np.linalg.norm(surface.points - defect.position, axis=1) < defect.reach)
        x, y, same = surface_coordinates(defect, surface.points[near], surface.normals[near])
        place = radial_place(defect.shape, x, y)
        found.append(pixels[near[same & (place > WALL[0]) & (place < WALL[1])]])
    return np.concatenate(found)


def table(points: list[Point]) -> str:
    """The points of whole catalogues and of pits, a line each, with the largest difference of a kind."""
    lines = [
        "| part | finish | images | defects | pixels | predicted | measured | kind that is furthest off |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for one in points:
        furthest, name = "", one.kind
        if one.kind == "all":
            case = (one.part, one.finish, one.seen_in, one.pixels)
            kinds = [
                p
                for p in points
                if (p.part, p.finish, p.seen_in, p.pixels) == case and not p.kind.startswith("pits")
            ]
            worst = max(kinds, key=lambda p: abs(p.measured - p.predicted))
            furthest = f"{worst.kind} {100.0 * (worst.measured - worst.predicted):+.1f} points"
            name = "the catalogue"
        elif not one.kind.startswith("pits"):
            continue
        lines.append(
            f"| {one.part} | {one.finish} | {one.seen_in} | {name} | {one.pixels} | {100.0 * one.predicted:.1f} % "
            f"| {100.0 * one.measured:.1f} % | {furthest} |"
        )
    return "\n".join(lines)


def plot(points: list[Point], path: Path) -> None:
    """Predicted across, measured up, a panel for each finish and number of pixels; the line is where they are equal."""
    line = np.array([0.0, 100.0])
    panels = [
        ChartPanel(
            label=f"{finish}, {'each pixel' if pixels == 1 else f'mean of {pixels} pixels'}: measured [%]",
            values=line,
            dots=np.array(
                [
                    [100.0 * p.predicted, 100.0 * p.measured]
                    for p in points
                    if (p.finish, p.pixels) == (finish, pixels)
                ]
            ),
        )
        for finish, pixels in itertools.product(FINISHES, MEANS)
    ]
    parts = ", ".join(dict.fromkeys(p.part for p in points))
    draw_chart(path, title=f"Defects seen: {parts}", x_label="predicted [%]", x=line, panels=panels)


def main(arguments: list[str] | None = None) -> None:
    """Compare, print a table, write all points."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.truth", description=__doc__)
    parser.add_argument("parts", nargs="*", type=Path, metavar="PART", default=list(PARTS), help="part files")
    parser.add_argument("--rig", type=Path, default=RIG, help="rig file")
    parser.add_argument("--patches", type=int, default=50_000, help="about how many patches are visible")
    parser.add_argument("--pits", type=int, default=PITS, help="how many are strewn; 0 for none")
    parser.add_argument("--out", type=Path, default=Path("out/truth"), help="folder of truth.csv")
    parser.add_argument("--plot", type=Path, help="picture to draw of the points")
    options = parser.parse_args(arguments)
    rig = load_rig(options.rig)
    points = [
        point
        for part in options.parts
        for point in compare(rig, load_part(part), patches=options.patches, pits=options.pits)
    ]
    print(table(points))
    worst = max(points, key=lambda p: abs(p.predicted - p.measured))
    print(
        f"\nlargest difference of all: {100.0 * abs(worst.predicted - worst.measured):.1f} points, {worst.kind}"
    )
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "truth.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["part", "finish", "defects", "seen_in", "pixels", "predicted", "measured"])
        for p in points:
            writer.writerow(
                [p.part, p.finish, p.kind, p.seen_in, p.pixels, f"{p.predicted:.6f}", f"{p.measured:.6f}"]
            )
    print(path)
    if options.plot is not None:
        plot(points, options.plot)


if __name__ == "__main__":
    main()
