"""Seconds from files to verdict of a part in a batch, against reading its files and casting its primary rays."""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks._case import CONFIGS, RIG, Size
from benchmarks._report import Report, Table, ratio_text, ratios, rounds
from benchmarks.bare import THREADS
from lightopt import load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.core.run_context import RunContext
from lightopt.core.threads import in_threads
from lightopt.core.transforms import Posture
from lightopt.geometry import RayCaster
from lightopt.images import ImageSet, read_image_set
from lightopt.inspection import InspectionResult, InspectOptions, PredictionCache, inspect_set, judge
from lightopt.rendering import RenderOptions, cast_rays_at, render_image_set, trace_samples
from lightopt.scene import Scene, screen_window, view_from_part

TARGETS = {"first": 12.0, "verdict": 2.0, "synthetic": 6.0}
"""Ratios of times to aim at: of the first part of a batch, and of a next one to its verdict and to its image."""

PARTS = ("cover-knob", "spout")
FIRST = Posture(elevation_deg=0.0, rotation_deg=0.0)
PLACES_MM = ((0.4, -0.3), (0.406, -0.304), (0.396, -0.296))
"""Of the part on its fixture: 7 µm from the first to the others, 0.16 pixels of the full size."""

ROWS = 64


def run(size: Size) -> Report:
    """Inspect three good parts of each kind that lie nearly alike, the last two again and again; a toy has one kind."""
    rows: list[tuple[str, ...]] = []
    numbers: dict[str, object] = {}
    for part in PARTS if size.repeats > 1 else PARTS[:1]:
        with tempfile.TemporaryDirectory(prefix="lightopt-bench-") as name:
            rows += _part(Path(name), part, size, numbers)
    header = ("", "seconds", "processor [s]", "read and cast [s]", "ratio, least", "ratio, median", "target", "met")
    header = (*header, "processor ratio")
    notes = (
        f"one posture, four lights, {size.width} px wide, 8 bits with noise, {THREADS} threads; files are in the cache",
        "read and cast: manifest, hashes and PNGs, and a ray through every pixel centre that can show the part",
        "processor: least time of all threads together, which other programs disturb less; and its ratio to the base's",
        "next: a part of a batch within a quarter of a pixel of the one before, whose predictions are kept",
    )
    return Report(
        "inspecting", [Table("inspect --detector residual, from files to verdict", header, rows)], numbers, notes
    )


def _part(folder: Path, part: str, size: Size, numbers: dict[str, object]) -> list[tuple[str, ...]]:
    rig = _rig(folder, size)
    good, sets = _sets(folder, part, rig)
    # registration, rendering and merging are measured, without the templates of a catalogue
    options = InspectOptions(detector="residual")
    cache = PredictionCache()
    once: list[tuple[float, float]] = []
    for folder_of_set in sets[:2]:
        start, begun = time.perf_counter(), time.process_time()
        result = _verdict(rig, good, folder_of_set, options, cache)
        once.append((time.perf_counter() - start, time.process_time() - begun))
    scene = result.nominal
    caster = cast_rays_at(scene)
    calls = {"verdict": 0, "synthetic": 0}
    processor: dict[str, list[float]] = {"base": [], "verdict": [], "synthetic": []}

    def task(name: str) -> Callable[[], object]:
        def inspect() -> object:
            calls[name] += 1
            begun = time.process_time()
            result = _verdict(rig, good, sets[1 + calls[name] % 2], options, cache)
            if name == "synthetic":
                assert all(posture.synthetic is not None for posture in result.postures)
            processor[name].append(time.process_time() - begun)
            return result

        return inspect

    def base() -> object:
        begun = time.process_time()
        _read(read_image_set(sets[1]))
        hits = _cast(scene, caster)
        processor["base"].append(time.process_time() - begun)
        return hits

    # apart: what the synthetic image leaves in caches and memory slows what comes next
    timed: dict[str, dict[str, list[float]]] = {}
    worked: dict[str, dict[str, list[float]]] = {}
    for key in ("verdict", "synthetic"):
        timed[key] = rounds({"base": base, key: task(key)}, size.repeats)
        worked[key] = {"base": processor["base"][-size.repeats :], key: processor[key]}
    cast, worked_cast = (min(min(times["base"]) for times in kind.values()) for kind in (timed, worked))
    numbers[f"{part}: first and second"] = {"seconds": [s for s, _ in once], "processor": [p for _, p in once]}
    table: list[tuple[str, ...]] = []
    for what, (seconds, work) in zip(("first part", "second part, slopes rendered"), once, strict=True):
        ratio, target = seconds / cast, TARGETS["first"] if what == "first part" else None
        goal = ("", "") if target is None else (f"≤ {target:g}", "yes" if ratio <= target else "no")
        cells = (f"{seconds:.2f}", f"{work:.2f}", f"{cast:.2f}", f"{ratio:.1f}", "", *goal, f"{work / worked_cast:.1f}")
        table.append((f"{part}: {what}", *cells))
    for key, label in (("verdict", "next part, to its verdict"), ("synthetic", "next part, to its synthetic image")):
        times, work, target = timed[key], worked[key], TARGETS[key]
        numbers[f"{part}: {label}"] = {"seconds": times[key], "base": times["base"], "processor": work}
        met = "yes" if ratios(times[key], times["base"])[0] <= target else "no"
        cells = (f"{min(times[key]):.2f}", f"{min(work[key]):.2f}", f"{min(times['base']):.2f}")
        cpu, _ = ratio_text(work[key], work["base"])
        table.append((f"{part}: {label}", *cells, *ratio_text(times[key], times["base"]), f"≤ {target:g}", met, cpu))
    return table


