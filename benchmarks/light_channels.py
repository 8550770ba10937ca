"""What the channels of a light cost together, beside one channel of it; and other lobes beside Torrance and Sparrow's.

``python -m benchmarks.light_channels [--repeats N]``. The sample knob is rendered in a posture under a dome of eight
segments and under a display of eight phases, at once, and under the dome of one segment and one phase of the display:
processor seconds of one thread, the least of some repeats. The light of other lobes is that of the points that every
fifth pixel sees, without shadows; the lobes take turns. Under panels, it is that of whole images of both sample parts.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks._case import CONFIGS, RIG
from lightopt import build_scene, load_part, load_rig
from lightopt.optics import Reflectance, SpecularModel
from lightopt.rendering import cast_rays_at, render_posture, trace_pixels
from lightopt.rendering._surface_light import shade_surface_lights
from lightopt.scene import Scene

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


LIGHTS = {
    "dome": DOME.format(1),
    "low-angle ring": "kind: low_angle_ring, radius_mm: 90, height_mm: 15, distance_mm: 22, segments: 4",
}
SIGMA, R_S = 0.0475, 12_500.0
PARTS = ("cover-knob", "spout")
SIGMAS = (0.003, 0.01, SIGMA)  # of the lobe under panels
LOBES = {
    "Torrance–Sparrow": SpecularModel(),
    "GGX": SpecularModel(name="ggx"),
    "GGX, nickel": SpecularModel(name="ggx", refractive_index=(1.96, 3.80)),
    "two lobes": SpecularModel(name="two-lobe", wide_share=0.02, wide_ratio=6.0),
}


def _scene(folder: Path, light: str, *, one: bool = False) -> Scene:
    # the knob under a light, or under the first of its channels
    camera = RIG.read_text(encoding="utf-8").split("light_source:")[0]
    camera = camera.replace("[1600, 1200]", "[320, 240]").replace("pixel_size_um: 4.4", "pixel_size_um: 22")
    path = folder / "rig.yaml"
    path.write_text(f"{camera}lights:\n  - {{name: x, {light}}}\n", encoding="utf-8")
    rig = load_rig(path)
    names = [rig.lights[0].name] if one else None
    return build_scene(rig, load_part(CONFIGS / "parts" / "cover-knob.yaml"), lights=names)


def seconds(scene: Scene, repeats: int) -> float:
    """Processor time of rendering a posture [s]."""
    best = float("inf")
    for _ in range(repeats + 1):  # the first one compiles
        begun = time.process_time()
        render_posture(scene, scene.postures[0], caster=cast_rays_at(scene), threads=1)
        best = min(best, time.process_time() - begun)
    return best


def _panels(part: str, points: int | Literal["auto"]) -> Scene:
    # a sample part under the four panels of the sample rig
    return build_scene(load_rig(RIG), load_part(CONFIGS / "parts" / f"{part}.yaml"), points=points)


def seconds_of_lobes(scene: Scene, repeats: int) -> list[float]:
    """Processor time of the light of each of :data:`LOBES` [s]."""
    pixels = trace_pixels(scene, scene.postures[0], cast_rays_at(scene), threads=1)
    surface, lights = pixels.surface.take(np.arange(0, len(pixels.surface), 5)), list(pixels.view.lights)
    best = [float("inf")] * len(LOBES)
    for _ in range(repeats + 1):
        for number, model in enumerate(LOBES.values()):
            reflectance = Reflectance(R_d=45.0, R_s=R_S, sigma=SIGMA, model=model)
            begun = time.process_time()
            shade_surface_lights(surface, lights, reflectance=reflectance, caster=None)
            best[number] = min(best[number], time.process_time() - begun)
    return best


def seconds_of_panels(scene: Scene, sigma: float, repeats: int) -> list[float]:
    """Processor time of images of a posture under panels, shadows included, with each of :data:`LOBES` [s]."""
    best, caster = [float("inf")] * len(LOBES), cast_rays_at(scene)
    for _ in range(repeats + 1):
        for number, model in enumerate(LOBES.values()):
            own = replace(scene, reflectance=Reflectance(R_d=45.0, R_s=R_S, sigma=sigma, model=model))
            begun = time.process_time()
            render_posture(own, own.postures[0], caster=caster, threads=1)
            best[number] = min(best[number], time.process_time() - begun)
    return best


def main(arguments: list[str] | None = None) -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.light_channels", description=__doc__)
    parser.add_argument("--repeats", type=int, default=2)
    repeats = parser.parse_args(arguments).repeats
    with tempfile.TemporaryDirectory(prefix="lightopt-channels-") as name:
        folder = Path(name)
        print("| light | 8 channels [s] | 1 channel [s] | ratio |\n|---|---|---|---|")
        for light, (several, single) in CASES.items():
            together = seconds(_scene(folder, several), repeats)
            alone = seconds(_scene(folder, single, one=True), repeats)
            print(f"| {light} | {together:.2f} | {alone:.2f} | {together / alone:.2f} |", flush=True)
        print(f"\n| light | {' | '.join(LOBES)} |\n|---|{'---|' * len(LOBES)}")
        for light, words in LIGHTS.items():
            first, *others = seconds_of_lobes(_scene(folder, words), repeats)
            print(f"| {light} | {first:.3f} s | {' | '.join(f'{one / first:.2f}' for one in others)} |", flush=True)
        print(f"\n| part | points | σ | {' | '.join(LOBES)} |\n|---|---|---|{'---|' * len(LOBES)}")
        for part, points, sigma in product(PARTS, (4, "auto"), SIGMAS):
            first, *others = seconds_of_panels(_panels(part, points), sigma, repeats)
            ratios = " | ".join(f"{one / first:.2f}" for one in others)
            print(f"| {part} | {points} | {sigma} | {first:.3f} s | {ratios} |", flush=True)


if __name__ == "__main__":
    main()
