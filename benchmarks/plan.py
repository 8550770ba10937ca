"""A hundred candidate postures planned with the lights, lights alone at fine steps, tolerances: seconds and memory."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from benchmarks._case import CONFIGS, RIG, Size, resized
from benchmarks._report import Report, Table
from benchmarks.bare import THREADS
from benchmarks.search import peak_bytes
from lightopt import build_scene, load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.design import DetectionModel, Tolerances, find_candidates, place_of, planned_catalogue
from lightopt.design._misalignment import PairAssessment, Setup
from lightopt.design._tolerances import analyse_tolerances
from lightopt.design.postures._light_positions import place_lights
from lightopt.design.postures._posture_search import PostureChoice, PostureRequest, choose_postures
from lightopt.design.responses._image_evaluator import DRAWN_PATCHES, ImageEvaluator, drawn_patches
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.scene import build_catalogue

PARTS = ("cover-knob", "spout")
TILTS = (-40.0, -20.0, 0.0, 20.0, 40.0)
TARGET_S, TARGET_BYTES = 600.0, 3e9


@dataclass(frozen=True)
class Scale:
    """Rotations of the grid, patches, those that are drawn, postures to choose, and a fine step of the lights [°]."""

    rotations: int
    patches: int
    drawn: int
    chosen: int
    fine: float


SCALES = {
    "full": Scale(20, 200_000, DRAWN_PATCHES, 8, 1.0),
    "quick": Scale(4, 20_000, 5_000, 4, 1.0),
    "toy": Scale(1, 600, 200, 2, 15.0),
}


def run(size: Size) -> Report:
    """Plan both sample parts from nothing: patches of all postures, turns of postures and lights, the final cover."""
    scale = SCALES[size.name]
    rows: list[tuple[str, ...]] = []
    trust_rows: list[tuple[str, ...]] = []
    place_rows: list[tuple[str, ...]] = []
    numbers: dict[str, object] = {}
    rig = load_rig(RIG)
    candidates = find_candidates(rig, step_deg=5.0)
    for name in PARTS:
        part = load_part(CONFIGS / "parts" / f"{name}.yaml")
        start, work = time.perf_counter(), time.process_time()
        scene = build_scene(rig, part)
        turns = [360.0 * k / scale.rotations for k in range(scale.rotations)]
        scene = replace(
            scene,
            camera=resized(scene.camera, size.width),
            postures=tuple(Posture(tilt, turn) for tilt in TILTS for turn in turns),
        )
        caster = cast_rays_at(scene)
        table = build_patches(scene, caster=caster, budget=scale.patches, edges=False)
        catalogue = planned_catalogue(build_catalogue(part))
        whole = ImageEvaluator(
            scene=scene,
            table=table,
            caster=caster,
            detection=DetectionModel(
                catalogue=catalogue, sensor=scene.sensor, full_scale=scene.reflectance.full_scale, min_images=2
            ),
            threads=THREADS,
        )
        drawn = replace(whole, table=drawn_patches(table, scale.drawn))
        cut = time.perf_counter() - start
        choice = choose_postures(whole, drawn, scene.lights, candidates, PostureRequest(count=scale.chosen))
        seconds, work = time.perf_counter() - start, time.process_time() - work
        cover = choice.cover
        rows.append(
            (
                name,
                f"{len(scene.postures)} × {len(whole.patches):,} × {len(catalogue.defects)}",
                f"{cut:.0f}",
                f"{seconds:.0f}",
                f"{work:.0f}",
                f"{peak_bytes() / 1e9:.2f}",
                f"{cover.share:.1%}",
                f"{cover.bound_share:.1%}",
                f"{cover.all_covered / cover.total:.1%}",
            )
        )
        placed = placing(whole, choice, scale.fine)
        place_rows += [
            (name, str(k), f"{combinations:,}", f"{len(whole.patches):,}", f"{took:.2f}", f"{used:.2f}")
            for k, (combinations, took, used) in placed.items()
        ]
        start = time.perf_counter()
        keeps, patches = tolerances(drawn, choice)
        trust_seconds = time.perf_counter() - start
        trust_rows.append((name, f"{patches:,}", f"{trust_seconds:.0f}", f"{keeps:.1%}"))
        numbers[name] = {
            "seconds": seconds,
            "processor_seconds": work,
            "patch_seconds": cut,
            "tolerance_seconds": trust_seconds,
            "peak_bytes": peak_bytes(),
            "share": cover.share,
            "bound": cover.bound_share,
            "iterations": choice.iterations,
            "lights_best_for_postures": choice.exact and choice.converged,
            "placing_seconds": {k: took for k, (_, took, _) in placed.items()},
        }
    return Report(
        "plan",
        [
            Table(
                f"{scale.chosen} postures chosen with the lights, {THREADS} threads "
                f"(targets: {TARGET_S:.0f} s, {TARGET_BYTES / 1e9:.0f} GB)",
                (
                    "part",
                    "postures × patches × defects",
                    "patches s",
                    "whole s",
                    "processor s",
                    "GB",
                    "found",
                    "bound",
                    "all",
                ),
                rows,
            ),
            Table(
                f"lights placed for two of the postures at {scale.fine:g}°, every combination, images counted before",
                ("part", "images", "combinations", "patches", "s", "processor s"),
                place_rows,
            ),
            Table(
                "tolerances of the first posture, 2° for lights and 1° for the part",
                ("part", "patches", "s", "worst corner keeps"),
                trust_rows,
            ),
        ],
        numbers,
        [
            "processor s: of all threads, for machines that do other work too; a busy machine makes whole s longer",
            "memory is the most that the process has had so far",
        ],
    )


def placing(whole: ImageEvaluator, choice: PostureChoice, step_deg: float) -> dict[int, tuple[int, float, float]]:
    """Combinations, seconds and processor seconds of placing the lights, by the images that must show a pair."""
    candidates = find_candidates(load_rig(RIG), step_deg=step_deg)
    images = [whole.flags(posture, candidates.panels) for posture in choice.postures[:2]]
    took: dict[int, tuple[int, float, float]] = {}
    detection = whole.detection
    assert detection is not None
    for k in (1, 2):
        needed = replace(whole, detection=replace(detection, min_images=k)).needed
        lights = [
            np.stack([whole.weights.sum_counts(places, needed) for places in zip(*postures, strict=True)])
            for postures in zip(*images, strict=True)
        ]
        start, work = time.perf_counter(), time.process_time()
        found = place_lights(lights, whole.weights, candidates.space, needed=needed, threads=THREADS)
        assert found.exact
        took[k] = (math.prod(candidates.space.sizes), time.perf_counter() - start, time.process_time() - work)
    return took


def tolerances(drawn: ImageEvaluator, choice: PostureChoice) -> tuple[float, int]:
    """What the worst corner keeps of the first posture's score, and the patches that this was computed on."""
    rig = load_rig(RIG)
    setup = Setup(
        rig=rig, postures=choice.postures[:1], places=(tuple(map(place_of, rig.lights)),), exposures=((1.0,),)
    )
    names = [light.name for light in rig.lights]
    assess = PairAssessment(drawn, setup)
    found = analyse_tolerances(assess, names, Tolerances(light_deg=2.0, pose_deg=1.0))
    return found.worst / max(1, found.score), len(drawn.patches)
