"""Detectors and fusions on parts with random defects, and baselines; writes tables of docs/validation/inspection.md.

``python -m benchmarks.inspection [--sets N]`` renders the sample parts from a mesh four times as fine as the
inspection's, 0.5 mm and 0.5° off their place, with noise and saturation; about a minute a set. ``--toy`` is for the
tests: one part in small images.
"""

from __future__ import annotations

import argparse
import math
import re
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks._case import one_posture_files
from lightopt import load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.core.transforms import Posture
from lightopt.defects import SCALES_PX
from lightopt.estimate.registration import Placement, place_part, register
from lightopt.images import ImageSet, read_exr, read_image_set
from lightopt.inspection import PostureView, SyntheticImage, predict
from lightopt.inspection.detection._deviation import Deviations, deviations
from lightopt.inspection.detection._matched_filter import TEMPLATES, score_templates
from lightopt.inspection.detection._regions import find_regions, split_regions
from lightopt.inspection.detection._residual_score import score_deviations, threshold
from lightopt.inspection.evaluation._evaluation import area_under_roc, defect_size, fit_detection_curve, region_hits
from lightopt.inspection.fusion._gradient_fusion import FUSIONS, pixel_weights
from lightopt.inspection.fusion._synthetic_image import fuse_images
from lightopt.inspection.prediction._posture_view import posture_view
from lightopt.inspection.prediction._registered_set import nominal_scene
from lightopt.rendering import RenderOptions, cast_rays_at, render_image_set
from lightopt.scene import _build

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "validation" / "inspection.md"
PARTS = ("cover-knob", "spout")
FIRST = Posture(elevation_deg=0.0, rotation_deg=0.0)

SLOPES, LOSSES = (2, 4, 8), (0.1, 0.2, 0.4)
FALSE_ALARMS = 0.05
FINE_MM = 0.0025
"""Chord tolerance of the mesh that images are rendered from; the inspection's is 0.01 mm."""

LIT = 3.0
"""Standard deviations above black from which a surface counts as lit; draws of the noise that a mean is taken of."""
LIES = Placement(x=0.4, y=-0.3, turn=math.radians(0.5))
"""Where the part is rendered."""

TWO_AGREE = "residual, second largest"


@dataclass(frozen=True)
class Size:
    """How large a trial is.

    Attributes
    ----------
    width
        Of the images [px]; they are 4 : 3.
    fine
        Whether images are rendered from the finer mesh, and the part is searched for: both take long.
    parts
        Names of the sample parts.
    across
        Of dents and stains [px].
    widths
        Of scratches, which are eight times as long [px].
    """

    width: int
    fine: bool
    parts: tuple[str, ...]
    across: tuple[int, ...]
    widths: tuple[int, ...]

    @property
    def defects(self) -> int:
        """How many there are to strew."""
        return len(SLOPES) * (len(self.across) + len(self.widths)) + len(LOSSES) * len(self.across)

    @property
    def pixel_mm(self) -> float:
        """Side of a pixel on the table [mm]."""
        return 0.044 * 1600 / self.width


FULL = Size(800, True, PARTS, (3, 8, 20), (3, 6))
TOY = Size(200, False, PARTS[:1], (3, 8), ())


@dataclass
class Tally:
    """What one way to look at images found."""

    areas: list[float] = field(default_factory=list)
    found: int = 0
    placed: int = 0
    false_alarms: int = 0
    good_alarms: int = 0
    by_name: dict[str, list[tuple[float, bool]]] = field(default_factory=dict)
    """Size [mm] and whether it was found, of each defect of a name."""

    def add(self, other: Tally) -> None:
        """Count along what was found in other images."""
        self.areas += other.areas
        self.found += other.found
        self.placed += other.placed
        self.false_alarms += other.false_alarms
        self.good_alarms += other.good_alarms
        for name, hits in other.by_name.items():
            self.by_name.setdefault(name, []).extend(hits)


@contextmanager
def finer_mesh(size: Size) -> Iterator[None]:
    """CAD surfaces tessellated more finely, where the size asks for that."""
    usual = _build.CHORD_TOLERANCE_MM
    _build.CHORD_TOLERANCE_MM = FINE_MM if size.fine else usual
    try:
        yield
    finally:
        _build.CHORD_TOLERANCE_MM = usual


