"""Defects strewn over a part, as many as there is room for."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lightopt.config import PartConfig, RigConfig
from lightopt.config._defects import CatalogueEntryConfig
from lightopt.core.errors import InputError
from lightopt.defects import PlacedDefect, tangent_direction
from lightopt.geometry import SurfaceFinder
from lightopt.inspection import place_random_defects
from lightopt.scene import Scene

__all__ = ["strew"]


def strew(
    rig: RigConfig,
    part: PartConfig,
    scene: Scene,
    *,
    count: int,
    seed: int,
    catalogue: Sequence[CatalogueEntryConfig] = (),
    turns: int | None = None,
) -> tuple[PlacedDefect, ...]:
    """Defects where the function behind ``lightopt defects`` puts them; as many as there is room for.

    Parameters
    ----------
    rig, part, scene
        The scene's postures are those in which the defects must be seen.
    count, seed
        As for :func:`lightopt.inspection.place_random_defects`.
    catalogue
        Instead of the part's.
    turns
        So many directions in turn, evenly from the part's X axis on, instead of those drawn.
    """
    postures = tuple(
        part.postures[0].model_copy(
            update={"elevation_deg": posture.elevation_deg, "rotation_deg": posture.rotation_deg}
        )
        for posture in scene.postures
    )
    own = part.model_copy(update={"postures": postures, "defects": ()})
    if catalogue:
        own = own.model_copy(update={"defect_catalogue": tuple(catalogue)})
    while True:
        try:
            found = place_random_defects(rig, own, count=count, seed=seed)
            break
        except InputError:
            if count < 4:
                raise
            count = count * 2 // 3
    placement, finder = scene.placement, SurfaceFinder(scene.mesh)
    axes = placement.rotation
    placed: list[PlacedDefect] = []
    for index, one in enumerate(found):
        place = finder.nearest(placement.to_part(np.array(one.at_mm)))
        turn = math.radians(one.direction_deg) if turns is None else 2.0 * math.pi * (index % turns) / turns
        along = tangent_direction(place.normal, turn, x_axis=axes[:, 0], y_axis=axes[:, 1])
        placed.append(
            PlacedDefect(name=one.name, shape=one.entry.shape, position=place.point, normal=place.normal, along=along)
        )
    return tuple(placed)
