"""Texts of the rig and part files of imported photographs, with where each value comes from."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable

import numpy as np

from lightopt.config import standing_at
from lightopt.core.arrays import Float64
from lightopt.core.transforms import vector_of_rotation
from lightopt.photographs._inputs import ImportOptions, Inputs
from lightopt.photographs._light_table import TableRow
from lightopt.photographs._placement import Placed


def rig_text(
    inputs: Inputs, placed: Placed, options: ImportOptions, *, name: str, table: str, light_distance: float
) -> str:
    """Rig file.

    name, table: Of the rig, and of the file of the lights
    light_distance: Of distant lights [mm]
    """
    camera, intrinsics, photographs = placed.camera, inputs.intrinsics, inputs.photographs
    lights = list({row.light: row for row in inputs.rows}.values())
    near = [float(np.linalg.norm(row.place)) for row in lights if row.near]
    side = options.light_size or 1e-3 * min(near or [light_distance])
    size_from = "as given" if options.light_size else "not known; a single point, whatever its size"
    distortion = ", ".join(f"{name}: {value:.9g}" for name, value in intrinsics.distortion.items())
    reference = (
        f"\n  reference_distance_mm: {np.mean(near):.9g} # of near lights: the mean of their distances" if near else ""
    )
    return f"""# Written by lightopt import. Lengths in mm, angles in degrees, Z up.

format: lightopt-rig/1
name: {_quoted(name)}

camera:
  pose:                         # {placed.camera_from}
    position_mm: {_list(camera.position)}
    rotation_vector_deg: {_list(np.degrees(vector_of_rotation(camera.rotation)))}
  resolution_px: [{photographs.size[0]}, {photographs.size[1]}]
  pixel_size_um: 3.45           # assumed; images do not depend on it
  # the lens: from {options.camera.name}; the first pixel's centre is at 0.5, 0.5
  focal_px: {_list(intrinsics.focal)}
  principal_point_px: {_list(intrinsics.principal_point)}
  distortion: {{{distortion}}}
  sensor:                       # its noise is not known; --write-noise of the fits adds it
    bit_depth: {photographs.sensor_bits:<3}              # {photographs.bits_from}

light_source:
  size_mm: [{side:.9g}, {side:.9g}] # {size_from}
  points: {"auto" if options.light_size else 1}
  falloff: none                 # of distant lights: brightness does not depend on the distance{reference}

lights:                         # {table}; gain is the column intensity, 1 without it
{chr(10).join(_light(row, light_distance) for row in lights)}
"""


def _light(row: TableRow, light_distance: float) -> str:
    at = standing_at([float(v) for v in row.place * (1.0 if row.near else light_distance)])
    if not row.near:
        at["distance_mm"] = light_distance
    place = ", ".join(f"{key}: {value:.9g}" for key, value in at.items())
    own = ", falloff: inverse_square" if row.near else ""
    return f'  - {{name: "{row.light}", {place}, gain: {row.intensity:.9g}{own}}}'


def part_text(inputs: Inputs, placed: Placed) -> str:
    """Part file."""
    shape, postures = inputs.shape, dict.fromkeys(row.posture for row in inputs.rows)
    units = f"\n  units: {shape.units}" if shape.units else ""
    listed = "\n".join(
        f"  - {{elevation_deg: {p.elevation_deg:.9g}, rotation_deg: {p.rotation_deg:.9g}}}" for p in postures
    )
    return f"""# Written by lightopt import.

format: lightopt-part/1
name: {_quoted(shape.name)}

mesh:
  file: {_quoted(shape.file)}{units}

placement:                      # {placed.part_from}
  anchor: {placed.anchor}
  rotate_deg: {_list(_fixed_angles(inputs.turn))}
  translate_mm: {_list(placed.translate)}

postures:
{listed}

reflectance:                    # not known yet: fit-diffuse and fit-specular find it
  R_d: 50
  R_s: 1000
  sigma_rad: 0.05
"""


def _fixed_angles(rotation: Float64) -> tuple[float, float, float]:
    """Angles about the fixed X, then Y, then Z axis [deg] of a rotation of shape (3, 3)."""
    r = rotation
    about_y = math.asin(min(1.0, max(-1.0, -r[2, 0])))
    if abs(r[2, 0]) > 1.0 - 1e-9:  # X and Z turn about one line: all of it is put on X
        about_x, about_z = math.atan2(-r[1, 2], r[1, 1]), 0.0
    else:
        about_x, about_z = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    return math.degrees(about_x), math.degrees(about_y), math.degrees(about_z)


def _list(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{round(float(v), 9) + 0.0:.12g}" for v in values) + "]"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
