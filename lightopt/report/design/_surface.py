"""The part coloured by what the images of the best set show of each patch, and of defects on it, and why not more."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lightopt import design
from lightopt.core.arrays import UInt8
from lightopt.core.transforms import Posture
from lightopt.rendering import GRAZING_DEG, grain_of, trace_samples
from lightopt.report._page import Block, Note, SurfaceView, Table
from lightopt.report._pictures import DPI, POINT, SOFT, figure_image, fixed_style, hex_colour
from lightopt.report._surface import SurfaceLayer, standing_surface, surface_classes
from lightopt.scene import view_from_part

# images that must show a patch usably, and may show it saturated: the paper's section 5.1, as the objective `coverage`
# has it
LEAST_USABLE, MOST_SATURATED = 2, 1

# colours that stay apart with any colour vision: Okabe and Ito, Color Universal Design (2008)
LEVEL_CLASSES = (
    ("usable in two images or more", "#56b4e9"),
    ("usable in one image only", "#f0e442"),
    ("saturated in two images or more", "#d55e00"),
    ("shaded: usable in no image", "#0b3c5d"),
    ("left out: at a grazing angle or an edge", "#cc79a7"),
    ("the camera does not see it", "#c9ced6"),
)
_UNSEEN = len(LEVEL_CLASSES) - 1
_LEFT_OUT = _UNSEEN - 1

# matplotlib's cividis (Nuñez, Anderton and Renslow, 2018) in equal steps: the brighter the more is seen
SHARES = (
    (0.0, "none", "#00224e"),
    (0.25, "up to a quarter", "#35456c"),
    (0.5, "up to a half", "#666970"),
    (0.75, "up to three quarters", "#948e77"),
    (1.0, "more, not all", "#c8b866"),
    (np.inf, "all", "#fee838"),
)

BACKGROUND = (255, 255, 255)
LEAST_SHADE = 0.8  # brightness of a surface that is seen edge on; one that faces the camera has its legend's colour
BLOCK_ROWS = 64  # of a picture, traced at once
LEAST_WIDTH = 640  # of a picture with its legend [px]
SMALLEST_LEGEND, LARGEST_LEGEND = 13, 26  # sizes of a legend's text [px]; in between a fiftieth of the picture's width


def level_classes(levels: design.Levels, thresholds: design.LevelThresholds) -> UInt8:
    """Class of each inspectable patch (:data:`LEVEL_CLASSES`) by its levels under each light, shape (lights, p)."""
    saturated = levels >= thresholds.saturation
    usable = ((levels >= thresholds.shade) & ~saturated).sum(axis=0)
    several = saturated.sum(axis=0) > MOST_SATURATED
    return np.select([several, usable >= LEAST_USABLE, usable == 1], [2, 0, 1], default=3).astype(np.uint8)


def surface_blocks(output: design.DesignOutput) -> list[Block]:
    """One view of the part with all its colourings; areas as a table."""
    shown = _postures(output)
    levels = [layer for layer, _ in shown]
    summary: list[Block] = []
    if shown:
        # what one posture does not show another may
        best = np.min([layer.of_face for layer in levels], axis=0)
        shares = _shares(output, best)
        summary = [_table([row for _, row in shown]), _combined_note(shares, len(shown))]
        if len(shown) > 1:
            classes = surface_classes(LEVEL_CLASSES, [*shares[:_LEFT_OUT], "", shares[_UNSEEN]])
            levels.insert(0, SurfaceLayer(name="the best of all postures", classes=classes, of_face=best))
    defects: list[SurfaceLayer] = []
    if output.result.blind is not None:
        defects = [replace(layer, group="Defects") for layer in blind_layers(output.result.blind)]
        levels = [replace(layer, group="Levels of the images") for layer in levels]
    # what the lights were placed for is seen first
    of_defects = output.result.results[0].answers[0].objective.name == "detectability"
    layers = [*defects, *levels] if of_defects else [*levels, *defects]
    if not layers:
        return []
    patches, camera = output.patches.patches, output.result.scene.camera
    surface = standing_surface(patches.vertices, patches.triangles, tuple(layers), camera)
    alt = f"{output.result.part.name}, coloured by what the images of the best set show of it"
    return [SurfaceView(surface=surface, alt=alt, caption=_caption(output)), *summary]


def _caption(output: design.DesignOutput) -> str:
    low, high = output.result.thresholds.shade, output.result.thresholds.saturation
    caption = (
        f"{output.result.part.name} at posture (0°, 0°), Z up. A level from {low} on and below {high} is usable, one "
        f"from {high} on saturated, one below {low} shaded."
    )
    if output.result.blind is None:
        return caption
    return (
        f"{caption} Defects are those of the catalogue, by weight. How many are seen: percentages are of the part's "
        "surface. Why not: they are of its surface × defects, as in the table of blind spots; blue where all are seen, "
        "pale where some are and others not."
    )


def _postures(output: design.DesignOutput) -> list[tuple[SurfaceLayer, list[str]]]:
    # of each posture the classes of the patches, and a row of the table of areas, counted as the objectives count
    table, found = output.patches, list[tuple[SurfaceLayer, list[str]]]()
    for result in output.result.results:
        if result.answers[0].nothing is not None:
            continue
        for posture, levels in zip(result.postures, result.levels, strict=True):
            seen, left_out = table.inspectable(posture), table.left_out(posture)
            classes = np.full(len(table.patches), _UNSEEN, np.uint8)
            classes[left_out] = _LEFT_OUT
            classes[seen] = level_classes(levels, output.result.thresholds)
            own = table.patches.areas[seen]
            units, grain = design.area_units(own), grain_of(own)
            areas = [int(units[classes[seen] == k].sum()) for k in range(_LEFT_OUT)]
            counted = sum(areas)
            shares = [design.share_text(area / max(1, counted), grain) for area in areas]
            legend = surface_classes(LEVEL_CLASSES, [*shares, "", ""])
            layer = SurfaceLayer(name=f"posture {posture}", classes=legend, of_face=classes)
            cells = [f"{design.area_text(a, grain * counted)} ({b})" for a, b in zip(areas, shares, strict=True)]
            grazing = float(table.patches.areas[left_out].sum())
            rest = design.share_text(grazing / (grazing + float(own.sum())), grain)
            found.append((layer, [str(posture), *cells, rest]))
    return found


def _shares(output: design.DesignOutput, classes: UInt8) -> list[str]:
    # in words: of each class, of the part's surface without what is left out; the latter is of the whole surface
    own = output.patches.patches.areas
    areas, grain = np.bincount(classes, weights=own, minlength=len(LEVEL_CLASSES)), grain_of(own)
    counted = max(float(areas.sum() - areas[_LEFT_OUT]), 1e-300)
    return [
        design.share_text(float(area / (areas.sum() if k == _LEFT_OUT else counted)), grain)
        for k, area in enumerate(areas)
    ]


def _table(rows: list[list[str]]) -> Table:
    return Table(
        header=["posture", *(label for label, _ in LEVEL_CLASSES[:_UNSEEN])],
        rows=rows,
        caption="Areas, and their shares of the surface that the camera sees in the posture at up to "
        f"{GRAZING_DEG:g}° to its normal. Left out: of all that it sees there, the rest.",
    )


def _combined_note(shares: Sequence[str], postures: int) -> Note:
    which = "The posture shows" if postures == 1 else f"The {postures} postures together show"
    return Note(
        text=f"{which} {shares[0]} of the part's surface in two usable images or more; "
        f"{shares[_UNSEEN]} the camera never sees. {shares[_LEFT_OUT]} of the whole surface, "
        "which it sees at a grazing angle or an edge only, is left out of these shares."
    )


def blind_pictures(result: design.DesignResult) -> dict[Posture, UInt8]:
    """What the camera sees in each posture, coloured by what the chosen lights show of the defects, with a legend.

    Pictures have the shape (height, width, 3); none where images are not tested for defects.
    """
    if result.blind is None or result.patches is None:
        return {}
    patches, scene = result.patches.patches, result.scene
    pictures: dict[Posture, UInt8] = {}
    for posture, spots, _ in result.blind.parts[1:]:
        assert posture is not None
        camera = view_from_part(scene, posture).camera
        colours = design.blind_colours(spots).astype(np.float64)
        picture = np.full((camera.height, camera.width, 3), BACKGROUND, np.uint8)
        for top in range(0, camera.height, BLOCK_ROWS):
            rows = picture[top : top + BLOCK_ROWS]
            y, x = np.divmod(np.arange(len(rows) * camera.width), camera.width)
            hits, surface = trace_samples(result.caster, scene.mesh, camera, x + 0.5, top + y + 0.5, neighbours=True)
            # brightness shows the shape: how much the surface faces the camera
            facing = np.abs(np.einsum("ij,ij->i", surface.normals, surface.views))
            shade = LEAST_SHADE + (1.0 - LEAST_SHADE) * facing[:, None]
            shaded = colours[patches.patch_at(hits.face, hits.u, hits.v)] * shade
            rows.reshape(-1, 3)[hits.ray] = np.rint(shaded).astype(np.uint8)
        title = (
            f"posture {posture}: shares of the surface × defects without what is left out;\n"
            "pale where other defects are seen"
        )
        pictures[posture] = _with_legend(picture, title, design.blind_legend(spots))
    return pictures


def blind_layers(summary: design.BlindSpotSummary) -> list[SurfaceLayer]:
    """How many defects are seen, and why the others are not: all postures together, wherever the lights stand, each."""
    layers = [share_layer("all postures, how many defects are seen", summary.parts[0][1])]
    for posture, chosen, possible in summary.parts if len(summary.parts) > 2 else summary.parts[:1]:
        where = "all postures" if posture is None else f"posture {posture}"
        layers.append(blind_layer(f"{where}, why not", chosen))
        if posture is None:
            layers.append(blind_layer(f"{where}, why not with the lights {design.BLIND_LIGHTS[1]}", possible))
    return layers


def share_layer(name: str, spots: design.BlindSpots) -> SurfaceLayer:
    """How large a share of the defects is seen on every patch, and of how much of the surface that is not left out."""
    limits = np.array([limit for limit, *_ in SHARES])
    of_face = np.searchsorted(limits, spots.share, side="left").astype(np.uint8)
    of_face[spots.share >= 1.0] = len(SHARES) - 1
    apart = [design.blind_class(code) for code in (design.BlindReason.CAMERA, design.BlindReason.GRAZING)]
    for place, one in enumerate(apart, start=len(SHARES)):
        of_face[spots.codes == one.code] = place
    kinds = [*((label, colour) for _, label, colour in SHARES), *((one.label, hex_colour(one.colour)) for one in apart)]
    areas = np.bincount(of_face, weights=spots.areas, minlength=len(kinds)) / spots.counted
    amounts = [*(design.share_text(float(area), spots.grain) for area in areas[:-1]), ""]
    return SurfaceLayer(name=name, classes=surface_classes(kinds, amounts), of_face=of_face)


def blind_layer(name: str, spots: design.BlindSpots) -> SurfaceLayer:
    """The reasons of every patch, those that there are, with their shares of the surface × defects.

    Which light saturates a patch is told by the table.
    """
    left_out = design.blind_class(design.BlindReason.GRAZING).label
    shares = {row.label: "" if row.label == left_out else row.amount for row in design.blind_legend(spots)}
    of_face = design.blind_classes(spots)
    shown = [k for k, one in enumerate(design.BLIND_CLASSES) if one.label in shares or (of_face == k).any()]
    kinds = [(design.BLIND_CLASSES[k].label, hex_colour(design.BLIND_CLASSES[k].colour)) for k in shown]
    classes = surface_classes(kinds, [shares.get(label, "") for label, _ in kinds])
    return SurfaceLayer(name=name, classes=classes, of_face=np.searchsorted(shown, of_face).astype(np.uint8))


@fixed_style()
def _with_legend(picture: UInt8, title: str, rows: Sequence[design.LegendRow]) -> UInt8:
    """A picture with a title and a legend below it, on white; it is made wider where they need more room."""
    from matplotlib.figure import Figure
    from matplotlib.legend_handler import HandlerTuple
    from matplotlib.patches import Patch

    width = max(picture.shape[1], LEAST_WIDTH)
    size = min(LARGEST_LEGEND, max(SMALLEST_LEGEND, width // 50))
    figure = Figure(figsize=(width / DPI, 1.7 * size * (len(rows) + 3) / DPI), dpi=DPI)
    swatches: list[Any] = [
        tuple(Patch(facecolor=hex_colour(one), edgecolor=SOFT) for one in row.colours) for row in rows
    ]
    labels = [f"{row.label}: {row.amount}" for row in rows]
    style: dict[str, Any] = {"handler_map": {tuple: HandlerTuple(ndivide=None)}, "frameon": False}
    style |= {"handlelength": 3.0, "handleheight": 1.0, "alignment": "left"}
    style |= {"fontsize": size * POINT, "title_fontsize": size * POINT}
    figure.legend(swatches, labels, title=title, loc="center left", **style)
    wide = np.pad(picture, ((0, 0), (0, width - picture.shape[1]), (0, 0)), constant_values=255)
    return np.concatenate([wide, np.asarray(figure_image(figure))])
