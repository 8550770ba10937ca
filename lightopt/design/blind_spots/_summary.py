"""Blind spots of a result: of the chosen lights and of all that lights can do, per posture and in all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lightopt.core.arrays import Float64
from lightopt.core.run_context import Share
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates
from lightopt.design._tolerances import Setup
from lightopt.design.blind_spots._blind_spots import (
    BlindReason,
    BlindSpots,
    DefectVisibility,
    blind_spots,
    blind_text,
    by_light,
    defect_visibility,
)
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.responses._image_evaluator import ImageEvaluator
from lightopt.design.responses._luminance_matrix import LevelThresholds

BLIND_SHARES_OF = "the part's surface without that seen at grazing angles only, × defects by weight"
"""What shares of blind spots are shares of."""

BLIND_LIGHTS = ("chosen", "best for each defect")
"""Light positions in the rows of the tables: the chosen ones; or for each defect any that show it, which no one set of
positions need do for all."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PostureVisibility:
    """What a posture's images show of defects.

    `chosen` is with the chosen lights and exposures, `possible` with all that there were to choose from.
    """

    posture: Posture
    chosen: DefectVisibility
    possible: DefectVisibility


@dataclass(frozen=True, eq=False, kw_only=True)
class BlindSpotSummary:
    """Blind spots of the whole surface.

    objective: Whose defects they are.
    lights: Names, in the rig's order.
    chosen, possible: Over all postures, by all their images together: of the chosen lights, and of all that the
        lights can do.
    chosen_in, possible_in: The same of the images of each posture alone.
    """

    objective: DetectabilityObjective
    lights: tuple[str, ...]
    postures: tuple[Posture, ...]
    chosen: BlindSpots
    possible: BlindSpots
    chosen_in: tuple[BlindSpots, ...]
    possible_in: tuple[BlindSpots, ...]

    @staticmethod
    def of(
        visibility: Sequence[PostureVisibility],
        areas: Float64,
        objective: DetectabilityObjective,
        lights: Sequence[str],
    ) -> BlindSpotSummary:
        """Combine postures; `areas` are those of all patches of the run [mm²], shape (n,)."""
        chosen = [one.chosen for one in visibility]
        possible = [one.possible for one in visibility]
        return BlindSpotSummary(
            objective=objective,
            lights=tuple(lights),
            postures=tuple(one.posture for one in visibility),
            chosen=blind_spots(areas, chosen),
            possible=blind_spots(areas, possible),
            chosen_in=tuple(blind_spots(areas, [one]) for one in chosen),
            possible_in=tuple(blind_spots(areas, [one]) for one in possible),
        )

    def parts(self) -> list[tuple[Posture | None, BlindSpots, BlindSpots]]:
        """All postures together (None), then each: with the chosen lights, and with all that they can do."""
        own = zip(self.postures, self.chosen_in, self.possible_in, strict=True)
        return [(None, self.chosen, self.possible), *own]

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "min_images": self.objective.min_images,
            "shares_of": BLIND_SHARES_OF,
            "surface_mm2": round(float(self.chosen.areas.sum()), 6),
            "grain": round(self.chosen.grain, 6),
            **self._both(self.chosen, self.possible),
            "postures": [
                {"posture": posture.as_dict(), **self._both(chosen, possible)}
                for posture, chosen, possible in self.parts()
                if posture is not None
            ],
        }

    def _both(self, chosen: BlindSpots, possible: BlindSpots) -> dict[str, Any]:
        return {"chosen": self._facts(chosen), "any_position": self._facts(possible)}

    def _facts(self, spots: BlindSpots) -> dict[str, Any]:
        reasons = [
            {"reason": blind_text(code, self.lights), "share": round(share, 6)}
            for code, share in spots.by_reason().items()
        ]
        return {"seen": round(spots.seen, 6), "blind": reasons, "left_out_of_surface": round(spots.left_out, 6)}


def reason_names(lights: Sequence[str]) -> list[tuple[int, str]]:
    """All codes and their names."""
    codes = [*BlindReason, *(BlindReason.SATURATED + light for light in range(1, len(lights)))]
    return [(int(code), blind_text(int(code), lights)) for code in codes]


def planned_visibility(
    evaluator: ImageEvaluator,
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
    `all_exposures` are those to choose from. The patches of `evaluator` are those of the blind spots.
    """
    found: list[PostureVisibility] = []
    for index, posture in enumerate(setup.postures):
        panels = [[panel] for panel in setup.panels(index)]
        matrices = evaluator.matrices(posture, panels, exposures=setup.exposures[index])
        # light by light, and of each as many positions as there is room for: all at all exposures would be much to hold
        every = (
            (
                (matrix, 0)
                for some in evaluator.in_batches(posture, positions, exposures=all_exposures)
                for matrix in some
            )
            for positions in (panels if candidates is None else candidates.panels)
        )
        found.append(
            PostureVisibility(
                posture=posture,
                chosen=defect_visibility(by_light(matrices), thresholds, least=least),
                possible=defect_visibility(every, thresholds, least=least),
            )
        )
        if progress is not None:
            progress((index + 1) / len(setup.postures))
    return tuple(found)
