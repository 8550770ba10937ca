"""Does the loop close: lights planned for defects, defects captured under them, and what ``inspect`` finds of them.

``python -m benchmarks.loop [--finish polished] [--waviness 0.1] [--lobe 1.05] [--rays 3] [--bounces 1]
[--seeds N] [--plot PNG]``. For each part
the lights are placed once by ``optimize --objective detectability`` and once by ``--objective paper``. Random defects
of the built-in catalogue are placed on the part, the same ones for both rigs, the simulated rig captures it 0.4 and 0.3
mm off its place with noise of its own for each seed, and the inspection with the part's catalogue is held against the
defects that the part's file names.

With ``--waviness`` the part's file has so much, and each captured part has a surface of its own. With ``--lobe`` the
parts have a lobe so much wider than their file says, and the inspection is calibrated on good parts. With ``--rays``
the simulated camera's pixels show the mean of so many rays along each side, as a real camera's do. With ``--bounces``
images have so many bounces of light from the part to the part, as plan and inspection know.

Two shares are set beside what was found, kind by kind:

*planned*: of all inspectable places, those where ``optimize`` predicts a defect of the kind to be found.
*at these places*: the same of the places where the defects lie, in their orientations.
"""

from __future__ import annotations

import argparse
import itertools
import math
import re
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks._case import one_posture_files, write_records
from benchmarks.inspection import FIRST, replace_block
from lightopt import build_scene, load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Bool
from lightopt.core.errors import InputError
from lightopt.defects import DEFAULT_FALSE_ALARMS, PlacedDefect, tangent_references
from lightopt.design import DetectionModel, planned_catalogue
from lightopt.design._problem import images_that_decide
from lightopt.design.responses._evidence import spare_units
from lightopt.design.responses._image_evaluator import ImageEvaluator
from lightopt.design.responses._pairs import unpack_flags
from lightopt.estimate.registration import part_file_placement
from lightopt.images import ImageSet, read_image_set
from lightopt.inspection import (
    Calibration,
    InspectOptions,
    PredictionCache,
    SetEvaluation,
    calibrate,
    evaluate_set,
    inspect_set,
)
from lightopt.inspection.calibration._calibration import sets_needed
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.report import chart, figure_image, fixed_style
from lightopt.rig.capture import CaptureOptions, CapturePlan, Devices, capture, connect_devices, wiring_of
from lightopt.rig.capture._wiring import start_bench
from lightopt.rig.simulated import BenchTruth
from lightopt.scene import build_catalogue, place_defects

PARTS = ("cover-knob", "spout")
OBJECTIVES = ("detectability", "paper")
FINISHES = {"as-filed": {}, "polished": {"R_d": 1.0}, "satin": {"R_s": 2820.0, "sigma_rad": 0.1}}
"""What replaces the coefficients of the part's file: polished, hardly anything scatters, and defects are glints on a
dark field; satin, a highlight is twice as wide and holds as much light."""
MIN_IMAGES = (1, 2)

OFF_MM = (0.4, -0.3, 0.0)
NORMAL_95 = 1.959964


@dataclass(frozen=True)
class Tally:
    """Defects of a kind: predicted shares, how many were placed, and how many of them were found."""

    part: str
    objective: str
    min_images: int
    kind: str
    planned: float
    at_places: float
    placed: int
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


def files(
    folder: Path, name: str, *, width: int, finish: str = "as-filed", surface: str = "", bounces: int = 0
) -> tuple[Path, Path]:
    """The sample rig with a camera of a width, and the part in its first posture with a finish and a surface."""
    rig, part = one_posture_files(folder, name, width=width, pixel_um=f"{4.4 * 1600 / width:g}")
    for key, value in FINISHES[finish].items():
        part = re.sub(rf"( {key}:) [0-9.]+", rf"\1 {value:g}", part)
    if surface:
        part += f"\nsurface: {surface}\n"
    if bounces:
        part += f"\ninspection: {{bounces: {bounces}}}\n"
    path = folder / f"{Path(name).stem}.yaml"
    path.write_text(part, encoding="utf-8")
    return rig, path


def as_made(path: Path, lobe: float) -> PartConfig:
    """The part with a lobe so many times as wide as its file says."""
    part = load_part(path)
    wider = part.reflectance.model_copy(update={"sigma_rad": lobe * part.reflectance.sigma_rad})
    return part.model_copy(update={"reflectance": wider})


