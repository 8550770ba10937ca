"""Draw docs/pictures/finishes.png, brushed.png, diffuse-forms.png and measured-finishes.png.

``python scripts/finishes_picture.py``. finishes.png: the sample knob with each form of the lobe, all reflecting as much
light, under all four lights; the fourth root of the levels, by one highest level. brushed.png: the same of a surface
that is brushed in four ways. diffuse-forms.png: a sphere with each form of the diffuse component under one panel;
levels. measured-finishes.png: the knob in every finish of docs/reference/finishes.md that has a line for part files.
"""

from __future__ import annotations

import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw

from lightopt import build_scene, render
from lightopt.core.arrays import Float64, UInt8
from lightopt.geometry import (
    CurvedBrushing,
    LoadedMesh,
    RoundBrushing,
    StraightBrushing,
    TextureBrushing,
    TriangleMesh,
    texture_brushing,
)
from lightopt.optics import LAMBERT, DiffuseForm, Reflectance, SpecularModel
from lightopt.scene import Scene

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
BRUSHED = Reflectance(R_d=8.0, R_s=2000.0, sigma=0.025, model=SpecularModel(name="ggx", across_ratio=5.0))
BRUSHINGS = {
    "along X": StraightBrushing(np.array([1.0, 0.0, 0.0])),
    "around its axis": RoundBrushing(np.zeros(3), np.array([0.0, 0.0, 1.0])),
    "along a curve": CurvedBrushing(
        np.array([[-30.0, -12.0, 0.0], [-8.0, 6.0, 0.0], [8.0, 6.0, 0.0], [30.0, -12.0, 0.0]])
    ),
}
DIFFUSE_FORMS = {
    "Lambert": LAMBERT,
    "diffuse_exponent: 0.7": DiffuseForm(exponent=0.7),
    "diffuse_exponent: 1.5": DiffuseForm(exponent=1.5),
    "oren_nayar_roughness: 0.4": DiffuseForm(roughness=0.4),
    "oren_nayar_roughness: 1": DiffuseForm(roughness=1.0),
}
PAGE = ROOT / "docs" / "reference" / "finishes.md"
TILE_WIDTH, TILE_HEIGHT, TILE_CROP, COLUMNS = 256, 192, 36, 7
RADIUS, BALL_WIDTH, BALL_HEIGHT, BALL_CROP = 22.0, 320, 240, 50


def _scene(width: int, height: int) -> Scene:
    scene = build_scene(ROOT / "configs/rigs/four-panel.yaml", ROOT / "configs/parts/cover-knob.yaml", points="auto")
    scale = width / scene.camera.width
    camera = replace(scene.camera, width=width, height=height, pixel_size=scene.camera.pixel_size / scale)
    return replace(scene, camera=camera, postures=scene.postures[:1])


def _sum_of_lights(scene: Scene) -> Float64:
    return np.sum([image.level for image in next(iter(render(scene, supersample=2))).lights], axis=0, dtype=np.float64)


def _save(target: Path, pictures: dict[str, Float64]) -> None:
    # side by side, of levels from 0 to 1
    Image.fromarray(np.concatenate(_tiles(pictures), axis=1)).save(target, optimize=True)


def _tiles(pictures: dict[str, Float64]) -> list[UInt8]:
    tiles: list[UInt8] = []
    for title, shown in pictures.items():
        tile = Image.new("L", (shown.shape[1], shown.shape[0] + TITLE), 255)
        tile.paste(Image.fromarray((255.0 * np.clip(shown, 0.0, 1.0)).astype(np.uint8)), (0, TITLE))
        ImageDraw.Draw(tile).text((4, 3), title, fill=0)
        tiles.append(np.asarray(tile))
    return tiles


def finishes_picture(target: Path) -> None:
    """Draw the sample knob with each form of the lobe."""
    scene = _scene(WIDTH, HEIGHT)
    levels = {name: _sum_of_lights(replace(scene, reflectance=one))[:, CROP:-CROP] for name, one in FINISHES.items()}
    top = next(iter(levels.values())).max()
    _save(target, {name: (level / top) ** 0.25 for name, level in levels.items()})


