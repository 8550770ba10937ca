"""What photographs come with: tables of lights, and camera calibrations of other programs.

Tables are CSV with one row per photograph: its light, where that stood, exposure and posture. Calibrations are K,
distortion and [R|t] in OpenCV's YAML or JSON, or one matrix as text. There the first pixel's centre is at (0, 0), and
[R|t] turns the world's points to the camera's own axes: x right and y down in the image, z ahead.
"""

import csv
import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import read_opencv_file
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError, collected, refuse
from lightopt.core.transforms import Posture, rotation_from_vector

_PIXEL_CENTRE = 0.5  # of the first pixel here; 0 in OpenCV
_ROTATION_TOLERANCE = 2e-3  # entries that were written with three decimals are off by less
# names of values in files; the key of the one matrix of a text file is empty
_K = ("camera_matrix", "cameraMatrix", "K", "mtx", "")
_DISTORTION = ("distortion_coefficients", "distCoeffs", "dist")
_ROTATION, _TRANSLATION = ("rvec", "R"), ("tvec", "T", "t")


@dataclass(frozen=True)
class Intrinsics:
    focal: tuple[float, float]  # in columns and rows [px]
    principal_point: tuple[float, float]  # column and row [px]; the first pixel's centre is at (0.5, 0.5)
    distortion: Mapping[str, float]  # coefficients k1, k2, p1, p2, k3 by their name
    size: tuple[int, int] | None  # width and height of the images that were calibrated [px], where the file says so


@dataclass(frozen=True)
class Pose:
    """Where a camera is, world frame."""

    position: Float64  # [mm], shape (3,)
    rotation: Float64  # from the camera's own axes (x right, y down, z ahead) to the world's, shape (3, 3)


def read_intrinsics(path: Path) -> Intrinsics:
    """Focal lengths, principal point and distortion; InputError where the file, K or the lens is not as expected."""
    values = _read(path)
    K = _numbers(path, values, _K, (3, 3))
    if K is None:
        raise InputError(f"{path}: expected K as camera_matrix, found {', '.join(values) or 'nothing'}")
    (fx, skew, cx), (left, fy, cy) = K[:2]
    if fx <= 0.0 or fy <= 0.0 or skew or left or K[2].tolist() != [0.0, 0.0, 1.0]:
        rows = "; ".join(_listed(row) for row in K)
        raise InputError(f"{path}: expected K as fx, 0, cx; 0, fy, cy; 0, 0, 1, without skew, found {rows}")
    given = _numbers(path, values, _DISTORTION)
    distortion = np.zeros(5) if given is None else given.ravel()
    if distortion[5:].any() or "fisheye_model" in values:
        raise InputError(f"{path}: a fisheye lens or more than five coefficients; undistort the images")
    size = [_numbers(path, values, (f"image_{side}",), ()) for side in ("width", "height")]
    return Intrinsics(
        focal=(float(fx), float(fy)),
        principal_point=(float(cx) + _PIXEL_CENTRE, float(cy) + _PIXEL_CENTRE),
        distortion=dict(zip(("k1", "k2", "p1", "p2", "k3"), distortion.tolist(), strict=False)),
        size=None if size[0] is None or size[1] is None else (int(size[0]), int(size[1])),
    )


def read_pose(path: Path, *, mm_per_unit: float) -> Pose | None:
    """Pose of a camera from the [R|t] of a file; None where it has none.

    mm_per_unit: Millimetres in one unit of t
    Raises InputError: Shapes are wrong, or R is not a rotation
    """
    values = _read(path)
    if "" in values and values[""].shape == (3, 3):  # K as text
        return None
    both = _numbers(path, values, ("",), (3, 4))
    if both is not None:
        turn, t = both[:, :3], both[:, 3]
    else:
        turn, t = _numbers(path, values, _ROTATION, (3,), (3, 3)), _numbers(path, values, _TRANSLATION, (3,))
        if turn is None or t is None:
            return None
    R = rotation_from_vector(turn) if turn.ndim == 1 else _rotation(path, turn)
    return Pose(position=-R.T @ t * mm_per_unit, rotation=R.T)


def _rotation(path: Path, R: Float64) -> Float64:
    # the nearest rotation to entries that were rounded
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > _ROTATION_TOLERANCE:
        raise InputError(f"{path}: R is not a rotation: R·Rᵀ is off the identity by {off:.2g}")
    if np.linalg.det(R) < 0.0:
        raise InputError(f"{path}: R is left-handed (its determinant is −1): one axis is mirrored")
    u, _, v = np.linalg.svd(R)
    return u @ v


def _read(path: Path) -> dict[str, Any]:
    if path.suffix.lower() in (".yml", ".yaml", ".json"):
        return read_opencv_file(path)
    try:
        text = path.read_text(encoding="utf-8-sig").replace(",", " ")
        return {"": np.loadtxt(io.StringIO(text), ndmin=2)}
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; expected a calibration") from None
    except ValueError as error:
        raise InputError(f"{path}: expected numbers as text, or a .yml or .json file: {error}") from None