class Prediction:
    """What the planner says of a rig: which defects the inspection finds at which patches."""

    def __init__(
        self,
        rig: RigConfig,
        part: PartConfig,
        min_images: int,
        options: argparse.Namespace,
        calibration: Calibration | None = None,
    ) -> None:
        scene = build_scene(rig, part, defects=False, bounces=part.inspection.bounces)
        caster = cast_rays_at(scene)
        posture = scene.postures[0]
        catalogue = planned_catalogue(build_catalogue(part))
        self.table = build_patches(scene, caster=caster, budget=options.patches, edges=False)
        evaluator = ImageEvaluator(
            scene=scene,
            table=self.table,
            caster=caster,
            detection=DetectionModel(
                catalogue=catalogue,
                sensor=scene.sensor,
                full_scale=scene.reflectance.full_scale,
                false_alarms=options.false_alarms,
                threshold=None
                if calibration is None
                else max(one.threshold(options.false_alarms) for one in calibration.postures),
                min_images=images_that_decide(rig, part, min_images, longest=1.0),
            ),
        )
        self.defects = catalogue.defects
        self.axes = scene.placement.rotation
        self.patches = evaluator.patches
        self.areas = self.table.patches.areas[self.patches]
        (matrix,) = evaluator.matrices(posture, [[panel] for panel in scene.lights])
        assert matrix.visibility is not None
        spare = spare_units(matrix.levels, scene.sensor, evaluator.detection.min_images)
        counts = replace(matrix.visibility, spare=spare).most_units(evaluator.needed)
        self.found: Bool = unpack_flags(counts[-1], len(self.defects)) > 0

    def planned(self, kind: str) -> float:
        """Share of the inspectable places."""
        own = [t for t, defect in enumerate(self.defects) if defect.name == kind]
        return float(self.areas @ self.found[:, own].mean(axis=1) / self.areas.sum())

    def at(self, defect: PlacedDefect, kind: str) -> bool:
        """Whether a defect is predicted to be found where it lies."""
        centroids = self.table.patches.centroids[self.patches]
        normals = self.table.patches.normals[self.patches]
        distance = np.linalg.norm(centroids - defect.position, axis=1)
        distance[normals @ defect.normal < 0.5] = np.inf
        own = [t for t, planned in enumerate(self.defects) if planned.name == kind]
        reference = tangent_references(defect.normal[None], x_axis=self.axes[:, 0], y_axis=self.axes[:, 1])[0]
        turn = math.atan2(defect.along @ np.cross(defect.normal, reference), defect.along @ reference)
        return bool(self.found[distance.argmin(), own[round(turn / math.pi * len(own)) % len(own)]])


def take(rig: RigConfig, part: PartConfig, folder: Path, seed: int, *, rays: int = 1) -> ImageSet:
    """Capture a part on the simulated rig, off its place and with noise of a seed; `rays` along a side of a pixel."""
    truth = BenchTruth(seed=seed, part_offset_mm=OFF_MM, rays=rays, bounces=part.inspection.bounces)
    with start_bench(rig, wiring_of(rig), part=part, truth=truth) as bench:

        def connect(plan: CapturePlan) -> Devices:
            return connect_devices(rig, plan.wiring, part=part, plan=plan, bench=bench)

        capture(rig, part, folder, options=CaptureOptions(postures=(FIRST,)), connect=connect)
    return read_image_set(folder)


def close_loop(folder: Path, name: str, options: argparse.Namespace) -> Iterator[Tally]:
    """Plan, place, capture and inspect one part under the rigs of both objectives."""
    surface = (
        f"{{waviness_deg: {options.waviness:g}, waviness_mm: {options.waviness_mm:g}}}" if options.waviness else ""
    )
    rig_file, part_file = files(
        folder, name, width=options.width, finish=options.finish, surface=surface, bounces=options.bounces
    )
    name = part_file.stem
    placed: list[Path] = []
    for seed in range(1, options.seeds + 1):
        placed.append(folder / f"{name}-{seed}.yaml")
        run_command(
            "defects", rig_file, part_file, "--seed", seed, "--count", options.count, "-o", placed[-1], "-q"
        )  # fmt: skip
    for objective in options.objectives:
        best = folder / f"{name}-{objective}"
        run_command(
            "optimize", rig_file, part_file, "-o", best, "--objective", objective, "--posture", "0,0",
            "--step", options.step, "--patches", options.patches, "--false-alarms", options.false_alarms,
            "--no-images", "--no-report", "-q",
        )  # fmt: skip
        rig = load_rig(best / "rig.optimized.yaml")
        angles = ", ".join(f"{light.elevation_deg:g}°" for light in rig.lights)
        print(f"{name}, {objective}: {angles}", flush=True)
        nominal = load_part(part_file)
        inspections = {
            k: InspectOptions(fusion=None, min_images=k, false_alarms=options.false_alarms) for k in MIN_IMAGES
        }
        calibrations: dict[int, Calibration] = {}
        if options.lobe != 1.0:
            good = [
                take(
                    rig,
                    as_made(part_file, options.lobe),
                    folder / f"{name}-{objective}-good-{seed}",
                    1000 + seed,
                    rays=options.rays,
                )
                for seed in range(sets_needed(options.false_alarms))
            ]
            calibrations = {k: calibrate(rig, nominal, good, options=one) for k, one in inspections.items()}
        predictions = {k: Prediction(rig, nominal, k, options, calibrations.get(k)) for k in MIN_IMAGES}
        found = count_found(folder, f"{name}-{objective}", rig, placed, predictions, options, calibrations)
        yield from (replace(one, part=name, objective=objective) for one in found)


