"""What ``detectability`` is worth, counted: strewn defects seen under its lights, and under those of ``paper``.

``python -m benchmarks.worth [PART.yaml …] [--plan] [--out DIR]``; the sample parts by default. A catalogue is strewn
over what the camera sees, rendered under each set of lights and exposed with noise; an image shows a defect where one
of its pixels passes the plain contrast test, and a defect is seen where enough images show it. Beside each count is the
objective's own: defects with a bit set on the patch of one of their walls, in as many images.

*Lights*: the best set for ``detectability`` against the best for ``paper``, in the part's first posture: for both
finishes, for one image and for two, and with free azimuths (±45° about the rig's) where a part is named in FREE.

*Plan* (``--plan``): postures of the stage chosen with one set of lights and planned with further exposures, against as
many of the part's own, planned for the same goal in the same way; defects over all that any candidate posture sees.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks._strewn import Touched, counted, predicted, strew, touched
from benchmarks.truth import FINISHES, PARTS, RIG, SEED
from lightopt import build_scene, load_part, load_rig
from lightopt.config import PartConfig, RigConfig
from lightopt.defects import PlacedDefect
from lightopt.errors import counted as counted_text
from lightopt.optimize import (
    OBJECTIVES,
    Contrast,
    Detectability,
    Inspection,
    Thresholds,
    Trial,
    area_units,
    find_candidates,
    luminance_matrix,
    search,
    unroll,
)
from lightopt.plan import (
    DRAWN_PATCHES,
    Survey,
    Wanted,
    choose_postures,
    drawn_patches,
    plan_exposures,
    posture_grid,
    usable_postures,
)
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.scene import PanelLight, Scene, build_catalogue, build_lights
from lightopt.transforms import Posture

__all__ = ["Row", "main", "plans", "sets"]

FREE = ("spout",)
FREE_AZIMUTH, FREE_STEP = 45.0, 15.0
"""To each side [°], and the step then."""

SEEN_IN = (1, 2)
STEP = 5.0
DEFECTS = 210
THIN_FROM_PX = 12.0
POSTURES, POSTURE_STEP = 4, 90.0
EXPOSURES = (1.0, 1.0 / 4.0, 1.0 / 16.0)

Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Row:
    """A set of lights, or a plan.

    Attributes
    ----------
    part, finish, seen_in
        What was asked.
    what
        Which set or plan.
    lights
        Where they stand.
    share
        Of surface × defects that the objective says is seen.
    defects
        That were strewn.
    predicted, counted
        Of these, how many the objective says are seen, and how many are.
    """

    part: str
    finish: str
    seen_in: int
    what: str
    lights: str
    share: float
    defects: int
    predicted: int
    counted: int


@dataclass(frozen=True, eq=False, kw_only=True)
class _Looked:
    """A survey, and defects strewn over it."""

    survey: Survey
    trials: tuple[Trial, ...]
    contrast: Contrast
    defects: tuple[PlacedDefect, ...]
    traced: dict[Posture, Touched] = field(default_factory=dict[Posture, Touched])

    def pixels(self, posture: Posture) -> Touched:
        """Of the defects in a posture's image, traced when first asked for."""
        if posture not in self.traced:
            self.traced[posture] = touched(
                self.survey.scene,
                posture,
                self.defects,
                caster=self.survey.caster,
                patches=self.survey.table.patches,
                thin_from_px=THIN_FROM_PX,
            )
        return self.traced[posture]

    def seen(
        self, postures: Sequence[Posture], panels: Sequence[PanelLight], exposures: Sequence[Sequence[float]]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """In how many images each defect is, predicted and counted; exposures of a light are one image."""
        count = len(self.defects)
        scene = replace(self.survey.scene, lights=tuple(panels))
        said, found = np.zeros(count, np.int64), np.zeros(count, np.int64)
        for number, (posture, levels) in enumerate(zip(postures, exposures, strict=True)):
            pixels = self.pixels(posture)
            both = pixels.levels(scene, self.survey.caster)
            matrices = self.survey.matrices(posture, [[panel] for panel in panels], exposures=levels)
            visibility = [matrix.visibility for matrix in matrices if matrix.visibility is not None]
            said += predicted(pixels, visibility, self._first_trials(), count).sum(axis=0)
            images = [
                counted(pixels, both, scene, count, contrast=self.contrast, exposure=level, image=number)
                for level in levels
            ]
            found += np.any(images, axis=0).sum(axis=0)
        return said, found

    def _first_trials(self) -> NDArray[np.intp]:
        names = [trial.name for trial in self.trials]
        # the name of a strewn defect is its entry's and a number
        return np.array([names.index(defect.name.rsplit("-", 1)[0]) for defect in self.defects])


def _looked(rig: RigConfig, part: PartConfig, scene: Scene, *, patches: int, defects: int) -> _Looked:
    caster = cast_rays_at(scene)
    trials = unroll(build_catalogue(part))
    contrast = Contrast(sensor=scene.sensor, full_scale=scene.reflectance.full_scale)
    survey = Survey(
        scene=scene,
        table=build_patches(scene, caster=caster, budget=patches),
        caster=caster,
        inspection=Inspection(trials=trials, contrast=contrast),
    )
    placed = strew(rig, part, scene, count=defects, seed=SEED)
    return _Looked(survey=survey, trials=trials, contrast=contrast, defects=placed)


def _finished(looked: _Looked, finish: str) -> _Looked:
    scene = looked.survey.scene
    scene = replace(scene, reflectance=replace(scene.reflectance, **FINISHES[finish]))
    return replace(looked, survey=replace(looked.survey, scene=scene))


def sets(
    rig: RigConfig, part: PartConfig, *, patches: int, defects: int = DEFECTS, step: float = STEP
) -> Iterator[Row]:
    """The best lights for detectability and for paper, in the part's first posture."""
    scene = build_scene(rig, part, defects=False)
    scene = replace(scene, postures=scene.postures[:1])
    looked = _looked(rig, part, scene, patches=patches, defects=defects)
    for finish in FINISHES:
        yield from _best_sets(_finished(looked, finish), rig, part, finish, step)
    if part.name in FREE:
        free = rig.model_copy(
            update={
                "lights": tuple(
                    light.model_copy(
                        update={
                            "azimuth_range_deg": (
                                light.azimuth_deg - FREE_AZIMUTH,
                                light.azimuth_deg + FREE_AZIMUTH,
                            )
                        }
                    )
                    for light in rig.lights
                )
            }
        )
        yield from _best_sets(_finished(looked, "glossy"), free, part, "glossy, free azimuths", FREE_STEP)


def _best_sets(looked: _Looked, rig: RigConfig, part: PartConfig, finish: str, step: float) -> Iterator[Row]:
    survey = looked.survey
    scene, posture = survey.scene, survey.scene.postures[0]
    candidates = find_candidates(rig, step_deg=step, scene=scene, caster=survey.caster)
    matrix = luminance_matrix(
        scene, survey.table, posture, candidates.panels, caster=survey.caster, inspection=survey.inspection
    )
    thresholds = Thresholds.of_sensor(
        shade_share=10 / 255,
        max_level=scene.sensor.max_level,
        saturated_from=scene.sensor.saturated_from,
        black_level=scene.sensor.black_level,
    )
    weights = area_units(matrix.areas)
    paper = search([matrix], OBJECTIVES["paper"], thresholds, space=candidates.space, keep=1).best.candidates
    seen: dict[tuple[int, ...], tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
    for seen_in in SEEN_IN:
        goal = Detectability(looked.trials, seen_in)
        own = search([matrix], goal, thresholds, space=candidates.space, keep=1).best.candidates
        for what, places in (("detectability", own), ("paper", paper)):
            score = goal.score(matrix.combination(places), weights, thresholds)
            panels = [some[k] for some, k in zip(candidates.panels, places, strict=True)]
            if places not in seen:
                seen[places] = looked.seen([posture], panels, [(1.0,)])
            said, found = seen[places]
            yield Row(
                part=part.name, finish=finish, seen_in=seen_in, what=what, lights=_places(panels),
                share=score / (int(weights.sum()) * goal.total_weight), defects=len(looked.defects),
                predicted=int((said >= seen_in).sum()), counted=int((found >= seen_in).sum()),
            )  # fmt: skip


def plans(rig: RigConfig, part: PartConfig, *, patches: int, defects: int = DEFECTS) -> Iterator[Row]:
    """Chosen postures against the part's own, both with their best lights for the same goal, then exposures."""
    candidates = find_candidates(rig, step_deg=STEP)
    scene = build_scene(rig, part, defects=False)
    grid = replace(scene, postures=posture_grid(rig, part, step_deg=POSTURE_STEP))
    places = tuple(panel for some in candidates.panels for panel in some)
    offered, _ = usable_postures(grid, places, cast_rays_at(scene))
    looked = _looked(rig, part, replace(scene, postures=offered), patches=patches, defects=defects)
    survey = looked.survey
    drawn = replace(survey, table=drawn_patches(survey.table, DRAWN_PATCHES))
    own = tuple(posture for posture in scene.postures if posture in offered)[:POSTURES]
    lights = build_lights(rig)
    for seen_in in SEEN_IN:
        wanted = Wanted(least=seen_in, count=POSTURES)
        for what, among in ((f"the part's own {len(own)}", own), (f"{POSTURES} chosen", offered)):
            choice = choose_postures(survey, drawn, among, lights, candidates, wanted)
            brackets = plan_exposures(
                survey, choice.postures, [choice.panels] * len(choice.postures), EXPOSURES, least=seen_in
            )
            for bracketed in (False, True):
                exposures = [brackets.of(p) if bracketed else (1.0,) for p in choice.postures]
                said, found = looked.seen(choice.postures, choice.panels, exposures)
                yield Row(
                    part=part.name, finish="glossy", seen_in=seen_in,
                    what=what + (f", {_further(exposures)}" if bracketed else ""),
                    lights=_places(choice.panels), share=brackets.after if bracketed else brackets.before,
                    defects=len(looked.defects), predicted=int((said >= seen_in).sum()),
                    counted=int((found >= seen_in).sum()),
                )  # fmt: skip


def _further(exposures: Sequence[Sequence[float]]) -> str:
    return counted_text(sum(map(len, exposures)) - len(exposures), "further exposure")


def _places(panels: Sequence[PanelLight]) -> str:
    angles: list[str] = []
    for panel in panels:
        x, y, z = panel.centre / np.linalg.norm(panel.centre)
        elevation, azimuth = math.degrees(math.asin(z)), math.degrees(math.atan2(y, x)) % 360.0
        angles.append(f"{elevation:.0f}°/{azimuth:.0f}°")
    return ", ".join(angles)


def table(rows: Sequence[Row]) -> str:
    """A line for each row."""
    lines = [
        "| part | surface | images | set | lights | share | predicted | counted |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.part} | {r.finish} | {r.seen_in} | {r.what} | {r.lights} | {100.0 * r.share:.1f} % | "
        f"{r.predicted} of {r.defects} | {r.counted} |"
        for r in rows
    ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Count, print a table, write all rows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.worth", description=__doc__)
    parser.add_argument("parts", nargs="*", type=Path, metavar="PART", default=list(PARTS), help="part files")
    parser.add_argument("--rig", type=Path, default=RIG, help="rig file")
    parser.add_argument("--plan", action="store_true", help="postures and exposures instead of lights")
    parser.add_argument("--patches", type=int, default=50_000, help="about how many patches are visible")
    parser.add_argument("--defects", type=int, default=DEFECTS, help="how many are strewn")
    parser.add_argument("--out", type=Path, default=Path("out/worth"), help="folder of worth.csv or plan.csv")
    options = parser.parse_args(arguments)
    rig = load_rig(options.rig)
    rows: list[Row] = []
    for path in options.parts:
        part = load_part(path)
        made = plans if options.plan else sets
        for row in made(rig, part, patches=options.patches, defects=options.defects):
            rows.append(row)
            print(table(rows).splitlines()[-1], flush=True)
    print("\n" + table(rows))
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / ("plan.csv" if options.plan else "worth.csv")
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            ["part", "surface", "seen_in", "set", "lights", "share", "defects", "predicted", "counted"]
        )
        for r in rows:
            numbers = (f"{r.share:.6f}", r.defects, r.predicted, r.counted)
            writer.writerow([r.part, r.finish, r.seen_in, r.what, r.lights, *numbers])
    print(path)


if __name__ == "__main__":
    main()
