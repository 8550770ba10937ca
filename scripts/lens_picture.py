"""Draw docs/pictures/lens.png: the sample knob through a pinhole and through lenses, satin and chrome.

``python scripts/lens_picture.py [PNG]``. All four lights; the fourth root of the levels, by the highest of the
pinhole's.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from lightopt import build_scene, render
from lightopt.scene import Lens

ROOT = Path(__file__).resolve().parent.parent
WIDTH, HEIGHT, TITLE = 400, 300, 18
FOCAL_MM = 50.0
LENSES = {
    "pinhole": None,
    "f/4, focused on the top": Lens(aperture=FOCAL_MM / 4, focus=534.0),
    "f/4, focused 24 mm above it": Lens(aperture=FOCAL_MM / 4, focus=510.0),
    "f/22, diffraction": Lens(aperture=FOCAL_MM / 22, focus=534.0, wavelength=550e-6),
}
FINISHES = {"satin": (45.0, 12500.0, 0.0475), "polished": (4.0, 3.13e6, 0.003)}


def lens_picture(target: Path) -> None:
    """Draw the picture."""
    scene = build_scene(ROOT / "configs/rigs/four-panel.yaml", ROOT / "configs/parts/cover-knob.yaml", points="auto")
    rows = []
    for finish, (diffuse, specular, sigma) in FINISHES.items():
        tiles, top = [], 0.0
        for title, lens in LENSES.items():
            camera = replace(scene.camera, width=WIDTH, height=HEIGHT, lens=lens)
            own = replace(
                scene,
                camera=camera,
                reflectance=replace(scene.reflectance, R_d=diffuse, R_s=specular, sigma=sigma),
                postures=scene.postures[:1],
            )
            level = sum(image.level for image in next(iter(render(own, supersample=3))).lights)
            tile = Image.new("L", (WIDTH, HEIGHT + TITLE), 255)
            top = top or float(level.max())
            shown = np.clip((level / top) ** 0.25, 0.0, 1.0) * 255.0
            tile.paste(Image.fromarray(shown.astype(np.uint8)), (0, TITLE))
            ImageDraw.Draw(tile).text((4, 3), f"{finish}, {title}", fill=0)
            tiles.append(np.asarray(tile))
        rows.append(np.concatenate(tiles, axis=1))
    Image.fromarray(np.concatenate(rows)).save(target, optimize=True)


if __name__ == "__main__":
    lens_picture(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pictures" / "lens.png")