def count_found(
    folder: Path,
    name: str,
    rig: RigConfig,
    placed: list[Path],
    predictions: dict[int, Prediction],
    options: argparse.Namespace,
    calibrations: dict[int, Calibration] | None = None,
    *,
    take: Callable[..., ImageSet] = take,
    fixture: bool = False,
) -> Iterator[Tally]:
    """Capture and inspect parts with defects, with each number of images that must show one.

    fixture: The parts lie in the same place, which the images of the first one show
    """
    counts = {k: Counts(prediction) for k, prediction in predictions.items()}
    cache, place = PredictionCache(), None
    for seed, path in enumerate(placed, 1):
        part = load_part(path)
        # where the prediction has the part
        placed_nominally = place_defects(build_scene(rig, part, defects=False), rig, part)
        if place is not None:
            part = part.model_copy(update={"placement": place})
        image_set = take(rig, as_made(path, options.lobe), folder / f"{name}-{seed}", seed, rays=options.rays)
        for k, own in counts.items():
            register = place is None
            inspection = InspectOptions(fusion=None, min_images=k, false_alarms=options.false_alarms, register=register)
            known_good = (calibrations or {}).get(k)
            try:
                result = inspect_set(rig, part, image_set, options=inspection, cache=cache, calibration=known_good)
            except InputError as refused:
                print(f"{name}, seed {seed}: {refused}", flush=True)
                own.miss(placed_nominally)
                continue
            known = place_defects(result.nominal, rig, part)
            own.add(placed_nominally, evaluate_set(image_set, result, known=known))
            if fixture and place is None and result.placement is not None:
                place = part_file_placement(result.nominal, result.placement, part.placement)
                cache = PredictionCache()
        print(f"{name}, seed {seed}: done", flush=True)
    for k, own in counts.items():
        yield from own.tallies(name, "", k)


class Counts:
    """Defects counted by kind."""

    def __init__(self, prediction: Prediction) -> None:
        self.prediction = prediction
        self.hits: dict[str, list[tuple[bool, bool]]] = {}
        self.false_alarms = self.postures = 0

    def add(self, placed: tuple[PlacedDefect, ...], known: SetEvaluation) -> None:
        found = {defect.name: defect.found for defect in known.defects}
        for defect in placed:
            if defect.name in found:
                self._count(defect, found=found[defect.name])
        self.false_alarms += known.false_alarms
        self.postures += known.postures

    def miss(self, placed: tuple[PlacedDefect, ...]) -> None:
        """Of images that the inspection refuses."""
        for defect in placed:
            self._count(defect, found=False)
        self.postures += 1

    def _count(self, defect: PlacedDefect, *, found: bool) -> None:
        kind = defect.name.rsplit("-", 1)[0]
        self.hits.setdefault(kind, []).append((self.prediction.at(defect, kind), found))

    def tallies(self, part: str, objective: str, min_images: int) -> Iterator[Tally]:
        planned = {kind: self.prediction.planned(kind) for kind in self.hits}
        for kind in (*self.hits, "all"):
            own = [k for k in self.hits if kind in (k, "all")]
            hits = [x for k in own for x in self.hits[k]]
            yield Tally(
                part=part,
                objective=objective,
                min_images=min_images,
                kind=kind,
                planned=float(np.mean([planned[k] for k in own])),
                at_places=float(np.mean([predicted for predicted, _ in hits])),
                placed=len(hits),
                found=sum(found for _, found in hits),
                false_alarms=self.false_alarms,
                postures=self.postures,
            )