def brushed_picture(target: Path) -> None:
    """Draw the sample knob brushed in four ways."""
    scene = replace(_scene(WIDTH, HEIGHT), reflectance=BRUSHED)
    ways = BRUSHINGS | {"along a texture": _spiral(scene.mesh)}
    scenes = {name: replace(scene, mesh=replace(scene.mesh, brushing=(way,))) for name, way in ways.items()}
    levels = {name: _sum_of_lights(one)[:, CROP:-CROP] for name, one in scenes.items()}
    top = max(level.max() for level in levels.values())
    _save(target, {name: (level / top) ** 0.25 for name, level in levels.items()})


def _spiral(mesh: TriangleMesh) -> TextureBrushing:
    # along a texture that is wound about Z, 60 mm outwards in a turn
    x, y, _ = mesh.vertices[mesh.faces].transpose(2, 0, 1)
    turn = np.unwrap(np.arctan2(y, x), axis=1) / (2.0 * np.pi)
    texture = np.stack([turn, np.hypot(x, y) / 60.0 - turn], axis=2)
    return texture_brushing(LoadedMesh(mesh, (), texture=texture), "u")


def diffuse_forms_picture(target: Path) -> None:
    """Draw a sphere with each form of the diffuse component."""
    ball = trimesh.creation.icosphere(subdivisions=6, radius=RADIUS)
    normals = np.asarray(ball.vertices) / RADIUS
    scene = _scene(BALL_WIDTH, BALL_HEIGHT)
    scene = replace(scene, mesh=TriangleMesh(np.asarray(ball.vertices), ball.faces, normals), lights=scene.lights[:1])
    matte = Reflectance(R_d=255.0, R_s=0.0, sigma=0.05)
    levels = {
        name: _sum_of_lights(replace(scene, reflectance=replace(matte, diffuse=form)))[:, BALL_CROP:-BALL_CROP] / 255.0
        for name, form in DIFFUSE_FORMS.items()
    }
    _save(target, levels)


def measured_finishes_picture(target: Path) -> None:
    """Draw the sample knob in every finish of the page that has a line for part files."""
    lines = re.findall(r"^(reflectance: \{.*\}) +# (.*)$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    text = (ROOT / "configs/parts/cover-knob.yaml").read_text(encoding="utf-8")
    scene = _scene(TILE_WIDTH, TILE_HEIGHT)
    levels: dict[str, Float64] = {}
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "part.yaml"
        for line, name in lines:
            own = re.sub(r"reflectance:.*?(?=\n\S|\Z)", line, text, flags=re.DOTALL)
            part.write_text(own.replace("file: ", f"file: {ROOT}/configs/parts/"), encoding="utf-8")
            finished = build_scene(ROOT / "configs/rigs/four-panel.yaml", part, points="auto")
            finished = replace(finished, camera=scene.camera, postures=scene.postures)
            levels[name] = _sum_of_lights(finished)[:, TILE_CROP:-TILE_CROP]
    top = max(level.max() for level in levels.values())
    tiles = _tiles({name.replace(" gloss units", " GU"): (level / top) ** 0.25 for name, level in levels.items()})
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % COLUMNS)
    rows = [np.concatenate(tiles[k : k + COLUMNS], axis=1) for k in range(0, len(tiles), COLUMNS)]
    Image.fromarray(np.concatenate(rows)).save(target, optimize=True)


if __name__ == "__main__":
    finishes_picture(ROOT / "docs" / "pictures" / "finishes.png")
    brushed_picture(ROOT / "docs" / "pictures" / "brushed.png")
    diffuse_forms_picture(ROOT / "docs" / "pictures" / "diffuse-forms.png")
    measured_finishes_picture(ROOT / "docs" / "pictures" / "measured-finishes.png")
