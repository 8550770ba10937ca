"""Texts of the rig and part files of imported photographs, with where each value comes from."""

import json
from collections.abc import Iterable, Sequence

import numpy as np

from lightopt.config import standing_at
from lightopt.core.transforms import vector_of_rotation
from lightopt.photographs._calibration import Intrinsics, Pose
from lightopt.photographs._light_table import TableRow
from lightopt.photographs._part import PhotographedPart

_FAR_MM = 1e6  # a distant light: its direction differs by less than 0.06° over a part of 1 m


def rig_text(
    name: str, rows: Sequence[TableRow], intrinsics: Intrinsics, pose: Pose, *, size: tuple[int, int], bits: int
) -> str:
    """Rig file of photographs of a size [px] and of so many bits."""
    lights = list({row.light: row for row in rows}.values())
    near = [float(np.linalg.norm(row.place)) for row in lights if row.near]
    mean = sum(near) / max(len(near), 1)
    reference = f"  reference_distance_mm: {mean:.9g} # of near lights: the mean of their distances\n" if near else ""
    distortion = ", ".join(f"{name}: {value:.9g}" for name, value in intrinsics.distortion.items())
    return f"""# Written by lightopt import. Lengths in mm, angles in degrees, Z up.

format: lightopt-rig/1
name: {_quoted(name)}

camera:
  pose:
    position_mm: {_list(pose.position)}
    rotation_vector_deg: {_list(np.degrees(vector_of_rotation(pose.rotation)))}
  resolution_px: [{size[0]}, {size[1]}]
  pixel_size_um: 3.45           # assumed; images do not depend on it
  focal_px: {_list(intrinsics.focal)}
  principal_point_px: {_list(intrinsics.principal_point)} # the first pixel's centre is at 0.5, 0.5
  distortion: {{{distortion}}}
  sensor:                       # its noise is not known; --write-noise of the fits adds it
    bit_depth: {bits}

light_source:
  size_mm: [1, 1]
  points: 1                     # size not known: single points; give size_mm and auto if it is
  falloff: none                 # of distant lights: brightness does not depend on the distance
{reference}
lights:                         # gain is the column intensity, 1 without it
{chr(10).join(map(_light, lights))}
"""


def _light(row: TableRow) -> str:
    at = standing_at([float(v) for v in row.place * (1.0 if row.near else _FAR_MM)])
    at["distance_mm"] = at["distance_mm"] if row.near else _FAR_MM
    place = ", ".join(f"{key}: {value:.9g}" for key, value in at.items())
    falloff = ", falloff: inverse_square" if row.near else ""
    return f'  - {{name: "{row.light}", {place}, gain: {row.intensity:.9g}{falloff}}}'


def part_text(part: PhotographedPart, rows: Sequence[TableRow]) -> str:
    postures = [
        f"  - {{elevation_deg: {p.elevation_deg:.9g}, rotation_deg: {p.rotation_deg:.9g}}}"
        for p in dict.fromkeys(row.posture for row in rows)
    ]
    return f"""# Written by lightopt import.

format: lightopt-part/1
name: {_quoted(part.name)}

mesh:
  file: {_quoted(part.file)}
{f"  units: {part.units}" if part.units else ""}

placement:
  anchor: as_modelled
  rotate_deg: {_list(part.rotate_deg)}
  translate_mm: {_list(part.translate_mm)}

postures:
{chr(10).join(postures)}

reflectance:                    # not known yet: fit-diffuse and fit-specular find it
  R_d: 50
  R_s: 1000
  sigma_rad: 0.05
"""


def _list(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{round(float(v), 9) + 0.0:.12g}" for v in values) + "]"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
