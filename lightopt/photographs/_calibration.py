"""Camera calibrations of other programs: K, distortion and [R|t] in OpenCV's YAML or JSON, or one matrix as text.

There the first pixel's centre is at (0, 0), and [R|t] turns the world's points to the camera's own axes: x right and y
down in the image, z ahead.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import read_opencv_file
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.transforms import rotation_from_vector

_PIXEL_CENTRE = 0.5  # of the first pixel here; 0 in OpenCV
_ROTATION_TOLERANCE = 2e-3  # entries that were written with three decimals are off by less

# names of values in files; the key of the one matrix of a text file is empty
_K = ("camera_matrix", "cameraMatrix", "K", "mtx", "")
_DISTORTION = ("distortion_coefficients", "distCoeffs", "dist")
_ROTATION, _TRANSLATION = ("rvec", "R"), ("tvec", "T", "t")


@dataclass(frozen=True)
class Intrinsics:
    """How a camera images."""

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
        rows = "; ".join(_row(row) for row in K)
        raise InputError(f"{path}: expected K as fx, 0, cx; 0, fy, cy; 0, 0, 1, without skew, found {rows}")
    given = _numbers(path, values, _DISTORTION)
    distortion = np.zeros(5) if given is None else given.ravel()
    if distortion[5:].any() or "fisheye_model" in values:
        raise InputError(
            f"{path}: the lens has a fisheye model or more than five coefficients; calibrate with OpenCV's k1, k2, p1, "
            "p2, k3, or undistort the images"
        )
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
        raise InputError(
            f"{path}: R is not a rotation: R·Rᵀ is off the identity by {off:.2g}; expected rows of length 1 at right "
            "angles to each other"
        )
    if np.linalg.det(R) < 0.0:
        raise InputError(
            f"{path}: R is left-handed (its determinant is −1): one axis is mirrored; expected a rotation from a "
            "right-handed world to x right, y down, z ahead"
        )
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
        expected, found = (
            " or ".join(" × ".join(map(str, s)) or "one" for s in some) for some in (shapes, [numbers.shape])
        )
        raise InputError(f"{where}: expected {expected} numbers, found {found}")
    if not np.isfinite(numbers).all():
        raise InputError(f"{where}: expected finite numbers, found {_row(numbers.ravel())}")
    return numbers


def _row(values: Float64) -> str:
    return ", ".join(f"{v:g}" for v in values)
