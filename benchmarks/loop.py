"""Does the loop close: lights planned for defects, defects captured under them, and what ``inspect`` finds of them.

``python -m benchmarks.loop [--finish polished] [--seeds N] [--plot PNG]``. For each sample part the lights are placed
once by ``optimize --objective detectability`` and once by ``--objective paper``. Defects of the built-in catalogue are
strewn over the part, the same ones for both rigs, the virtual bench captures it 0.4 and 0.3 mm off its place with noise
of its own for each seed, and the inspection is held against the defects that the part's file names.

Three shares are set beside what was found, kind by kind:

*planned*: of the (patch, defect) pairs of all that the camera sees, those that ``optimize`` predicts to be seen.
*beneath*: the same of the patches beneath the defects that were strewn: they lie in the open, off edges.
*whole*: of the strewn defects, those of which one pair or more beneath them is predicted to be seen. A defect is found
as a whole, by any of its walls, so that this is what to hold the finds against.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks._case import one_posture_files
from benchmarks.inspection import FALSE_ALARMS, FIRST, replace_block
from lightopt import build_scene, load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.defects import BUILT_IN_CATALOGUE, PlacedDefect, radial_place, surface_coordinates
from lightopt.design import Contrast, DetectionModel, Visibility, defect_hypotheses, luminance_matrix, unpack_flags
from lightopt.images import ImageSet, read_image_set
from lightopt.inspection import (
    SCALES_PX,
    InspectionResult,
    InspectOptions,
    SetEvaluation,
    deviations,
    evaluate_set,
    find_regions,
    inspect_set,
    score_deviations,
    split_regions,
    threshold,
)
from lightopt.rendering import PatchTable, build_patches, cast_rays_at
from lightopt.report import chart, figure_image, fixed_style
from lightopt.rig.capture import CaptureOptions, CapturePlan, Devices, capture, connect_devices, start_bench, wiring_of
from lightopt.rig.simulated import BenchTruth
from lightopt.scene import place_defects

PARTS = ("cover-knob", "spout")
OBJECTIVES = ("detectability", "paper")
FINISHES = {"as-filed": {}, "polished": {"R_d": 1.0}}
"""What replaces the coefficients of the part's file: polished, hardly anything scatters, and defects are glints on a
dark field."""
SEEN_IN = (1, 2)
PLANNED_IN = 1
"""Images that must show a defect, of the rig for detectability."""

OFF_MM = (0.4, -0.3, 0.0)
NORMAL_95 = 1.959964

Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class Tally:
    """Defects of a kind: predicted shares, and how many were strewn, predicted to be found and found."""

    part: str
    objective: str
    min_images: int
    kind: str
    planned: float
    beneath: float
    strewn: int
    whole: int
    found: int
    false_alarms: int = 0
    postures: int = 0


def interval(found: int, of: int) -> tuple[float, float]:
    """Interval of 95 % of a share (Wilson 1927, doi:10.1080/01621459.1927.10502953)."""
    if of == 0:
        return 0.0, 1.0
    z2 = NORMAL_95**2
    middle = (found + 0.5 * z2) / (of + z2)
    half = NORMAL_95 / (of + z2) * math.sqrt(found * (of - found) / of + 0.25 * z2)
    return max(0.0, middle - half), min(1.0, middle + half)


def run_command(*words: object) -> None:
    """A command of lightopt, in process."""
    from lightopt.cli._main import run

    status = run([str(word) for word in words])
    if status != 0:
        raise SystemExit(f"lightopt {words[0]} left with {status}")


def files(folder: Path, name: str, width: int, finish: str) -> tuple[Path, Path]:
    """The sample rig with a camera of a width, and the part in its first posture with a finish."""
    rig, part = one_posture_files(folder, name, width=width, pixel_um=f"{4.4 * 1600 / width:g}")
    for key, value in FINISHES[finish].items():
        part = re.sub(rf"( {key}:) [0-9.]+", rf"\1 {value:g}", part)
    (folder / f"{name}.yaml").write_text(part, encoding="utf-8")
    return rig, folder / f"{name}.yaml"


class Prediction:
    """What the planner says of a rig: which pairs of patch and defect enough images show."""

    def __init__(self, rig: RigConfig, part: PartConfig, patches: int) -> None:
        scene = build_scene(rig, part, defects=False)
        caster = cast_rays_at(scene)
        self.table: PatchTable = build_patches(scene, caster=caster, budget=patches)
        contrast = Contrast(sensor=scene.sensor, full_scale=scene.reflectance.full_scale)
        self.trials = defect_hypotheses(BUILT_IN_CATALOGUE)
        matrix = luminance_matrix(
            scene,
            self.table,
            scene.postures[0],
            [(light,) for light in scene.lights],
            caster=caster,
            detection=DetectionModel(hypotheses=self.trials, contrast=contrast),
        )
        assert matrix.visibility is not None
        self.visibility: Visibility = matrix.visibility

    def seen(self, min_images: int) -> Bool:
        """Whether enough images show each trial on each patch, shape (p, t)."""
        one_each = self.visibility.rows([np.zeros(1, np.int64)] * len(self.visibility.words))
        words = one_each.reachable(min_images)
        return unpack_flags(words, len(self.trials))

    def trials_of(self, name: str) -> Bool:
        """The trials of an entry of the catalogue, shape (t,)."""
        return np.array([trial.name == name for trial in self.trials])

    def beneath(self, defect: PlacedDefect) -> NDArray[np.intp]:
        """The patches that a defect lies on, at least the nearest."""
        patches, own = self.table.patches, self.visibility.patch
        centroids = patches.centroids[own]
        distance = np.linalg.norm(centroids - defect.position, axis=1)
        near = np.flatnonzero(distance <= defect.reach)
        x, y, same = surface_coordinates(defect, centroids[near], patches.normals[own][near])
        inside = near[same & (radial_place(defect.shape, x, y) < 1.0)]
        return inside if len(inside) else np.array([distance.argmin()])


def looked_at_again(result: InspectionResult, min_images: int) -> InspectionResult:
    """The same images, judged by another number of images that must show a defect."""
    postures = []
    for posture in result.postures:
        found = deviations(posture.view)
        score = score_deviations(found, min_images=min_images)
        high = threshold(FALSE_ALARMS, int(posture.view.clean.sum()), len(SCALES_PX))
        labels, _ = split_regions(*find_regions(score, high), score, found, high)
        postures.append(replace(posture, score=score, labels=labels, threshold=high))
    return replace(result, postures=tuple(postures))


def take(rig: RigConfig, part: PartConfig, folder: Path, seed: int) -> ImageSet:
    """Capture a part on the virtual bench, off its place and with noise of a seed."""
    truth = BenchTruth(seed=seed, part_offset_mm=OFF_MM)
    with start_bench(rig, wiring_of(rig), part=part, truth=truth) as bench:

        def connect(plan: CapturePlan) -> Devices:
            return connect_devices(rig, plan.wiring, part=part, plan=plan, bench=bench)

        capture(rig, part, folder, options=CaptureOptions(postures=(FIRST,)), connect=connect)
    return read_image_set(folder)


def close_loop(folder: Path, name: str, options: argparse.Namespace) -> Iterator[Tally]:
    """Plan, strew, capture and inspect one part under the rigs of both objectives."""
    rig_file, part_file = files(folder, name, options.width, options.finish)
    strewn: list[Path] = []
    for seed in range(1, options.seeds + 1):
        strewn.append(folder / f"{name}-{seed}.yaml")
        run_command(
            "defects", rig_file, part_file, "--seed", seed, "--count", options.count, "-o", strewn[-1], "-q"
        )  # fmt: skip
    for objective in OBJECTIVES:
        best = folder / f"{name}-{objective}"
        run_command(
            "optimize", rig_file, part_file, "-o", best, "--objective", objective, "--posture", "0,0",
            "--step", options.step, "--patches", options.patches, "--no-images", "--no-report", "-q",
            *(("--min-images", PLANNED_IN) if objective == "detectability" else ()),
        )  # fmt: skip
        rig = load_rig(best / "rig.optimized.yaml")
        angles = ", ".join(f"{light.elevation_deg:g}°" for light in rig.lights)
        print(f"{name}, {objective}: {angles}", flush=True)
        prediction = Prediction(rig, load_part(part_file), options.patches)
        counts = _Counts(prediction)
        for seed, path in enumerate(strewn, 1):
            part = load_part(path)
            image_set = take(rig, part, folder / f"{name}-{objective}-{seed}", seed)
            once = inspect_set(rig, part, image_set, options=InspectOptions(fusion=None, min_images=1))
            placed = place_defects(once.nominal, rig, part)
            for min_images in SEEN_IN:
                result = once if min_images == 1 else looked_at_again(once, min_images)
                counts.add(min_images, placed, evaluate_set(image_set, result, known=placed))
            print(f"{name}, {objective}, seed {seed}: done", flush=True)
        yield from counts.tallies(name, objective)


class _Counts:
    """Defects counted by kind and by the number of images that must show them."""

    def __init__(self, prediction: Prediction) -> None:
        self.prediction = prediction
        self.shares: dict[tuple[int, str], list[float]] = {}
        self.hits: dict[tuple[int, str], list[tuple[bool, bool]]] = {}
        self.false_alarms = dict.fromkeys(SEEN_IN, 0)
        self.postures = dict.fromkeys(SEEN_IN, 0)

    def add(self, min_images: int, placed: tuple[PlacedDefect, ...], known: SetEvaluation) -> None:
        seen, areas = self.prediction.seen(min_images), self.prediction.visibility.areas
        found = {defect.name: defect.found for defect in known.defects}
        for defect in placed:
            if defect.name not in found:
                continue
            kind = defect.name.rsplit("-", 1)[0]
            rows = self.prediction.beneath(defect)
            pairs = seen[np.ix_(rows, self.prediction.trials_of(kind))]
            key = min_images, kind
            share = float(areas[rows] @ pairs.mean(axis=1) / areas[rows].sum())
            self.shares.setdefault(key, []).append(share)
            self.hits.setdefault(key, []).append((bool(pairs.any()), found[defect.name]))
        self.false_alarms[min_images] += known.false_alarms
        self.postures[min_images] += known.postures

    def tallies(self, part: str, objective: str) -> Iterator[Tally]:
        areas = self.prediction.visibility.areas
        for min_images in SEEN_IN:
            seen = self.prediction.seen(min_images)
            kinds = [kind for number, kind in self.hits if number == min_images]
            planned = {
                kind: float(areas @ seen[:, self.prediction.trials_of(kind)].mean(axis=1) / areas.sum())
                for kind in kinds
            }
            for kind in (*kinds, "all"):
                own = [k for k in kinds if kind in (k, "all")]
                shares = [x for k in own for x in self.shares[min_images, k]]
                hits = [x for k in own for x in self.hits[min_images, k]]
                yield Tally(
                    part=part,
                    objective=objective,
                    min_images=min_images,
                    kind=kind,
                    planned=float(np.mean([planned[k] for k in own])),
                    beneath=float(np.mean(shares)),
                    strewn=len(hits),
                    whole=sum(whole for whole, _ in hits),
                    found=sum(found for _, found in hits),
                    false_alarms=self.false_alarms[min_images],
                    postures=self.postures[min_images],
                )


def table(tallies: list[Tally]) -> str:
    """A line per part, rig and number of images for all kinds together, then one per kind of the planned rig."""
    lines = [
        "| part | lights for | images | planned | beneath | whole | found | 95 % | false alarms |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for t in tallies:
        if t.kind == "all":
            alarms = f"{t.false_alarms} in {t.postures}"
            lines.append(f"| {t.part} | {t.objective} | {t.min_images} | {_cells(t)} | {alarms} |")
    lines += ["", "| kind | images | planned | beneath | whole | found | 95 % |", "|---|---|---|---|---|---|---|"]
    mine = [t for t in tallies if t.objective == "detectability" and t.kind != "all"]
    for min_images, kind in itertools.product(SEEN_IN, dict.fromkeys(t.kind for t in mine)):
        both = [t for t in mine if (t.min_images, t.kind) == (min_images, kind)]
        strewn = sum(t.strewn for t in both)
        joined = replace(
            both[0],
            planned=float(np.mean([t.planned for t in both])),
            beneath=sum(t.beneath * t.strewn for t in both) / strewn,
            strewn=strewn,
            whole=sum(t.whole for t in both),
            found=sum(t.found for t in both),
        )
        lines.append(f"| {kind} | {min_images} | {_cells(joined)} |")
    return "\n".join(lines)


def _cells(t: Tally) -> str:
    low, high = interval(t.found, t.strewn)
    return (
        f"{100 * t.planned:.0f} % | {100 * t.beneath:.0f} % | {t.whole} of {t.strewn} | {t.found} of {t.strewn} | "
        f"{100 * low:.0f} to {100 * high:.0f} %"
    )


def plot(tallies: list[Tally], path: Path) -> None:
    """Predicted across, found up, a dot per part, rig and kind; the line is where they are equal."""
    shown = list(itertools.product(SEEN_IN, ("share of pairs planned", "defects of which a pair beneath is seen")))
    with fixed_style():
        figure, panels = chart(
            title="The loop, kind by kind",
            x_label="predicted [%]",
            labels=[
                f"found [%] against {what}, {min_images} image{'s' if min_images > 1 else ''}"
                for min_images, what in shown
            ],
        )
        for panel, (min_images, what) in zip(panels, shown, strict=True):
            own = [t for t in tallies if t.kind != "all" and t.min_images == min_images]
            predicted = [t.planned if what.startswith("share") else t.whole / t.strewn for t in own]
            found = [100.0 * t.found / t.strewn for t in own]
            panel.plot([100.0 * share for share in predicted], found, ".", color="#5c636e")
            panel.plot([0.0, 100.0], [0.0, 100.0])
        figure_image(figure).save(path)


def main(arguments: list[str] | None = None) -> None:
    """Close the loop, print the tables, write all tallies."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loop", description=__doc__)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--finish", choices=FINISHES, default="as-filed", help="of the surface")
    parser.add_argument("--seeds", type=int, default=3, help="sets of defects per part")
    parser.add_argument("--count", type=int, default=42, help="defects per set")
    parser.add_argument("--width", type=int, default=800, help="of the images [px]")
    parser.add_argument("--patches", type=int, default=50_000, help="about how many patches are visible")
    parser.add_argument("--step", type=float, default=5.0, help="of the lights' angles [°]")
    parser.add_argument("--out", type=Path, default=Path("out/loop"), help="folder of loop.csv")
    parser.add_argument("--plot", type=Path, help="picture to draw")
    parser.add_argument("--page", action="store_true", help="put the tables into docs/validation/inspection.md")
    options = parser.parse_args(arguments)
    tallies: list[Tally] = []
    for name in options.parts:
        with tempfile.TemporaryDirectory(prefix="lightopt-loop-") as folder:
            tallies += close_loop(Path(folder), name, options)
    text = table(tallies)
    print(f"\n{text}")
    options.out.mkdir(parents=True, exist_ok=True)
    with (options.out / "loop.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(vars(tallies[0]))
        writer.writerows(vars(t).values() for t in tallies)
    print(options.out / "loop.csv")
    if options.page:
        replace_block("loop" if options.finish == "as-filed" else f"loop-{options.finish}", text)
    if options.plot is not None:
        plot(tallies, options.plot)


if __name__ == "__main__":
    main()
