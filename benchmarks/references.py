"""The three references on parts that the model does not describe; writes a table of docs/validation/inspection.md.

``python -m benchmarks.references`` renders parts from meshes and textures of their own, and inspects them with a flat
plate or disc as CAD: a matte plate without features, a brushed plate, a sheet with wavy normals, and a coin. Each part
is displaced, and has noise, texture or waves of its own. Calibrations learn from other good parts than those that are
counted.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks._case import RIG
from benchmarks.inspection import FIRST, replace_block
from lightopt import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import rotation_z
from lightopt.estimate.registration import Placement, place_part
from lightopt.images import ImageSet, read_image_set, write_png
from lightopt.inspection import (
    Calibration,
    InspectionResult,
    InspectOptions,
    PredictionCache,
    calibrate,
    inspect_set,
    region_hits,
    sets_needed,
)
from lightopt.optics import expose, image_rng
from lightopt.rendering import PostureImages, cast_rays_at, render_posture
from lightopt.scene import build_scene

Float = NDArray[np.float64]
Surface = Callable[[Float, Float, np.random.Generator], Float]
"""Height of a surface over x and y [mm]; waves of its own are drawn from the generator."""

WIDTH = 400
PIXEL_MM = 0.044 * 1600 / WIDTH
THICKNESS_MM = 3.0
STEP_MM = 0.2
"""Between the vertices of the top."""
SHIFT_MM, TURN_RAD = 0.25, math.radians(0.15)
"""A part lies up to so far off its place."""

CATALOGUE = """\
defect_catalogue:
  - {name: scratch, kind: scratch, size_mm: [6, 0.5], slope_deg: 6}
  - {name: dent, kind: dent, size_mm: 2, slope_deg: 5}
  - {name: bump, kind: bump, size_mm: 1.5, slope_deg: 5}
  - {name: pit, kind: pit, size_mm: 0.8, slope_deg: 15}
  - {name: blister, kind: blister, size_mm: 1.5, slope_deg: 6}
  - {name: stain, kind: stain, size_mm: [2, 1.5], R_d_factor: 0.85}
"""
DEFECTS = 6


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of part that its model does not describe.

    half_mm: Half of its sides.
    round: Whether it is a disc.
    surface: Of the true part; None is flat, as the model has it.
    own_surface: Whether each part has another one.
    grain_mm: Width of the texture's grain along x and y.
    grain: Its standard deviation, as a share of the light.
    common: Of the grain's variance, the share that is the same under all lights.
    """

    half_mm: tuple[float, float] = (21.0, 15.0)
    round: bool = False
    surface: Surface | None = None
    own_surface: bool = False
    grain_mm: tuple[float, float] = (0.1, 0.1)
    grain: float = 0.0
    common: float = 0.5


def waves(x: Float, y: Float, rng: np.random.Generator) -> Float:
    """A sheet's waves: slopes of about half a degree, 8 to 25 mm long."""
    height = np.zeros_like(x)
    for _ in range(8):
        length, direction, phase = rng.uniform(8.0, 25.0), rng.uniform(0.0, math.pi), rng.uniform(0.0, 2.0 * math.pi)
        k = 2.0 * math.pi / length
        slope = math.radians(0.5) / math.sqrt(4.0)
        height += slope / k * np.sin(k * (math.cos(direction) * x + math.sin(direction) * y) + phase)
    return height


def relief(x: Float, y: Float, _rng: np.random.Generator) -> Float:
    """A coin's relief, the same on each: smooth hills with slopes up to some 15°, and a flat rim."""
    rng = np.random.default_rng(5)
    height = np.zeros_like(x)
    for _ in range(60):
        r, a = 12.5 * math.sqrt(rng.random()), rng.uniform(0.0, 2.0 * math.pi)
        width = rng.uniform(0.7, 2.0)
        square = (x - r * math.cos(a)) ** 2 + (y - r * math.sin(a)) ** 2
        height += 0.2 * width * rng.choice([-1.0, 1.0]) * np.exp(-square / (2.0 * width**2))
    return height * np.clip((15.5 - np.hypot(x, y)) / 2.0, 0.0, 1.0)


KINDS = {
    "matte plate": Kind(),
    "brushed plate": Kind(grain_mm=(4.0, 0.12), grain=0.05),
    "sheet": Kind(surface=waves, own_surface=True, grain=0.01),
    "coin": Kind(half_mm=(18.0, 18.0), round=True, surface=relief, grain=0.01),
}