def joined(tallies: list[Tally]) -> Tally:
    """Several parts as one row."""
    placed = sum(t.placed for t in tallies)
    return replace(
        tallies[0],
        part="all",
        planned=float(np.mean([t.planned for t in tallies])),
        at_places=sum(t.at_places * t.placed for t in tallies) / placed,
        placed=placed,
        found=sum(t.found for t in tallies),
        false_alarms=sum(t.false_alarms for t in tallies),
        postures=sum(t.postures for t in tallies),
    )


def table(tallies: list[Tally]) -> str:
    """A line per part, rig and number of images for all kinds together, then one per kind of all parts."""
    lines = [
        "| part | lights for | images | planned | at these places | found | 95 % | false alarms |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for t in tallies:
        if t.kind == "all":
            alarms = f"{t.false_alarms} in {t.postures}"
            lines.append(f"| {t.part} | {t.objective} | {t.min_images} | {_cells(t)} | {alarms} |")
    lines += [
        "",
        "| kind | lights for | images | planned | at these places | found | 95 % |",
        "|---|---|---|---|---|---|---|",
    ]
    kinds = dict.fromkeys(t.kind for t in tallies if t.kind != "all")
    for objective, min_images, kind in itertools.product(OBJECTIVES, MIN_IMAGES, kinds):
        own = [t for t in tallies if (t.objective, t.min_images, t.kind) == (objective, min_images, kind)]
        if own:
            lines.append(f"| {kind} | {objective} | {min_images} | {_cells(joined(own))} |")
    return "\n".join(lines)


def _cells(t: Tally) -> str:
    low, high = interval(t.found, t.placed)
    return (
        f"{100 * t.planned:.0f} % | {100 * t.at_places:.0f} % | {100 * t.found / t.placed:.0f} % of {t.placed} | "
        f"{100 * low:.0f} to {100 * high:.0f} %"
    )


def plot(tallies: list[Tally], path: Path) -> None:
    """Predicted across, found up, a dot per part, rig and kind; the line is where they are equal."""
    shown = list(itertools.product(MIN_IMAGES, ("planned", "at_places")))
    with fixed_style():
        figure, panels = chart(
            title="Planned and found, kind by kind",
            x_label="planned [%]",
            labels=[
                f"found [%], {'all places' if what == 'planned' else 'these places'}, {k} image{'s' * (k > 1)}"
                for k, what in shown
            ],
        )
        for panel, (min_images, what) in zip(panels, shown, strict=True):
            own = [t for t in tallies if t.kind != "all" and t.min_images == min_images]
            found = [100.0 * t.found / t.placed for t in own]
            panel.plot([100.0 * getattr(t, what) for t in own], found, ".", color="#5c636e")
            panel.plot([0.0, 100.0], [0.0, 100.0])
        figure_image(figure).save(path)


def main(arguments: list[str] | None = None) -> None:
    """Close the loop, print the tables, write all tallies."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loop", description=__doc__)
    parser.add_argument("--parts", nargs="+", default=list(PARTS), help="samples, or files of other parts")
    parser.add_argument("--objectives", nargs="+", choices=OBJECTIVES, default=list(OBJECTIVES))
    parser.add_argument("--finish", choices=FINISHES, default="as-filed", help="of the surface")
    parser.add_argument("--waviness", type=float, default=0.0, help="of the parts: root mean square slope [°]")
    parser.add_argument("--waviness-mm", type=float, default=1.5, help="and its correlation length [mm]")
    parser.add_argument("--lobe", type=float, default=1.0, help="of the parts: its width, as a multiple of the file's")
    parser.add_argument("--rays", type=int, default=1, help="of the simulated camera, along a side of a pixel")
    parser.add_argument(
        "--bounces", type=int, default=0, help="of light from the part to the part, in images and plans"
    )
    parser.add_argument("--false-alarms", type=float, default=DEFAULT_FALSE_ALARMS, help="per posture of a good part")
    parser.add_argument("--seeds", type=int, default=34, help="sets of defects per part")
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
    write_records(options.out / "loop.csv", tallies)
    if options.page:
        replace_block("loop" if options.finish == "as-filed" else f"loop-{options.finish}", text)
    if options.plot is not None:
        plot(tallies, options.plot)


if __name__ == "__main__":
    main()
