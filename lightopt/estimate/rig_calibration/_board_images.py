"""Corners of a board in images, what is wrong with an image that shows none, and corners that others found (JSON)."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64, Int64, UInt8
from lightopt.core.errors import InputError, counted, percent
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._board import BoardView
from lightopt.estimate.rig_calibration._charuco import CharucoBoard, opencv, opencv_board

_LEAST_CORNERS = 8
_LEAST_MARKERS = 4
_LEAST_CONTRAST = 20.0  # of 255
_MOST_BLUR_PX = 2.0  # standard deviation of an edge's spread
_SATURATED, _MOST_SATURATED = 0.995, 0.01  # level, as a share of the full scale; share of the pixels of the board

FORMAT = "lightopt-corners/1"


@dataclass(frozen=True, eq=False)
class BoardImage:
    """An image of the board."""

    name: str
    posture: Posture
    pixels: Any  # grey levels, shape (height, width), or with colours (height, width, 3)


@dataclass(frozen=True, kw_only=True)
class ImageProblem:
    """What is wrong with an image, and what to do; whether its corners are used all the same."""

    name: str
    message: str
    used: bool


def find_corners(
    images: Sequence[BoardImage], target: CharucoBoard, *, full_scale: float = 255.0
) -> tuple[list[BoardView], list[ImageProblem]]:
    """Corners of the board in each image that shows it, and problems of images.

    full_scale: Level at which a pixel is saturated
    Raises InputError: No OpenCV, images of several sizes, or none that shows the board
    """
    sizes = {image.pixels.shape[:2]: image.name for image in images}
    if len(sizes) > 1:
        found = ", ".join(f"{width} × {height} ({name})" for (height, width), name in sizes.items())
        raise InputError(f"images of a board: sizes differ: {found}. Take all with one camera and one image area")
    cv2, board = opencv(), opencv_board(target)
    views: list[BoardView] = []
    problems: list[ImageProblem] = []
    for image in images:
        levels = np.asarray(image.pixels, np.float64)
        grey = (levels if levels.ndim == 2 else levels.mean(axis=2)) / full_scale
        eight = np.clip(np.rint(grey * 255.0), 0, 255).astype(np.uint8)
        pixels, points = _detect(cv2, board, eight)
        if len(pixels) < _LEAST_CORNERS:
            problems.append(ImageProblem(name=image.name, message=_cause(cv2, target, eight, len(pixels)), used=False))
            continue
        columns = target.squares[0] - 1
        column, row = (np.rint(points[:, :2] / target.square).astype(int) - 1).T
        views.append(BoardView(image.name, image.posture, row * columns + column, pixels + 0.5))
        problems += [ImageProblem(name=image.name, message=text, used=True) for text in _defects(grey, pixels)]
    if not views:
        raise InputError(*(f"{problem.name}: {problem.message}" for problem in problems))
    return views, problems


def _detect(cv2: Any, board: Any, image: UInt8) -> tuple[Float64, Float64]:
    # corners in OpenCV's pixels (centres at whole numbers), shape (n, 2), and on the board [mm], shape (n, 3)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    if ids is None or len(ids) == 0:
        return np.zeros((0, 2)), np.zeros((0, 3))
    points, pixels = board.matchImagePoints(corners, ids)
    return np.asarray(pixels, np.float64).reshape(-1, 2), np.asarray(points, np.float64).reshape(-1, 3)


def _cause(cv2: Any, target: CharucoBoard, image: UInt8, corners: int) -> str:
    # why so few corners were found
    turned = replace(target, legacy_pattern=not target.legacy_pattern)
    if len(_detect(cv2, opencv_board(turned), image)[0]) > max(corners, _LEAST_CORNERS):
        return f"the board is of the other pattern: set legacy_pattern to {str(turned.legacy_pattern).lower()}"
    if len(_detect(cv2, opencv_board(target), np.ascontiguousarray(image[:, ::-1]))[0]) >= _LEAST_CORNERS:
        return "the image is mirrored: turn the camera's mirroring off"
    mine = _markers(cv2, target.dictionary, image)
    count = target.squares[0] * target.squares[1] // 2
    if np.sum(mine >= count) >= max(np.sum(mine < count), _LEAST_MARKERS):
        return (
            f"wrong board: it shows marker {mine.max()} of {target.dictionary}, and a board of {target.squares[0]} × "
            f"{target.squares[1]} squares has 0 to {count - 1}. Check the numbers of squares"
        )
    if len(mine) >= _LEAST_MARKERS:
        return (
            f"{counted(len(mine), 'marker')} and {counted(corners, 'corner')} found, expected at least "
            f"{_LEAST_CORNERS} corners. Show more of the board, or check its numbers of squares"
        )
    # the largest of each kind
    others = [
        n for n in dir(cv2.aruco) if n.startswith("DICT_") and n.isupper() and n[-3:] not in ("_50", "100", "250")
    ]
    found = {name: len(_markers(cv2, name, image)) for name in others}
    best = max(found, key=lambda name: found[name])
    if found[best] >= _LEAST_MARKERS:
        return f"wrong board: its markers are of {best}, expected {target.dictionary}"
    low, high = np.percentile(image, [1, 99])
    if high - low < _LEAST_CONTRAST:
        return f"no board found: grey levels are between {low:.0f} and {high:.0f} of 255. Change the exposure"
    return "no board found. It must be in the image, in focus (stop down), and not at a grazing angle"


def _markers(cv2: Any, dictionary: str, image: UInt8) -> Int64:
    # numbers of the markers of a dictionary that the image shows
    aruco: Any = cv2.aruco
    detector = aruco.ArucoDetector(aruco.getPredefinedDictionary(getattr(aruco, dictionary)))
    _, numbers, _ = detector.detectMarkers(image)
    return np.zeros(0, np.int64) if numbers is None else np.asarray(numbers, np.int64).ravel()


def _defects(grey: Float64, corners: Float64) -> list[str]:
    # what makes corners inaccurate: blur and saturation near them; grey levels as shares of the full scale
    distances = np.linalg.norm(corners[:, None] - corners, axis=2)
    np.fill_diagonal(distances, np.inf)
    radius = max(2, int(0.35 * np.median(distances.min(axis=1))))
    widths: list[float] = []
    saturated: list[float] = []
    for column, row in np.rint(corners).astype(int):
        patch = grey[max(row - radius, 0) : row + radius + 1, max(column - radius, 0) : column + radius + 1]
        dark, bright = np.percentile(patch, [5, 95])
        down, right = np.gradient(patch)
        steepest = float(np.percentile(np.hypot(down, right), 99))
        # an edge blurred by a Gaussian has the slope contrast / (σ·√2π)
        widths.append((bright - dark) / max(steepest * np.sqrt(2.0 * np.pi), 1e-9))
        saturated.append(float(np.mean(patch >= _SATURATED)))
    found: list[str] = []
    if np.median(widths) > _MOST_BLUR_PX:
        found.append(
            f"blurred: edges are {np.median(widths):.1f} px wide (standard deviation), expected at most "
            f"{_MOST_BLUR_PX:g}. Focus, stop the lens down, or wait until the stage stands still"
        )
    if np.mean(saturated) > _MOST_SATURATED:
        found.append(
            f"saturated: {percent(float(np.mean(saturated)))} of the pixels around corners are at full scale, which "
            "moves corners. Expose less"
        )
    return found


def read_corners(path: str | Path) -> list[BoardView]:
    """Views of a board from a corner list.

    ``{"format": "lightopt-corners/1", "views": [{"name": .., "elevation_deg": .., "rotation_deg": .., "ids": [..],
    "pixels": [[column, row], ..]}, ..]}``. Pixel (0, 0) has its centre at (0.5, 0.5): add 0.5 to what OpenCV finds.
    Points are numbered row by row from the board's top left, from 0.

    Raises InputError: The file cannot be read, or is no such list
    """
    path = Path(path)
    try:
        found: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no corner list can be read: {error}") from None
    if not isinstance(found, dict) or found.get("format") != FORMAT or not isinstance(found.get("views"), list):
        raise InputError(f'{path}: expected {{"format": "{FORMAT}", "views": [..]}}')
    views = [_view(f"{path}, view {number}", view) for number, view in enumerate(found["views"], start=1)]
    if not views:
        raise InputError(f"{path}: no views")
    return views


def _view(where: str, view: Any) -> BoardView:
    try:
        posture = Posture(float(view["elevation_deg"]), float(view["rotation_deg"]))
        pixels = np.asarray(view["pixels"], np.float64).reshape(-1, 2)
        return BoardView(str(view.get("name", posture)), posture, np.asarray(view["ids"]), pixels)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        wrong = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{where}: expected name, elevation_deg, rotation_deg, ids and pixels; {wrong}") from None
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
