"""Flat boards on the stage: their points, printed ChArUco boards, and corners in images. Home of OpenCV.

A ChArUco board is a chessboard with a marker in each white square, so that corners have numbers. OpenCV is an optional
extra. Its corners are half a pixel off from 4.10 to 4.13, so 4.14 is the least.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import BoardTargetConfig
from lightopt.core.arrays import Float64, Index, Int64, UInt8, read_only
from lightopt.core.errors import InputError, counted, percent
from lightopt.core.transforms import Posture
from lightopt.geometry import TriangleMesh


@dataclass(frozen=True, kw_only=True)
class Board:
    """A grid of points on a nearly flat board. Point ``id = row · columns + column`` counts from the top left.

    Board frame: origin at the grid's centre, x to the right, y up, z out of the printed face.
    """

    columns: int  # points along the two sides
    rows: int
    pitch: float  # distance of neighbouring points, the geometric mean of both sides' [mm]; measure it with a caliper
    pitch_error: float = 1e-4  # standard error of that, as a share of the pitch
    # of the grid's centre above the table at tilt 0: the board's thickness [mm]. It alone fixes the origin along Z
    height: float = 0.0
    height_error: float = 0.01  # standard error of that [mm]

    @property
    def points(self) -> Float64:
        """Positions of all points by id in the board frame [mm], shape (columns · rows, 2)."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        x, y = column - 0.5 * (self.columns - 1), 0.5 * (self.rows - 1) - row
        return self.pitch * np.column_stack([x, y])


@dataclass(frozen=True, eq=False)
class BoardView:
    name: str  # of the image, for messages
    posture: Posture  # readings of the stage
    ids: Index = field(repr=False)  # points' numbers, shape (n,)
    # where the image shows them (column, row) [px], shape (n, 2); pixel (0, 0) has its centre at (0.5, 0.5)
    pixels: Float64 = field(repr=False)

    def __post_init__(self) -> None:
        ids, pixels = np.asarray(self.ids), np.asarray(self.pixels, np.float64)
        whole = not len(ids) or ids.dtype.kind in "iu"
        if not whole or ids.ndim != 1 or pixels.shape != (len(ids), 2) or not np.isfinite(pixels).all():
            raise InputError(
                f"{self.name}: expected n whole numbers and n × 2 finite pixel positions, found {ids.shape}, "
                f"{pixels.shape}"
            )
        if len(np.unique(ids)) < len(ids):
            raise InputError(f"{self.name}: a point is listed twice")
        object.__setattr__(self, "ids", read_only(ids.astype(np.intp)))
        object.__setattr__(self, "pixels", read_only(pixels))


_LEAST_OPENCV = (4, 14)
INSTALL = "pip install 'lightopt[opencv]'"


def board_grid(target: BoardTargetConfig) -> Board:
    columns, rows = target.squares
    return Board(
        columns=columns - 1,
        rows=rows - 1,
        pitch=target.square_mm,
        pitch_error=target.square_error,
        height=target.height_mm,
        height_error=target.height_error_mm,
    )


def opencv() -> Any:
    """The module cv2; an InputError with how to install it where it is missing or too old."""
    try:
        cv2: Any = import_module("cv2")
    except ImportError as error:
        raise InputError(f"ChArUco boards need OpenCV, which is not there ({error}); {INSTALL}") from None
    found = tuple(int(digits) for digits in str(cv2.__version__).split(".")[:2])
    if found < _LEAST_OPENCV:
        raise InputError(f"OpenCV {cv2.__version__} finds ChArUco corners half a pixel off; expected 4.14: {INSTALL}")
    if not hasattr(cv2, "aruco"):
        raise InputError(f"this OpenCV has no module aruco; {INSTALL}")
    return cv2


def opencv_board(target: BoardTargetConfig) -> Any:
    """OpenCV's board of a target.

    Raises InputError: No such dictionary, or it has too few markers
    """
    aruco: Any = opencv().aruco
    names = sorted(name for name in dir(aruco) if name.startswith("DICT_"))
    if target.dictionary not in names:
        raise InputError(f"no dictionary {target.dictionary}; expected one of {', '.join(names)}")
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, target.dictionary))
    if target.marker_mm >= target.square_mm:
        raise InputError(f"markers of {target.marker_mm:g} mm: expected less than the squares' {target.square_mm:g} mm")
    needed, there = target.squares[0] * target.squares[1] // 2, len(dictionary.bytesList)
    if needed > there:
        raise InputError(f"{target.dictionary} has {there} markers; the board needs {needed}. Choose a larger one")
    board = aruco.CharucoBoard(target.squares, target.square_mm, target.marker_mm, dictionary)
    board.setLegacyPattern(target.legacy_pattern)
    return board


def white_areas(target: BoardTargetConfig, *, margin: float = 0.0) -> Float64:
    """White rectangles of the board (left, bottom, right, top) in its frame [mm], shape (n, 4); they do not overlap.

    Board frame: origin at the centre, x to the right, y up. Needs OpenCV for the markers' bits.

    margin: Width of a white border around the squares [mm]
    """
    board = opencv_board(target)
    aruco: Any = opencv().aruco
    dictionary: Any = board.getDictionary()
    cells = int(dictionary.markerSize) + 2
    square_side, marker_side = target.square_mm, target.marker_mm
    width, height = square_side * np.array(target.squares, np.float64)
    rectangles = [
        (-margin, -margin, width + margin, 0.0),
        (-margin, height, width + margin, height + margin),
        (-margin, 0.0, 0.0, height),
        (width, 0.0, width + margin, height),
    ]
    rectangles = rectangles if margin > 0.0 else []
    white = np.ones((cells + 2, cells + 2), np.bool_)  # a square, its marker within
    for number, marker in zip(np.ravel(board.getIds()), np.asarray(board.getObjPoints(), np.float64), strict=True):
        low = marker.reshape(4, 3)[:, :2].min(axis=0)
        square = square_side * np.floor(low / square_side)
        x, y = (
            np.array([start, *np.linspace(first, first + marker_side, cells + 1), start + square_side])
            for start, first in zip(square, low, strict=True)
        )
        white[1:-1, 1:-1] = np.asarray(aruco.generateImageMarker(dictionary, int(number), cells)) > 0
        for row, line in enumerate(white):
            change = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
            rectangles += [(x[i], y[row], x[j], y[row + 1]) for i, j in change.reshape(-1, 2)]
    # OpenCV's frame of the board: origin at the top left, y down
    left, top, right, bottom = np.array(rectangles).T
    return np.column_stack([left - width / 2, height / 2 - bottom, right - width / 2, height / 2 - top])