def write_solid(path: Path, kind: Kind, surface: Surface | None, rng: np.random.Generator) -> None:
    """Write a plate or disc as STL: a top with a surface, walls, and a flat bottom."""
    n, m = (math.ceil(2.0 * half / STEP_MM) + 1 for half in kind.half_mm)
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, n), np.linspace(-1.0, 1.0, m), indexing="ij")
    if kind.round:
        u, v = u * np.sqrt(1.0 - 0.5 * v * v), v * np.sqrt(1.0 - 0.5 * u * u)
    x, y = kind.half_mm[0] * u, kind.half_mm[1] * v
    top = np.full_like(x, THICKNESS_MM) if surface is None else THICKNESS_MM + surface(x, y, rng)
    above, below = np.stack([x, y, top], axis=-1), np.stack([x, y, np.zeros_like(x)], axis=-1)

    def faces(a: Float) -> Float:
        corners = a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]
        first, second, third, fourth = (corner.reshape(-1, 3) for corner in corners)
        return np.concatenate([np.stack([first, second, third], 1), np.stack([first, third, fourth], 1)])

    def border(a: Float) -> Float:
        return np.concatenate([a[:-1, 0], a[-1, :-1], a[:0:-1, -1], a[0, ::-1]])

    walls = faces(np.stack([border(below), border(above)], axis=1))[:, ::-1]
    triangles = np.concatenate([faces(above), faces(below)[:, ::-1], walls[:, ::-1]])
    data = np.zeros(len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")]))
    data["corners"] = triangles
    path.write_bytes(bytes(80) + np.uint32(len(data)).tobytes() + data.tobytes())


def part_text(mesh: str) -> str:
    """A part file of a matte plate or disc."""
    return (
        f"format: lightopt-part/1\nname: {mesh}\nmesh: {{file: {mesh}.stl, units: mm}}\n"
        "placement: {anchor: rest_on_table}\npostures: [{elevation_deg: 0, rotation_deg: 0}]\n"
        f"reflectance: {{R_d: 170, R_s: 400, sigma_rad: 0.1}}\n{CATALOGUE}"
    )


def files(folder: Path, kind: Kind) -> tuple[Path, Path]:
    """The sample rig with a smaller camera, and the part as its model has it."""
    text = RIG.read_text(encoding="utf-8").replace("[1600, 1200]", f"[{WIDTH}, {WIDTH * 3 // 4}]")
    (folder / "rig.yaml").write_text(text.replace("pixel_size_um: 4.4", f"pixel_size_um: {100 * PIXEL_MM:g}"))
    write_solid(folder / "cad.stl", kind, None, np.random.default_rng(0))
    (folder / "cad.yaml").write_text(part_text("cad"), encoding="utf-8")
    return folder / "rig.yaml", folder / "cad.yaml"


def grain(kind: Kind, points: Float, rng: np.random.Generator) -> Float:
    """Texture at points of the part, shape (n, 3): standard deviation 1."""
    step = 0.5 * PIXEL_MM
    sides = [math.ceil((2.0 * half + 2.0) / step) for half in kind.half_mm]
    noise = ndimage.gaussian_filter(rng.standard_normal(sides), [one / step for one in kind.grain_mm], mode="wrap")
    where = [(points[:, axis] + kind.half_mm[axis] + 1.0) / step for axis in (0, 1)]
    return ndimage.map_coordinates(noise / noise.std(), where, order=1, mode="nearest")


@dataclass(frozen=True)
class Taken:
    """The images of a part, and the number of the defect that each pixel shows, −1 for none; None for a good part."""

    image_set: ImageSet
    labels: NDArray[np.int32] | None = None


def take(folder: Path, kind: Kind, seed: int, *, good: bool) -> Taken:
    """Images of a part that lies off its place, with noise, texture and waves of a seed."""
    rng = np.random.default_rng([11, seed, good])
    out = folder / f"{'good' if good else 'bad'}-{seed:03}"
    out.mkdir()
    name = f"own-{out.name}" if kind.own_surface else "own"
    if not (folder / f"{name}.stl").exists():
        write_solid(folder / f"{name}.stl", kind, kind.surface, rng)
        (folder / f"{name}.yaml").write_text(part_text(name), encoding="utf-8")
    path = folder / f"{name}.yaml"
    if not good:
        path = _with_defects(folder, path, seed)
    scene = build_scene(load_rig(folder / "rig.yaml"), load_part(path), postures=(FIRST,), defects=not good)
    x, y, turn = (float(a) for a in rng.uniform(-1.0, 1.0, 3) * (SHIFT_MM, SHIFT_MM, TURN_RAD))
    placed = place_part(scene, Placement(x=x, y=y, turn=turn))
    images = render_posture(placed, FIRST, caster=cast_rays_at(placed))
    hit = images.geometry.hit
    points = (images.geometry.points[hit].astype(np.float64) - [x, y, 0.0]) @ rotation_z(turn)
    common = grain(kind, points, rng)
    entries: list[dict[str, object]] = []
    for number, image in enumerate(images.lights):
        own = math.sqrt(kind.common) * common + math.sqrt(1.0 - kind.common) * grain(kind, points, rng)
        level = image.level.astype(np.float64)
        level[hit] *= np.maximum(1.0 + kind.grain * own, 0.0)
        noise = image_rng(seed + 1000 * (not good), light=number, posture=0, exposure=0)
        full_scale = scene.reflectance.full_scale
        levels = expose(level, sensor=scene.sensor, exposure=1.0, full_scale=full_scale, rng=noise)
        write_png(out / f"{image.light}.png", levels, metadata={})
        light = next(one for one in load_rig(folder / "rig.yaml").lights if one.name == image.light)
        entries.append(
            {
                "light": image.light,
                "light_elevation_deg": light.elevation_deg,
                "light_azimuth_deg": light.azimuth_deg,
                "posture": FIRST.as_dict(),
                "exposure": 1.0,
                "png": f"{image.light}.png",
            }
        )
    manifest = {"format": "lightopt-images/1", "kind": "captured", "bit_depth": 8, "full_scale": 255, "images": entries}
    (out / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    return Taken(read_image_set(out), _labels(images) if not good else None)


def _labels(images: PostureImages) -> NDArray[np.int32]:
    assert images.geometry.defect is not None
    return images.geometry.defect.astype(np.int32)


def _with_defects(folder: Path, part: Path, seed: int) -> Path:
    from lightopt.cli._main import run

    out = folder / f"{part.stem}-{seed}.yaml"
    words = ["defects", folder / "rig.yaml", part, "--seed", seed, "--count", DEFECTS, "-o", out, "-q", "--force"]
    assert run([str(word) for word in words]) == 0
    return out
