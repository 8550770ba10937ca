"""Camera calibrations of other programs: K, distortion and [R|t] from text, CSV, NPZ, or OpenCV's YAML and JSON.

There the first pixel's centre is at (0, 0), and [R|t] turns the world's points to the camera's own axes: x right and y
down in the image, z ahead.
"""

from __future__ import annotations

import re
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
_MOST_SKEW_PX = 0.05  # how far skew may move an image point

# names of a value in files, without upper case, dashes and underscores; those of OpenCV's tutorials among them
_K = ("cameramatrix", "k", "mtx", "intrinsicmatrix", "intrinsics", "intrinsic")
_DISTORTION = ("distortioncoefficients", "distcoeffs", "dist", "d", "distortion")
_ROTATION = ("r", "rotationmatrix", "rotation", "rvec", "rvecs", "rotationvector")
_TRANSLATION = ("t", "tvec", "tvecs", "translation", "translationvector")
_BOTH = ("rt", "extrinsics", "extrinsic", "extrinsicmatrix")


@dataclass(frozen=True)
class Intrinsics:
    """How a camera images.

    focal: In columns and rows [px]
    principal_point: Column and row [px]; the first pixel's centre is at (0.5, 0.5)
    distortion: Coefficients k1, k2, p1, p2, k3 by their name
    size: Width and height of the images that were calibrated [px], where the file says so
    """

    focal: tuple[float, float]
    principal_point: tuple[float, float]
    distortion: Mapping[str, float]
    size: tuple[int, int] | None


@dataclass(frozen=True)
class Pose:
    """Where a camera is, world frame.

    position: [mm], shape (3,)
    rotation: From the camera's own axes (x right, y down, z ahead) to the world's, shape (3, 3)
    """

    position: Float64
    rotation: Float64


def read_intrinsics(path: Path) -> Intrinsics:
    """Focal lengths, principal point and distortion from a calibration file.

    Raises InputError: The file, K or the lens model is not as expected
    """
    values = _Values(path)
    where, found = values.first("", *_K)
    if found is None:
        raise InputError(f"{path}: expected K as camera_matrix or K, found {values.names}")
    K = _numbers(where, found, (3, 3))
    low = np.array([K[1, 0], K[2, 0], K[2, 1]])
    if low.any():
        hint = "; it looks transposed, as MATLAB writes it" if not np.triu(K, 1).any() else ""
        raise InputError(f"{where}: K is not upper triangular: {_row(low)} below the diagonal; expected 0{hint}")
    if K[2, 2] != 1.0 or min(K[0, 0], K[1, 1]) <= 0.0:
        found = _row(np.diag(K))
        raise InputError(
            f"{where}: expected fx and fy above 0 and 1 as the last number of K, found the diagonal {found}"
        )
    if (slant := abs(K[0, 1]) * K[1, 2] / K[1, 1]) > _MOST_SKEW_PX:
        raise InputError(f"{where}: skew {K[0, 1]:g} moves image points by {slant:.2g} px; calibrate without skew")
    where, size = values.first("imagesize")
    if size is None:
        sides = [values.first(f"image{name}", name)[1] for name in ("width", "height")]
        size = None if None in sides else sides
    width_height = None if size is None else [int(side) for side in _numbers(where, size, (2,))]
    return Intrinsics(
        focal=(float(K[0, 0]), float(K[1, 1])),
        principal_point=(float(K[0, 2]) + _PIXEL_CENTRE, float(K[1, 2]) + _PIXEL_CENTRE),
        distortion=_distortion(values),
        size=None if width_height is None else (width_height[0], width_height[1]),
    )


def read_pose(path: Path, *, mm_per_unit: float, required: bool) -> Pose | None:
    """Pose of a camera from the [R|t] of a file; None where it has none and `required` is False.

    mm_per_unit: Millimetres in one unit of t
    Raises InputError: Shapes are wrong, or R is not a rotation
    """
    values = _Values(path)
    where, both = values.first(*_BOTH, *([""] if required else []))
    if both is not None:
        matrix = _numbers(where, both, (3, 4), (4, 4))
        if matrix[3:].any() and not np.array_equal(matrix[3:], [[0.0, 0.0, 0.0, 1.0]]):
            raise InputError(f"{where}: expected 0, 0, 0, 1 as the last row, found {_row(matrix[3])}")
        where_t, turn, t = where, matrix[:3, :3], matrix[:3, 3]
    else:
        (where, turn), (where_t, t) = values.first(*_ROTATION), values.first(*_TRANSLATION)
        if t is None and not required:  # ROS files have an R of another meaning
            return None
    if turn is None or t is None:
        raise InputError(f"{path}: expected R and t, rvec and tvec, or a matrix of 3 × 4, found {values.names}")
    numbers = _numbers(where, turn, (3,), (3, 3))
    R = _rotation(where, numbers) if numbers.ndim == 2 else rotation_from_vector(numbers)
    return Pose(position=-R.T @ _numbers(where_t, t, (3,)) * mm_per_unit, rotation=R.T)


