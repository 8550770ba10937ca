"""Lights chosen from images: time of the search, its proof, exhaustive search, and samples that were not used.

``python -m benchmarks.from_images [--quick] [--toy]``. First images of several lights, captured on the simulated rig
and synthesised. Then drawn contrasts of 64 and 128 lights. Then an array of 64 LEDs over the cover knob: rendered with
noise, good samples and samples with random defects; lights are chosen with half of the defective samples, and scored
with the other half, against the best choice for these.
"""

from __future__ import annotations

import argparse
import itertools
import math
import re
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks._case import CONFIGS
from benchmarks._report import Table
from benchmarks.loop import run_command
from lightopt import load_rig
from lightopt.core.arrays import Float64
from lightopt.design import FromImagesOptions, optimize_from_images
from lightopt.design.from_images._choice import choose_lights, score
from lightopt.design.from_images._evidence import Evidence
from lightopt.design.from_images._mixture import MixedImages, mix_lights
from lightopt.design.from_images._samples import ChosenImage, compare_captured, read_samples
from lightopt.design.from_images._sensor_noise import ROUNDING
from lightopt.images import read_image_set
from lightopt.rendering import RenderOptions, render_image_set

WAVES = 3  # kinds of variation that the lights of drawn contrasts have in common
LEVEL, PIXELS = 235.0, 2000  # of the highlights of drawn parts; pixels of their surface
SENSOR = (0.7, 1.0 / 60.0)  # variance of the noise: at level 0, and its increase per level
VARIATION = 0.02  # of good parts


@dataclass(frozen=True)
class Size:
    """Drawn contrasts as (lights, images), and the rendered case: pixels, LEDs, good samples, defective ones."""

    drawn: tuple[tuple[int, int], ...]
    width: int
    rows: int
    columns: int
    good: int
    bad: int
    defects: int


FULL = Size(((16, 4), (64, 4), (64, 5), (64, 6), (128, 4), (128, 5)), 320, 8, 8, 5, 4, 14)
QUICK = Size(((16, 4), (64, 4), (128, 4)), 160, 4, 4, 3, 2, 10)
TOY = Size(((8, 2),), 96, 2, 2, 2, 2, 4)


def drawn_evidence(lights: int, defects: int, seed: int) -> Evidence:
    """Contrasts as an array of lights has them: each defect shows under a few neighbours, and parts vary in common.

    Images of single lights are exposed until their highlight saturates nearly. Each has it at another place of the
    part; the rest of the part has 15 % of its level.
    """
    random = np.random.default_rng(seed)
    common = random.normal(size=(lights, WAVES))
    covariance = np.eye(lights) + 0.2 * common @ common.T
    scale = np.sqrt(np.diag(covariance))
    at, width = random.uniform(0, lights, (2 * defects, 1)), random.uniform(0.02, 0.1, (2 * defects, 1)) * lights
    lobes = np.exp(-((np.arange(lights) - at) ** 2) / (2 * width**2)) * random.lognormal(1.2, 0.8, (2 * defects, 1))
    lobes *= random.choice([-1.0, 1.0], (2 * defects, lights)) ** (random.random((2 * defects, lights)) < 0.1)
    places = np.linspace(0, lights, PIXELS)
    surface = LEVEL * (0.15 + 0.85 * np.exp(-((places[:, None] - np.arange(lights)) ** 2) / (2 * (0.05 * lights) ** 2)))
    levels = surface[(at[::2, 0] * (PIXELS - 1) / lights).astype(int)].T
    return Evidence(
        correlation=covariance / np.outer(scale, scale),
        factors=lobes.T,
        starts=np.arange(0, 2 * defects + 1, 2),
        thresholds=np.full(defects, 36.0),
        deviations=np.sqrt(SENSOR[0] + SENSOR[1] * levels + (VARIATION * levels) ** 2),
        levels=levels,
        sensor=SENSOR,
        surface=(surface.astype(np.float32),),
        room=242.0,
        defects=tuple(("drawn", str(j)) for j in range(defects)),
        brightest=np.full(lights, LEVEL),
        noise=np.ones(lights),
        z=6.0,
        shrinkage=0.05,
        good=10,
        surface_contrast=None,
    )


