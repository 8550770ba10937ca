"""What a plan's images show and what others could: its blind spots beside those that no position would mend."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Literal

from lightopt.config import RigConfig
from lightopt.core.transforms import Posture
from lightopt.design._plan_progress import Share
from lightopt.design.blind_spots._blind_spots import Shown, shown_by, shown_together
from lightopt.design.blind_spots._summary import Looked
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.postures._image_evaluator import ImageEvaluator
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.design.tolerances._assessments import Setup
from lightopt.scene import PanelLight


def looked_at(
    survey: ImageEvaluator,
    rig: RigConfig,
    angles: Mapping[Posture, tuple[tuple[float, float], ...]],
    candidates: Candidates | None,
    *,
    exposures: Mapping[Posture, tuple[float, ...]],
    offered: tuple[float, ...],
    thresholds: LevelThresholds,
    least: int,
    points: int | Literal["auto"] | None = None,
    tell: Share | None = None,
) -> tuple[Looked, ...]:
    """Look at the images of a plan, and at those of all that there was to choose from in its postures.

    Parameters
    ----------
    survey
        The part, its patches being those of the blind spots.
    rig
        Whose lights they are.
    angles
        Where they stand in each posture [°].
    candidates
        Where they could stand; None where no light moves.
    exposures, offered
        Planned in each posture, and all that there were to choose from.
    thresholds
        Black level and saturation.
    least
        Images that must show a defect.
    points
        Point lights per panel, instead of the rig's.
    tell
        Called with the share that is done.
    """
    setup = Setup(
        rig=rig,
        postures=tuple(angles),
        angles=tuple(angles.values()),
        exposures=tuple(exposures[posture] for posture in angles),
        points=points,
    )
    looked: list[Looked] = []
    lights = range(len(rig.lights))
    for index, posture in enumerate(setup.postures):
        panels = [[setup.panel(index, light, (0.0, 0.0))] for light in lights]
        chosen = shown_by(
            survey.matrices(posture, panels, exposures=setup.exposures[index]), thresholds, least=least
        )
        places = panels if candidates is None else candidates.panels
        possible = _possible(survey, posture, places, offered, thresholds, least)
        looked.append(Looked(posture=posture, chosen=chosen, possible=possible))
        if tell is not None:
            tell((index + 1) / len(setup.postures))
    return tuple(looked)


def _possible(
    survey: ImageEvaluator,
    posture: Posture,
    places: Sequence[Sequence[PanelLight]],
    offered: tuple[float, ...],
    thresholds: LevelThresholds,
    least: int,
) -> Shown:
    # light by light, and of each as many positions as there is room for: all at all exposures would be much to hold
    total: Shown | None = None
    for light, panels in enumerate(places):
        matrices = chain.from_iterable(survey.in_pieces(posture, panels, exposures=offered))
        one = shown_by(matrices, thresholds, least=least, first_light=light)
        total = one if total is None else shown_together(total, one)
    assert total is not None
    return total
