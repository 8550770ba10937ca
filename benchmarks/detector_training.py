"""A small detector trained on a dataset of lightopt, the same one trained on pasted noise, and ``inspect``.

``python -m benchmarks.detector_training [--parts cover-knob spout] [--samples 240] [--pieces 10] [--width 400]
[--page]``. Needs ``scikit-learn``, which is no dependency of lightopt.

The detector is gradient boosting on features of each pixel: deviations from the mean of good pieces, in its standard
deviations, and local contrast, both at three widths and under each light, the light that deviates most first. Both
kinds of training have the good images of the dataset. One has its defective images, with defects that are marked as
invisible left out; the other has as many good images into which patches of noise are pasted.

The test is on pieces that ``lightopt render`` makes with nine rays in each pixel, other seeds, other defects and other
places on the stage. Both detectors are compared at thresholds with no false alarm on good pieces, and with one on each.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks._case import write_records
from benchmarks.inspection import ROOT, replace_block
from benchmarks.loop import files
from lightopt import load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.dataset import DatasetOptions, make_dataset
from lightopt.dataset._formats import pixels_of
from lightopt.images import ImageSet, read_image_set, read_png
from lightopt.inspection import (
    InspectOptions,
    PredictionCache,
    evaluate_set,
    inspect_set,
    place_random_defects,
    random_defect_provenance,
    random_defects_text,
)
from lightopt.inspection.evaluation._evaluation import area_under_roc, region_hits
from lightopt.rendering import RenderOptions, render_image_set

Array = NDArray[Any]

WIDTHS_PX = (0.0, 1.0, 2.5)
CONTRASTS_PX = ((0.7, 3.0), (1.5, 6.0), (3.0, 12.0))
OTHERS = 6  # pixels without a defect for each pixel with one
LEAST_SPREAD = 1.0  # of good pieces [level]
SHIFT_MM, TURN_DEG = 0.2, 0.5  # by which pieces of the test are off their place, as those of the dataset


@dataclass(frozen=True)
class Row:
    """A way to find defects, on the pieces of a test."""

    part: str
    trained_on: str
    found: int
    placed: int
    false_alarms: int
    good: int
    auc: float


@dataclass(frozen=True)
class Piece:
    """Images of a piece, shape (lights, H, W), its labels, −1 where no defect is, and whether pixels show it."""

    images: Array
    labels: Array
    part: Array
    set: ImageSet


@dataclass(frozen=True)
class Golden:
    """Mean and standard deviation of good pieces, shape (lights, H, W)."""

    mean: Array
    spread: Array

    @staticmethod
    def of(good: list[Array]) -> Golden:
        stack = np.stack(good)
        spread = np.maximum(stack.std(axis=0), LEAST_SPREAD)
        return Golden(stack.mean(axis=0), ndimage.maximum_filter(spread, (1, 3, 3)))

    def features(self, images: Array) -> Array:
        """Of each pixel, shape (H, W, features)."""
        off = (images - self.mean) / self.spread
        found = [off if width == 0.0 else ndimage.gaussian_filter(off, (0, width, width)) for width in WIDTHS_PX]
        noise = np.sqrt(1.0 + np.maximum(images, 0.0) / 60.0)
        for narrow, wide in CONTRASTS_PX:
            local = [ndimage.gaussian_filter(images, (0, width, width)) for width in (narrow, wide)]
            found.append((local[0] - local[1]) / noise)
        found.append(np.log(self.spread))
        stacked = np.stack(found, axis=-1).astype(np.float32)  # (lights, H, W, features)
        order = np.argsort(-np.abs(stacked[..., 1]), axis=0)
        stacked = np.take_along_axis(stacked, order[..., None], axis=0)
        return np.moveaxis(stacked, 0, -2).reshape(*images.shape[1:], -1)


def read_samples(folder: Path, lights: list[str]) -> Iterator[tuple[dict[str, str], Array, Array]]:
    """Rows of the dataset's table, images, and labels: 1 of a visible defect, −1 of an invisible one, 0 elsewhere."""
    known = {
        sample["sample"]: sample
        for path in sorted((folder / "poses").glob("*.json"))
        for sample in json.loads(path.read_text(encoding="utf-8"))["samples"]
    }
    for row in csv.DictReader((folder / "samples.csv").read_text(encoding="utf-8").splitlines()):
        images = np.stack([read_png(folder / row[light]) for light in lights]).astype(np.float64)
        labels = np.zeros(images.shape[1:], np.int8)
        for defect in known[int(row["sample"])]["defects"]:
            labels.reshape(-1)[pixels_of(defect["mask"])] = 1 if defect["visibility"]["stack"]["visible"] else -1
        yield row, images, labels


