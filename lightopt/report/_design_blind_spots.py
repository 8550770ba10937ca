"""The part coloured by why defects on it stay invisible: as layers of the report, and as the camera sees it."""

import numpy as np

from lightopt.core.arrays import UInt8
from lightopt.core.transforms import Posture
from lightopt.design import (
    BLIND_CLASSES,
    BLIND_LIGHTS,
    BlindClass,
    BlindReason,
    BlindSpots,
    BlindSpotSummary,
    DesignResult,
    blind_class,
    blind_classes,
    blind_colours,
    blind_legend,
    share_text,
)
from lightopt.rendering import trace_samples
from lightopt.report._drawing import with_legend
from lightopt.report._surface import SurfaceClass, SurfaceLayer
from lightopt.scene import view_from_part

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


def blind_pictures(result: DesignResult) -> dict[Posture, UInt8]:
    """What the camera sees in each posture, coloured by what the chosen lights show of the defects, with a legend.

    Pictures have the shape (height, width, 3); none where images are not tested for defects.
    """
    if result.blind is None or result.patches is None:
        return {}
    patches, scene = result.patches.patches, result.scene
    pictures: dict[Posture, UInt8] = {}
    for posture, spots in zip(result.blind.postures, result.blind.chosen_in, strict=True):
        camera = view_from_part(scene, posture).camera
        colours = blind_colours(spots).astype(np.float64)
        picture = np.full((camera.height, camera.width, 3), BACKGROUND, np.uint8)
        for top in range(0, camera.height, BLOCK_ROWS):
            rows = picture[top : top + BLOCK_ROWS]
            y, x = np.divmod(np.arange(len(rows) * camera.width), camera.width)
            hits, surface = trace_samples(result.caster, scene.mesh, camera, x + 0.5, top + y + 0.5)
            # brightness shows the shape: how much the surface faces the camera
            facing = np.abs(np.einsum("ij,ij->i", surface.normals, surface.views))
            shade = LEAST_SHADE + (1.0 - LEAST_SHADE) * facing[:, None]
            shaded = colours[patches.patch_at(hits.face, hits.u, hits.v)] * shade
            rows.reshape(-1, 3)[hits.ray] = np.rint(shaded).astype(np.uint8)
        title = (
            f"posture {posture}: shares of the surface × defects without what is left out; pale where other defects "
            "are seen"
        )
        pictures[posture] = with_legend(picture, title, blind_legend(spots))
    return pictures


def blind_layers(summary: BlindSpotSummary) -> list[SurfaceLayer]:
    """How many defects are seen, and why the others are not: all postures together, wherever the lights stand, each."""
    layers = [share_layer("all postures, how many defects are seen", summary.chosen)]
    for posture, chosen, possible in summary.parts() if len(summary.postures) > 1 else summary.parts()[:1]:
        where = "all postures" if posture is None else f"posture {posture}"
        layers.append(blind_layer(f"{where}, why not", chosen))
        if posture is None:
            layers.append(blind_layer(f"{where}, why not with the lights {BLIND_LIGHTS[1]}", possible))
    return layers


def share_layer(name: str, spots: BlindSpots) -> SurfaceLayer:
    """How large a share of the defects is seen on every patch, and of how much of the surface that is not left out."""
    limits = np.array([limit for limit, *_ in SHARES])
    of_face = np.searchsorted(limits, spots.share, side="left").astype(np.uint8)
    of_face[spots.share >= 1.0] = len(SHARES) - 1
    apart = [blind_class(code) for code in (BlindReason.CAMERA, BlindReason.GRAZING)]
    for place, one in enumerate(apart, start=len(SHARES)):
        of_face[spots.codes == one.code] = place
    kinds = [*((label, colour) for _, label, colour in SHARES), *((one.label, _hex(one)) for one in apart)]
    areas = np.bincount(of_face, weights=spots.areas, minlength=len(kinds)) / spots.counted
    amounts = [*(share_text(float(area), spots.grain) for area in areas[:-1]), ""]
    classes = tuple(
        SurfaceClass(label=label, colour=colour, amount=amount)
        for (label, colour), amount in zip(kinds, amounts, strict=True)
    )
    return SurfaceLayer(name=name, classes=classes, of_face=of_face)


def blind_layer(name: str, spots: BlindSpots) -> SurfaceLayer:
    """The reasons of every patch, those that there are, with their shares of the surface × defects.

    Which light saturates a patch is told by the table.
    """
    left_out = blind_class(BlindReason.GRAZING).label
    shares = {row.label: "" if row.label == left_out else row.amount for row in blind_legend(spots)}
    of_face = blind_classes(spots)
    shown = [k for k, one in enumerate(BLIND_CLASSES) if one.label in shares or (of_face == k).any()]
    classes = tuple(
        SurfaceClass(label=one.label, colour=_hex(one), amount=shares.get(one.label, ""))
        for one in (BLIND_CLASSES[k] for k in shown)
    )
    return SurfaceLayer(name=name, classes=classes, of_face=np.searchsorted(shown, of_face).astype(np.uint8))


def _hex(one: BlindClass) -> str:
    return "#{:02x}{:02x}{:02x}".format(*one.colour)
