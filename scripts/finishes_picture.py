"""Draw docs/pictures/finishes.png: the sample knob with each form of the lobe, all reflecting as much light.

``python scripts/finishes_picture.py [PNG]``. All four lights; the fourth root of the levels, by one highest level.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from lightopt import build_scene, render
from lightopt.optics import Reflectance, SpecularModel

ROOT = Path(__file__).resolve().parent.parent
WIDTH, HEIGHT, TITLE, CROP = 640, 480, 18, 90
GGX = SpecularModel(name="ggx", refractive_index=(1.96, 3.80))
TWO_LOBES = SpecularModel(name="two-lobe", wide_share=0.005, wide_ratio=10.0)
# R_s such that R_s·σ² of a lobe, of two lobes their sum, and R_s·α²/2 are the same
FINISHES = {
    "torrance-sparrow, sigma 0.003": Reflectance(R_d=4.0, R_s=3.13e6, sigma=0.003),
    "two-lobe, sigma 0.003 and 0.03": Reflectance(R_d=4.0, R_s=2.087e6, sigma=0.003, model=TWO_LOBES),
    "ggx, alpha 0.06": Reflectance(R_d=4.0, R_s=15_650.0, sigma=0.03, model=GGX),
}


def finishes_picture(target: Path) -> None:
    """Draw the picture."""
    scene = build_scene(ROOT / "configs/rigs/four-panel.yaml", ROOT / "configs/parts/cover-knob.yaml", points="auto")
    scale = WIDTH / scene.camera.width
    camera = replace(scene.camera, width=WIDTH, height=HEIGHT, pixel_size=scene.camera.pixel_size / scale)
    tiles, top = [], 0.0
    for title, reflectance in FINISHES.items():
        own = replace(scene, camera=camera, reflectance=reflectance, postures=scene.postures[:1])
        level = sum(image.level for image in next(iter(render(own, supersample=2))).lights)
        top = top or float(level.max())
        shown = np.clip((level[:, CROP:-CROP] / top) ** 0.25, 0.0, 1.0) * 255.0
        tile = Image.new("L", (shown.shape[1], HEIGHT + TITLE), 255)
        tile.paste(Image.fromarray(shown.astype(np.uint8)), (0, TITLE))
        ImageDraw.Draw(tile).text((4, 3), title, fill=0)
        tiles.append(np.asarray(tile))
    Image.fromarray(np.concatenate(tiles, axis=1)).save(target, optimize=True)


if __name__ == "__main__":
    finishes_picture(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pictures" / "finishes.png")
