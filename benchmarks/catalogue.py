"""What the catalogue's detector finds more than the residual detector, and how well it names that.

``python -m benchmarks.catalogue [--sets N]``. Random defects of the built-in catalogue are rendered as they are, at
half and at a quarter of their effect, from a mesh four times as fine as the inspection's, 0.5 mm and 0.5° off their
place, with noise. Both detectors inspect the same images; the second always has the catalogue as it is.
"""

from __future__ import annotations

import argparse
import math
import re
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks._case import one_posture_files
from benchmarks.inspection import FULL, LIES, PARTS, TOY, Size, finer_mesh
from benchmarks.loop import run_command
from lightopt import load_part, load_rig
from lightopt.defects import BUILT_IN_CATALOGUE
from lightopt.images import ImageSet, read_image_set
from lightopt.inspection import (
    InspectionResult,
    InspectOptions,
    PredictionCache,
    SetEvaluation,
    evaluate_set,
    inspect_set,
)
from lightopt.rendering import RenderOptions, render_image_set

DETECTORS = ("residual", "catalogue")
EFFECTS = (1.0, 0.5, 0.25)
SEEN_IN = (1, 2)
PER_KIND = 4  # defects of each kind in a set
KINDS = tuple(entry.shape.kind for entry in BUILT_IN_CATALOGUE)
NEAR = math.log(1.25)  # ratios of a size that is right

Key = tuple[str, float, int, str]  # part, effect, images that must show a defect, detector


@dataclass
class Tally:
    """Found of each kind, false alarms, areas under the ROC, processor seconds; kinds and sizes that are right."""

    hits: dict[str, list[bool]] = field(default_factory=lambda: defaultdict(list))
    false_alarms: int = 0
    areas: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    kind_right: list[bool] = field(default_factory=list)
    size_right: list[bool] = field(default_factory=list)


def weaker(text: str, effect: float) -> str:
    """The text of a part file, its defects with a share of their effect."""
    head, tail = text.split("\ndefects:", 1)

    def slope(match: re.Match[str]) -> str:
        return f"slope_deg: {math.degrees(math.atan(effect * math.tan(math.radians(float(match[1]))))):.6g}"

    tail = re.sub(r"slope_deg: ([0-9.]+)", slope, tail)
    return (
        head
        + "\ndefects:"
        + re.sub(
            r"((?:R_d|sigma)_factor): ([0-9.]+)", lambda m: f"{m[1]}: {1.0 + effect * (float(m[2]) - 1.0):.6g}", tail
        )
    )


def image_sets(folder: Path, name: str, sets: int, size: Size) -> Iterator[tuple[int, float, ImageSet]]:
    """Image sets of a part; the files are `rig.yaml` and `part.yaml` in the folder."""
    rig, text = one_posture_files(folder, name, width=size.width, pixel_um=f"{4.4 * 1600 / size.width:g}")
    part = folder / "part.yaml"
    part.write_text(text, encoding="utf-8")
    moved = f"translate_mm: [{LIES.x}, {LIES.y}, 0], rotate_deg: [0, 0, {math.degrees(LIES.turn):.6g}]"
    placed = f"placement: {{anchor: rest_on_table, {moved}}}\n\npostures:"
    for seed in range(1, sets + 1):
        strewn = folder / f"{seed}.yaml"
        count = PER_KIND * len(KINDS)
        run_command("defects", rig, part, "--seed", seed, "--count", count, "-o", strewn, "-q", "--force")
        known = re.sub(r"placement:.*?\npostures:", placed, strewn.read_text(encoding="utf-8"), flags=re.DOTALL)
        for number, effect in enumerate(EFFECTS):
            strewn.write_text(weaker(known, effect), encoding="utf-8")
            out = folder / f"{seed}-{effect:g}"
            with finer_mesh(size):
                options = RenderOptions(noise=len(EFFECTS) * seed + number, patch_budget=2000)
                render_image_set(load_rig(rig), load_part(strewn), out, options=options)
            yield seed, effect, read_image_set(out)


def count(tally: Tally, image_set: ImageSet, result: InspectionResult, known: SetEvaluation) -> None:
    """Add what an inspection found."""
    tally.false_alarms += known.false_alarms
    tally.areas += known.areas
    (posture,) = result.postures
    truth = image_set.load_geometry(image_set.geometry[0])["defect"]
    listed = image_set.manifest.extra["defects"]
    for index, one in enumerate(listed):
        defect = next((d for d in known.defects if d.name == one["name"]), None)
        if defect is None:
            continue
        tally.hits[defect.kind].append(defect.found)
        own = [posture.detections[n - 1].named for n in np.unique(posture.labels[truth == index]) if n > 0]
        named = max((n for n in own if n is not None), key=lambda n: abs(n.z), default=None)
        if defect.found and named is not None:
            tally.kind_right.append(named.kind == defect.kind)
            if named.kind == defect.kind:
                size = math.sqrt(named.length[0] * named.width[0]) / defect.size
                tally.size_right.append(abs(math.log(size)) <= NEAR)


def table(tallies: dict[Key, Tally]) -> str:
    """A line per part, effect, number of images and detector."""
    heads = [
        "part",
        "effect",
        "images",
        "detector",
        *KINDS,
        "all",
        "false alarms",
        "ROC-AUC",
        "kind",
        "size",
        "seconds",
    ]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for (part, effect, images, detector), t in tallies.items():
        hits = [hit for kind in KINDS for hit in t.hits[kind]]
        cells = [part, f"{effect:g}", f"{images}", detector, *(f"{sum(t.hits[k])} of {len(t.hits[k])}" for k in KINDS)]
        cells += [f"{sum(hits)} of {len(hits)}", f"{t.false_alarms}", f"{np.mean(t.areas):.3f}"]
        cells += [f"{sum(right)} of {len(right)}" if right else "" for right in (t.kind_right, t.size_right)]
        lines.append("| " + " | ".join([*cells, f"{np.median(t.seconds):.2f}"]) + " |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Inspect all sets with both detectors and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=6, help="sets of random defects per part")
    parser.add_argument("--toy", action="store_true", help="one part in small images")
    given = parser.parse_args(arguments)
    size = TOY if given.toy else FULL
    tallies: dict[Key, Tally] = defaultdict(Tally)
    for name in PARTS if size is FULL else PARTS[:1]:
        caches = {detector: PredictionCache() for detector in DETECTORS}
        with tempfile.TemporaryDirectory(prefix="lightopt-catalogue-") as folder:
            for seed, effect, image_set in image_sets(Path(folder), name, given.sets, size):
                rig, part = load_rig(Path(folder) / "rig.yaml"), load_part(Path(folder) / "part.yaml")
                for images in SEEN_IN:
                    for detector, cache in caches.items():
                        options = InspectOptions(detector=detector, fusion=None, min_images=images)
                        begun = time.process_time()
                        result = inspect_set(rig, part, image_set, options=options, cache=cache)
                        tally = tallies[name, effect, images, detector]
                        tally.seconds.append(time.process_time() - begun)
                        count(tally, image_set, result, evaluate_set(image_set, result, known=()))
                print(f"{name}, seed {seed}, effect {effect:g}: done", flush=True)
    print(f"\n{table(dict(sorted(tallies.items(), key=str)))}")


if __name__ == "__main__":
    main()