def _rig(folder: Path, size: Size) -> RigConfig:
    text = RIG.read_text(encoding="utf-8")
    text = text.replace("[1600, 1200]", f"[{size.width}, {size.width * 3 // 4}]")
    text = text.replace("pixel_size_um: 4.4", f"pixel_size_um: {4.4 * 1600 / size.width:g}")
    path = folder / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    return load_rig(path)


def _sets(folder: Path, name: str, rig: RigConfig) -> tuple[PartConfig, list[Path]]:
    # the part where its file has it, and image sets of three of them on a fixture
    text = (CONFIGS / "parts" / f"{name}.yaml").read_text(encoding="utf-8")
    text = re.sub(r"file: \S+", f"file: '{(CONFIGS / 'parts' / f'{name}.step').as_posix()}'", text)
    path = folder / "part.yaml"
    path.write_text(text, encoding="utf-8")
    sets: list[Path] = []
    scale = 1600 / rig.camera.resolution_px[0]
    for number, (x, y) in enumerate(PLACES_MM):
        # as many pixels apart whatever the size
        own = ", ".join(
            f"{first + scale * (there - first):.6g}" for there, first in zip((x, y), PLACES_MM[0], strict=True)
        )
        placed = f"placement: {{anchor: rest_on_table, translate_mm: [{own}, 0]}}\n\npostures:"
        moved = folder / f"part-{number}.yaml"
        moved.write_text(
            re.sub(r"placement:.*?\npostures:", lambda _, t=placed: t, text, flags=re.DOTALL), encoding="utf-8"
        )
        sets.append(folder / f"set-{number}")
        options = RenderOptions(noise=number + 1, postures=(FIRST,), patch_budget=2000)
        render_image_set(rig, load_part(moved), sets[-1], options=options)
    return load_part(path), sets


def _verdict(
    rig: RigConfig, part: PartConfig, folder: Path, options: InspectOptions, cache: PredictionCache
) -> InspectionResult:
    run = RunContext(threads=THREADS)
    result = inspect_set(rig, part, read_image_set(folder), options=options, cache=cache, run=run)
    judge(result, part.inspection)
    return result


def _read(image_set: ImageSet) -> None:
    for entry in image_set.images:
        image_set.load(entry)


def _cast(scene: Scene, caster: RayCaster) -> int:
    view = view_from_part(scene, FIRST)
    left, top, right, bottom = screen_window(view.camera, scene.mesh)
    columns = np.arange(left, right) + 0.5

    def block(first: int) -> int:
        x, y = np.meshgrid(columns, np.arange(first, min(first + ROWS, bottom)) + 0.5)
        hits, _ = trace_samples(caster, scene.mesh, view.camera, x.ravel(), y.ravel())
        return len(hits.ray)

    return sum(in_threads(block, range(top, bottom, ROWS), THREADS))