def board_mesh(target: BoardTargetConfig, *, margin: float = 0.0) -> TriangleMesh:
    """The white areas as flat triangles that face +z, board frame [mm]; black is where there is nothing.

    As a matt white part under a black sky it looks like the board. Parameters as of :func:`white_areas`.
    """
    left, bottom, right, top = white_areas(target, margin=margin).T
    corners = np.stack([left, bottom, right, bottom, right, top, left, top], axis=1).reshape(-1, 2)
    first = 4 * np.arange(len(left))[:, None]
    return TriangleMesh(
        vertices=np.column_stack([corners, np.zeros(len(corners))]),
        faces=np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])]).astype(np.int32),
    )


_LEAST_CORNERS, _LEAST_MARKERS = 8, 4
_LEAST_CONTRAST = 20.0  # of 255
_MOST_BLUR_PX = 2.0  # standard deviation of an edge's spread
_SATURATED, _MOST_SATURATED = 0.995, 0.01  # level, as a share of the full scale; share of the pixels of the board
FORMAT = "lightopt-corners/1"


@dataclass(frozen=True, eq=False)
class BoardImage:
    name: str
    posture: Posture
    pixels: Any  # grey levels, shape (height, width), or with colours (height, width, 3)


def find_corners(
    images: Sequence[BoardImage], target: BoardTargetConfig, *, full_scale: float = 255.0
) -> tuple[list[BoardView], list[str]]:
    """Corners of the board in each image that shows it, and what is wrong with images, and what to do.

    full_scale: Level at which a pixel is saturated
    Raises InputError: No OpenCV, images of several sizes, or none that shows the board
    """
    sizes = {image.pixels.shape[:2]: image.name for image in images}
    if len(sizes) > 1:
        found = ", ".join(f"{width} × {height} ({name})" for (height, width), name in sizes.items())
        raise InputError(f"images of a board: sizes differ: {found}. Take all with one camera and one image area")
    cv2, board = opencv(), opencv_board(target)
    views: list[BoardView] = []
    problems: list[str] = []
    for image in images:
        levels = np.asarray(image.pixels, np.float64)
        grey = (levels if levels.ndim == 2 else levels.mean(axis=2)) / full_scale
        eight = np.clip(np.rint(grey * 255.0), 0, 255).astype(np.uint8)
        pixels, points = _detect(cv2, board, eight)
        if len(pixels) < _LEAST_CORNERS:
            problems.append(f"{image.name}: {_cause(cv2, target, eight, len(pixels))}")
            continue
        columns = target.squares[0] - 1
        column, row = (np.rint(points[:, :2] / target.square_mm).astype(int) - 1).T
        views.append(BoardView(image.name, image.posture, row * columns + column, pixels + 0.5))
        problems += [f"{image.name}: {text}" for text in _defects(grey, pixels)]
    if not views:
        raise InputError(*problems)
    return views, problems


def _detect(cv2: Any, board: Any, image: UInt8) -> tuple[Float64, Float64]:
    # corners in OpenCV's pixels (centres at whole numbers), shape (n, 2), and on the board [mm], shape (n, 3)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    if ids is None or len(ids) == 0:
        return np.zeros((0, 2)), np.zeros((0, 3))
    points, pixels = board.matchImagePoints(corners, ids)
    return np.asarray(pixels, np.float64).reshape(-1, 2), np.asarray(points, np.float64).reshape(-1, 3)


def _cause(cv2: Any, target: BoardTargetConfig, image: UInt8, corners: int) -> str:
    # why so few corners were found
    turned = target.model_copy(update={"legacy_pattern": not target.legacy_pattern})
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
    names = [n for n in dir(cv2.aruco) if n.startswith("DICT_") and n.isupper()]
    others = [n for n in names if n[-3:] not in ("_50", "100", "250")]
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
        share = percent(float(np.mean(saturated)))
        found.append(f"saturated: {share} of the pixels around corners are at full scale. Expose less")
    return found


def read_corners(path: Path) -> list[BoardView]:
    """Views of a board from a corner list.

    ``{"format": "lightopt-corners/1", "views": [{"name": .., "elevation_deg": .., "rotation_deg": .., "ids": [..],
    "pixels": [[column, row], ..]}, ..]}``. Pixel (0, 0) has its centre at (0.5, 0.5): add 0.5 to what OpenCV finds.
    Points are numbered row by row from the board's top left, from 0.

    Raises InputError: The file cannot be read, or is no such list
    """
    try:
        found: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no corner list can be read: {error}") from None
    views: Any = found.get("views") if isinstance(found, dict) and found.get("format") == FORMAT else None
    if not isinstance(views, list) or not views:
        raise InputError(f'{path}: expected {{"format": "{FORMAT}", "views": [..]}} with at least one view')
    return [_view(f"{path}, view {number}", view) for number, view in enumerate(views, start=1)]


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
