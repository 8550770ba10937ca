"""The part coloured by why defects on it stay invisible."""

from __future__ import annotations

import numpy as np

from lightopt.optimize import Blind, BlindSpots, Draft
from lightopt.report._optimum_plan import blind_tables
from lightopt.report._optimum_surface import view_of_part
from lightopt.report._page import Block, SurfaceView
from lightopt.report._surface import SurfaceClass, SurfaceLayer

__all__ = ["blind_blocks"]

# Okabe and Ito; what is seen and what no camera sees as in the view of what the images show
KINDS = (
    (Blind.SEEN, "all defects seen", "#56b4e9"),
    (Blind.CONTRAST, "contrast under noise", "#f0e442"),
    (Blind.SATURATED, "saturated by a light", "#d55e00"),
    (Blind.SHADOWED, "shadowed", "#0b3c5d"),
    (Blind.GRAZING, "seen at a grazing angle", "#cc79a7"),
    (Blind.CAMERA, "never seen by the camera", "#c9ced6"),
)


def blind_blocks(draft: Draft) -> list[Block]:
    """Blind spots by reason: the part to turn, and the shares."""
    blocks = blind_tables(draft)
    if draft.blind:
        surface = view_of_part(draft, tuple(blind_layer(name, spots) for name, spots in draft.blind))
        view = SurfaceView(
            surface=surface,
            alt=f"{draft.part.name}, coloured by why defects on it are not seen",
            caption="The reason at a patch is that of the defects that are not seen there; shares are of the surface.",
        )
        blocks.insert(0, view)
    return blocks


def blind_layer(name: str, spots: BlindSpots) -> SurfaceLayer:
    """The reasons of every patch; which light saturates it is told by the table."""
    codes = np.minimum(spots.codes, Blind.SATURATED)
    of_face = np.zeros(len(codes), np.uint8)
    kinds: list[SurfaceClass] = []
    for index, (code, label, colour) in enumerate(KINDS):
        of_face[codes == code] = index
        share = float(spots.areas[codes == code].sum() / spots.areas.sum())
        kinds.append(SurfaceClass(label=label, colour=colour, amount=f"{100.0 * share:.1f} %"))
    return SurfaceLayer(name=name, classes=tuple(kinds), of_face=of_face)