def _numbers(path: Path, values: Mapping[str, Any], names: tuple[str, ...], *shapes: tuple[int, ...]) -> Float64 | None:
    """An array of one of the shapes, of any shape where none is given; a vector may be a row or a column."""
    name = next((name for name in names if name in values), None)
    if name is None:
        return None
    where = f"{path}: {name}" if name else str(path)
    try:
        numbers = np.asarray(values[name], dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where}: expected numbers, found {str(values[name])[:60]}") from None
    if (numbers.size,) in shapes:
        numbers = numbers.ravel()
    if shapes and numbers.shape not in shapes:
        words = [" or ".join(" × ".join(map(str, s)) or "one" for s in some) for some in (shapes, [numbers.shape])]
        expected, found = words
        raise InputError(f"{where}: expected {expected} numbers, found {found}")
    if not np.isfinite(numbers).all():
        raise InputError(f"{where}: expected finite numbers, found {_listed(numbers.ravel())}")
    return numbers


def _listed(values: Float64) -> str:
    return ", ".join(f"{v:g}" for v in values)


_DIRECTION, _POSITION = ("x", "y", "z"), ("x_mm", "y_mm", "z_mm")
_DEFAULTS = {"exposure": 1.0, "intensity": 1.0, "tilt_deg": 0.0, "rotation_deg": 0.0}
_COLUMNS = ("image", "light", *_DIRECTION, *_POSITION, *_DEFAULTS)
_UNIT_TOLERANCE = 0.05  # a direction whose length is further off 1 is suspected to be a position


@dataclass(frozen=True)
class TableRow:
    where: str  # file and line, for messages
    image: str
    light: str
    place: Float64  # unit vector to a distant light or, if `near`, where it stands [mm]; shape (3,)
    near: bool
    exposure: float
    intensity: float  # brightness of the light, relative to the others
    posture: Posture


def read_light_table(path: Path) -> tuple[TableRow, ...]:
    """Rows of a table of lights; an InputError has a message for each wrong column, cell, light or image."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}; expected a table of lights, CSV in UTF-8") from None
    header = text.partition("\n")[0]
    reader = csv.DictReader(text.splitlines(), delimiter=max(",;\t", key=header.count), skipinitialspace=True)
    names = {name.strip() for name in reader.fieldnames or ()}
    if names - {*_COLUMNS} or not names >= {"image", "light"} or not (names >= {*_DIRECTION} or names >= {*_POSITION}):
        raise InputError(
            f"{path}:1: expected the columns image, light and x, y, z (direction to the light) or x_mm, y_mm, z_mm "
            f"(position), and perhaps {', '.join(_DEFAULTS)}, found {', '.join(reader.fieldnames or ()) or 'nothing'}"
        )
    problems: list[str] = []
    rows: list[TableRow] = []
    for cells in reader:
        where = f"{path}:{reader.line_num}"
        if None in cells or None in cells.values():
            problems.append(f"{where}: expected as many cells as the header has")
            continue
        with collected(problems):
            rows.append(_row(where, {name.strip(): cell.strip() for name, cell in cells.items()}))
    problems += _contradictions(rows)
    if not rows and not problems:
        problems.append(f"{path}: expected a row per photograph, found none")
    refuse(problems)
    return tuple(rows)


def _row(where: str, cells: Mapping[str, str]) -> TableRow:
    problems: list[str] = []

    def number(name: str) -> float:
        try:
            value = float(cells.get(name) or _DEFAULTS.get(name, math.nan))
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or (name in ("exposure", "intensity") and value <= 0.0):
            above = " above 0" if name in ("exposure", "intensity") else ""
            problems.append(f'{where}: column {name}: expected a number{above}, found "{cells.get(name)}"')
        return value

    light = cells["light"]
    if not cells["image"]:
        problems.append(f'{where}: light "{light}" without an image; give its file in column image, or remove the row')
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}", light):
        problems.append(f'{where}: column light: expected a name of letters, digits and . _ -, found "{light}"')
    near, distant = (any(cells.get(name) for name in names) for names in (_POSITION, _DIRECTION))
    place = np.zeros(3)
    if near == distant:
        found = "both" if near else "neither: an image without light"
        problems.append(f"{where}: expected a direction (x, y, z) or a position (x_mm, y_mm, z_mm), found {found}")
    else:
        place = np.array([number(name) for name in (_POSITION if near else _DIRECTION)])
    length = float(np.linalg.norm(place))
    if distant and abs(length - 1.0) > _UNIT_TOLERANCE:
        problems.append(f"{where}: expected a direction of length 1, found {length:.4g}; positions: x_mm, y_mm, z_mm")
    exposure, intensity, tilt, rotation = (number(name) for name in _DEFAULTS)
    refuse(problems)
    place = place if near else place / length
    return TableRow(where, cells["image"], light, place, near, exposure, intensity, Posture(tilt, rotation))


def _contradictions(rows: list[TableRow]) -> list[str]:
    problems: list[str] = []
    seen: dict[object, TableRow] = {}
    for row in rows:
        first = seen.setdefault(("light", row.light.lower()), row)
        same = (first.light, first.near, first.intensity) == (row.light, row.near, row.intensity)
        if not same or not np.allclose(first.place, row.place, rtol=0.0, atol=1e-6):
            problems.append(f'{row.where}: "{row.light}" has another place, intensity or spelling in {first.where}')
        for key in (row.image, (row.light, row.posture, row.exposure)):
            if (before := seen.setdefault(key, row)) is not row:
                what = row.image if key == row.image else f"{row.light} {row.posture}, exposure {row.exposure:g},"
                problems.append(f"{row.where}: {what} is already in {before.where}; expected each once")
    return problems
