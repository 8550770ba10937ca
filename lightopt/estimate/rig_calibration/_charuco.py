"""ChArUco boards: a chessboard with a marker in each white square, so that corners have numbers. Home of OpenCV.

OpenCV is an optional extra. Its corners are half a pixel off from 4.10 to 4.13, so 4.14 is the least.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from lightopt.config import BoardTargetConfig
from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.estimate.rig_calibration._board import Board
from lightopt.geometry import TriangleMesh

_LEAST_OPENCV = (4, 14)
INSTALL = "pip install 'lightopt[opencv]'"


@dataclass(frozen=True, kw_only=True)
class CharucoBoard:
    """A printed board; lengths [mm].

    square, marker: Side of a square and of the marker in it, with the marker's black border
    legacy_pattern: Even number of rows starts with a white square, as boards from before OpenCV 4.6 and of calib.io do
    """

    squares: tuple[int, int]  # along x and along y
    square: float
    marker: float
    dictionary: str = "DICT_4X4_1000"  # name of the markers, as OpenCV has it
    legacy_pattern: bool = False

    def __post_init__(self) -> None:
        if min(self.squares) < 3 or not 0.0 < self.marker < self.square:
            raise InputError(
                f"ChArUco board of {self.squares[0]} × {self.squares[1]} squares of {self.square:g} mm with markers of "
                f"{self.marker:g} mm: expected at least 3 × 3 squares, and markers smaller than squares"
            )

    def __str__(self) -> str:
        legacy = ", legacy pattern" if self.legacy_pattern else ""
        columns, rows = self.squares
        sides = f"squares {self.square:g} mm, markers {self.marker:g} mm"
        return f"{columns} × {rows} {sides}, {self.dictionary}{legacy}"

    @property
    def size(self) -> Float64:
        """Width and height without margin [mm], shape (2,)."""
        return self.square * np.array(self.squares, np.float64)

    def grid(self, **measured: float) -> Board:
        """The inner corners; `measured` are pitch, pitch_error, height, height_error of :class:`Board`."""
        columns, rows = self.squares
        return Board(columns=columns - 1, rows=rows - 1, **{"pitch": self.square, **measured})


def charuco_board(target: BoardTargetConfig) -> CharucoBoard:
    """The board of a targets file."""
    return CharucoBoard(
        squares=target.squares,
        square=target.square_mm,
        marker=target.marker_mm,
        dictionary=target.dictionary,
        legacy_pattern=target.legacy_pattern,
    )


def opencv() -> Any:
    """The module cv2; an InputError with how to install it where it is missing or too old."""
    try:
        cv2: Any = import_module("cv2")
    except ImportError as error:
        raise InputError(f"ChArUco boards need OpenCV, which is not there ({error}); {INSTALL}") from None
    found = tuple(int(digits) for digits in str(cv2.__version__).split(".")[:2])
    if found < _LEAST_OPENCV:
        raise InputError(
            f"OpenCV {cv2.__version__} finds ChArUco corners half a pixel off; expected 4.14 or later: {INSTALL}"
        )
    if not hasattr(cv2, "aruco"):
        raise InputError(f"this OpenCV has no module aruco; {INSTALL}")
    return cv2


def opencv_board(target: CharucoBoard) -> Any:
    """OpenCV's board of a target.

    Raises InputError: No such dictionary, or it has too few markers
    """
    aruco: Any = opencv().aruco
    names = sorted(name for name in dir(aruco) if name.startswith("DICT_"))
    if target.dictionary not in names:
        raise InputError(f"no dictionary {target.dictionary}; expected one of {', '.join(names)}")
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, target.dictionary))
    needed, there = target.squares[0] * target.squares[1] // 2, len(dictionary.bytesList)
    if needed > there:
        raise InputError(f"{target.dictionary} has {there} markers; the board needs {needed}. Choose a larger one")
    board = aruco.CharucoBoard(target.squares, target.square, target.marker, dictionary)
    board.setLegacyPattern(target.legacy_pattern)
    return board


def white_areas(target: CharucoBoard, *, margin: float = 0.0) -> Float64:
    """White rectangles of the board (left, bottom, right, top) in its frame [mm], shape (n, 4); they do not overlap.

    Board frame: origin at the centre, x to the right, y up. Needs OpenCV for the markers' bits.

    margin: Width of a white border around the squares [mm]
    """
    board = opencv_board(target)
    aruco: Any = opencv().aruco
    dictionary: Any = board.getDictionary()
    cells = int(dictionary.markerSize) + 2
    width, height = target.size
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
        square = target.square * np.floor(low / target.square)
        x, y = (
            np.array([start, *np.linspace(first, first + target.marker, cells + 1), start + target.square])
            for start, first in zip(square, low, strict=True)
        )
        white[1:-1, 1:-1] = np.asarray(aruco.generateImageMarker(dictionary, int(number), cells)) > 0
        for row, line in enumerate(white):
            change = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
            rectangles += [(x[i], y[row], x[j], y[row + 1]) for i, j in change.reshape(-1, 2)]
    # OpenCV's frame of the board: origin at the top left, y down
    left, top, right, bottom = np.array(rectangles).T
    return np.column_stack([left - width / 2, height / 2 - bottom, right - width / 2, height / 2 - top])


def board_mesh(target: CharucoBoard, *, margin: float = 0.0) -> TriangleMesh:
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
