"""False alarms on good parts whose images are averaged over the pixel, as a camera's are.

``python -m benchmarks.pixel_means [--places N] [--rays 1 3 4] [--page]``. The sample parts, good ones, are rendered in
all their postures under the sample rig as filed with n × n rays per pixel and noise, at random places up to half a
millimetre and half a degree off, and inspected with ``--min-images`` 1 and 2. The sets of a place are a batch; each
number of rays is the first of it in turn.
"""

from __future__ import annotations

import argparse
import re
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks._case import CONFIGS, RIG, write_records
from benchmarks.inspection import PARTS, replace_block
from lightopt import load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.core.run_context import RunContext
from lightopt.images import read_image_set
from lightopt.inspection import InspectOptions, PredictionCache, inspect_set
from lightopt.rendering import RenderOptions, render_image_set

MIN_IMAGES = (1, 2)
MOST_MM, MOST_DEG = 0.5, 0.5


@dataclass(frozen=True)
class Row:
    """False alarms in the postures of a part under panels of some points, with n × n rays per pixel."""

    part: str
    points: str
    rays: int
    min_images: int
    postures: int
    false_alarms: int
    with_any: int
    seconds: float


def rig_of(folder: Path, points: str, width: int) -> RigConfig:
    """The sample rig with panels of so many points, and images of a width [px]."""
    text = RIG.read_text(encoding="utf-8").replace("[1600, 1200]", f"[{width}, {width * 3 // 4}]")
    text = text.replace("pixel_size_um: 4.4", f"pixel_size_um: {4.4 * 1600 / width:g}")
    path = folder / f"rig-{points}.yaml"
    path.write_text(re.sub(r"points: 4\b", f"points: {points}", text), encoding="utf-8")
    return load_rig(path)


def displaced_part(folder: Path, name: str, place: int) -> PartConfig:
    """A sample part at one of its random places."""
    rng = np.random.default_rng([place, PARTS.index(name)])
    x, y = rng.uniform(-MOST_MM, MOST_MM, 2)
    turn = rng.uniform(-MOST_DEG, MOST_DEG)
    file = CONFIGS / "parts" / f"{name}.yaml"
    text = re.sub(r"file: (\S+)", lambda m: f"file: '{file.with_name(m[1]).as_posix()}'", file.read_text("utf-8"))
    moved = (
        f"placement:\n  anchor: rest_on_table\n  translate_mm: [{x:.4f}, {y:.4f}, 0]\n  rotate_deg: [0, 0, {turn:.4f}]"
    )
    path = folder / f"{name}-{place}.yaml"
    path.write_text(re.sub(r"placement:.*?\n\npostures:", f"{moved}\n\npostures:", text, flags=re.DOTALL), "utf-8")
    return load_part(path)


def count(folder: Path, options: argparse.Namespace) -> list[Row]:
    """Render and inspect all sets; sets that the folder has are used again."""
    totals: dict[tuple[str, str, int, int], list[tuple[int, int, int, float]]] = defaultdict(list)
    for name in options.parts:
        part = load_part(CONFIGS / "parts" / f"{name}.yaml")
        for points in options.points:
            rig = rig_of(folder, points, options.width)
            for place in range(options.places):
                moved, cache = displaced_part(folder, name, place), PredictionCache()
                first = place % len(options.rays)
                for rays in (*options.rays[first:], *options.rays[:first]):
                    out = folder / f"{name}-{points}-{rays}-{place}"
                    if not (out / "manifest.json").exists():
                        rendering = RenderOptions(noise=place + 1, supersample=rays, patch_budget=2000)
                        render_image_set(rig, moved, out, options=rendering)
                    images = read_image_set(out)
                    for k in MIN_IMAGES:
                        begun = time.process_time()
                        inspection = InspectOptions(fusion=None, min_images=k)
                        result = inspect_set(
                            rig, part, images, options=inspection, cache=cache, run=RunContext(threads=1)
                        )
                        alarms = [len(p.detections) for p in result.postures]
                        seen = len(alarms), sum(alarms), sum(n > 0 for n in alarms), time.process_time() - begun
                        totals[name, points, rays, k].append(seen)
                        text = f"{name}, {points} points, place {place}, {rays} × {rays} rays, {k} of the images"
                        print(f"{text}: {sum(alarms)} in {len(alarms)}, {seen[-1]:.1f} s", flush=True)
    return [
        Row(
            *key,
            postures=sum(x[0] for x in seen),
            false_alarms=sum(x[1] for x in seen),
            with_any=sum(x[2] for x in seen),
            seconds=float(np.median([x[3] for x in seen])),
        )
        for key, seen in totals.items()
    ]


def table(rows: list[Row]) -> str:
    """A line per part, points and rays."""
    lines = ["| part | points | rays per pixel | postures | false alarms, 1 image | 2 images |", "|---" * 6 + "|"]
    by_key: dict[tuple[str, str, int], dict[int, Row]] = defaultdict(dict)
    for row in rows:
        by_key[row.part, row.points, row.rays][row.min_images] = row
    for (part, points, rays), own in by_key.items():
        cells = [f"{own[k].false_alarms}" for k in MIN_IMAGES]
        lines.append(f"| {part} | {points} | {rays} × {rays} | {own[1].postures} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Count false alarms and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pixel_means", description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--points", nargs="+", default=["4", "auto"], help="of the panels")
    parser.add_argument("--rays", nargs="+", type=int, default=[1, 3, 4], help="along a side of a pixel")
    parser.add_argument("--places", type=int, default=8, help="per part and panel")
    parser.add_argument("--width", type=int, default=800, help="of the images [px]")
    parser.add_argument("--folder", type=Path, help="keep image sets here, and use those that are there")
    parser.add_argument("--out", type=Path, default=Path("out/pixel-means"), help="folder of pixel-means.csv")
    parser.add_argument("--page", action="store_true", help="put the table into docs/validation/inspection.md")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="lightopt-pixels-") as name:
        folder = options.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        rows = count(folder, options)
    text = table(rows)
    print(f"\n{text}")
    write_records(options.out / "pixel-means.csv", rows)
    if options.page:
        replace_block("pixel-means", text)


if __name__ == "__main__":
    main()
