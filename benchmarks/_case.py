"""The scene that everything is measured on: the cover knob at 1.4 million triangles under the four-panel rig."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lightopt import build_scene
from lightopt.core.transforms import Posture
from lightopt.geometry import TriangleMesh, load_mesh, transformed
from lightopt.scene import PinholeCamera, Scene

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
RIG = CONFIGS / "rigs" / "four-panel.yaml"


@dataclass(frozen=True)
class Size:
    """How large the case is.

    Attributes
    ----------
    name
        For the tables.
    width
        Of the image [px]; the height is three quarters of it.
    chord_mm, angle
        Tolerances of the STEP file's tessellation [mm], [rad].
    repeats
        Rounds of every comparison.
    reference_width
        Of the image that is compared pixel by pixel with a panel of many points [px].
    reference_points
        Points along a side of that panel.
    """

    name: str
    width: int
    chord_mm: float
    angle: float
    repeats: int
    reference_width: int
    reference_points: int


FULL = Size("full", 1600, 0.000_15, 0.012, 7, 320, 64)
QUICK = Size("quick", 800, 0.001, 0.03, 3, 120, 64)
TOY = Size("toy", 64, 0.05, 0.3, 1, 32, 8)


def case_scene(size: Size) -> Scene:
    """The cover knob in posture (0, 0), tessellated to the size's tolerances with the surface's normals."""
    return _scene("cover-knob", size, 1.0)


def spout_scene(size: Size) -> Scene:
    """The spout, which shades itself; coarser tolerances give its stronger curvature about as many triangles."""
    return _scene("spout", size, 3.0)


SCENES: dict[str, Callable[[Size], Scene]] = {"cover knob": case_scene, "spout": spout_scene}
"""The sample parts by name."""


def _scene(part: str, size: Size, coarser: float) -> Scene:
    scene = build_scene(RIG, CONFIGS / "parts" / f"{part}.yaml")
    loaded = load_mesh(
        CONFIGS / "parts" / f"{part}.step",
        unit_mm=None,
        normals="smooth",
        crease_angle=math.radians(30.0),
        chord_tolerance_mm=coarser * size.chord_mm,
        angular_tolerance=coarser * size.angle,
    )
    scene = replace(scene, mesh=_rest_on_table(loaded.mesh), postures=(Posture(elevation_deg=0.0, rotation_deg=0.0),))
    return replace(scene, camera=resized(scene.camera, size.width))


def resized(camera: PinholeCamera, width: int) -> PinholeCamera:
    """The same view with another number of pixels, `width` by three quarters of it."""
    height = width * 3 // 4
    assert camera.principal_point is None
    return replace(camera, width=width, height=height, pixel_size=camera.pixel_size * camera.width / width)


def one_posture_files(folder: Path, name: str, *, width: int, pixel_um: str) -> tuple[Path, str]:
    """The sample rig's file with a smaller camera, and the text of a part's file with one posture.

    name: Of a sample part, or the path of another part's file.
    """
    rig = RIG.read_text(encoding="utf-8").replace("[1600, 1200]", f"[{width}, {width * 3 // 4}]")
    (folder / "rig.yaml").write_text(rig.replace("pixel_size_um: 4.4", f"pixel_size_um: {pixel_um}"), encoding="utf-8")
    file = Path(name).resolve() if name.endswith(".yaml") else CONFIGS / "parts" / f"{name}.yaml"
    part = re.sub(
        r"file: ([^\s,}]+)", lambda m: f"file: '{(file.parent / m[1]).as_posix()}'", file.read_text(encoding="utf-8")
    )
    one = "postures: [{elevation_deg: 0, rotation_deg: 0}]\n\nreflectance:"
    return folder / "rig.yaml", re.sub(r"postures:.*?\nreflectance:", one, part, flags=re.DOTALL)


def write_records(path: Path, records: Sequence[object]) -> None:
    """Write instances of a dataclass, one at least, as rows of a CSV file, and print its name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(vars(records[0]))
        writer.writerows(vars(one).values() for one in records)
    print(path)


def chrome(scene: Scene) -> Scene:
    """The scene in polished chrome: σ = 0.003, and R_s so great that the mirror image of a panel is saturated."""
    return replace(scene, reflectance=replace(scene.reflectance, sigma=0.003, R_s=60_000.0))


def _rest_on_table(mesh: TriangleMesh) -> TriangleMesh:
    low, high = mesh.bounds
    shift = -np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    return transformed(mesh, np.eye(3), shift)
