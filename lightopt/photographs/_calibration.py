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
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
_LENS_ADVICE = "expected OpenCV's k1, k2, p1, p2, k3: calibrate with these, or undistort the images"

# names of a value in files, without upper case, dashes and underscores; the tutorials' own among them
_K = ("cameramatrix", "k", "mtx", "intrinsicmatrix", "intrinsics", "intrinsic")
_DISTORTION = ("distortioncoefficients", "distcoeffs", "dist", "d", "distortion")
_ROTATION = ("r", "rotationmatrix", "rotation", "rvec", "rvecs", "rotationvector")
_TRANSLATION = ("t", "tvec", "tvecs", "translation", "translationvector")
_BOTH = ("rt", "extrinsics", "extrinsic", "extrinsicmatrix")
_WIDTH, _HEIGHT, _SIZE = ("imagewidth", "width"), ("imageheight", "height"), ("imagesize",)


@dataclass(frozen=True)
class Intrinsics:
    """How a camera images.

    focal: In columns and rows [px]
    principal_point: Column and row [px]; the first pixel's centre is at (0.5, 0.5)
    distortion: Coefficients by their name
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

    def turned(self, turn: Float64) -> Pose:
        """The pose in a world turned by a rotation of shape (3, 3)."""
        return Pose(turn @ self.position, turn @ self.rotation)


def read_intrinsics(path: Path) -> Intrinsics:
    """Focal lengths, principal point and distortion from a calibration file.

    Raises InputError: The file, K or the lens model is not as expected
    """
    values = _read(path)
    key, found = _first(values, _K)
    if found is None and "" in values:
        key, found = "", values[""]
    if found is None:
        raise InputError(f"{path}: expected K as camera_matrix or K, found {', '.join(values) or 'nothing'}")
    where = _place(path, key)
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
    return Intrinsics(
        focal=(float(K[0, 0]), float(K[1, 1])),
        principal_point=(float(K[0, 2]) + _PIXEL_CENTRE, float(K[1, 2]) + _PIXEL_CENTRE),
        distortion=_distortion(path, values),
        size=_size(path, values),
    )


def read_pose(path: Path, *, mm_per_unit: float, required: bool) -> Pose | None:
    """Pose of a camera from the [R|t] of a file; None where it has none and `required` is False.

    mm_per_unit: Millimetres in one unit of t
    Raises InputError: Shapes are wrong, or R is not a rotation
    """
    values = _read(path)
    key, both = _first(values, _BOTH)
    if both is None and np.shape(values.get("", ())) in ((3, 4), (4, 4)):
        key, both = "", values[""]
    key_R, turn = _first(values, _ROTATION)
    key_t, t = _first(values, _TRANSLATION)
    if both is not None:
        shape = (4, 4) if np.shape(both) == (4, 4) else (3, 4)
        matrix = _numbers(_place(path, key), both, shape)
        key_R, key_t, turn, t = key, key, matrix[:3, :3], matrix[:3, 3]
        if shape == (4, 4) and not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
            raise InputError(f"{_place(path, key)}: expected the last row 0 0 0 1, found {_row(matrix[3])}")
    if turn is None or t is None:
        if t is None and not required:  # ROS files have an R of another meaning
            return None
        raise InputError(
            f"{path}: expected R and t (or rvec and tvec, or a matrix of 3 × 4), found only {_names(values)}"
        )
    where = _place(path, key_R)
    if np.shape(turn) == (3, 3):
        rotation = _rotation(where, _numbers(where, turn, (3, 3)))
    else:
        rotation = rotation_from_vector(_numbers(where, turn, (3,)))
    translation = _numbers(_place(path, key_t), t, (3,)) * mm_per_unit
    return Pose(position=-rotation.T @ translation, rotation=rotation.T)


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


def _distortion(path: Path, values: Mapping[str, Any]) -> dict[str, float]:
    model, fisheye = (_first(values, (name,))[1] for name in ("distortionmodel", "fisheyemodel"))
    if model not in (None, "plumb_bob", "rational_polynomial") or fisheye:
        raise InputError(f"{path}: the lens model is {model or 'fisheye'}; {_LENS_ADVICE}")
    key, found = _first(values, _DISTORTION)
    numbers = _numbers(_place(path, key), [] if found is None else found, None).ravel()
    if numbers[5:].any():
        raise InputError(f"{_place(path, key)}: found {len(numbers)} coefficients, not only five; {_LENS_ADVICE}")
    return dict(zip(_COEFFICIENTS, (*map(float, numbers[:5]), *[0.0] * 5), strict=False))


def _size(path: Path, values: Mapping[str, Any]) -> tuple[int, int] | None:
    width, height = _first(values, _WIDTH)[1], _first(values, _HEIGHT)[1]
    key, both = _first(values, _SIZE)
    if both is None and (width is None or height is None):
        return None
    size = _numbers(_place(path, key or "image size"), [width, height] if both is None else both, (2,))
    return int(size[0]), int(size[1])


def _read(path: Path) -> dict[str, Any]:
    """Values of a file by their names; a text file has one matrix, without a name."""
    suffix = path.suffix.lower()
    if suffix in (".yml", ".yaml", ".json"):
        return read_opencv_file(path)
    try:
        if suffix == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                return {name: archive[name] for name in archive.files}
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; expected a calibration file") from None
    except (ValueError, EOFError) as error:
        raise InputError(f"{path}: expected numbers as text, or a .npz, .yml or .json file: {error}") from None
    rows: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        cells = re.split(r"[\s,;]+", re.sub(r"[#%].*", "", line).strip(" \t,;[]"))
        if cells == [""]:
            continue
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            raise InputError(f'{path}:{number}: expected numbers only, found "{line.strip()[:60]}"') from None
        if len(rows[-1]) != len(rows[0]):
            raise InputError(
                f"{path}:{number}: expected {len(rows[0])} numbers as in the rows above, found {len(cells)}"
            )
    return {"": rows}


def _first(values: Mapping[str, Any], names: tuple[str, ...]) -> tuple[str, Any]:
    """Key, as the file has it, and value of the first entry that has one of the names."""
    found = ((key, value) for key, value in values.items() if re.sub(r"[-_ ]", "", key.lower()) in names)
    return next(found, ("", None))


def _numbers(where: str, value: object, shape: tuple[int, ...] | None) -> Float64:
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where}: expected numbers, found {str(value)[:60]}") from None
    if shape is not None and (numbers.size == 3 and shape == (3,)):
        numbers = numbers.reshape(3)  # a row or a column
    if shape is not None and numbers.shape != shape:
        expected, found = (" × ".join(map(str, s)) or "one" for s in (shape, numbers.shape))
        several = "; of several poses, write the one of these images to a file" if shape == (3,) else ""
        raise InputError(f"{where}: expected {expected} numbers, found {found}{several}")
    if not np.isfinite(numbers).all():
        raise InputError(f"{where}: expected finite numbers, found {_row(numbers.ravel())}")
    return numbers


def _place(path: Path, key: str) -> str:
    return f"{path}: {key}" if key else str(path)


def _names(values: Mapping[str, Any]) -> str:
    return (
        ", ".join(name or "a matrix of " + " × ".join(map(str, np.shape(v))) for name, v in values.items()) or "nothing"
    )


def _row(values: Float64) -> str:
    return ", ".join(f"{v:g}" for v in values)