def drawn_table(size: Size) -> Table:
    """Times and proofs of searches in drawn contrasts of 50 defects."""
    rows = []
    choose_lights(drawn_evidence(8, 3, 0), 2)  # compiled
    for lights, images in size.drawn:
        evidence = drawn_evidence(lights, 50, lights)
        start, busy = time.perf_counter(), time.process_time()
        choice = choose_lights(evidence, images)
        searched, worked = time.perf_counter(), time.process_time()
        mixture = mix_lights(MixedImages(evidence), choice.lights)
        mixed, ended = time.perf_counter(), time.process_time()
        gap = choice.bound / choice.score - 1.0
        rows.append(
            (
                f"{images} of {lights}",
                f"{choice.total:,}",
                f"{choice.scored:,}",
                f"{searched - start:.2f}",
                f"{worked - busy:.2f}",
                "proven" if choice.proven else f"≤ {gap:.2%}",
                f"{mixed - searched:.2f}",
                f"{ended - worked:.2f}",
                f"{mixture.score / mixture.single_score - 1.0:+.1%}",
                f"{mixture.bound / mixture.score - 1.0:.1%}",
            )
        )
    header = ("lights", "choices", "scored", "search [s]", "processor [s]", "gap")
    header = (*header, "weights [s]", "processor [s]", "weights gain", "at most more")
    return Table("Drawn contrasts of 50 defects", header, rows)


def exhaustive(evidence: Evidence, images: int) -> float:
    """Greatest score of all choices, in plain NumPy, many at once."""
    best = 0.0
    choices = itertools.combinations(range(evidence.lights), images)
    while block := list(itertools.islice(choices, 50_000)):
        chosen = np.array(block)
        inverse = np.linalg.inv(evidence.correlation[chosen[:, :, None], chosen[:, None, :]])
        total: Float64 = np.zeros(len(chosen))
        for j, threshold in enumerate(evidence.thresholds):
            own = evidence.factors[:, evidence.starts[j] : evidence.starts[j + 1]][chosen]
            x = np.einsum("cab,caq,cbq->c", inverse, own, own) / threshold
            total += 0.9 * np.minimum(1.0, x) + 0.1 * x / (1.0 + x)
        best = max(best, float(total.max()) / len(evidence.thresholds))
    return best


def sample_sets(folder: Path, size: Size) -> tuple[list[Path], list[Path]]:
    """Rendered good and defective samples."""
    text = (CONFIGS / "rigs" / "led-array.yaml").read_text(encoding="utf-8").partition("hardware:")[0]
    text = text.replace("640, 480", f"{size.width}, {size.width * 3 // 4}").replace(
        "pixel_size_um: 11", f"pixel_size_um: {11 * 640 / size.width:g}"
    )
    rig = folder / "rig.yaml"
    rig.write_text(text.replace("rows: 2, columns: 4", f"rows: {size.rows}, columns: {size.columns}"), encoding="utf-8")
    plain = (CONFIGS / "parts" / "cover-knob.yaml").read_text(encoding="utf-8")
    plain = plain.replace("file: cover-knob.step", f"file: {(CONFIGS / 'parts' / 'cover-knob.step').as_posix()}")
    part = folder / "part.yaml"
    part.write_text(re.sub(r"  - \{elevation_deg: 0, rotation_deg: (82|180|278)\}\n", "", plain), encoding="utf-8")
    good, bad = [folder / f"good-{i}" for i in range(size.good)], [folder / f"bad-{i}" for i in range(size.bad)]
    # a light has its share of the light of the array
    exposures = (float(size.rows * size.columns),)
    for seed, target in enumerate(good):
        render_image_set(rig, part, target, options=RenderOptions(noise=seed, exposures=exposures, patch_budget=500))
    for seed, target in enumerate(bad, start=100):
        own = folder / f"part-{seed}.yaml"
        run_command("defects", rig, part, "--seed", seed, "--count", size.defects, "-o", own, "--quiet")
        render_image_set(rig, own, target, options=RenderOptions(noise=seed, exposures=exposures, patch_budget=500))
    return good, bad


