"""Is the lighting system that is predicted to find most the one that finds most: rendered and inspected.

``python -m benchmarks.lighting [--parts cover-knob spout cap ring] [--finishes as-filed polished satin]
[--systems four-panel,coaxial] [--seeds N] [--processes N]``. The parts are the two samples, and two that are made here:
``cap``, a shallow cap of a sphere, and ``ring``, a torus. Random defects are placed on each part, the same ones for all
systems; those of the built-in catalogue, larger as the pixels are. The part is rendered 0.4 and 0.3 mm off its place,
with noise of its own for each seed. The images of the first seed find its place. What the inspection finds is set
beside what is predicted of all places, and of the places where the defects lie.
"""

from __future__ import annotations

import argparse
import csv
import math
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import get_type_hints

import numpy as np
import trimesh

from benchmarks._case import CONFIGS, write_records
from benchmarks.inspection import replace_block
from benchmarks.loop import FINISHES, OFF_MM, Counts, Prediction, Tally, count_found, files, interval, run_command
from lightopt import build_scene, load_part, load_rig
from lightopt.comparison import PRESETS, preset_files
from lightopt.config import PartConfig, RigConfig
from lightopt.defects import BUILT_IN_CATALOGUE, DEFAULT_FALSE_ALARMS
from lightopt.images import ImageSet, read_image_set
from lightopt.rendering import RenderOptions, render_image_set
from lightopt.scene import place_defects

SYSTEMS = ("four-panel", "low-ring", "coaxial", "display", "dome-quadrants")
MADE = {
    # sagitta 4.2 mm over 44 mm; and a ring 54 mm across, whose hole shows the table
    "cap": lambda: trimesh.creation.revolve(_arc(radius=60.0, start=-90.0, end=-90.0 + 21.5), sections=256),
    "ring": lambda: trimesh.creation.torus(17.0, 10.0, major_sections=256, minor_sections=128),
}
"""Parts that are no samples of the package."""


@dataclass(frozen=True)
class Row:
    """A system on a part of a finish: shares of the kinds' mean."""

    part: str
    finish: str
    system: str
    min_images: int
    planned: float
    at_places: float
    placed: int
    found: int
    false_alarms: int
    postures: int


def _arc(*, radius: float, start: float, end: float) -> np.ndarray:
    # of a circle in (radius, height), from the axis outwards with the middle on top, closed by a flat bottom [deg, mm]
    angles = np.radians(np.linspace(start, end, 65))
    curve = radius * np.stack([np.cos(angles), -np.sin(angles)], axis=1)
    return np.concatenate([[[0.0, curve[-1, 1] - 2.0], [curve[-1, 0], curve[-1, 1] - 2.0]], curve[::-1]])


def part_name(folder: Path, name: str) -> str:
    """A sample's name or a file's as it is; for a part that is made here the file that is written for it."""
    if name not in MADE:
        return name
    made = MADE[name]()
    made.export(folder / f"{name}.stl")
    text = (CONFIGS / "parts" / "cover-knob.yaml").read_text(encoding="utf-8")
    (folder / f"made-{name}.yaml").write_text(
        text.replace("cover-knob.step", f"{name}.stl").replace("cover-knob", name), encoding="utf-8"
    )
    return str(folder / f"made-{name}.yaml")


def catalogue_text(larger: float) -> str:
    """The built-in catalogue for a part's file, with defects so many times as large, and as steep."""
    lines = ["", "defect_catalogue:"]
    for entry in BUILT_IN_CATALOGUE:
        shape = entry.shape
        values = {"size_mm": f"[{larger * shape.length:g}, {larger * shape.width:g}]"}
        if shape.slope > 0.0:
            values["slope_deg"] = f"{math.degrees(shape.slope):g}"
        values |= {key: f"{value:g}" for key in ("R_d_factor", "sigma_factor") if (value := getattr(shape, key)) != 1.0}
        facts = ", ".join(f"{key}: {value}" for key, value in values.items())
        lines.append(f"  - {{name: {entry.name}, kind: {shape.kind}, {facts}}}")
    return "\n".join(lines) + "\n"


