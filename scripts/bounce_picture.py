"""The picture of light from the part to the part."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from lightopt.images import write_png
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import build_scene

CONFIGS = Path(__file__).parents[1] / "configs"
POINTS, WIDTH, MARGIN = 16, 800, 10


def bounce_picture(target: Path) -> None:
    """The spout by direct light, with one bounce, and the bounce alone, side by side."""
    rig, part = CONFIGS / "rigs" / "four-panel.yaml", CONFIGS / "parts" / "spout.yaml"
    scene = build_scene(rig, part, points=POINTS, lights=["light1"])
    scale = scene.camera.width / WIDTH
    camera = replace(
        scene.camera, width=WIDTH, height=round(scene.camera.height / scale), pixel_size=scale * scene.camera.pixel_size
    )
    scene = replace(scene, camera=camera)
    caster = cast_rays_at(scene)
    direct, whole = (
        render_posture(replace(scene, bounces=bounces), scene.postures[0], caster=caster).lights[0].level
        for bounces in (0, 1)
    )
    seen = np.flatnonzero(direct.any(axis=0))
    own = slice(max(0, seen[0] - MARGIN), seen[-1] + MARGIN)
    levels = np.concatenate([direct[:, own], whole[:, own], (whole - direct)[:, own]], axis=1)
    write_png(target, np.clip(np.rint(levels), 0, 255).astype(np.uint8), metadata={})


if __name__ == "__main__":
    bounce_picture(CONFIGS.parent / "docs" / "pictures" / "interreflection.png")
