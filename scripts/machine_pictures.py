"""Draw docs/pictures/motion.png and housings.png: the sample spout on a stage that moves, the knob in a white box.

``python scripts/machine_pictures.py``. Square roots of the levels, clipped at 255.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from lightopt import build_scene, render
from lightopt.scene import Housings, Motion, Scene

ROOT = Path(__file__).resolve().parent.parent
WIDTH, HEIGHT, TITLE = 400, 300, 18
POINTS, MARGIN_MM = 16, 20.0


def motion_picture(target: Path) -> None:
    """At rest, on a conveyor, and on a table that turns: 12 px at most."""
    scene = _scene("spout", ["light1", "light2"])
    still = Motion(velocity=np.zeros(3), turn_deg_per_s=0.0, exposure_s=1.0)
    moving = replace(still, velocity=np.array([2.6, 0.0, 0.0]))
    turning = replace(still, turn_deg_per_s=6.0)
    titles = {"at rest": None, "moves 12 px to the right": moving, "turns by 6°": turning}
    _draw(target, ((title, replace(scene, motion=own)) for title, own in titles.items()))


def housings_picture(target: Path) -> None:
    """In a dark box, in a white box, and in a white box with dark housings."""
    scene = _scene("cover-knob", None)
    chrome = replace(scene.reflectance, R_d=4.0, R_s=3.13e6, sigma=0.003)
    dark = replace(scene, reflectance=chrome)
    white = replace(dark, environment=60.0)
    rows: list[list[np.ndarray]] = []
    for light in scene.lights:
        across, along = (0.5 * side + MARGIN_MM for side in light.size)
        rows.append([light.centre, light.outward, light.across / across, light.along / along])
    housed = replace(white, housings=Housings(level=0.0, rectangles=np.array(rows)))
    titles = {"black box": dark, "white box": white, "white box, black housings": housed}
    _draw(target, titles.items())


def _scene(name: str, lights: list[str] | None) -> Scene:
    rig, part = ROOT / "configs/rigs/four-panel.yaml", ROOT / f"configs/parts/{name}.yaml"
    scene = build_scene(rig, part, points=POINTS if lights else "auto", lights=lights)
    scale = scene.camera.width / WIDTH
    camera = replace(scene.camera, width=WIDTH, height=HEIGHT, pixel_size=scale * scene.camera.pixel_size)
    return replace(scene, camera=camera, postures=scene.postures[:1])


def _draw(target: Path, titles: Iterable[tuple[str, Scene]]) -> None:
    # under all lights together
    tiles: list[np.ndarray] = []
    for title, scene in titles:
        level = sum(image.level for image in next(iter(render(scene, supersample=2))).lights)
        tile = Image.new("L", (WIDTH, HEIGHT + TITLE), 255)
        tile.paste(Image.fromarray((255.0 * np.sqrt(np.clip(level / 255.0, 0.0, 1.0))).astype(np.uint8)), (0, TITLE))
        ImageDraw.Draw(tile).text((4, 3), title, fill=0)
        tiles.append(np.asarray(tile))
    Image.fromarray(np.concatenate(tiles, axis=1)).save(target, optimize=True)


if __name__ == "__main__":
    motion_picture(ROOT / "docs" / "pictures" / "motion.png")
    housings_picture(ROOT / "docs" / "pictures" / "housings.png")
