"""Draw docs/pictures/statistic.png: how far the sample knob's images let defects of the catalogue stand out.

``python scripts/statistic_picture.py [PNG]``. Posture (0°, 0°) of the sample rig as filed: the share of the inspectable
surface on which the statistic is expected to be so great or greater, by all images and by those but the best one.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lightopt import build_scene, load_part, load_rig
from lightopt.core.arrays import Float64
from lightopt.defects import BUILT_IN_CATALOGUE, CONFIRMED
from lightopt.design import DetectionModel, planned_catalogue
from lightopt.design.responses._image_evaluator import ImageEvaluator
from lightopt.design.responses._pairs import unpack_flags
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.report import chart, figure_image, fixed_style

ROOT = Path(__file__).resolve().parent.parent
UNITS = 3
TICKS = (1, 2, 3, 5, 10, 20, 50)
STEPS = np.geomspace(0.5, 60.0, 14 * UNITS)  # of the statistic of an image


@dataclass(frozen=True, eq=False, kw_only=True)
class Levels(DetectionModel):
    """Units of evidence as steps of the statistic of an image.

    needed: What a defect of each entry needs to count as found where one image may decide; filled in.
    """

    steps: tuple[float, ...]
    needed: list[Float64]

    def limits(self, pixels: float, footprint: float, blur: float = 0.0) -> Float64:
        """The same steps for each entry."""
        self.needed[:] = [np.sqrt(super().limits(pixels, footprint, blur)[:, -1])]
        return np.tile(np.square(self.steps), (len(self.catalogue.entries), 1))


def statistic_picture(target: Path, *, patches: int = 20_000) -> None:
    """Draw the picture."""
    rig = load_rig(ROOT / "configs" / "rigs" / "four-panel.yaml")
    part = load_part(ROOT / "configs" / "parts" / "cover-knob.yaml")
    scene = build_scene(rig, part, defects=False)
    caster, posture = cast_rays_at(scene), scene.postures[0]
    table = build_patches(scene, caster=caster, budget=patches, edges=False)
    catalogue = planned_catalogue(BUILT_IN_CATALOGUE)
    seen = table.inspectable(posture)
    needed: list[Float64] = []

    def images(steps: tuple[float, ...]) -> Iterator[np.ndarray]:
        # of each light: how many of the steps each pair of patch and defect reaches, shape (p, t)
        levels = Levels(
            catalogue=catalogue,
            sensor=scene.sensor,
            full_scale=scene.reflectance.full_scale,
            steps=steps,
            needed=needed,
        )
        evaluator = ImageEvaluator(scene=scene, table=table, caster=caster, detection=levels)
        for units in evaluator.flags(posture, [[light] for light in scene.lights]):
            here = np.searchsorted(evaluator.patches, seen)
            yield unpack_flags(units[0][:, here], len(catalogue.defects)).sum(axis=0, dtype=np.int64)

    reached = np.sum([np.stack(list(images(tuple(some)))) for some in STEPS.reshape(-1, UNITS)], axis=0)
    evidence = np.sort(np.concatenate([[0.0], STEPS])[reached] ** 2, axis=0)
    areas = table.patches.areas[seen]
    with fixed_style():
        figure, panels = chart(
            title="How far defects stand out on the cover knob",
            x_label="expected Z [standard deviations]",
            labels=[
                "share of the surface with this Z or more [%], all images",
                "the same, all images but the best one",
            ],
            log_x=True,
        )
        for panel, shown in zip(panels, (evidence.sum(axis=0), evidence[:-1].sum(axis=0)), strict=True):
            for name in dict.fromkeys(defect.name for defect in catalogue.defects):
                own = [t for t, defect in enumerate(catalogue.defects) if defect.name == name]
                z = np.sqrt(shown[:, own])
                share = [100.0 * areas @ (z >= step).mean(axis=1) / areas.sum() for step in STEPS]
                panel.plot(STEPS, share, label=name)
        low, high = float(needed[0].min()), float(needed[0].max())
        panels[0].axvspan(low, high, color="#d55e00", alpha=0.35, label=f"needed: {low:.1f} to {high:.1f}")
        panels[1].axvline(CONFIRMED, color="#d55e00", linestyle="--", label=f"needed: {CONFIRMED:g}")
        handles, names = panels[1].get_legend_handles_labels()
        panels[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        panels[1].legend(handles[-1:], names[-1:], loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        for panel in panels:
            panel.set_xlim(1.0, 60.0)
            panel.set_ylim(0.0, 104.0)
            panel.set_xticks(TICKS, labels=[f"{tick:g}" for tick in TICKS])
        figure_image(figure).save(target)


if __name__ == "__main__":
    statistic_picture(Path(sys.argv[1]) if sys.argv[1:] else ROOT / "docs" / "pictures" / "statistic.png")
