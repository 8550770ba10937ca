"""Do whole units of evidence find as much of a part as the evidence itself: planned shares, with and without units.

``python -m benchmarks.evidence_units [--parts cover-knob spout cap] [--finishes as-filed satin]
[--systems four-panel,low-ring] [--min-images 2]``. The search counts evidence in units, so that sums of images are sums
of bits (:mod:`lightopt.design.responses._evidence`). Here the evidence of each image is worked out in fine steps: a
defect is found where the images add up to T², and those but the k − 1 best to 3².
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.lighting import MADE, SYSTEMS, case_files
from benchmarks.loop import FINISHES, Prediction
from lightopt import build_scene, load_part, load_rig
from lightopt.comparison import preset_files
from lightopt.config import PartConfig, RigConfig
from lightopt.core.arrays import Bool, Float64
from lightopt.defects import CONFIRMED, DEFAULT_FALSE_ALARMS
from lightopt.design import DetectionModel, planned_catalogue
from lightopt.design.responses._evidence import PatchEvidence, spare_units
from lightopt.design.responses._image_evaluator import patch_points
from lightopt.design.responses._pairs import unpack_flags
from lightopt.optics import expose
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.scene import build_catalogue, view_from_part

STEPS = np.concatenate([np.linspace(0.0, 1.6, 65)[1:], np.linspace(1.6, 6.0, 24)[1:]])
"""Evidence that is told apart, as multiples of T²."""


class FineModel(DetectionModel):
    """With a unit for each of :data:`STEPS`."""

    def limits(self, pixels: float, footprint: float, blur: float = 0.0) -> Float64:
        return self.enough(pixels, footprint, blur)[:, None] * STEPS

    def enough(self, pixels: float, footprint: float, blur: float = 0.0) -> Float64:
        """T² of each entry."""
        alone = DetectionModel(**{**vars(self), "min_images": 1})
        return alone.limits(pixels, footprint, blur)[:, -1]


def found_by_sums(rig: RigConfig, part: PartConfig, min_images: int, options: argparse.Namespace) -> Bool:
    """Whether each planned defect is found at each inspectable patch of the first posture, shape (p, h)."""
    scene = build_scene(rig, part, defects=False)
    caster, posture = cast_rays_at(scene), scene.postures[0]
    table = build_patches(scene, caster=caster, budget=options.patches, edges=False)
    catalogue = planned_catalogue(build_catalogue(part))
    facts = {"sensor": scene.sensor, "full_scale": scene.reflectance.full_scale, "min_images": min_images}
    model = FineModel(catalogue=catalogue, false_alarms=options.false_alarms, **facts)
    view, (surface, _) = view_from_part(scene, posture), patch_points(scene, table, posture)
    surface = replace(surface, outside=caster.is_outside(view.camera.position))
    evidence = PatchEvidence(scene, table, surface, posture, model)
    widths = np.diff(STEPS, prepend=0.0)
    energies: list[Float64] = []
    levels = []
    for level, (words,) in evidence.evaluate(view.lights, caster, caster, (1.0,)):
        steps = (unpack_flags(unit, len(catalogue.defects)) > 0 for unit in words)
        energies.append(np.sum([width * step for width, step in zip(widths, steps, strict=True)], axis=0))
        full_scale = scene.reflectance.full_scale
        levels.append(expose(level[None, :], sensor=scene.sensor, exposure=1.0, full_scale=full_scale))
    images = np.stack(energies)
    # T² of each defect: that of its entry
    enough = evidence._limits[:, 0][evidence._planned.entry] / STEPS[0]
    total = images.sum(axis=0)
    spare = spare_units(levels, scene.sensor, min_images)
    decide = np.full(len(total), min_images) if spare is None else min_images - (spare > 0)
    ordered = np.sort(images, axis=0)
    found = total >= 1.0
    for k in range(2, min_images + 1):
        rest = (total - ordered[-(k - 1) :].sum(axis=0)) * enough
        found &= (rest >= CONFIRMED**2) | (decide < k)[:, None]
    return found


def main(arguments: list[str] | None = None) -> None:
    """Print both shares of each part, finish and system, and by how much they differ."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.evidence_units", description=__doc__)
    parser.add_argument("--parts", nargs="+", default=["cover-knob", "spout", *MADE])
    parser.add_argument("--finishes", nargs="+", choices=FINISHES, default=["as-filed", "satin"])
    parser.add_argument("--systems", type=lambda text: text.split(","), default=[s for s in SYSTEMS if s != "coaxial"])
    parser.add_argument("--false-alarms", type=float, default=DEFAULT_FALSE_ALARMS, help="per posture of a good part")
    parser.add_argument("--min-images", type=int, choices=[2], default=2, help="that must show a defect")
    parser.add_argument("--width", type=int, default=320, help="of the images [px]")
    parser.add_argument(
        "--larger", type=float, default=2.0, help="size of the defects, as a multiple of the catalogue's"
    )
    parser.add_argument("--patches", type=int, default=3000, help="about how many patches are visible")
    options = parser.parse_args(arguments)
    off: list[float] = []
    print(f"{'part':12s} {'finish':9s} {'system':15s} units  sums [%]")
    for name in options.parts:
        for finish in options.finishes:
            with tempfile.TemporaryDirectory(prefix="lightopt-units-") as folder:
                rig_file, part_file = case_files(Path(folder), name, finish, options)
                part = load_part(part_file)
                for path in preset_files(options.systems, Path(folder) / "presets", camera_of=load_rig(rig_file)):
                    rig = load_rig(path)
                    prediction = Prediction(rig, part, options.min_images, options)
                    by_sums = found_by_sums(rig, part, options.min_images, options)
                    shares = [
                        100.0 * float(prediction.areas @ found.mean(axis=1) / prediction.areas.sum())
                        for found in (prediction.found, by_sums)
                    ]
                    off.append(shares[0] - shares[1])
                    print(f"{name:12s} {finish:9s} {path.stem:15s} {shares[0]:5.1f} {shares[1]:5.1f}", flush=True)
    print(f"difference [points]: {np.mean(off):+.2f} on average, {np.sqrt(np.mean(np.square(off))):.2f} rms")


if __name__ == "__main__":
    main()
