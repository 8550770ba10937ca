"""How much of the part, and of what the camera sees, each region of the part is, and where it has a brushing."""

from collections.abc import Iterator

import numpy as np

from lightopt.geometry import face_areas
from lightopt.preflight._findings import CheckedScene, Finding, percent

_WITHOUT_DIRECTION = 0.1  # share of a brushed surface from which on a direction along its normal is worth a warning


def check_regions(checked: CheckedScene) -> Iterator[Finding]:
    """Area of each region, and its share of the pixels that show the part; nothing for a part without regions."""
    material, regions = checked.scene.mesh.material, checked.scene.regions
    if material is None:
        return
    area = np.bincount(material, face_areas(checked.scene.mesh), len(regions) + 1)
    pixels = np.zeros(len(regions) + 1)
    for sample in checked.samples:
        seen = sample.surface.material
        assert seen is not None
        pixels += sample.step**2 * np.bincount(seen[sample.surface.front], minlength=len(pixels))
    shares = pixels / max(float(pixels.sum()), 1.0)
    names = ["outside the regions", *(region.name for region in regions)]
    texts = [
        f"{name} {own:.4g} mm² ({percent(own / area.sum())}), {percent(share)} of the pixels"
        for name, own, share in zip(names, area.tolist(), shares.tolist(), strict=True)
    ]
    text = "of the surface, and of the pixels that show it in all postures: " + "; ".join((*texts[1:], texts[0]))
    where, values = checked.part.source.at("regions"), dict(zip(names, shares.tolist(), strict=True))
    yield Finding("ok", "regions", text, where, values)
    if area[0] == 0.0:
        text = "no surface is outside the regions: the part's own reflectance is not used"
        yield Finding("note", "regions", text, checked.part.source.at("reflectance"))
    for number, region in enumerate(regions):
        if not pixels[number + 1]:
            text = f"the camera does not see {region.name}: check where the region is, or add postures that show it"
            yield Finding("warning", "regions", text, checked.part.source.at("regions", number))


def check_brushing(checked: CheckedScene) -> Iterator[Finding]:
    """How much of a brushed surface in view has no direction, since the brushing is along its normal."""
    for number, own in enumerate(checked.scene.reflectances):
        if own.model.across_ratio == 1.0:
            continue
        pixels = without = 0
        for sample in checked.samples:
            surface = sample.surface
            assert surface.across is not None
            seen = surface.front if surface.material is None else surface.front & (surface.material == number)
            pixels += int(seen.sum())
            without += int(np.sum(seen & ~surface.across.any(axis=1)))
        if not pixels:
            continue
        share, keys = without / pixels, ("reflectance",) if number == 0 else ("regions", number - 1, "reflectance")
        text = f"the lobe is {own.model.across_ratio:.3g} times as wide across the brushing; it has a direction on "
        text += f"{percent(1.0 - share)} of this surface in view"
        if share > _WITHOUT_DIRECTION:
            text += ", and is along the normal on the rest: directions are in the mesh file's coordinates"
        kind = "warning" if share > _WITHOUT_DIRECTION else "ok"
        yield Finding(kind, "brushing", text, checked.part.source.at(*keys, "brushing"), {"share": 1.0 - share})
