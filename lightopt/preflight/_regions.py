"""How much of the part, and of what the camera sees, each region of the part is."""

from collections.abc import Iterator

import numpy as np

from lightopt.geometry import face_areas
from lightopt.preflight._findings import CheckedScene, Finding, percent


def check_regions(checked: CheckedScene) -> Iterator[Finding]:
    """Area of each region, and its share of the pixels that show the part; none for a part without regions."""
    material = checked.scene.mesh.material
    if material is None:
        return
    count = len(checked.scene.reflectances)
    area = np.bincount(material, face_areas(checked.scene.mesh), count)
    pixels = np.zeros(count)
    for sample in checked.samples:
        seen = sample.surface.material
        assert seen is not None
        pixels += sample.step**2 * np.bincount(seen[sample.surface.front], minlength=count)
    for number, region in enumerate(checked.scene.regions, 1):
        shown = float(pixels[number] / max(pixels.sum(), 1.0))
        text = f"{region.name}: {area[number]:.4g} mm², {percent(float(area[number] / area.sum()))} of the surface; "
        text += f"{percent(shown)} of the pixels that show the part, over all postures"
        if not pixels[number]:
            text += ". The camera does not see it: check where the region is, or add postures that show it"
        values = {"region": region.name, "area_mm2": float(area[number]), "share_of_pixels": shown}
        level = "ok" if pixels[number] else "warning"
        yield Finding(level, "region", text, checked.part.source.at("regions", number - 1), values)
