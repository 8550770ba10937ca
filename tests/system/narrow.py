"""Are narrow defects predicted as often as images show them: pits, dents and scratches of a third of a pixel to two.

``python tests/system/narrow.py [PART.yaml …] [--matt] [--out DIR]``; the sample parts by default, glossy and satin, or
without highlights. Defects of one kind, width and slope are strewn over the part, their pixels rendered with 36 to 256
rays each and exposed with noise, and a defect counts as shown by an image where one of the pixels that it touches
passes the plain contrast test. Beside it is what the objective's bits say of the patch at its middle: a wall to one of
the directions that it has. Scratches are 12 pixels long, in eight directions in turn, and looked at on 1.25 pixels to
each side of their middle, where the patch is.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from contrasts import counted
from numpy.typing import NDArray
from strewn import strew
from touched import touched
from truth import FINISHES, PARTS, RIG, SEED, SEEN_IN

from lightopt import build_scene, load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.config._defects import CatalogueEntryConfig
from lightopt.defects import CatalogueEntry, DefectShape, PlacedDefect
from lightopt.design import DIRECTIONS, Contrast, DetectionModel, defect_hypotheses, luminance_matrix, unpack_flags
from lightopt.geometry import RayCaster
from lightopt.rendering import PatchTable, build_patches, cast_rays_at, trace_samples
from lightopt.scene import Scene, pixel_footprint, project, view_from_part

__all__ = ["CASES", "Narrow", "compare", "main"]

CASES = (
    ("pit", 20.0, (0.35, 0.7, 1.0, 1.5, 2.0)),
    ("scratch", 4.0, (0.35, 0.7, 1.0, 1.5, 2.0)),
    ("scratch", 15.0, (1.0,)),
    ("dent", 10.0, (1.5,)),
)
"""Kind, slope [°], and widths [px]."""

MATT = {"matt": {"R_s": 0.0}}
"""A surface without highlights: what its diffuse light alone shows."""

COUNT = 150
SAMPLES = 6, 16
"""Across a pixel, least and most: eight across the defect where that is between."""
LENGTH_PX = 12.0
STRETCH_PX = 1.25


@dataclass(frozen=True, kw_only=True)
class Narrow:
    """A prediction beside a count.

    Attributes
    ----------
    part, finish, kind
        What was looked at.
    slope_deg, width_px
        Of the defects; pixels that face the camera.
    min_images
        Images that must show a defect.
    predicted, measured
        Shares of the defects.
    """

    part: str
    finish: str
    kind: str
    slope_deg: float
    width_px: float
    min_images: int
    predicted: float
    measured: float


def compare(
    rig: RigConfig,
    part: PartConfig,
    *,
    patches: int,
    count: int = COUNT,
    finishes: Mapping[str, Mapping[str, float]] = FINISHES,
) -> Iterator[Narrow]:
    """Predict and count a part in its first posture, lights as the rig has them, for each finish."""
    scene = build_scene(rig, part, defects=False)
    scene = replace(scene, postures=scene.postures[:1])
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=patches)
    footprint = pixel_footprint(scene.camera, rig.camera.distance_mm)
    places = strew(
        rig, part, scene, count=count, seed=SEED, turns=DIRECTIONS,
        catalogue=[CatalogueEntryConfig(kind="pit", name="place", size_mm=2.0 * footprint, slope_deg=10.0)],
    )  # fmt: skip
    at = _patches_of(scene, places, caster, table)
    for kind, slope, widths in CASES:
        for width in widths:
            length = max(LENGTH_PX, 2.0 * width) if kind == "scratch" else width
            shape = DefectShape(
                kind=kind,  # pyright: ignore[reportArgumentType]
                length=length * footprint,
                width=width * footprint,
                slope=math.radians(slope),
            )
            defects = tuple(replace(place, shape=shape) for place in places)
            for finish, changes in finishes.items():
                own = replace(scene, reflectance=replace(scene.reflectance, **changes))
                said, shown = _both(own, caster, table, defects, at, _samples(width))
                for min_images in SEEN_IN:
                    yield Narrow(
                        part=part.name, finish=finish, kind=kind, slope_deg=slope, width_px=width,
                        min_images=min_images,
                        predicted=float((said.sum(axis=0) >= min_images).mean()),
                        measured=float((shown.sum(axis=0) >= min_images).mean()),
                    )  # fmt: skip


def _samples(width_px: float) -> int:
    low, high = SAMPLES
    return min(high, max(low, math.ceil(8.0 / width_px)))


def _patches_of(
    scene: Scene, places: tuple[PlacedDefect, ...], caster: RayCaster, table: PatchTable
) -> NDArray[np.int32]:
    camera = view_from_part(scene, scene.postures[0]).camera
    columns, rows, _ = project(camera, np.array([place.position for place in places]))
    hits, _ = trace_samples(caster, scene.mesh, camera, columns, rows)
    assert len(hits.ray) == len(places)
    return table.patches.patch_at(hits.face, hits.u, hits.v)


def _both(
    scene: Scene,
    caster: RayCaster,
    table: PatchTable,
    defects: tuple[PlacedDefect, ...],
    at: NDArray[np.int32],
    samples: int,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    # which defects the images are predicted to show, and which they do: (lights, defects)
    shape = defects[0].shape
    contrast = Contrast(sensor=scene.sensor, full_scale=scene.reflectance.full_scale)
    trials = defect_hypotheses([CatalogueEntry(shape.kind, shape)])
    visibility = luminance_matrix(
        scene,
        table,
        scene.postures[0],
        [(light,) for light in scene.lights],
        caster=caster,
        detection=DetectionModel(hypotheses=trials, contrast=contrast),
    ).visibility
    assert visibility is not None
    row_of = np.full(len(table.patches), 0)
    row_of[visibility.patch] = np.arange(len(visibility.patch))
    walls = np.ones((len(defects), DIRECTIONS), np.bool_)
    if shape.kind == "scratch":
        # along the direction of its index, so that its walls lean a quarter of a turn to both sides
        index = np.arange(len(defects))
        walls[:] = False
        walls[index, (index + DIRECTIONS // 4) % DIRECTIONS] = True
        walls[index, (index - DIRECTIONS // 4) % DIRECTIONS] = True
    said = np.stack(
        [(unpack_flags(layer[0][row_of[at]], len(trials)) & walls).any(axis=1) for layer in visibility.words]
    )
    seen = touched(
        scene,
        scene.postures[0],
        defects,
        caster=caster,
        patches=table.patches,
        samples=samples,
        stretch_px=STRETCH_PX if shape.kind == "scratch" else math.inf,
    )
    levels = seen.levels(scene, caster)
    return said, counted(seen, levels, scene, len(defects), contrast=contrast)


def table_of(rows: list[Narrow]) -> str:
    """A line for each part, finish, kind and width; both numbers of images in it."""
    lines = [
        "| part | finish | defect | width | 1 image: predicted | counted | 2 images: predicted | counted |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for one, two in zip(rows[::2], rows[1::2], strict=True):
        shares = " | ".join(f"{100.0 * x:.1f} %" for r in (one, two) for x in (r.predicted, r.measured))
        lines.append(
            f"| {one.part} | {one.finish} | {one.kind} of {one.slope_deg:g}° | {one.width_px:g} px | {shares} |"
        )
    return "\n".join(lines)


def shares(row: Narrow) -> tuple[str, str]:
    """Predicted and counted, as text."""
    return f"{row.predicted:.6f}", f"{row.measured:.6f}"


def main(arguments: list[str] | None = None) -> None:
    """Compare, print a table, write all rows."""
    parser = argparse.ArgumentParser(prog="python tests/system/narrow.py", description=__doc__)
    parser.add_argument("parts", nargs="*", type=Path, metavar="PART", default=list(PARTS), help="part files")
    parser.add_argument("--rig", type=Path, default=RIG, help="rig file")
    parser.add_argument("--matt", action="store_true", help="a surface without highlights, instead of both finishes")
    parser.add_argument("--patches", type=int, default=50_000, help="about how many patches are visible")
    parser.add_argument("--count", type=int, default=COUNT, help="how many defects are strewn")
    parser.add_argument("--out", type=Path, default=Path("out/truth"), help="folder of narrow.csv")
    options = parser.parse_args(arguments)
    rig = load_rig(options.rig)
    rows = [
        row
        for part in options.parts
        for row in compare(
            rig,
            load_part(part),
            patches=options.patches,
            count=options.count,
            finishes=MATT if options.matt else FINISHES,
        )
    ]
    print(table_of(rows))
    differences = np.array([abs(r.predicted - r.measured) for r in rows])
    worst = rows[int(differences.argmax())]
    print(
        f"\n{int((differences <= 0.05).sum())} of {len(rows)} within 5 points, mean difference "
        f"{100.0 * differences.mean():.1f}; furthest off: {worst.part}, {worst.finish}, {worst.kind} of "
        f"{worst.width_px:g} px, {worst.min_images} images, {100.0 * (worst.predicted - worst.measured):+.1f} points"
    )
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "narrow.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["part", "finish", "kind", "slope_deg", "width_px", "min_images", "predicted", "measured"])
        for r in rows:
            writer.writerow([r.part, r.finish, r.kind, r.slope_deg, r.width_px, r.min_images, *shares(r)])
    print(path)


if __name__ == "__main__":
    main()
