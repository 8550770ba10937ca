"""How the time of images and of the hierarchy grows with triangles, pixels, lights and points.

``python -m benchmarks.growth NUMBERS PICTURE`` draws the curves from the JSON file that a run has written.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks._case import Size, case_scene, resized
from benchmarks._report import Report, Table
from benchmarks.bare import THREADS
from lightopt.core.transforms import rotation_z
from lightopt.geometry import TriangleMesh
from lightopt.rendering import cast_rays_at, rays_of_images, render_posture
from lightopt.report import chart, figure_image, fixed_style
from lightopt.scene import Scene

TRIANGLES = {
    "full": (10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000),
    "quick": (10_000, 30_000, 100_000, 300_000, 1_000_000),
    "toy": (200, 800, 3_200),
}
PIXELS = (0.25, 0.5, 1.0, 2.0)  # widths, relative to the size's
LIGHTS = (1, 2, 4, 8)
POINTS = (1, 4, 9, 16, 36, 64)

# which row of a curve is the common case: the third last number of triangles, the size's pixels, 4 lights of 4 points
BASES = {"triangles": -3, "pixels": 2, "lights": 2, "points": 1}

Curve = Sequence[tuple[float, float, float]]  # what grows, seconds of the hierarchy, seconds of the images


def run(size: Size) -> Report:
    """Measure the curves, one quantity at a time from a common case: a torus on the four-panel rig."""
    triangles = TRIANGLES[size.name]
    base = torus_scene(case_scene(replace(size, chord_mm=0.05, angle=0.3)), triangles[BASES["triangles"]])
    curves: dict[str, Curve] = {
        "triangles": [_measured(count, torus_scene(base, count), size) for count in triangles],
        "pixels": [
            _measured(camera.width * camera.height, replace(base, camera=camera), size)
            for camera in (resized(base.camera, round(share * size.width)) for share in PIXELS)
        ],
        "lights": [_measured(count, with_lights(base, count), size) for count in LIGHTS],
        "points": [
            _measured(count, replace(base, lights=tuple(replace(light, points=count) for light in base.lights)), size)
            for count in POINTS
        ],
    }
    width, height, mesh = base.camera.width, base.camera.height, base.mesh
    return Report(
        "growth",
        [_table(name, curve) for name, curve in curves.items()],
        {"curves": curves},
        [
            f"a torus of {len(mesh.faces):,} triangles, {width} × {height} px, 4 lights of 4 points, {THREADS} threads",
            "one of them grows; growth: the exponent, from one row to the next; 1 is in proportion",
        ],
    )


def torus_scene(scene: Scene, triangles: int) -> Scene:
    """The scene with a torus of about so many triangles as its part: closed, curved everywhere, in its own shadow."""
    rings = max(3, round(math.sqrt(triangles / 4.0)))
    around, along = np.meshgrid(np.arange(2 * rings) * (math.pi / rings), np.arange(rings) * (2.0 * math.pi / rings))
    around, along = around.ravel(), along.ravel()
    outward = np.stack([np.cos(around), np.sin(around), np.zeros(len(around))], axis=1)
    normals = np.cos(along)[:, None] * outward + np.sin(along)[:, None] * np.array([0.0, 0.0, 1.0])
    row, column = np.divmod(np.arange(2 * rings * rings), 2 * rings)
    after, above = (column + 1) % (2 * rings), (row + 1) % rings
    a, b, c, d = (r * 2 * rings + k for r, k in ((row, column), (row, after), (above, after), (above, column)))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    order = np.argsort(np.tile(np.arange(len(a)), 2), kind="stable")  # neighbours one after the other
    return replace(scene, mesh=TriangleMesh(17.0 * outward + 8.0 * normals + (0.0, 0.0, 8.0), faces[order], normals))


def with_lights(scene: Scene, count: int) -> Scene:
    """The scene with so many of its lights, and beyond them with the same ones turned by 45°."""
    turned = [light.moved(rotation_z(math.pi / 4.0), np.zeros(3)) for light in scene.lights]
    return replace(scene, lights=(*scene.lights, *turned)[:count])


def _measured(value: float, scene: Scene, size: Size) -> tuple[float, float, float]:
    times: list[tuple[float, float]] = []
    for _ in range(min(3, size.repeats)):
        begun = perf_counter()
        caster = cast_rays_at(scene, rays=rays_of_images(scene))  # anew, as it keeps the maps of blockers
        built = perf_counter()
        render_posture(scene, scene.postures[0], caster=caster, threads=THREADS)
        times.append((built - begun, perf_counter() - built))
        del caster
    return value, min(hierarchy for hierarchy, _ in times), min(images for _, images in times)


def _table(name: str, curve: Curve) -> Table:
    rows: list[tuple[str, ...]] = []
    for before, here in zip((None, *curve), curve, strict=False):
        exponents = ("", "")
        if before is not None:
            step = math.log(here[0] / before[0])
            exponents = tuple(f"{math.log(now / then) / step:.2f}" for now, then in zip(here, before, strict=True))[1:]
        rows.append((f"{here[0]:,.0f}", f"{here[1]:.3f}", exponents[0], f"{here[2]:.3f}", exponents[1]))
    return Table(name, (name, "hierarchy s", "growth", "images s", "growth"), rows)


def plot(curves: Mapping[str, Curve], path: Path) -> None:
    """Time over what grows, each relative to the case that the others share."""
    with fixed_style():
        labels = ("images: time, relative", "hierarchy: time over triangles, relative")
        figure, panels = chart(
            title="How time grows",
            x_label="triangles, pixels, lights, or points, relative to the common case",
            labels=labels,
            log_x=True,
            log_y=(True, True),
        )
        for name, curve in curves.items():
            value, hierarchy, images = curve[BASES[name]]
            over = [row[0] / value for row in curve]
            panels[0].plot(over, [row[2] / images for row in curve], marker="o", label=name)
            if name == "triangles":
                panels[1].plot(over, [row[1] / hierarchy for row in curve], marker="o", label=name)
        for panel in panels:
            panel.plot([0.1, 10.0], [0.1, 10.0], "--", color="#5c636e", label="in proportion")
            panel.legend(frameon=False)
        figure_image(figure).save(path)


if __name__ == "__main__":
    plot(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["numbers"]["curves"], Path(sys.argv[2]))
