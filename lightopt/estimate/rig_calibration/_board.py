"""A flat board of points in a grid, and what one image of it shows."""

from dataclasses import dataclass, field

import numpy as np

from lightopt.core.arrays import Float64, Index, read_only
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture


@dataclass(frozen=True, kw_only=True)
class Board:
    """A grid of points on a nearly flat board. Point ``id = row · columns + column`` counts from the top left.

    Board frame: origin at the grid's centre, x to the right, y up, z out of the printed face.

    columns, rows: Points along the two sides
    height: Of the grid's centre above the table at tilt reading 0: the board's thickness [mm]. It alone fixes the
        world's origin along Z
    """

    columns: int
    rows: int
    pitch: float  # distance of neighbouring points, the geometric mean of both sides' [mm]; measure it with a caliper
    pitch_error: float = 1e-4  # standard error of that, as a share of the pitch
    height: float = 0.0
    height_error: float = 0.01  # standard error of that [mm]

    def __post_init__(self) -> None:
        if self.columns < 2 or self.rows < 2 or not self.pitch > 0.0:
            raise InputError(
                f"board of {self.columns} × {self.rows} points, pitch {self.pitch:g} mm: expected at least 2 × 2 "
                "points and a pitch above 0"
            )

    @property
    def points(self) -> Float64:
        """Positions of all points by id in the board frame [mm], shape (columns · rows, 2)."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        x, y = column - 0.5 * (self.columns - 1), 0.5 * (self.rows - 1) - row
        return self.pitch * np.column_stack([x, y])


@dataclass(frozen=True, eq=False)
class BoardView:
    """Points of a board found in one image.

    pixels: Where the image shows them (column, row) [px], shape (n, 2); pixel (0, 0) has its centre at (0.5, 0.5)
    """

    name: str  # of the image, for messages
    posture: Posture  # readings of the stage
    ids: Index = field(repr=False)  # points' numbers, shape (n,)
    pixels: Float64 = field(repr=False)

    def __post_init__(self) -> None:
        ids, pixels = np.asarray(self.ids), np.asarray(self.pixels, np.float64)
        if ids.ndim != 1 or pixels.shape != (len(ids), 2) or (len(ids) and ids.dtype.kind not in "iu"):
            raise InputError(
                f"{self.name}: expected n whole numbers and n × 2 pixel positions, found {ids.shape}, {pixels.shape}"
            )
        if not np.isfinite(pixels).all():
            raise InputError(f"{self.name}: a pixel position is not a finite number")
        if len(np.unique(ids)) < len(ids):
            raise InputError(f"{self.name}: a point is listed twice")
        object.__setattr__(self, "ids", read_only(ids.astype(np.intp)))
        object.__setattr__(self, "pixels", read_only(pixels))
