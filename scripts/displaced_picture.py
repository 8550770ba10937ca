"""Draw docs/pictures/displaced.png: defects as normals and as displaced geometry, and the difference.

``python scripts/displaced_picture.py [PNG]``. A blister and a pit on the cover knob under light1, with the walls of the
built-in catalogue and with four times their slope. Pixels are a quarter as wide as the sample rig's.
"""

from __future__ import annotations

import math
import re
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from benchmarks._case import resized
from benchmarks.displaced import displaced, refined, steeper
from lightopt import build_scene
from lightopt.core.arrays import Float64
from lightopt.rendering import cast_rays_at, render_lights
from lightopt.scene import Scene, pixel_footprint, project

ROOT = Path(__file__).resolve().parent.parent
FINER = 4
TILE, GAP, LEFT, TOP = 220, 6, 100, 28  # px
DIFFERENCE = 64.0  # levels that are white or black
FACTORS = 1.0, 4.0

# by pixel of the sample rig, on the edge of light1's highlight and on a slope beside it; and how much around is shown
DEFECTS = """
defects:
  - {name: blister, kind: blister, size_mm: 1.5, slope_deg: 6, AT: [975, 450]}
  - {name: pit, kind: pit, size_mm: 0.3, slope_deg: 20, AT: [1130, 480]}
"""
SHOWN_MM = {"blister": 2.4, "pit": 0.7}


def displaced_picture(target: Path) -> None:
    """Draw the picture."""
    part = (ROOT / "configs" / "parts" / "cover-knob.yaml").read_text(encoding="utf-8")
    part = part.replace("file: cover-knob.step", f"file: '{(ROOT / 'configs/parts/cover-knob.step').as_posix()}'")
    posture = "at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel:"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.yaml"
        path.write_text(part + re.sub(r"AT: (\[\d+, \d+\])", rf"{posture} \1}}", DEFECTS), encoding="utf-8")
        scene = build_scene(ROOT / "configs" / "rigs" / "four-panel.yaml", path, lights=["light1"])
    defects = scene.defects
    scene = replace(scene, camera=resized(scene.camera, FINER * scene.camera.width), defects=())
    pixel = pixel_footprint(scene.camera, float(np.linalg.norm(scene.camera.position)))
    mesh = refined(scene.mesh, defects, pixel)
    step = TILE + GAP
    picture = Image.new("L", (LEFT + 3 * step, TOP + len(FACTORS) * len(defects) * step), 255)
    draw = ImageDraw.Draw(picture)
    for number, title in enumerate(("model: normals", "displaced geometry", "difference, ±64 levels")):
        draw.text((LEFT + number * step, 4), title, fill=0, font_size=16)
    for k, factor in enumerate(FACTORS):
        walls = tuple(steeper(one, factor) for one in defects)
        model = _level(replace(scene, defects=walls))
        moved = _level(replace(scene, mesh=displaced(mesh, walls)))
        for number, defect in enumerate(walls):
            column, row, _ = project(scene.camera, defect.position[None])
            half = round(0.5 * SHOWN_MM[defect.name] / pixel)
            window = tuple(slice(int(c[0]) - half, int(c[0]) + half) for c in (row, column))
            a, b = model[window], moved[window]
            top = TOP + (len(FACTORS) * number + k) * step
            text = f"{defect.name}\n{math.degrees(defect.shape.slope):.0f}° walls\n{SHOWN_MM[defect.name]:g} mm"
            draw.text((4, top + 8), text, fill=0, font_size=16)
            for place, level in enumerate((a, b, 127.5 + 127.5 / DIFFERENCE * (b - a))):
                picture.paste(_tile(level), (LEFT + place * step, top))
    picture.save(target, optimize=True)


def _level(scene: Scene) -> Float64:
    (image,) = render_lights(scene, scene.postures[0], caster=cast_rays_at(scene))
    return np.clip(image.level.astype(np.float64), 0.0, 255.0)


def _tile(level: Float64) -> Image.Image:
    picture = Image.fromarray(np.clip(level, 0.0, 255.0).astype(np.uint8))
    tile = picture.resize((TILE, TILE), Image.Resampling.NEAREST)
    ImageDraw.Draw(tile).rectangle((0, 0, TILE - 1, TILE - 1), outline=160)
    return tile


if __name__ == "__main__":
    displaced_picture(Path(sys.argv[1]) if sys.argv[1:] else ROOT / "docs" / "pictures" / "displaced.png")