def render_set(rig: RigConfig, part: PartConfig, folder: Path, seed: int, *, rays: int = 1) -> ImageSet:
    """Images of the part off its place, with noise of a seed."""
    place = part.placement.model_copy(update={"translate_mm": OFF_MM})
    moved = part.model_copy(update={"placement": place})
    render_image_set(rig, moved, folder, options=RenderOptions(noise=seed, supersample=rays, patch_budget=500))
    return read_image_set(folder)


def placed_parts(folder: Path, rig_file: Path, part_file: Path, options: argparse.Namespace) -> list[Path]:
    """Files of the part with random defects, one for each seed."""
    placed: list[Path] = []
    for seed in range(1, options.seeds + 1):
        placed.append(folder / f"{part_file.stem}-{seed}.yaml")
        command = ("defects", rig_file, part_file, "--seed", seed, "--count", options.count, "-o", placed[-1], "-q")
        run_command(*command)
    return placed


def case_files(folder: Path, name: str, finish: str, options: argparse.Namespace) -> tuple[Path, Path]:
    """The sample rig and a part of a finish, with the catalogue."""
    rig_file, part_file = files(folder, part_name(folder, name), width=options.width, finish=finish)
    # a sample's triangles are read sooner than its STEP file
    text = part_file.read_text(encoding="utf-8").replace(".step", ".stl")
    part_file.write_text(text + catalogue_text(options.larger), encoding="utf-8")
    return rig_file, part_file


def compare(folder: Path, name: str, finish: str, options: argparse.Namespace) -> Iterator[tuple[Row, list[Tally]]]:
    """Predict and inspect all systems on one part of one finish."""
    rig_file, part_file = case_files(folder, name, finish, options)
    placed = placed_parts(folder, rig_file, part_file, options)
    for path in preset_files(options.systems, folder / "presets", camera_of=load_rig(rig_file)):
        rig, nominal = load_rig(path), load_part(part_file)
        least = min(2, len(rig.lights))
        counts = {least: Prediction(rig, nominal, least, options)}
        name_of_set = f"{part_file.stem}-{path.stem}"
        found = count_found(folder, name_of_set, rig, placed, counts, options, take=render_set, fixture=True)
        tallies = list(found)
        (whole,) = [one for one in tallies if one.kind == "all"]
        facts = {key: getattr(whole, key) for key in ("planned", "at_places", "placed", "found")}
        alarms = {"false_alarms": whole.false_alarms, "postures": whole.postures}
        yield Row(name, finish, path.stem, least, **facts, **alarms), tallies


def predict_again(name: str, finish: str, rows: list[Row], options: argparse.Namespace) -> list[Row]:
    """Rows of one part of one finish as they are predicted now; what was found stays."""
    with tempfile.TemporaryDirectory(prefix="lightopt-lighting-") as folder:
        rig_file, part_file = case_files(Path(folder), name, finish, options)
        placed = placed_parts(Path(folder), rig_file, part_file, options)
        paths = preset_files([row.system for row in rows], Path(folder) / "presets", camera_of=load_rig(rig_file))
        found: list[Row] = []
        for row, path in zip(rows, paths, strict=True):
            rig = load_rig(path)
            counts = Counts(Prediction(rig, load_part(part_file), row.min_images, options))
            for part in map(load_part, placed):
                counts.miss(place_defects(build_scene(rig, part, defects=False), rig, part))
            (whole,) = [one for one in counts.tallies(name, "", row.min_images) if one.kind == "all"]
            if whole.placed != row.placed:
                raise SystemExit(f"{whole.placed} defects placed, {row.placed} in {options.out}: --seeds, --count?")
            found.append(replace(row, planned=whole.planned, at_places=whole.at_places))
            print(f"{found[-1]}, before {100 * row.planned:.1f} and {100 * row.at_places:.1f} %", flush=True)
    return found


def rows_of(case: tuple[str, str], options: argparse.Namespace) -> list[Row]:
    """All systems on one part of one finish; prints what it finds."""
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="lightopt-lighting-") as folder:
        for row, tallies in compare(Path(folder), *case, options):
            rows.append(row)
            shares = (f"{one.kind} {100 * one.planned:.0f}/{100 * one.found / one.placed:.0f}" for one in tallies)
            print(f"{row}\n   planned/found [%]: {', '.join(shares)}", flush=True)
    return rows


