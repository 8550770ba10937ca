"""The defects for which an inspection is planned: one hypothesis per slope and direction, stain and haze."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from lightopt.core.errors import InputError
from lightopt.defects import MAX_SLOPE, SHAPE_KINDS, CatalogueEntry, DefectKind

DIRECTIONS = 8
"""Directions around that a wall may lean to."""

MOST_TRIALS = 1024  # more are refused: each costs a bit per patch and position of a light


@dataclass(frozen=True, kw_only=True)
class DefectHypothesis:
    """The change of the surface by a defect, at its position.

    A scratch, dent, bump, pit or blister is its wall where that is steepest: a surface whose normal leans by the slope
    in one of several directions. A stain and a haze keep the normal and change the reflectance.

    name: Of the catalogue's entry.
    weight: A whole number; the hypotheses of each entry of the catalogue have the same sum of weights.
    length, width: Of the defect's outline [mm].
    slope: By which the normal leans [rad]; 0 for stains and hazes.
    direction: In which it leans, in the tangent plane from the part's X axis, counterclockwise seen from outside
        [rad]; see :func:`lightopt.defects.tangent_direction`.
    R_d_factor, sigma_factor: By which R_d and σ are multiplied.
    """

    name: str
    kind: DefectKind
    weight: int
    length: float
    width: float
    slope: float = 0.0
    direction: float = 0.0
    R_d_factor: float = 1.0
    sigma_factor: float = 1.0


def defect_hypotheses(
    catalogue: Sequence[CatalogueEntry], *, directions: int = DIRECTIONS
) -> tuple[DefectHypothesis, ...]:
    """The hypotheses of a catalogue, entry after entry, directions counterclockwise from the reference axis.

    `directions` is even and 8 or more, so that each wall has one that faces it.

    Raises InputError: No entry, a slope of 0 or above 60°, fewer than 8 or odd directions, too many hypotheses.
    """
    problems: list[str] = []
    if not catalogue:
        problems.append("defect catalogue: expected at least one kind of defect to plan for, found none")
    if directions < DIRECTIONS or directions % 2:
        problems.append(f"directions of walls: expected an even number, {DIRECTIONS} or more, found {directions}")
    problems += [
        f"defect {entry.name}: expected a slope above 0° up to {math.degrees(MAX_SLOPE):g}°, found "
        f"{math.degrees(entry.shape.slope):g}°"
        for entry in catalogue
        if entry.shape.kind in SHAPE_KINDS and not 0.0 < entry.shape.slope <= MAX_SLOPE
    ]
    turns = [directions if entry.shape.kind in SHAPE_KINDS else 1 for entry in catalogue]
    if sum(turns) > MOST_TRIALS:
        problems.append(
            f"defect catalogue: {len(catalogue)} entries in {directions} directions are {sum(turns)} trials, more than "
            f"{MOST_TRIALS}; plan for fewer kinds"
        )
    if problems:
        raise InputError(*problems)
    return tuple(
        DefectHypothesis(
            name=entry.name,
            kind=entry.shape.kind,
            weight=directions // count,
            length=entry.shape.length,
            width=entry.shape.width,
            slope=entry.shape.slope if count > 1 else 0.0,
            direction=2.0 * math.pi * turn / directions,
            R_d_factor=entry.shape.R_d_factor,
            sigma_factor=entry.shape.sigma_factor,
        )
        for entry, count in zip(catalogue, turns, strict=True)
        for turn in range(count)
    )
