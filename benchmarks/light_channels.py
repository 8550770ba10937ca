"""What the channels of a light cost together, beside one channel of it.

``python -m benchmarks.light_channels [--repeats N]``. The sample knob is rendered in a posture under a dome of eight
segments and under a display of eight phases, at once, and under the dome of one segment and one phase of the display:
processor seconds of one thread, the least of some repeats.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from benchmarks._case import CONFIGS, RIG
from lightopt import build_scene, load_part, load_rig
from lightopt.rendering import cast_rays_at, render_posture

DOME = "kind: dome, radius_mm: 150, camera_hole_mm: 40, lower_elevation_deg: 10, leak: 0.2, segments: {}"
DISPLAY = (
    "kind: display, size_mm: [300, 200], distance_mm: 300, elevation_deg: 50, azimuth_deg: 90, "
    "pattern: {{period_mm: 40, phases: {}, directions: {}}}"
)
# eight channels, and one: of the light of so many channels the first alone
CASES = {
    "dome, 8 segments": (DOME.format(8), DOME.format(1)),
    "display, 8 phases": (DISPLAY.format(8, "[u]"), DISPLAY.format(8, "[u]")),
    "display, 4 + 4 phases": (DISPLAY.format(4, "[u, v]"), DISPLAY.format(4, "[u]")),
}


def seconds(folder: Path, light: str, *, one: bool, repeats: int) -> float:
    """Processor time of rendering a posture under all channels of a light, or under the first [s]."""
    camera = RIG.read_text(encoding="utf-8").split("light_source:")[0]
    camera = camera.replace("[1600, 1200]", "[320, 240]").replace("pixel_size_um: 4.4", "pixel_size_um: 22")
    path = folder / "rig.yaml"
    path.write_text(f"{camera}lights:\n  - {{name: x, {light}}}\n", encoding="utf-8")
    rig = load_rig(path)
    names = [rig.lights[0].name] if one else None
    scene = build_scene(rig, load_part(CONFIGS / "parts" / "cover-knob.yaml"), lights=names)
    best = float("inf")
    for _ in range(repeats + 1):  # the first one compiles
        begun = time.process_time()
        render_posture(scene, scene.postures[0], caster=cast_rays_at(scene), threads=1)
        best = min(best, time.process_time() - begun)
    return best


def main(arguments: list[str] | None = None) -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.light_channels", description=__doc__)
    parser.add_argument("--repeats", type=int, default=2)
    repeats = parser.parse_args(arguments).repeats
    print("| light | 8 channels [s] | 1 channel [s] | ratio |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory(prefix="lightopt-channels-") as folder:
        for name, (several, single) in CASES.items():
            together = seconds(Path(folder), several, one=False, repeats=repeats)
            alone = seconds(Path(folder), single, one=True, repeats=repeats)
            print(f"| {name} | {together:.2f} | {alone:.2f} | {together / alone:.2f} |")


if __name__ == "__main__":
    main()
