"""The part coloured by what the images of the best set show of each patch, and of defects on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.errors import percent
from lightopt.optimize import AREA_UNIT_MM2, Draft, Levels, Thresholds, area_units
from lightopt.report._optimum_blind import blind_layers
from lightopt.report._page import Block, Note, SurfaceView, Table
from lightopt.report._surface import ColouredSurface, SurfaceClass, SurfaceLayer, first_view
from lightopt.transforms import Posture

__all__ = ["SHOWN", "Shown", "shown_by_images", "surface_blocks"]

LEAST_USABLE, MOST_SATURATED = 2, 1
"""Images that must show a patch usably, and may show it saturated: the paper's section 5.1, as the objective
``coverage`` has it."""

# colours that stay apart with any colour vision: Okabe and Ito, Color Universal Design (2008)
SHOWN = (
    ("usable in two images or more", "#56b4e9"),
    ("usable in one image only", "#f0e442"),
    ("saturated in two images or more", "#d55e00"),
    ("shaded: usable in no image", "#0b3c5d"),
    ("the camera does not see it", "#c9ced6"),
)
_UNSEEN = len(SHOWN) - 1


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What the images of a posture show.

    Attributes
    ----------
    posture
        Of the part.
    classes
        Of all patches, indices into :data:`SHOWN`, shape (p,), uint8.
    areas
        Of each class [µm²]; of those that the camera sees, counted as the objectives count.
    """

    posture: Posture
    classes: NDArray[np.uint8]
    areas: tuple[int, ...]


def shown_by_images(levels: Levels, thresholds: Thresholds) -> NDArray[np.uint8]:
    """Class of each visible patch by its levels under each light, shape (lights, p); shape (p,), see :data:`SHOWN`."""
    saturated = levels >= thresholds.saturation
    usable = ((levels >= thresholds.shade) & ~saturated).sum(axis=0)
    several = saturated.sum(axis=0) > MOST_SATURATED
    return np.select([several, usable >= LEAST_USABLE, usable == 1], [2, 0, 1], default=3).astype(np.uint8)


def surface_blocks(draft: Draft) -> list[Block]:
    """The part to turn, once, with all that it can be coloured by; areas as a table."""
    shown = _postures(draft)
    levels = [_together(draft, shown)] if len(shown) > 1 else []
    levels += [_layer(one) for one in shown]
    defects: list[SurfaceLayer] = []
    if draft.blind is not None:
        defects = [replace(layer, group="Defects") for layer in blind_layers(draft.blind)]
        levels = [replace(layer, group="Levels of the images") for layer in levels]
    # what the lights were placed for is seen first
    of_defects = draft.results[0].answers[0].objective.name == "detectability"
    layers = [*defects, *levels] if of_defects else [*levels, *defects]
    if not layers:
        return []
    view = SurfaceView(
        surface=ColouredSurface(
            vertices=draft.table.patches.vertices,
            triangles=draft.table.patches.triangles,
            layers=tuple(layers),
            up=np.array([0.0, 0.0, 1.0]),
            toward=first_view(draft.scene.camera),
        ),
        alt=f"{draft.part.name}, coloured by what the images of the best set show of it",
        caption=" ".join(_captions(draft)),
    )
    return [view, *([_table(shown), *_together_note(draft, shown)] if shown else [])]


def _captions(draft: Draft) -> list[str]:
    low, high = draft.thresholds.shade, draft.thresholds.saturation
    captions = [
        f"{draft.part.name} as it stands at posture (0°, 0°), Z up.",
        f"A level from {low} on and below {high} is usable, one from {high} on saturated, one below {low} shaded.",
    ]
    if draft.blind is not None:
        captions.append(
            "Defects are those of the catalogue, by weight. How many are seen: percentages are of the part's surface. "
            "Why not: they are of its surface × defects, as in the table of blind spots; blue where all are seen, pale "
            "where some are and others not."
        )
    return captions


def _postures(draft: Draft) -> list[Shown]:
    table, found = draft.table, list[Shown]()
    for result in draft.results:
        if result.answers[0].nothing is not None:
            continue
        for posture, levels in zip(result.postures, result.levels, strict=True):
            seen = np.flatnonzero(table.visible[table.postures.index(posture)])
            classes = np.full(len(table.patches), _UNSEEN, np.uint8)
            classes[seen] = shown_by_images(levels, draft.thresholds)
            units = area_units(table.patches.areas[seen])
            areas = tuple(int(units[classes[seen] == k].sum()) for k in range(_UNSEEN))
            found.append(Shown(posture=posture, classes=classes, areas=areas))
    return found


def _layer(shown: Shown) -> SurfaceLayer:
    visible = sum(shown.areas)
    amounts = [*(percent(area / max(1, visible)) for area in shown.areas), ""]
    kinds = tuple(
        SurfaceClass(label=label, colour=colour, amount=amount)
        for (label, colour), amount in zip(SHOWN, amounts, strict=True)
    )
    return SurfaceLayer(name=f"posture {shown.posture}", classes=kinds, of_face=shown.classes)


def _best(shown: list[Shown]) -> NDArray[np.uint8]:
    # what one posture does not show another may
    return np.min([one.classes for one in shown], axis=0)


def _together(draft: Draft, shown: list[Shown]) -> SurfaceLayer:
    best = _best(shown)
    areas = draft.table.patches.areas
    kinds = tuple(
        SurfaceClass(label=label, colour=colour, amount=percent(float(areas[best == k].sum() / areas.sum())))
        for k, (label, colour) in enumerate(SHOWN)
    )
    return SurfaceLayer(name="the best of all postures", classes=kinds, of_face=best)


def _table(shown: list[Shown]) -> Table:
    rows = [
        [
            str(one.posture),
            *(
                f"{area * AREA_UNIT_MM2:,.2f} mm² ({percent(area / max(1, sum(one.areas)))})"
                for area in one.areas
            ),
        ]
        for one in shown
    ]
    return Table(
        header=["posture", *(label for label, _ in SHOWN[:_UNSEEN])],
        rows=rows,
        caption="Areas, and their shares of the surface that the camera sees in the posture.",
    )


def _together_note(draft: Draft, shown: list[Shown]) -> list[Block]:
    areas = draft.table.patches.areas
    best = _best(shown)
    unseen = float(areas[best == _UNSEEN].sum() / areas.sum())
    usable = float(areas[best == 0].sum() / areas.sum())
    which = "The posture shows" if len(shown) == 1 else f"The {len(shown)} postures together show"
    return [
        Note(
            text=f"{which} {percent(usable)} of the part's whole surface in two usable images or more; "
            f"{percent(unseen)} the camera never sees."
        )
    ]
