"""The defects for which an inspection is planned: whole defects of the catalogue, long ones in several orientations."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce

from lightopt.core.errors import InputError, refuse
from lightopt.defects import MAX_SLOPE, PLANNING_GRID, SHAPE_KINDS, CatalogueEntry, DefectHypotheses, defect_hypotheses

MOST_HYPOTHESES = 1024  # more are refused: each costs a few bits per patch and position of a light


@dataclass(frozen=True, kw_only=True)
class PlannedDefect:
    """A defect of the catalogue in one orientation, with its middle on a patch."""

    name: str  # of the catalogue's entry
    weight: int  # a whole number; those of each entry of the part's catalogue have the same sum of weights
    # of the length, in the tangent plane from the part's X axis, counterclockwise seen from outside [rad]; see
    # :func:`lightopt.defects.tangent_direction`. None for a round defect
    turn: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class PlannedCatalogue:
    """A catalogue of defects to plan for."""

    entries: tuple[DefectHypotheses, ...]  # what pixels see of each of them; the same order as those of `defects`

    @cached_property
    def defects(self) -> tuple[PlannedDefect, ...]:
        """Entry after entry; the orientations of an entry are adjacent, evenly around half a turn."""
        # a kind may have several sizes and slopes
        members = Counter(own.entry.name for own in self.entries)
        most = reduce(math.lcm, (len(own.turns) * members[own.entry.name] for own in self.entries))
        found: list[PlannedDefect] = []
        for own in self.entries:
            name, weight = own.entry.name, most // (len(own.turns) * members[own.entry.name])
            turns = map(float, own.turns) if len(own.turns) > 1 else (None,)
            found += [PlannedDefect(name=name, weight=weight, turn=one) for one in turns]
        return tuple(found)


def planned_catalogue(catalogue: Sequence[CatalogueEntry]) -> PlannedCatalogue:
    """The defects to plan for.

    Raises InputError: No entry, a slope of 0 or above 60°, too many defects.
    """
    return _planned(tuple(catalogue))


@lru_cache(maxsize=4)
def _planned(catalogue: tuple[CatalogueEntry, ...]) -> PlannedCatalogue:
    # equal catalogues are one object, whose stencils are made once
    problems: list[str] = []
    if not catalogue:
        problems.append("defect catalogue: expected at least one kind of defect to plan for, found none")
    problems += [
        f"defect {entry.name}: expected a slope above 0° up to {math.degrees(MAX_SLOPE):g}°, found "
        f"{math.degrees(entry.shape.slope):g}°"
        for entry in catalogue
        if entry.shape.kind in SHAPE_KINDS and not 0.0 < entry.shape.slope <= MAX_SLOPE
    ]
    refuse(problems)
    entries = (one for entry in catalogue for one in entry.in_sizes_and_slopes())
    found = PlannedCatalogue(entries=tuple(defect_hypotheses(one, PLANNING_GRID) for one in entries))
    if len(found.defects) > MOST_HYPOTHESES:
        raise InputError(
            f"defect catalogue: {len(catalogue)} entries in their orientations are {len(found.defects)} hypotheses, "
            f"more than {MOST_HYPOTHESES}; plan for fewer kinds"
        )
    return found
