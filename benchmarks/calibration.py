"""False alarms on good parts that a calibration has not seen; writes a table of docs/validation/inspection.md.

``python -m benchmarks.calibration`` renders good parts with a lobe 1 % wider than the part's file says, up to 0.5 mm
and 0.5° off their place, with noise and saturation. Half of them calibrate, the others are held against what those
taught. The inspection is assumed where each part lies, but for a hundredth of a pixel: the search for the part, which
leaves less than that (``benchmarks.inspection`` does it), would take nearly all of the time.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.inspection import FIRST, FULL, Size, prepare, replace_block
from lightopt import load_part
from lightopt.estimate.registration import Observation, Placement, place_part
from lightopt.inspection import InspectOptions, PostureView, least_rate, predict
from lightopt.inspection.calibration._calibrate import calibrate_registered
from lightopt.inspection.calibration._calibration import CalibratedPosture, sets_needed
from lightopt.inspection.calibration._systematic import subtract_systematic
from lightopt.inspection.detection._deviation import Deviations, deviations
from lightopt.inspection.detection._regions import find_regions
from lightopt.inspection.detection._registry import DETECTORS
from lightopt.inspection.detection._residual_score import threshold
from lightopt.inspection.evaluation._evaluation import region_hits
from lightopt.inspection.fusion._synthetic_image import synthetic_image
from lightopt.inspection.prediction._posture_view import posture_view
from lightopt.inspection.prediction._registered_set import RegisteredSet, nominal_pixels
from lightopt.optics import expose, image_rng, saturated
from lightopt.rendering import PostureImages, cast_rays_at, render_posture
from lightopt.scene import Scene, build_scene

RATE = 0.1
SMALL = replace(FULL, width=160, fine=False, across=(3, 8), widths=())
TOY = replace(SMALL, parts=FULL.parts[:1])

FARTHEST_MM, FARTHEST_RAD = 0.5, math.radians(0.5)
MISPLACED_PX = 0.01
"""Error of the place that the inspection is assumed: normal, of this standard deviation."""

WIDER_LOBE = 1.01


def strewn(folder: Path, part: Path, rig: Path, size: Size) -> Path:
    """The part with its catalogue strewn over it."""
    from lightopt.cli._main import run

    out = folder / "strewn.yaml"
    command = ["defects", rig, part, "--seed", 1, "--count", size.defects, "-o", out, "-q"]
    assert run([str(word) for word in command]) == 0
    return out


def taken(scene: Scene, images: PostureImages, seed: int) -> list[Observation]:
    """What the camera makes of the images."""
    sensor = scene.sensor
    found: list[Observation] = []
    for index, image in enumerate(images.lights):
        rng = image_rng(seed, light=index, posture=0, exposure=0)
        levels = expose(image.level, sensor=sensor, exposure=1.0, full_scale=scene.reflectance.full_scale, rng=rng)
        found.append(
            Observation(
                light=image.light,
                posture=FIRST,
                exposure=1.0,
                levels=levels.astype(np.float32),
                saturated=saturated(levels, sensor=sensor),
                half_width=0.5,
                source=Path(f"{seed}.png"),
            )
        )
    return found


def view_of(true: Scene, model: Scene, lies: Placement, seed: int, pixel_mm: float) -> tuple[PostureView, Placement]:
    """Noisy images of the true part where it lies, registered with the model about there."""
    placed = place_part(true, lies)
    images = render_posture(placed, FIRST, caster=cast_rays_at(placed))
    rng = np.random.default_rng([7, seed])
    off = MISPLACED_PX * pixel_mm * rng.standard_normal(3)
    assumed = Placement(x=lies.x + off[0], y=lies.y + off[1], turn=lies.turn + off[2] / 20.0)
    scene = place_part(model, assumed)
    lights = [light.name for light in scene.lights]
    prediction = predict(scene, FIRST, cast_rays_at(scene), lights=lights)
    return posture_view(scene, taken(scene, images, seed), prediction, where=f"set {seed}"), assumed


def try_part(task: tuple[str, int, Size, float]) -> list[str]:
    """Rows of the table: one part, so many good sets to learn from and as many to hold against that."""
    name, half, size, rate = task
    with tempfile.TemporaryDirectory(prefix="lightopt-calibration-") as place:
        folder = Path(place)
        rig, path = prepare(folder, name, size)
        bad = strewn(folder, path, rig.source.path, size)
        model = build_scene(rig, load_part(path), postures=(FIRST,), defects=False)
        true = build_scene(rig, load_part(bad), postures=(FIRST,))
    lobe = replace(true.reflectance, sigma=WIDER_LOBE * true.reflectance.sigma)
    true = replace(true, reflectance=lobe)
    good = replace(true, defects=())
    rng = np.random.default_rng([1, len(name)])
    far = np.array([FARTHEST_MM, FARTHEST_MM, FARTHEST_RAD])
    sets: list[tuple[PostureView, Placement]] = []
    for seed in range(2 * half):
        x, y, turn = (float(v) for v in rng.uniform(-far, far))
        sets.append(view_of(good, model, Placement(x=x, y=y, turn=turn), seed, size.pixel_mm))
        print(f"{name}: {seed + 1} of {2 * half} good sets", flush=True)
    marked = view_of(true, model, Placement(), 2 * half, size.pixel_mm)
    labels = render_posture(true, FIRST, caster=cast_rays_at(true)).geometry.defect
    assert labels is not None
    rows: list[str] = []
    for detector in (name for name, one in DETECTORS.items() if not one.uses_catalogue):
        options = InspectOptions(
            detector=detector, fusion="paper" if detector == "template" else None, false_alarms=rate
        )
        shots = dict.fromkeys(sets[0][0].lights, ((1.0, 1),))
        registered = (
            (str(i), RegisteredSet(model, assumed, model, iter([(view, shots)])))
            for i, (view, assumed) in enumerate(sets[:half])
        )
        names = [str(i) for i in range(half)]
        learned = calibrate_registered(registered, names, options=options, fingerprint={}).postures[0]
        cells: list[str] = []
        for taught in (None, learned):
            alarms = [len_of(regions_of(one, model, options, taught)) for one in sets[half:]]
            hits = region_hits(regions_of(marked, model, options, taught), labels)
            found = {int(index) for touched in hits for index in touched}
            cells += [f"{sum(map(bool, alarms))} of {half} ({sum(alarms)})", f"{len(found)} of {size.defects}"]
        rows.append(f"| {name} | {detector} | {' | '.join(cells)} |")
    return rows


def regions_of(
    one: tuple[PostureView, Placement], model: Scene, options: InspectOptions, taught: CalibratedPosture | None
) -> np.ndarray:
    """Number of the region of each pixel."""
    view, assumed = one
    found: Deviations = deviations(view)
    if taught is not None and taught.systematic is not None:
        found = subtract_systematic(found, taught.systematic, nominal_pixels(view, model, assumed))
    make_synthetic = None if options.fusion is None else partial(synthetic_image, view, options.fusion, probes=0)
    detector = DETECTORS[options.detector]
    score = detector.score(found, options.min_images, make_synthetic, (), None).score
    noise = threshold(options.false_alarms, int(view.clean.sum()), detector.tests)
    high = noise if taught is None else taught.threshold(options.false_alarms)
    return find_regions(score, high)[0]


def len_of(labels: np.ndarray) -> int:
    """How many regions there are."""
    return int(labels.max(initial=0))


def table(rows: Sequence[str]) -> str:
    """All parts and detectors."""
    columns = ("good sets with false alarms (regions)", "found")
    head = ["", "detector", *columns, *(f"calibrated: {column}" for column in columns)]
    return "\n".join([f"| {' | '.join(head)} |", "|---" * len(head) + "|", *rows])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=RATE, help="of false alarms, to be held")
    parser.add_argument("--sets", type=int, help="good sets that calibrate a part; as many as the rate takes")
    parser.add_argument("--workers", type=int, default=2, help="parts that are worked on at once")
    parser.add_argument("--no-page", action="store_true", help="print the table only")
    parser.add_argument("--toy", action="store_true", help="one part; prints the table only")
    given = parser.parse_args(arguments)
    size = TOY if given.toy else SMALL
    sets = given.sets or sets_needed(given.rate)
    if least_rate(sets) > given.rate:
        parser.error(f"--sets: {given.rate:g} takes {sets_needed(given.rate)} good sets")
    tasks = [(part, sets, size, given.rate) for part in size.parts]
    # not forked: a copy of a process whose threads hold locks waits for ever
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        rows = [row for rows in pool.map(try_part, tasks) for row in rows]
    print(table(rows))
    if not given.no_page and not given.toy:
        replace_block("calibration", table(rows))


if __name__ == "__main__":
    main()