def catalogue(size: Size) -> str:
    """The defects to strew."""
    lines = ["defect_catalogue:"]
    for slope in SLOPES:
        lines += [
            f"  - {{name: dent {slope}° {n} px, kind: dent, size_mm: {n * size.pixel_mm:.4g}, slope_deg: {slope}}}"
            for n in size.across
        ]
        lines += [
            f"  - {{name: scratch {slope}° {n} px, kind: scratch, size_mm: [{8 * n * size.pixel_mm:.4g}, "
            f"{n * size.pixel_mm:.4g}], slope_deg: {slope}}}"
            for n in size.widths
        ]
    for loss in LOSSES:
        lines += [
            f"  - {{name: stain {round(100 * loss)} % {n} px, kind: stain, size_mm: {n * size.pixel_mm:.4g}, "
            f"R_d_factor: {1 - loss:g}}}"
            for n in size.across
        ]
    return "\n".join(lines) + "\n"


def prepare(folder: Path, name: str, size: Size = FULL) -> tuple[RigConfig, Path]:
    """The sample rig with a smaller camera, and a part of one posture with the catalogue."""
    rig, part = one_posture_files(folder, name, width=size.width, pixel_um=f"{100 * size.pixel_mm:.4g}")
    path = folder / f"{name}.yaml"
    path.write_text(part + catalogue(size), encoding="utf-8")
    return load_rig(rig), path


def images(folder: Path, rig: RigConfig, part: Path, seed: int, *, good: bool, size: Size = FULL) -> ImageSet:
    """Noisy images of a part 0.5 mm and 0.5° off, with defects of a seed or none."""
    from lightopt.cli._main import run

    strewn = folder / f"{part.stem}-{seed}.yaml"
    command = ["defects", rig.source.path, part, "--seed", seed, "--count", size.defects, "-o", strewn, "-q", "--force"]
    assert run([str(word) for word in command]) == 0
    text = strewn.read_text(encoding="utf-8")
    turn = math.degrees(LIES.turn)
    moved = (
        f"placement: {{anchor: rest_on_table, translate_mm: [{LIES.x}, {LIES.y}, 0], rotate_deg: [0, 0, {turn:.6g}]}}"
        "\n\npostures:"
    )
    strewn.write_text(re.sub(r"placement:.*?\npostures:", moved, text, flags=re.DOTALL), encoding="utf-8")
    out = folder / f"{part.stem}-{seed}-{'good' if good else 'bad'}"
    with finer_mesh(size):
        options = RenderOptions(noise=seed, defects=not good, patch_budget=2000, layers=good)
        render_image_set(rig, load_part(strewn), out, options=options)
    return read_image_set(out)


def look(rig: RigConfig, part: PartConfig, image_set: ImageSet, *, told: bool = False) -> PostureView:
    """The images registered with the model, by the search or at a given placement."""
    scene, observations = nominal_scene(rig, part, image_set)
    found = LIES if told else register(scene, observations, caster=cast_rays_at(scene)).placement
    scene = place_part(scene, found)
    prediction = predict(scene, FIRST, cast_rays_at(scene), lights=[o.light for o in observations])
    return posture_view(scene, observations, prediction, where=str(image_set.folder))


def ways(view: PostureView, found: Deviations) -> Iterator[tuple[str, NDArray[np.float32], int]]:
    """Each way to look at a posture: its name, its scores, and how many tests those are the greatest of."""
    yield TWO_AGREE, score_deviations(found, min_images=2), len(SCALES_PX)
    yield "residual, largest", score_deviations(found, min_images=1), len(SCALES_PX)
    for i, light in enumerate(view.lights):
        one = slice(i, i + 1)
        alone = Deviations(found.z[one], found.scale[one], found.usable[one], found.lit[one])
        yield f"residual on {light} alone", score_deviations(alone, min_images=1), len(SCALES_PX)
    weights = pixel_weights(view.saturated, view.predicted, view.specular, view.deviation, view.limit)
    for fusion in FUSIONS:
        good = {"predicted": view.predicted, "specular": view.specular}
        image = fuse_images(view.level, view.deviation, weights, view.clean, fusion=fusion, probes=0, **good)
        yield f"template on fusion {fusion}", score_templates(image), TEMPLATES
    seen = np.minimum(view.level, view.limit)
    singles = {f"template on {light} alone": seen[i] for i, light in enumerate(view.lights)}
    for name, level in {**singles, "template on the pixel-wise minimum": seen.min(axis=0)}.items():
        none = np.zeros(view.clean.shape, np.bool_)
        yield name, score_templates(SyntheticImage(level, np.zeros_like(level), none, view.clean)), TEMPLATES


