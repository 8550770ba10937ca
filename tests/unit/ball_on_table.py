"""A small rig and a ball of radius 20 mm on the table, or a plate."""

from __future__ import annotations

from pathlib import Path

import trimesh

from lightopt import load_part, load_rig

RIG = """\
format: lightopt-rig/1
name: small
camera: {distance_mm: 550, elevation_deg: 90, resolution_px: [80, 60], pixel_size_um: 88, image_distance_mm: 55,
  sensor: {bit_depth: 8}}
"""
PART = """\
format: lightopt-part/1
name: ball
mesh: {file: ball.stl, units: mm}
reflectance: {R_d: 45, R_s: 12500, sigma_rad: 0.01}
postures: [{elevation_deg: 0, rotation_deg: 0}]
"""


def world(folder: Path, *lights: str, plate: bool = False):
    """Rig and part: a ball of radius 20 mm, or a plate."""
    mesh = trimesh.creation.box((50, 40, 2)) if plate else trimesh.creation.icosphere(subdivisions=5, radius=20.0)
    mesh.export(folder / "ball.stl")
    (folder / "rig.yaml").write_text(RIG + "lights:\n" + "".join(f"  - {light}\n" for light in lights))
    (folder / "part.yaml").write_text(PART)
    return load_rig(folder / "rig.yaml"), load_part(folder / "part.yaml")
