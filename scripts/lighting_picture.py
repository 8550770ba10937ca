"""Draw docs/pictures/lighting-systems.png: the sample knob in the sample rig of each lighting system.

``python scripts/lighting_picture.py [PNG]``. The first channel of each light; levels are scaled so that the brightest
percent of the part saturates, with a gamma of 3.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from lightopt import build_scene, render

ROOT = Path(__file__).resolve().parent.parent
SYSTEMS = (
    "spot",
    "led-array",
    "bars",
    "ring-quadrants",
    "low-angle-ring",
    "coaxial",
    "flat-dome",
    "dome-quadrants",
    "tunnel",
    "display-stripes",
    "binary-stripes",
    "moving-grid",
    "dome-stripes",
    "silhouette",
)
WIDTH, HEIGHT, TITLE = 320, 240, 18
ACROSS = 5
PERCENTILE = 99.0


def lighting_picture(target: Path) -> None:
    """Draw the picture."""
    rows = -(-len(SYSTEMS) // ACROSS)
    sheet = Image.new("L", (ACROSS * WIDTH, rows * (HEIGHT + TITLE)), 255)
    draw = ImageDraw.Draw(sheet)
    for number, name in enumerate(SYSTEMS):
        scene = build_scene(ROOT / f"configs/rigs/{name}.yaml", ROOT / "configs/parts/cover-knob.yaml")
        first = build_scene(
            ROOT / f"configs/rigs/{name}.yaml",
            ROOT / "configs/parts/cover-knob.yaml",
            lights=[scene.lights[0].name],
            postures=scene.postures[:1],
        )
        (images,) = render(first)
        level = images.lights[0].level
        shown = images.geometry.hit if name != "silhouette" else ~images.geometry.hit
        white = np.percentile(level[shown], PERCENTILE)
        grey = np.clip(level / white, 0.0, 1.0) ** (1.0 / 3.0)
        place = (number % ACROSS * WIDTH, number // ACROSS * (HEIGHT + TITLE))
        draw.text((place[0] + 4, place[1] + 3), first.lights[0].name + f"  ({name}.yaml)", fill=0)
        pixels = Image.fromarray(np.rint(255.0 * grey).astype(np.uint8)).resize((WIDTH, HEIGHT))
        sheet.paste(pixels, (place[0], place[1] + TITLE))
    sheet.save(target, optimize=True)


if __name__ == "__main__":
    lighting_picture(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pictures" / "lighting-systems.png")