def _rotation(where: str, R: Float64) -> Float64:
    # the nearest rotation to entries that were rounded
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > _ROTATION_TOLERANCE:
        raise InputError(
            f"{where}: R is not a rotation: R·Rᵀ is off the identity by {off:.2g}; expected rows of length 1 at right "
            "angles to each other"
        )
    if np.linalg.det(R) < 0.0:
        raise InputError(
            f"{where}: R is left-handed (its determinant is −1): one axis is mirrored; expected a rotation from a "
            "right-handed world to x right, y down, z ahead"
        )
    u, _, v = np.linalg.svd(R)
    return u @ v


def _distortion(values: _Values) -> dict[str, float]:
    advice = "expected OpenCV's k1, k2, p1, p2, k3: calibrate with these, or undistort the images"
    model, fisheye = (values.first(name)[1] for name in ("distortionmodel", "fisheyemodel"))
    if model not in (None, "plumb_bob", "rational_polynomial") or fisheye:
        raise InputError(f"{values.path}: the lens model is {model or 'fisheye'}; {advice}")
    where, found = values.first(*_DISTORTION)
    numbers = _numbers(where, [] if found is None else found).ravel()
    if numbers[5:].any():
        raise InputError(f"{where}: found {len(numbers)} coefficients, not only five; {advice}")
    return dict(zip(("k1", "k2", "p1", "p2", "k3"), (*map(float, numbers[:5]), *[0.0] * 5), strict=False))


class _Values:
    """Values of a calibration file by their names; a text file has one matrix, without a name."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if path.suffix.lower() in (".yml", ".yaml", ".json"):
            self._found = read_opencv_file(path)
            return
        try:
            if path.suffix.lower() == ".npz":
                with np.load(path, allow_pickle=False) as archive:
                    self._found = {name: archive[name] for name in archive.files}
            else:
                self._found = {"": list(_rows(path, path.read_text(encoding="utf-8-sig")))}
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}; expected a calibration") from None
        except (ValueError, EOFError) as error:
            raise InputError(f"{path}: expected numbers as text, or a .npz, .yml or .json file: {error}") from None

    @property
    def names(self) -> str:
        """What the file has, in words."""
        named = (name or "a matrix of " + " × ".join(map(str, np.shape(v))) for name, v in self._found.items())
        return ", ".join(named) or "nothing"

    def first(self, *names: str) -> tuple[str, Any]:
        """Place, for messages, and value of the first entry that has one of the names; None without one."""
        for key, value in self._found.items():
            if re.sub(r"[-_ ]", "", key.lower()) in names:
                return f"{self.path}: {key}" if key else str(self.path), value
        return str(self.path), None


def _rows(path: Path, text: str) -> list[list[float]]:
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        numbers = re.sub(r"[#%].*|[\[\],;]", " ", line).split()
        try:
            rows += [[float(cell) for cell in numbers]] if numbers else []
        except ValueError:
            raise InputError(f'{path}:{number}: expected numbers only, found "{line.strip()[:60]}"') from None
        if numbers and len(numbers) != len(rows[0]):
            raise InputError(f"{path}:{number}: expected {len(rows[0])} numbers as above, found {len(numbers)}")
    return rows


def _numbers(where: str, value: object, *shapes: tuple[int, ...]) -> Float64:
    """An array of one of the shapes, of any shape where none is given; a vector may be a row or a column."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where}: expected numbers, found {str(value)[:60]}") from None
    if shapes and (numbers.size,) in shapes:
        numbers = numbers.ravel()
    if shapes and numbers.shape not in shapes:
        expected = " or ".join(" × ".join(map(str, shape)) for shape in shapes)
        found = " × ".join(map(str, numbers.shape)) or "one"
        several = "; of several poses, write the one of these images to a file" if (3,) in shapes else ""
        raise InputError(f"{where}: expected {expected} numbers, found {found}{several}")
    if not np.isfinite(numbers).all():
        raise InputError(f"{where}: expected finite numbers, found {_row(numbers.ravel())}")
    return numbers


def _row(values: Float64) -> str:
    return ", ".join(f"{v:g}" for v in values)
