"""What a plan's images show of defects, beside what all positions and exposures to choose from could show."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from itertools import chain

from lightopt.core.run_context import Share
from lightopt.core.transforms import Posture
from lightopt.design.blind_spots._blind_spots import DefectVisibility, combined_visibility, defect_visibility
from lightopt.design.blind_spots._summary import PostureVisibility
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.postures._image_evaluator import ImageEvaluator
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.design.tolerances._assessments import Setup
from lightopt.scene import PanelLight


def planned_visibility(
    survey: ImageEvaluator,
    setup: Setup,
    candidates: Candidates | None,
    *,
    all_exposures: tuple[float, ...],
    thresholds: LevelThresholds,
    least: int,
    progress: Share | None = None,
) -> tuple[PostureVisibility, ...]:
    """Visibility of defects in each posture: `least` images must show one.

    `setup` has the lights, postures and planned exposures; `candidates` (None where no light moves) and
    `all_exposures` are those to choose from. The patches of `survey` are those of the blind spots.
    """
    found: list[PostureVisibility] = []
    for index, posture in enumerate(setup.postures):
        panels = [[setup.panel(index, light, (0.0, 0.0))] for light in range(len(setup.rig.lights))]
        matrices = survey.matrices(posture, panels, exposures=setup.exposures[index])
        chosen = defect_visibility(matrices, thresholds, least=least)
        positions = panels if candidates is None else candidates.panels
        possible = _possible(survey, posture, positions, all_exposures, thresholds, least)
        found.append(PostureVisibility(posture=posture, chosen=chosen, possible=possible))
        if progress is not None:
            progress((index + 1) / len(setup.postures))
    return tuple(found)


def _possible(
    survey: ImageEvaluator,
    posture: Posture,
    positions: Sequence[Sequence[PanelLight]],
    exposures: tuple[float, ...],
    thresholds: LevelThresholds,
    least: int,
) -> DefectVisibility:
    # light by light, and of each as many positions as there is room for: all at all exposures would be much to hold
    return reduce(
        combined_visibility,
        (
            defect_visibility(
                chain.from_iterable(survey.in_pieces(posture, panels, exposures=exposures)),
                thresholds,
                least=least,
                first_light=light,
            )
            for light, panels in enumerate(positions)
        ),
    )