def count(
    tally: Tally,
    score: NDArray[np.float32],
    tests: int,
    view: PostureView,
    found: Deviations,
    image_set: ImageSet | None,
) -> None:
    """Add what a score finds; without a set of images with labels, all of it is false alarms of a good part."""
    high = threshold(FALSE_ALARMS, int(view.clean.sum()), tests)
    labels, regions = split_regions(*find_regions(score, high), score, found, high)
    if image_set is None:
        tally.good_alarms += regions
        return
    truth = image_set.load_geometry(image_set.geometry[0])["defect"].astype(np.int32)
    clean = view.clean
    tally.areas.append(area_under_roc(score[clean].astype(np.float64), truth[clean] >= 0))
    hits = region_hits(labels, truth)
    tally.false_alarms += sum(not len(touched) for touched in hits)
    hit = {int(index) for touched in hits for index in touched}
    for index, defect in enumerate(image_set.manifest.extra["defects"]):
        if not (clean & (truth == index)).any():
            continue
        name = defect["name"].rsplit("-", 1)[0]
        tally.by_name.setdefault(name, []).append((defect_size(defect), index in hit))
        tally.placed += 1
        tally.found += index in hit


def highlights(view: PostureView, image_set: ImageSet) -> list[tuple[str, float, float, float]]:
    """Per fusion: how far former highlights stand out in the synthetic image, their uncertainty, and before.

    What the same images without highlights and noise make is taken off first: what is left should be the same in a
    former highlight and in a ring of 12 pixels around it.
    """
    diffuse = np.stack([read_exr(image_set.path(e.exr or ""))["diffuse.Y"] for e in image_set.images])
    lit = (diffuse >= LIT * view.deviation).astype(np.float32)
    weights = pixel_weights(view.saturated, view.predicted, view.specular, view.deviation, view.limit)
    full = ndimage.binary_dilation(view.saturated.any(axis=0), iterations=3) & view.clean
    regions, number = ndimage.label(full)
    rows: list[tuple[str, float, float, float]] = []
    for fusion in FUSIONS:
        good = {"predicted": view.predicted, "specular": view.specular}
        image = fuse_images(view.level, view.deviation, weights, view.clean, fusion=fusion, **good)
        plain = fuse_images(diffuse, view.deviation, lit, view.clean, fusion=fusion, probes=0)
        off = image.level - plain.level
        worst = (0.0, 1.0, 0.0)
        for region in range(1, number + 1):
            inside = regions == region
            ring = ndimage.binary_dilation(inside, iterations=12) & view.clean & ~full
            if inside.sum() < 200 or ring.sum() < 200:
                continue
            step = abs(float(off[inside].mean() - off[ring].mean()))
            deviation = float(image.deviation[inside].mean())
            seen = np.minimum(view.level, view.limit)[view.saturated[:, inside].any(axis=1).argmax()]
            before = float(seen[inside].mean() - seen[ring].mean())
            if step / deviation > worst[0] / worst[1]:
                worst = step, deviation, before
        rows.append((fusion, *worst))
    return rows


def try_set(task: tuple[str, int, int, Size]) -> tuple[dict[str, Tally], list[tuple[str, float, float, float]]]:
    """One set of a part: with defects, or the good part where the seed is beyond the number of sets."""
    part_name, seed, sets, size = task
    good = seed > sets
    with tempfile.TemporaryDirectory(prefix="lightopt-inspection-") as name:
        rig, path = prepare(Path(name), part_name, size)
        image_set = images(Path(name), rig, path, seed, good=good, size=size)
        view = look(rig, load_part(path), image_set, told=not size.fine)
        tallies: dict[str, Tally] = defaultdict(Tally)
        found = deviations(view)
        for way, score, tests in ways(view, found):
            count(tallies[way], score, tests, view, found, None if good else image_set)
        return dict(tallies), highlights(view, image_set) if good else []


