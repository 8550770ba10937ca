"""Render a part: the level at each pixel under each light, before the sensor."""

from __future__ import annotations

from pathlib import Path

from lightopt import build_scene, load_part, load_rig, render

HERE = Path(__file__).parent


def main() -> None:
    scene = build_scene(load_rig(HERE / "rig.yaml"), load_part(HERE / "part.yaml"))
    for posture in render(scene):
        surface = posture.geometry.hit  # (height, width): which pixels show the part
        for image in posture.lights:
            levels = image.level[surface]  # grey levels at exposure 1, linear and not clipped
            saturated = (levels >= 255).mean()
            print(f"{posture.posture} {image.light}: mean {levels.mean():.1f}, saturated {saturated:.2%}")


if __name__ == "__main__":
    main()
