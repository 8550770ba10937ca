"""Does ``detectability`` tell the truth: its predicted share of defects seen against noisy renders, counted plainly.

``python tests/system/truth.py [PART.yaml …] [--out DIR] [--plot PNG]``; the sample parts by default. For each part,
finish and number of images, two countings, both with noise and with a test that knows nothing of patches: a pixel shows
a defect where its level is off the noise-free image of the good part by the threshold times the noise there.

*Walls*: the whole surface leans by each slope of the catalogue to each direction (or is stained, or hazed), every
fourth pixel of every fourth row is shaded and exposed with noise, and pixels count by the area that they see. Compared
with the share of surface × defects that the objective predicts from its patches; of what the camera sees at less than
80° to its normal, beyond which nothing counts as visible. Counted twice: one pixel at a time, where noise takes some of
those just below the threshold across it, and by the mean of nine pixels.

*Pits*: cones of known slope are strewn over the part by the function behind ``lightopt defects``, rendered by
``render_posture``, exposed with noise, and the pixels on their walls counted, each alone and by the mean of it and its
eight neighbours. Compared with what the patches under those pixels predict of a wall that leans as theirs does, to the
nearest of 32 directions. Defects of about a pixel are for ``python tests/system/narrow.py``.
"""

from __future__ import annotations

import argparse
import csv
import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from truth_case import MEANS, SEED, SEEN_IN, Case, Point
from truth_pits import pits_of
from truth_walls import walls

from lightopt import build_scene, load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import counted
from lightopt.design import Contrast
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.report import chart, figure_image, fixed_style

__all__ = ["FINISHES", "PARTS", "RIG", "SEED", "SEEN_IN", "Point", "compare", "main", "plot", "table"]

ROOT = Path(__file__).resolve().parents[2]
RIG = ROOT / "configs" / "rigs" / "four-panel.yaml"
PARTS = tuple(ROOT / "configs" / "parts" / f"{name}.yaml" for name in ("cover-knob", "spout"))

FINISHES = {"glossy": {}, "satin": {"R_s": 1500.0, "sigma": 0.14}}
"""As the part file says, and a satin surface."""

PITS = 60

TABLE = "truth.csv"


def compare(rig: RigConfig, part: PartConfig, *, patches: int, pits: int = PITS) -> Iterator[Point]:
    """Predict and measure a part in its first posture, lights as the rig has them, for both finishes."""
    for finish, changes in FINISHES.items():
        scene = build_scene(rig, part, defects=False)
        scene = replace(scene, postures=scene.postures[:1], reflectance=replace(scene.reflectance, **changes))
        caster = cast_rays_at(scene)
        table = build_patches(scene, caster=caster, budget=patches)
        contrast = Contrast(sensor=scene.sensor, full_scale=scene.reflectance.full_scale)
        case = Case(scene, caster, table, contrast)
        yield from walls(case, part, finish)
        if pits:
            yield from pits_of(case, rig, part, finish, pits)


def table(points: list[Point]) -> str:
    """The points of whole catalogues and of pits, a line each, with the largest difference of a kind."""
    lines = [
        "| part | finish | images | defects | pixels | predicted | measured | kind that is furthest off |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for one in points:
        furthest, name = "", one.kind
        if one.kind == "all":
            case = (one.part, one.finish, one.min_images, one.pixels)
            kinds = [
                p
                for p in points
                if (p.part, p.finish, p.min_images, p.pixels) == case and not p.kind.startswith("pits")
            ]
            worst = max(kinds, key=lambda p: abs(p.measured - p.predicted))
            furthest = f"{worst.kind} {100.0 * (worst.measured - worst.predicted):+.1f} points"
            name = "the catalogue"
        elif not one.kind.startswith("pits"):
            continue
        lines.append(
            f"| {one.part} | {one.finish} | {one.min_images} | {name} | {one.pixels} | {100.0 * one.predicted:.1f} % "
            f"| {100.0 * one.measured:.1f} % | {furthest} |"
        )
    return "\n".join(lines)


def plot(points: list[Point], path: Path) -> None:
    """Predicted across, measured up, a panel for each finish and number of pixels; the line is where they are equal."""
    parts = ", ".join(dict.fromkeys(p.part for p in points))
    shown = list(itertools.product(FINISHES, MEANS))
    with fixed_style():
        figure, panels = chart(
            title=f"Defects seen: {parts}",
            x_label="predicted [%]",
            labels=[
                f"{finish}, {'each pixel' if pixels == 1 else f'mean of {pixels} pixels'}: measured [%]"
                for finish, pixels in shown
            ],
        )
        for panel, which in zip(panels, shown, strict=True):
            own = [p for p in points if (p.finish, p.pixels) == which]
            panel.plot([100.0 * p.predicted for p in own], [100.0 * p.measured for p in own], ".", color="#5c636e")
            panel.plot([0.0, 100.0], [0.0, 100.0])
        figure_image(figure).save(path)


def write(points: list[Point], folder: Path) -> None:
    """All points as a table in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / TABLE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["part", "finish", "defects", "min_images", "pixels", "predicted", "measured"])
        for p in points:
            writer.writerow(
                [p.part, p.finish, p.kind, p.min_images, p.pixels, f"{p.predicted:.6f}", f"{p.measured:.6f}"]
            )


def main(arguments: list[str] | None = None) -> None:
    """Compare, print a table, write all points."""
    parser = argparse.ArgumentParser(prog="python tests/system/truth.py", description=__doc__)
    parser.add_argument("parts", nargs="*", type=Path, metavar="PART", default=list(PARTS), help="part files")
    parser.add_argument("--rig", type=Path, default=RIG, help="rig file")
    parser.add_argument("--patches", type=int, default=50_000, help="about how many patches are visible")
    parser.add_argument("--pits", type=int, default=PITS, help="how many are strewn; 0 for none")
    parser.add_argument("--out", type=Path, default=Path("out/truth"), help="folder of truth.csv")
    parser.add_argument("--plot", type=Path, help="picture to draw of the points")
    options = parser.parse_args(arguments)
    rig = load_rig(options.rig)
    points: list[Point] = []
    for path in options.parts:
        own = list(compare(rig, load_part(path), patches=options.patches, pits=options.pits))
        points += own
        # a part takes minutes: what there is is told and kept
        print(table(own), flush=True)
        write(points, options.out)
        if options.plot is not None:
            plot(points, options.plot)
    for pixels in MEANS:
        worst = max((p for p in points if p.pixels == pixels), key=lambda p: abs(p.predicted - p.measured))
        print(
            f"largest difference by {counted(pixels, 'pixel')}: "
            f"{100.0 * abs(worst.predicted - worst.measured):.1f} points, {worst.part}, {worst.finish}, {worst.kind}"
        )
    print(options.out / TABLE)


if __name__ == "__main__":
    main()