def rendered_table(size: Size) -> Table:
    """A choice from rendered samples, against exhaustive search and on samples that it has not seen."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        good, bad = sample_sets(Path(name), size)
        half = len(bad) // 2
        unseen = optimize_from_images([*good, *bad[half:]], options=FromImagesOptions(images=1)).evidence
        for images in (2, 3, 4):
            start, busy = time.perf_counter(), time.process_time()
            result = optimize_from_images([*good, *bad[:half]], options=FromImagesOptions(images=images))
            seconds, worked = time.perf_counter() - start, time.process_time() - busy
            choice = result.choice
            times = [time.perf_counter(), time.process_time()]
            choose_lights(result.evidence, images)
            times += [time.perf_counter(), time.process_time()]
            mixture = mix_lights(MixedImages(result.evidence), choice.lights)
            times += [time.perf_counter(), time.process_time()]
            best = exhaustive(result.evidence, images)
            own = unseen.gains(list(choice.lights))
            rows.append(
                (
                    f"{images} of {unseen.lights}",
                    f"{math.comb(unseen.lights, images):,}",
                    f"{seconds:.2f}",
                    f"{worked:.2f}",
                    *(f"{later - earlier:.2f}" for earlier, later in zip(times, times[2:], strict=False)),
                    f"{choice.score:.4f}",
                    f"{best:.4f}",
                    f"{int((result.gains >= 1.0).sum())} of {len(result.gains)}",
                    f"{int((own >= 1.0).sum())} of {len(own)}",
                    f"{score(own):.4f}",
                    f"{choose_lights(unseen, images).score:.4f}",
                    f"{mixture.score:.4f} ({mixture.score / mixture.single_score - 1.0:+.1%})",
                    f"{mixture.bound:.4f}",
                )
            )
    header = ("lights", "choices", "all [s]", "processor [s]", "search [s]", "processor [s]", "weights [s]")
    header = (*header, "processor [s]", "score", "exhaustive", "found", "found unseen", "score unseen", "best unseen")
    header = (*header, "several lights", "at most")
    return Table(f"Rendered samples, {size.good} good, {size.bad} with {size.defects} defects each", header, rows)


PROGRAMME = """
programme:
  - {name: three, lights: {ring-1: 1, ring-2: 0.5, ring-4: 0.75}, exposures: [0.4]}
  - {name: all-on, lights: {ring-1: 1, ring-2: 1, ring-3: 1, ring-4: 1}, exposures: [0.25]}
"""
# read noise, electrons per level, frames per image
SENSORS = {"as filed": (0.8, 60.0, 1), "as filed, mean of 4 frames": (0.8, 60.0, 4), "hardly any noise": (0.1, 1e6, 1)}


def captured_table(size: Size) -> Table:
    """Images of several lights against those synthesised from single ones, all captured on the simulated rig."""
    rows = []
    text = (CONFIGS / "rigs" / "ring-quadrants.yaml").read_text(encoding="utf-8")
    text = text.replace("640, 480", f"{2 * size.width}, {2 * size.width * 3 // 4}")
    text = text.replace("pixel_size_um: 11", f"pixel_size_um: {11 * 320 / size.width:g}")
    part = CONFIGS / "parts" / "cover-knob.yaml"
    for name, (read, electrons, frames) in SENSORS.items():
        sensor = f"black_level: 12, read_noise_levels: {read:g}, electrons_per_level: {electrons:g}"
        own = re.sub(r"black_level: 0, read_noise_levels: 0.8, electrons_per_level: 60", sensor, text)
        with tempfile.TemporaryDirectory() as folder:
            single, several = Path(folder) / "single.yaml", Path(folder) / "several.yaml"
            single.write_text(own, encoding="utf-8")
            several.write_text(own + PROGRAMME, encoding="utf-8")
            sets = [rig.with_suffix("") for rig in (single, several)]
            for rig, target in zip((single, several), sets, strict=True):
                run_command("capture", rig, part, "-o", target, "--posture", "0,0", "--average", str(frames), "--quiet")
            images = [
                ChosenImage(name=image.name, weights=dict(image.lights), exposure=(image.exposures or (1.0,))[0])
                for image in load_rig(several).programme or ()
            ]
            rounding = ROUNDING / frames + (ROUNDING if frames > 1 else 0.0)  # of each frame, and of their mean
            variance = read**2 / frames + rounding, 1.0 / electrons / frames
            _, found = compare_captured(read_samples([sets[0]]), images, read_image_set(sets[1]), variance)
        for one in found:
            beyond = math.sqrt(max(0.0, one.rms**2 - one.noise**2))
            values = (one.rms, one.noise, beyond, one.means_rms, one.noise / 5.0)
            rows.append((f"{name}, {one.image}", f"{one.pixels:,}", *(f"{value:.2f}" for value in values)))
    header = ("sensor, image", "pixels", "rms [levels]", "of noise alone", "beyond", "rms of means", "of noise alone")
    return Table("Images of several lights: captured against synthesised", header, rows)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.from_images", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer lights and samples")
    parser.add_argument("--toy", action="store_true", help="a tiny case: does it run at all")
    options = parser.parse_args()
    size = TOY if options.toy else QUICK if options.quick else FULL
    for measure in (captured_table, drawn_table, rendered_table):
        print(measure(size).text(), flush=True)


if __name__ == "__main__":
    main()
