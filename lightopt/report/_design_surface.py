"""The part coloured by what the images of the best set show of each patch, and of defects on it."""

from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import UInt8
from lightopt.core.transforms import Posture
from lightopt.design import DesignOutput, Levels, LevelThresholds, area_text, area_units, share_text
from lightopt.rendering import GRAZING_DEG, grain_of
from lightopt.report._design_blind_spots import blind_layers
from lightopt.report._page import Block, Note, SurfaceView, Table
from lightopt.report._surface import ColouredSurface, SurfaceClass, SurfaceLayer, first_view

# images that must show a patch usably, and may show it saturated: the paper's section 5.1, as the objective `coverage`
# has it
LEAST_USABLE, MOST_SATURATED = 2, 1

# colours that stay apart with any colour vision: Okabe and Ito, Color Universal Design (2008)
LEVEL_CLASSES = (
    ("usable in two images or more", "#56b4e9"),
    ("usable in one image only", "#f0e442"),
    ("saturated in two images or more", "#d55e00"),
    ("shaded: usable in no image", "#0b3c5d"),
    ("left out: seen at a grazing angle", "#cc79a7"),
    ("the camera does not see it", "#c9ced6"),
)
_UNSEEN = len(LEVEL_CLASSES) - 1
_LEFT_OUT = _UNSEEN - 1


@dataclass(frozen=True, kw_only=True)
class PostureClasses:
    """Class of each patch in a posture, indices into :data:`LEVEL_CLASSES`, shape (p,), uint8.

    `areas` are those of the inspectable classes [µm²], counted as the objectives count; `left_out` is the share of
    the surface in view that is seen at a grazing angle, `grain` how far shares may be off since each patch counts as
    its middle does.
    """

    posture: Posture
    classes: UInt8
    areas: tuple[int, ...]
    left_out: float
    grain: float


def level_classes(levels: Levels, thresholds: LevelThresholds) -> UInt8:
    """Class of each inspectable patch (:data:`LEVEL_CLASSES`) by its levels under each light, shape (lights, p)."""
    saturated = levels >= thresholds.saturation
    usable = ((levels >= thresholds.shade) & ~saturated).sum(axis=0)
    several = saturated.sum(axis=0) > MOST_SATURATED
    return np.select([several, usable >= LEAST_USABLE, usable == 1], [2, 0, 1], default=3).astype(np.uint8)


def surface_blocks(output: DesignOutput) -> list[Block]:
    """One view of the part with all its colourings; areas as a table."""
    shown = _postures(output)
    levels = [_combined_layer(output, shown)] if len(shown) > 1 else []
    levels += [_layer(one) for one in shown]
    defects: list[SurfaceLayer] = []
    if output.result.blind is not None:
        defects = [replace(layer, group="Defects") for layer in blind_layers(output.result.blind)]
        levels = [replace(layer, group="Levels of the images") for layer in levels]
    # what the lights were placed for is seen first
    of_defects = output.result.results[0].answers[0].objective.name == "detectability"
    layers = [*defects, *levels] if of_defects else [*levels, *defects]
    if not layers:
        return []
    view = SurfaceView(
        surface=ColouredSurface(
            vertices=output.patches.patches.vertices,
            triangles=output.patches.patches.triangles,
            layers=tuple(layers),
            up=np.array([0.0, 0.0, 1.0]),
            toward=first_view(output.result.scene.camera),
        ),
        alt=f"{output.result.part.name}, coloured by what the images of the best set show of it",
        caption=" ".join(_captions(output)),
    )
    return [view, *([_table(shown), *_combined_note(output, shown)] if shown else [])]


def _captions(output: DesignOutput) -> list[str]:
    low, high = output.result.thresholds.shade, output.result.thresholds.saturation
    captions = [
        f"{output.result.part.name} as it stands at posture (0°, 0°), Z up.",
        f"A level from {low} on and below {high} is usable, one from {high} on saturated, one below {low} shaded.",
    ]
    if output.result.blind is not None:
        captions.append(
            "Defects are those of the catalogue, by weight. How many are seen: percentages are of the part's surface. "
            "Why not: they are of its surface × defects, as in the table of blind spots; blue where all are seen, pale "
            "where some are and others not."
        )
    return captions


