"""Plans with and without further exposures: the part's own postures, and as many that are chosen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from benefit_sets import DEFECTS, STEP
from benefit_views import Looked, Row, finished, look_at, places_text
from truth import SEEN_IN

from lightopt import build_scene
from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import counted as counted_text
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design import DRAWN_PATCHES, PostureRequest, drawn_patches, find_candidates
from lightopt.design._candidates import Candidates
from lightopt.design.postures._exposures import DEFAULT_EXPOSURE_GAIN
from lightopt.design.postures._joint_choice import choose_with_exposures
from lightopt.design.postures._posture_grid import posture_grid, usable_postures
from lightopt.lights import PanelLight
from lightopt.scene import build_lights

__all__ = ["plans"]

POSTURES, POSTURE_STEP = 4, 90.0

OFFERED = {1.0 / 16.0: "1/16", 1.0 / 4.0: "1/4", 1.0: "1", 4.0: "4", 16.0: "16"}
"""Exposures, and how they are written: shorter ones for highlights, longer ones for what is dark."""


def plans(rig: RigConfig, part: PartConfig, *, finish: str, patches: int, defects: int = DEFECTS) -> Iterator[Row]:
    """Plan a part's own postures and chosen ones, at exposure 1 and with all that are offered, as the command does."""
    candidates = find_candidates(rig, step_deg=STEP)
    scene = build_scene(rig, part, defects=False)
    grid = replace(scene, postures=posture_grid(rig, part, step_deg=POSTURE_STEP))
    places = tuple(panel for some in candidates.panels for panel in some)
    usable, _ = usable_postures(grid, places)
    examined = look_at(rig, part, replace(scene, postures=usable), patches=patches, defects=defects)
    examined = finished(examined, finish)
    own = tuple(posture for posture in scene.postures if posture in usable)[:POSTURES]
    lights = build_lights(rig)
    for min_images in SEEN_IN:
        for what, among in ((f"the part's own {len(own)}", own), (f"{POSTURES} chosen", usable)):
            for offered in ((1.0,), tuple(OFFERED)):
                yield _plan(examined, among, lights, candidates, offered, part.name, finish, min_images, what)


def _plan(
    examined: Looked,
    among: Sequence[Posture],
    lights: Sequence[PanelLight],
    candidates: Candidates,
    offered: Sequence[float],
    part: str,
    finish: str,
    min_images: int,
    what: str,
) -> Row:
    evaluator = examined.evaluator
    choice = choose_with_exposures(
        evaluator,
        replace(evaluator, table=drawn_patches(evaluator.table, DRAWN_PATCHES)),
        among,
        lights,
        candidates,
        PostureRequest(min_images=min_images, count=POSTURES),
        exposures=offered,
        gain_points=DEFAULT_EXPOSURE_GAIN,
        run=RunContext(),
    )
    brackets = choice.brackets
    exposures = [(1.0,) if brackets is None else brackets.of(posture) for posture in choice.postures]
    said, found = examined.seen(choice.postures, choice.panels, exposures)
    return Row(
        part=part,
        finish=finish,
        min_images=min_images,
        what=what if len(offered) == 1 else f"{what}, {_further(exposures)}",
        lights=places_text(choice.panels),
        share=choice.cover.share,
        defects=len(examined.defects),
        predicted=int((said >= min_images).sum()),
        counted=int((found >= min_images).sum()),
    )


def _further(exposures: Sequence[Sequence[float]]) -> str:
    # how many further exposures are planned, and of each length
    planned = Counter(level for levels in exposures for level in levels if level != 1.0)
    if not planned:
        return "no further exposure pays"
    each = ", ".join(f"{planned[level]} × {text}" for level, text in OFFERED.items() if planned[level])
    return f"{counted_text(planned.total(), 'further exposure')} ({each})"
