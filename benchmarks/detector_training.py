"""A small detector trained on datasets of lightopt, the same one trained on pasted noise, and ``inspect``.

``python -m benchmarks.detector_training [--parts cover-knob spout] [--samples 160] [--defects 3 6] [--seeds 1 2 3 4 5]
[--pieces 30] [--goods 40] [--width 320] [--page]``. Needs ``scikit-learn``, which is no dependency of lightopt.

The detector is gradient boosting on features of each pixel under each light, the light that deviates most first:
deviations from the mean of good pieces, in its standard deviations and in those of the noise, at several widths; their
extremes nearby; their slopes and curvatures; and local contrast. Both kinds of training have the good images of the
dataset. One has its defective images, with defects that are marked as invisible left out; the other has as many good
images into which as many patches of noise are pasted. Each training is repeated with datasets of other seeds.

The test is on pieces that ``lightopt render`` makes with nine rays in each pixel, other seeds, other defects and other
places on the stage. All detectors have the same pieces, and are compared at thresholds with equal rates of false alarms
on good pieces. The interval of a difference is that of a bootstrap which draws trainings, defective pieces and good
pieces anew, each independently of the others (Owen, doi:10.1214/07-AOAS122), and sets the thresholds anew.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
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
from lightopt.config import PartConfig, RangesConfig, RigConfig, load_ranges
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
from lightopt.scene import build_catalogue

Array = NDArray[Any]

WIDTHS_PX = (0.0, 1.0, 2.5, 5.0)
CONTRASTS_PX = ((0.7, 3.0), (1.5, 6.0), (3.0, 12.0))
NEAR_PX = (5, 11)  # sides of the squares whose extremes count
CURVED_PX = (1.2, 2.5)  # widths at which slope and curvature are taken
OTHERS = 6  # pixels without a defect for each pixel with one
LEAST_SPREAD = 1.0  # of good pieces [level]
SHIFT_MM, TURN_DEG = 0.2, 0.5  # by which pieces of the test are off their place, as those of the dataset
RATES = (0.1, 1.0)  # of false alarms on each good piece, at which detectors are compared
STEP = 0.1  # between thresholds [log odds]
DATASET, PASTED, INSPECT = "dataset", "pasted noise", "nothing: inspect"
DRAWS = 4000  # of the bootstrap


@dataclass(frozen=True)
class Row:
    """How many defects of a kind are found on the pieces of a test, at a rate of false alarms."""

    part: str
    trained_on: str
    training: int  # number of the training
    rate: float  # that is allowed; of inspect the one that it is set for
    kind: str
    found: int
    placed: int
    false_alarms: int
    good: int


@dataclass(frozen=True)
class Curve:
    """What a detector finds at each threshold, the greatest first.

    alarms: on good pieces, shape (thresholds, good pieces)
    found: defects, shape (thresholds, pieces, kinds)
    areas: below the ROC of pixels, shape (pieces,)
    """

    alarms: Array
    found: Array
    areas: Array

    def least(self, rate: float, goods: Array) -> int:
        """The last threshold before more false alarms than so many on each of the good pieces named.

        That of ``inspect`` is its own.
        """
        if len(self.alarms) == 1:
            return 0
        over = self.alarms[:, goods].mean(axis=1) > rate
        return int(over.argmax()) - 1 if over.any() else len(over) - 1


@dataclass(frozen=True)
class Study:
    """All detectors on the pieces of one part."""

    part: str
    kinds: list[str]
    placed: Array  # shape (pieces, kinds)
    goods: int
    curves: dict[str, list[Curve]]  # of each training, by seed; inspect has one of one threshold

    def shares(self, rate: float, draw: tuple[Array, Array, Array]) -> dict[str, tuple[float, float]]:
        """Share of defects found, and ROC area, by training; `draw`: trainings, pieces and good pieces that count."""
        seeds, pieces, goods = draw
        placed, shares = self.placed[pieces].sum(), dict[str, tuple[float, float]]()
        for name, curves in self.curves.items():
            some = [curves[i] for i in seeds] if len(curves) > 1 else curves
            found = [one.found[one.least(rate, goods)][pieces].sum() / placed for one in some]
            areas = [one.areas[pieces].mean() for one in some]
            shares[name] = float(np.mean(found)), float(np.mean(areas))
        return shares

    @property
    def sizes(self) -> tuple[int, int, int]:
        return len(self.curves[DATASET]), len(self.placed), self.goods

    def differences(self, rate: float, other: str) -> Array:
        """Dataset less the other, of shares found and ROC areas: value and 95 % interval, shape (2, 3)."""
        rng = np.random.default_rng(11)
        seeds, pieces, goods = self.sizes
        shares = [self.shares(rate, (np.arange(seeds), np.arange(pieces), np.arange(goods)))]
        for _ in range(DRAWS):
            draw = rng.integers(0, seeds, seeds), rng.integers(0, pieces, pieces), rng.integers(0, goods, goods)
            shares.append(self.shares(rate, draw))
        off = np.array([np.subtract(one[DATASET], one[other]) for one in shares])
        return np.column_stack([off[0], *np.quantile(off[1:], (0.025, 0.975), axis=0)])

    def rows(self) -> Iterator[Row]:
        every = np.arange(self.goods)
        for name, curves in self.curves.items():
            for seed, curve in enumerate(curves, start=1):
                for rate in [InspectOptions().false_alarms] if name == INSPECT else RATES:
                    limit = curve.least(rate, every)
                    alarms, found = int(curve.alarms[limit].sum()), curve.found[limit].sum(axis=0)
                    for i, kind in enumerate(self.kinds):
                        placed = int(self.placed[:, i].sum())
                        yield Row(
                            self.part, name, seed, rate, kind, int(found[i]), placed, alarms, curve.alarms.shape[1]
                        )


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
        noise, off = np.sqrt(1.0 + np.maximum(images, 0.0) / 60.0), (images - self.mean) / self.spread
        wide = [off if width == 0.0 else _smooth(off, width) for width in WIDTHS_PX]
        found = [*wide, *(((_smooth(images, a) - _smooth(images, b)) / noise) for a, b in CONTRASTS_PX)]
        for side in NEAR_PX:
            found += [
                ndimage.maximum_filter(wide[1], (1, side, side)),
                ndimage.minimum_filter(wide[1], (1, side, side)),
            ]
        change, spread = (images - self.mean) / noise, np.log(self.spread)
        found += [_smooth(change, 0.8), spread, ndimage.maximum_filter(spread, (1, 9, 9))]
        for width in CURVED_PX:
            right, down, xx, xy, yy = (
                _smooth(change, width, order) for order in ((0, 1), (1, 0), (0, 2), (1, 1), (2, 0))
            )
            mean, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
            found += [width * np.hypot(right, down), width**2 * (mean + half), width**2 * (mean - half)]
        stacked = np.stack(found, axis=-1).astype(np.float32)  # (lights, H, W, features)
        order = np.argsort(-np.abs(stacked[..., 1]), axis=0)
        stacked = np.take_along_axis(stacked, order[..., None], axis=0)
        return np.moveaxis(stacked, 0, -2).reshape(*images.shape[1:], -1)


def _smooth(images: Array, width: float, order: tuple[int, int] = (0, 0)) -> Array:
    return ndimage.gaussian_filter(images, (0, width, width), (0, *order))


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


def paste_noise(images: Array, part: Array, rng: np.random.Generator, number: tuple[int, int]) -> tuple[Array, Array]:
    """Patches of noise on the images of a good piece, from the least to the most number, and where they are."""
    images, labels = images.copy(), np.zeros(images.shape[1:], np.int8)
    places = np.argwhere(part)
    y, x = np.mgrid[: part.shape[0], : part.shape[1]]
    for _ in range(int(rng.integers(*number, endpoint=True))):
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


def training_pixels(golden: Golden, samples: list[tuple[Array, Array]], part: Array, seed: int) -> tuple[Array, Array]:
    """Features and labels of some pixels of images: all of defects, and more of the good ones."""
    rng = np.random.default_rng(seed)
    pixels, truth = [], []
    for images, labels in samples:
        features = golden.features(images)
        bad, good = np.argwhere(labels == 1), np.argwhere((labels == 0) & part)
        good = good[rng.choice(len(good), min(len(good), OTHERS * len(bad) + 400), replace=False)]
        for places, value in ((bad, 1), (good, 0)):
            pixels.append(features[places[:, 0], places[:, 1]])
            truth.append(np.full(len(places), value))
    return np.concatenate(pixels), np.concatenate(truth)


def train(some: tuple[Array, Array], more: tuple[Array, Array], seed: int) -> Any:
    """Gradient boosting on features and labels of pixels."""
    from sklearn.ensemble import HistGradientBoostingClassifier

    features, labels = (np.concatenate(pair) for pair in zip(some, more, strict=True))
    return HistGradientBoostingClassifier(max_iter=200, random_state=seed).fit(features, labels)


def scores(golden: Golden, classifiers: list[Any], piece: Piece) -> list[Array]:
    """Log odds of a defect in each pixel of a piece, smoothed, by each classifier."""
    features = golden.features(piece.images)[piece.part]
    found = []
    for classifier in classifiers:
        result = np.full(piece.part.shape, -20.0)
        result[piece.part] = classifier.decision_function(features)
        found.append(ndimage.gaussian_filter(result, 0.7))
    return found


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


def curves_of(
    folder: Path, setup: tuple[RigConfig, PartConfig, RangesConfig], options: DatasetOptions, test: Test
) -> list[Curve]:
    """What the detector finds that is trained on a dataset, and the one that is trained on pasted noise."""
    (rig, part, ranges), seed = setup, options.seed
    make_dataset(rig, part, folder, options=options, ranges=ranges)
    every = list(read_samples(folder, [light.name for light in rig.lights]))
    good = [images for _, images, labels in every if not labels.any()]
    bad = [(images, labels) for _, images, labels in every if labels.any()]
    golden = Golden.of(good)
    shown = golden.mean.max(axis=0) > 2.0
    rng = np.random.default_rng([3, seed])
    pasted = [paste_noise(good[i % len(good)], shown, rng, ranges.defects) for i in range(len(bad))]
    plain = training_pixels(golden, [(images, np.zeros(shown.shape, np.int8)) for images in good], shown, seed)
    classifiers = [train(training_pixels(golden, some, shown, seed), plain, seed) for some in (bad, pasted)]
    pieces, goods = (
        zip(*(scores(golden, classifiers, one) for one in some), strict=True) for some in (test.pieces, test.goods)
    )
    return [curve(own, good_ones, test) for own, good_ones in zip(pieces, goods, strict=True)]


@dataclass(frozen=True)
class Test:
    """Pieces with defects, one of each kind in order again and again, and good pieces."""

    pieces: list[Piece]
    goods: list[Piece]
    kinds: int

    def by_kind(self, defects: Iterable[int]) -> Array:
        """Numbers of the defects of each kind."""
        return np.bincount([number % self.kinds for number in defects], minlength=self.kinds)


def curve(of_pieces: Sequence[Array], of_goods: Sequence[Array], test: Test) -> Curve:
    """Counts at falling thresholds, from no false alarm to more than are compared."""
    alarms, found, limit = list[Array](), list[Array](), max(float(one.max()) for one in of_goods) + 1e-6
    # far below, all of a piece is one region
    while not alarms or (alarms[-1].mean() <= 2.0 * max(RATES) and len(alarms) < 300):
        alarms.append(np.array([regions(one > limit).max() for one in of_goods]))
        hits = [region_hits(regions(own > limit), one.labels) for one, own in zip(test.pieces, of_pieces, strict=True)]
        found.append(np.stack([test.by_kind({int(i) for hit in some for i in hit}) for some in hits]))
        limit -= STEP
    areas = [
        area_under_roc(own[one.part], one.labels[one.part] >= 0)
        for one, own in zip(test.pieces, of_pieces, strict=True)
    ]
    return Curve(np.stack(alarms), np.stack(found), np.array(areas))


def inspected(rig: RigConfig, part: PartConfig, test: Test, goods: int) -> Curve:
    """What ``inspect`` finds, with so many of the good pieces."""
    cache, options = PredictionCache(), InspectOptions(fusion=None)
    judged, others = [
        [evaluate_set(one.set, inspect_set(rig, part, one.set, options=options, cache=cache), known=()) for one in some]
        for some in (test.pieces, test.goods[:goods])
    ]
    kinds = [entry.shape.kind for entry in build_catalogue(part)]
    found = [[sum(d.found for d in one.defects if d.kind == kind) for kind in kinds] for one in judged]
    alarms = [one.false_alarms for one in others]
    return Curve(np.array([alarms]), np.array([found]), np.array([one.areas[0] for one in judged]))


def compare(folder: Path, name: str, given: argparse.Namespace) -> Study:
    """All detectors on one part."""
    rig_file, part_file = files(folder, name, width=given.width)
    rig, part = load_rig(rig_file), load_part(part_file)
    kinds = [entry.shape.kind for entry in build_catalogue(part)]
    assert len(set(kinds)) == len(kinds), "a piece has a defect of each kind"
    test = Test(
        pieces=[render_piece(rig, part, folder / f"bad-{i}", 500 + i, len(kinds)) for i in range(given.pieces)],
        goods=[render_piece(rig, part, folder / f"good-{i}", 10_000 + i, 0) for i in range(given.goods)],
        kinds=len(kinds),
    )
    placed = np.stack([test.by_kind(np.unique(one.labels[one.labels >= 0]).tolist()) for one in test.pieces])
    curves = {DATASET: list[Curve](), PASTED: list[Curve]()}
    ranges_file = folder / "ranges.yaml"
    ranges_file.write_text(f"format: lightopt-ranges/1\ndefects: {given.defects}\n", encoding="utf-8")
    setup = rig, part, load_ranges(ranges_file)
    for seed in given.seeds:
        options = DatasetOptions(images=given.samples, seed=seed, fusion=None)
        own = curves_of(folder / f"dataset-{seed}", setup, options, test)
        for some, one in zip(curves.values(), own, strict=True):
            some.append(one)
            found = [int(one.found[one.least(rate, np.arange(given.goods))].sum()) for rate in RATES]
            print(f"{name}, seed {seed}: {found} of {placed.sum()}, ROC {one.areas.mean():.3f}", flush=True)
    return Study(name, kinds, placed, given.goods, {**curves, INSPECT: [inspected(rig, part, test, given.inspected)]})


def regions(mask: Array) -> NDArray[np.int32]:
    """Numbers of the regions of a mask, from 1."""
    return np.asarray(ndimage.label(mask, np.ones((3, 3)))[0], np.int32)


def table(studies: list[Study]) -> str:
    """Shares found and ROC areas, and what the dataset gains, with 95 % intervals."""
    heads = [f"found at {rate:g} false alarms per good piece" for rate in RATES]
    lines = [f"| part | trained on | {' | '.join(heads)} | ROC area |", "|---|---|" + "---|" * (len(RATES) + 1)]
    for study in studies:
        every, placed = np.arange(study.goods), int(study.placed.sum())
        for name, curves in study.curves.items():
            area = float(np.mean([one.areas for one in curves]))
            if name == INSPECT:
                (one,) = curves
                cells = [f"{_percent(one.found.sum() / placed)}; {one.alarms.sum()} on {one.alarms.size}", ""]
            else:
                found = [[int(one.found[one.least(rate, every)].sum()) for one in curves] for rate in RATES]
                shares = [_percent(np.mean(some) / placed) for some in found]
                cells = [f"{share} ({min(some)} to {max(some)})" for share, some in zip(shares, found, strict=True)]
            lines.append(f"| {study.part}, {placed} defects | {name} | {' | '.join(cells)} | {area:.3f} |")
        for other in (PASTED, INSPECT):
            # inspect has one threshold, which is for fewer false alarms
            off = [study.differences(rate, other) for rate in (RATES if other == PASTED else RATES[:1])]
            cells = ["{:+.1f} [{:+.1f}, {:+.1f}] points".format(*(100.0 * one[0])) for one in off]
            area = "{:+.3f} [{:+.3f}, {:+.3f}]".format(*off[0][1])
            cells = " | ".join([*cells, *[""] * (len(RATES) - len(cells))])
            lines.append(f"| {study.part} | dataset − {other.removeprefix('nothing: ')} | {cells} | {area} |")
    return "\n".join(lines)


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"


def kinds_table(rows: list[Row]) -> str:
    """Share of each kind that is found, at the least rate of false alarms."""
    kinds = list(dict.fromkeys(row.kind for row in rows))
    lines = [f"| part | trained on | {' | '.join(kinds)} |", "|---|---|" + "---|" * len(kinds)]
    for part, name in dict.fromkeys((row.part, row.trained_on) for row in rows):
        own = [row for row in rows if (row.part, row.trained_on) == (part, name) and row.rate <= RATES[0]]
        found = [sum(row.found for row in own if row.kind == kind) for kind in kinds]
        placed = [sum(row.placed for row in own if row.kind == kind) for kind in kinds]
        cells = [f"{100.0 * one / of:.0f} %" for one, of in zip(found, placed, strict=True)]
        lines.append(f"| {part} | {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--parts", nargs="+", default=["cover-knob"])
    parser.add_argument("--samples", type=int, default=160, help="of each dataset")
    parser.add_argument("--defects", type=int, nargs=2, default=[3, 6], help="of a defective sample, least and most")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5], help="of the datasets, one each")
    parser.add_argument("--pieces", type=int, default=30, help="with a defect of each kind")
    parser.add_argument("--goods", type=int, default=40, help="good pieces of the test")
    parser.add_argument("--inspected", type=int, default=20, help="good pieces that inspect gets, too")
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--page", action="store_true", help="put the tables into the page")
    given = parser.parse_args(arguments)
    studies = list[Study]()
    for name in given.parts:
        with tempfile.TemporaryDirectory() as folder:
            studies.append(compare(Path(folder), name, given))
    rows = [row for study in studies for row in study.rows()]
    write_records(ROOT / "out" / "benchmarks" / "detector-training.csv", rows)
    text = f"{table(studies)}\n\n{kinds_table(rows)}"
    print(text)
    if given.page:
        replace_block("detector-training", text)


if __name__ == "__main__":
    main()