def replace_block(name: str, text: str, *, page: str = PAGE.name) -> None:
    """Put text between the markers of a page of docs/validation."""
    path = PAGE.with_name(page)
    content = path.read_text(encoding="utf-8")
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
    assert pattern.search(content), name
    path.write_text(pattern.sub(lambda _: f"{begin}\n{text}\n{end}", content), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=2, help="sets of images with defects per part")
    parser.add_argument("--workers", type=int, default=2, help="sets that are worked on at once")
    parser.add_argument("--no-page", action="store_true", help="print the tables only")
    parser.add_argument("--toy", action="store_true", help="one part in small images; prints the tables only")
    given = parser.parse_args(arguments)
    size = TOY if given.toy else FULL
    tallies: dict[tuple[str, str], Tally] = defaultdict(Tally)
    gone: list[str] = []
    tasks = [(part, seed, given.sets, size) for part in size.parts for seed in range(1, given.sets + 2)]
    # not forked: a copy of a process whose threads hold locks waits for ever
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for (part, seed, *_), (found, rows) in zip(tasks, pool.map(try_set, tasks), strict=True):
            print(f"{part}, seed {seed}: done", flush=True)
            for way, tally in found.items():
                tallies[part, way].add(tally)
            gone += [
                f"| {part} | {fusion} | {before:.0f} | {step:.2f} | {deviation:.2f} |"
                for fusion, step, deviation, before in rows
            ]
    blocks = {"ways": ways_table(tallies, size.parts), "defects": defects_table(tallies, size.parts)}
    head = ["| part | fusion | before [level] | left [level] | uncertainty [level] |", "|---|---|---|---|---|"]
    blocks["highlights"] = "\n".join([*head, *gone])
    for block, text in blocks.items():
        print(f"\n{text}")
        if not given.no_page and not given.toy:
            replace_block(block, text)


def ways_table(tallies: dict[tuple[str, str], Tally], parts: Sequence[str]) -> str:
    """All ways to look, on every part."""
    names = list(dict.fromkeys(way for _, way in tallies))
    head = "| | " + " | ".join(f"{part}: ROC-AUC | found | false alarms" for part in parts) + " |"
    lines = [head, "|---|" + "---|" * (3 * len(parts))]
    for way in names:
        cells = [way]
        for part in parts:
            t = tallies[part, way]
            alarms = f"{t.false_alarms / max(1, len(t.areas)):.2g}, good part {t.good_alarms}"
            cells += [f"{np.mean(t.areas):.3f}", f"{t.found} of {t.placed}", alarms]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def defects_table(tallies: dict[tuple[str, str], Tally], parts: Sequence[str]) -> str:
    """What the residual detector finds where two images agree, by defect, and the sizes found 90 % of the time."""
    mine = [tallies[part, TWO_AGREE] for part in parts]
    lines = ["| defect | found |", "|---|---|"]
    for name in dict.fromkeys(name for t in mine for name in t.by_name):
        hits = [hit for t in mine for _, hit in t.by_name.get(name, [])]
        lines.append(f"| {name} | {sum(hits)} of {len(hits)} |")
    kinds = {"all": "", "dents": "dent", "scratches": "scratch", "stains": "stain"}
    lines += ["", "| | found | a90 [mm] | a90/95 [mm] |", "|---|---|---|---|"]
    for title, start in kinds.items():
        pairs = [pair for t in mine for n, own in t.by_name.items() if n.startswith(start) for pair in own]
        curve = fit_detection_curve([size for size, _ in pairs], [hit for _, hit in pairs])
        a90, bound = ("-" if a is None else f"{a:.2g}" for a in (curve.a90, curve.a90_95))
        lines.append(f"| {title} | {curve.found} of {curve.defects} | {a90} | {bound} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