def _postures(output: DesignOutput) -> list[PostureClasses]:
    table, found = output.patches, list[PostureClasses]()
    for result in output.result.results:
        if result.answers[0].nothing is not None:
            continue
        for posture, levels in zip(result.postures, result.levels, strict=True):
            seen, left_out = table.inspectable(posture), table.left_out(posture)
            classes = np.full(len(table.patches), _UNSEEN, np.uint8)
            classes[left_out] = _LEFT_OUT
            classes[seen] = level_classes(levels, output.result.thresholds)
            own = table.patches.areas[seen]
            units, grazing = area_units(own), float(table.patches.areas[left_out].sum())
            found.append(
                PostureClasses(
                    posture=posture,
                    classes=classes,
                    areas=tuple(int(units[classes[seen] == k].sum()) for k in range(_LEFT_OUT)),
                    left_out=grazing / (grazing + float(own.sum())),
                    grain=grain_of(own),
                )
            )
    return found


def _layer(shown: PostureClasses) -> SurfaceLayer:
    counted = sum(shown.areas)
    amounts = [*(share_text(area / max(1, counted), shown.grain) for area in shown.areas), "", ""]
    kinds = tuple(
        SurfaceClass(label=label, colour=colour, amount=amount)
        for (label, colour), amount in zip(LEVEL_CLASSES, amounts, strict=True)
    )
    return SurfaceLayer(name=f"posture {shown.posture}", classes=kinds, of_face=shown.classes)


def _best_classes(shown: list[PostureClasses]) -> UInt8:
    # what one posture does not show another may
    return np.min([one.classes for one in shown], axis=0)


def _combined_layer(output: DesignOutput, shown: list[PostureClasses]) -> SurfaceLayer:
    best = _best_classes(shown)
    shares = _shares(output, best)
    kinds = tuple(
        SurfaceClass(label=label, colour=colour, amount="" if k == _LEFT_OUT else shares[k])
        for k, (label, colour) in enumerate(LEVEL_CLASSES)
    )
    return SurfaceLayer(name="the best of all postures", classes=kinds, of_face=best)


def _shares(output: DesignOutput, classes: UInt8) -> list[str]:
    # in words: of each class, of the part's surface without what is left out; the latter is of the whole surface
    own = output.patches.patches.areas
    areas, grain = np.bincount(classes, weights=own, minlength=len(LEVEL_CLASSES)), grain_of(own)
    counted = max(float(areas.sum() - areas[_LEFT_OUT]), 1e-300)
    return [
        share_text(float(area / (areas.sum() if k == _LEFT_OUT else counted)), grain) for k, area in enumerate(areas)
    ]


def _table(shown: list[PostureClasses]) -> Table:
    rows = [
        [
            str(one.posture),
            *(
                f"{area_text(area, one.grain * counted)} ({share_text(area / max(1, counted), one.grain)})"
                for area in one.areas
            ),
            share_text(one.left_out, one.grain),
        ]
        for one in shown
        for counted in [sum(one.areas)]
    ]
    return Table(
        header=["posture", *(label for label, _ in LEVEL_CLASSES[:_UNSEEN])],
        rows=rows,
        caption="Areas, and their shares of the surface that the camera sees in the posture at up to "
        f"{GRAZING_DEG:g}° to its normal. Left out: of all that it sees there, the rest.",
    )


def _combined_note(output: DesignOutput, shown: list[PostureClasses]) -> list[Block]:
    shares = _shares(output, _best_classes(shown))
    which = "The posture shows" if len(shown) == 1 else f"The {len(shown)} postures together show"
    return [
        Note(
            text=f"{which} {shares[0]} of the part's surface in two usable images or more; "
            f"{shares[_UNSEEN]} the camera never sees. {shares[_LEFT_OUT]} of the whole surface, "
            "which it sees at a grazing angle only, is left out of these shares."
        )
    ]
