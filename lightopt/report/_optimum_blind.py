"""The part coloured by why defects on it stay invisible."""

from __future__ import annotations

import numpy as np

from lightopt.design import (
    BLIND_CLASSES,
    BLIND_LIGHTS,
    Blind,
    BlindClass,
    BlindReport,
    BlindSpots,
    blind_class,
    blind_classes,
    blind_legend,
    share_text,
)
from lightopt.report._surface import SurfaceClass, SurfaceLayer

# matplotlib's cividis (Nuñez, Anderton and Renslow, 2018) in equal steps: the brighter the more is seen
SHARES = (
    (0.0, "none", "#00224e"),
    (0.25, "up to a quarter", "#35456c"),
    (0.5, "up to a half", "#666970"),
    (0.75, "up to three quarters", "#948e77"),
    (1.0, "more, not all", "#c8b866"),
    (np.inf, "all", "#fee838"),
)


def blind_layers(report: BlindReport) -> list[SurfaceLayer]:
    """How many defects are seen, and why the others are not: all postures together, wherever the lights stand, each."""
    layers = [share_layer("all postures, how many defects are seen", report.chosen)]
    for posture, chosen, possible in report.parts() if len(report.postures) > 1 else report.parts()[:1]:
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
    apart = [blind_class(code) for code in (Blind.CAMERA, Blind.GRAZING)]
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
    left_out = blind_class(Blind.GRAZING).label
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