def read_rows(path: Path) -> list[Row]:
    """Rows that a run has written; none where it has not written yet."""
    if not path.is_file():
        return []
    kinds = get_type_hints(Row)
    with path.open(encoding="utf-8", newline="") as file:
        return [Row(**{key: kinds[key](text) for key, text in row.items()}) for row in csv.DictReader(file)]


def table(rows: list[Row]) -> str:
    """A line per part, finish and system, the winners in bold."""
    lines = [
        "| part | finish | system | images | planned | at these places | found | 95 % | false alarms |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    right = 0
    cases = list(dict.fromkeys((row.part, row.finish) for row in rows))
    for case in cases:
        own = [row for row in rows if (row.part, row.finish) == case]
        predicted, best = max(own, key=lambda row: row.planned), max(own, key=lambda row: row.found / row.placed)
        right += predicted is best
        for row in own:
            low, high = interval(row.found, row.placed)
            planned, found = f"{100 * row.planned:.0f} %", f"{100 * row.found / row.placed:.0f} %"
            planned, found = (
                f"**{text}**" if row is winner else text for text, winner in ((planned, predicted), (found, best))
            )
            lines.append(
                f"| {row.part} | {row.finish} | {row.system} | {row.min_images} | {planned} | "
                f"{100 * row.at_places:.0f} % | {found} of {row.placed} | {100 * low:.0f} to {100 * high:.0f} % | "
                f"{row.false_alarms} in {row.postures} |"
            )
    near = [
        sum(abs(getattr(row, key) - row.found / row.placed) <= 0.05 for row in rows) for key in ("planned", "at_places")
    ]
    lines += [
        "",
        (
            f"The predicted winner wins in {right} of {len(cases)}. Of {len(rows)} shares predicted at these places, "
            f"{near[1]} are within 5 points of those found; of those predicted of all places, {near[0]} are."
        ),
    ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Compare the systems, print the table, write all rows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lighting", description=__doc__)
    parser.add_argument("--parts", nargs="+", default=["cover-knob", "spout", *MADE], help="or files of other parts")
    parser.add_argument("--finishes", nargs="+", choices=FINISHES, default=list(FINISHES))
    parser.add_argument("--systems", type=lambda text: text.split(","), default=list(SYSTEMS), help=", ".join(PRESETS))
    parser.add_argument("--false-alarms", type=float, default=DEFAULT_FALSE_ALARMS, help="per posture of a good part")
    parser.add_argument("--seeds", type=int, default=16, help="sets of defects per part")
    parser.add_argument("--count", type=int, default=7, help="defects per set")
    parser.add_argument("--processes", type=int, default=1, help="cases at once")
    parser.add_argument("--width", type=int, default=320, help="of the images [px]")
    parser.add_argument("--rays", type=int, default=1, help="along a side of a pixel; a camera's pixels have many")
    parser.add_argument(
        "--larger", type=float, default=2.0, help="size of the defects, as a multiple of that in the built-in catalogue"
    )
    parser.add_argument("--patches", type=int, default=3000, help="about how many patches are visible")
    parser.add_argument(
        "--keep", action="store_true", help="do not compare again what --out has, from a run of the same options"
    )
    parser.add_argument(
        "--predict-again",
        action="store_true",
        help="predict rows of --parts in --out again and keep what was found; with --seeds and --count of their run",
    )
    parser.add_argument("--out", type=Path, default=Path("out/lighting"), help="folder of lighting.csv")
    parser.add_argument("--page", action="store_true", help="put the table into docs/validation/lighting.md")
    options = parser.parse_args(arguments)
    options.lobe = 1.0
    cases = [(name, finish) for name in options.parts for finish in options.finishes]
    results = options.out / "lighting.csv"
    rows = read_rows(results) if options.keep or options.predict_again else []
    if options.predict_again:
        for case in cases:
            own = [row for row in rows if (row.part, row.finish) == case]
            for row, again in zip(own, predict_again(*case, own, options), strict=True):
                rows[rows.index(row)] = again
            write_records(results, rows)
    cases = [case for case in cases if case not in {(row.part, row.finish) for row in rows}]
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        for some in pool.map(rows_of, cases, [options] * len(cases)):
            rows += some
            write_records(results, rows)
    text = table(rows)
    print(f"\n{text}")
    if options.page:
        replace_block("lighting", text, page="lighting.md")


if __name__ == "__main__":
    main()