def paste_noise(images: Array, part: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Patches of noise on the images of a good piece, and where they are."""
    images, labels = images.copy(), np.zeros(images.shape[1:], np.int8)
    places = np.argwhere(part)
    y, x = np.mgrid[: part.shape[0], : part.shape[1]]
    for _ in range(int(rng.integers(1, 3))):
        row, column = places[rng.integers(len(places))]
        length, width = np.exp(rng.uniform(np.log(2.0), np.log(30.0), 2))
        turn = rng.uniform(0.0, np.pi)
        along = np.cos(turn) * (x - column) + np.sin(turn) * (y - row)
        across = np.cos(turn) * (y - row) - np.sin(turn) * (x - column)
        inside = (np.hypot(along / length, across / width) < 0.5) & part
        grain = rng.uniform(0.5, 3.0)
        noise = ndimage.gaussian_filter(rng.standard_normal(images.shape), (0, grain, grain))
        noise *= np.exp(rng.uniform(np.log(3.0), np.log(60.0))) / noise.std()
        images += noise * inside
        labels[inside] = 1
    return np.clip(np.rint(images), 0.0, 255.0), labels


def train(golden: Golden, samples: list[tuple[Array, Array]], part: Array, seed: int) -> Any:
    """Gradient boosting on pixels of images with labels."""
    from sklearn.ensemble import HistGradientBoostingClassifier

    rng = np.random.default_rng(seed)
    pixels, truth = [], []
    for images, labels in samples:
        features = golden.features(images)
        bad, good = np.argwhere(labels == 1), np.argwhere((labels == 0) & part)
        good = good[rng.choice(len(good), min(len(good), OTHERS * len(bad) + 400), replace=False)]
        for places, value in ((bad, 1), (good, 0)):
            pixels.append(features[places[:, 0], places[:, 1]])
            truth.append(np.full(len(places), value))
    classifier = HistGradientBoostingClassifier(max_iter=200, random_state=seed)
    return classifier.fit(np.concatenate(pixels), np.concatenate(truth))


def score(golden: Golden, classifier: Any, piece: Piece) -> Array:
    """Log odds of a defect in each pixel of a piece, smoothed."""
    features = golden.features(piece.images)
    result = np.full(piece.part.shape, -20.0)
    result[piece.part] = classifier.decision_function(features[piece.part])
    return ndimage.gaussian_filter(result, 0.7)


def render_piece(rig: RigConfig, part: PartConfig, folder: Path, seed: int, defects: int) -> Piece:
    """A piece by ``lightopt render``, with so many random defects, off its place."""
    rng = np.random.default_rng([7, seed])
    text = part.source.text
    if defects:
        placed = place_random_defects(rig, part, count=defects, seed=seed)
        made_from = random_defect_provenance(rig, part, count=defects, seed=seed)
        text = random_defects_text(part, placed, folder=part.source.path.parent, comment="", made_from=made_from)
    x, y, turn = rng.uniform(-1.0, 1.0, 3) * (SHIFT_MM, SHIFT_MM, TURN_DEG)
    place = f"{{anchor: rest_on_table, translate_mm: [{x:.4f}, {y:.4f}, 0], rotate_deg: [0, 0, {turn:.4f}]}}"
    text, count = re.subn(r"placement:.*?\n(?=\S)", f"placement: {place}\n", text, flags=re.DOTALL)
    assert count == 1
    file = part.source.path.with_name(f"piece-{seed}.yaml")
    file.write_text(text, encoding="utf-8")
    options = RenderOptions(noise=seed, supersample=3, patch_budget=500)
    render_image_set(rig, load_part(file), folder, options=options)
    found = read_image_set(folder)
    images = np.stack([read_png(folder / str(entry.png)) for entry in found.images]).astype(np.float64)
    geometry = found.load_geometry(found.geometry[0])
    shape = images.shape[1:]
    labels = geometry["defect"].astype(np.int32) if defects else np.full(shape, -1, np.int32)
    return Piece(images, labels, np.hypot(geometry["N.X"], geometry["N.Z"]) > 0.0, found)


def compare(folder: Path, name: str, given: argparse.Namespace) -> Iterator[Row]:
    """Rows of one part."""
    rig_file, part_file = files(folder, name, width=given.width)
    rig, part = load_rig(rig_file), load_part(part_file)
    lights = [light.name for light in rig.lights]
    out = folder / f"{name}-dataset"
    make_dataset(rig, part, out, options=DatasetOptions(images=given.samples, seed=1, fusion=None))
    every = list(read_samples(out, lights))
    good = [images for _, images, labels in every if not labels.any()]
    bad = [(images, labels) for _, images, labels in every if labels.any()]
    golden = Golden.of(good)
    part_pixels = golden.mean.max(axis=0) > 2.0
    rng = np.random.default_rng(3)
    pasted = [paste_noise(good[i % len(good)], part_pixels, rng) for i in range(len(bad))]
    plain = [(images, np.zeros(part_pixels.shape, np.int8)) for images in good]
    pieces = [render_piece(rig, part, folder / f"{name}-bad-{i}", 500 + i, given.defects) for i in range(given.pieces)]
    goods = [render_piece(rig, part, folder / f"{name}-good-{i}", 900 + i, 0) for i in range(2 * given.pieces)]
    for trained_on, samples in (("dataset", bad), ("pasted noise", pasted)):
        classifier = train(golden, [*samples, *plain], part_pixels, 5)
        of_pieces, of_goods = ([score(golden, classifier, one) for one in some] for some in (pieces, goods))
        pairs = list(zip(pieces, of_pieces, strict=True))
        areas = [area_under_roc(own[one.part], one.labels[one.part] >= 0) for one, own in pairs]
        for allowed in (0, len(goods)):
            limit, alarms = least_limit(of_goods, allowed)
            hits = [region_hits(regions(own > limit), one.labels) for one, own in pairs]
            found = sum(len({int(i) for hit in some for i in hit}) for some in hits)
            row = Row(name, trained_on, found, given.pieces * given.defects, alarms, len(goods), float(np.mean(areas)))
            print(row, flush=True)
            yield row
    cache, options = PredictionCache(), InspectOptions(fusion=None)
    judged, others = [
        [evaluate_set(one.set, inspect_set(rig, part, one.set, options=options, cache=cache), known=()) for one in some]
        for some in (pieces, goods)
    ]
    found = sum(d.found for one in judged for d in one.defects)
    alarms = sum(one.false_alarms for one in others)
    area = float(np.mean([area for one in judged for area in one.areas]))
    yield Row(name, "nothing: inspect", found, given.pieces * given.defects, alarms, len(goods), area)


def least_limit(scores: list[Array], allowed: int) -> tuple[float, int]:
    """The least threshold with so many false alarms at most on good pieces, of 200, and their number."""
    top = max(float(one.max()) for one in scores) + 1e-6
    best, alarms = top, 0
    # from above: far below, all of a piece is one region
    for limit in np.linspace(top, top - 15.0, 200).tolist():
        count = sum(int(regions(one > limit).max()) for one in scores)
        if count > allowed:
            break
        best, alarms = limit, count
    return best, alarms


def regions(mask: Array) -> NDArray[np.int32]:
    """Numbers of the regions of a mask, from 1."""
    return np.asarray(ndimage.label(mask, np.ones((3, 3)))[0], np.int32)


def table(rows: list[Row]) -> str:
    lines = ["| part | trained on | defects found | false alarms on good pieces | ROC area |", "|---|---|---|---|---|"]
    for row in rows:
        numbers = f"{row.found} of {row.placed} | {row.false_alarms} on {row.good} | {row.auc:.3f}"
        lines.append(f"| {row.part} | {row.trained_on} | {numbers} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--parts", nargs="+", default=["cover-knob", "spout"])
    parser.add_argument("--samples", type=int, default=240, help="of the dataset")
    parser.add_argument("--pieces", type=int, default=10, help="with defects; good ones are twice as many")
    parser.add_argument("--defects", type=int, default=8, help="of each piece")
    parser.add_argument("--width", type=int, default=400)
    parser.add_argument("--page", action="store_true", help="put the table into the page")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [row for name in given.parts for row in compare(Path(folder), name, given)]
    write_records(ROOT / "out" / "benchmarks" / "detector-training.csv", rows)
    print(text := table(rows))
    if given.page:
        replace_block("detector-training", text)


if __name__ == "__main__":
    main()
