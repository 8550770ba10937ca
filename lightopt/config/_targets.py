"""The targets of a calibration, as they are: sizes that were measured, and how well."""

from typing import Annotated, Literal

from pydantic import Field

from lightopt.config import _fields as fields

READING_ERROR_DEG = 0.02
"""Standard deviation of a stage's readings, where nothing else is known [deg]."""

_Squares = Annotated[int, Field(ge=3, le=200)]
_Error = Annotated[float, Field(gt=0, le=100), fields.expecting("a standard deviation above 0")]


class BoardTargetConfig(fields.Frozen):
    """A printed ChArUco board that lies flat on the stage."""

    squares: Annotated[tuple[_Squares, _Squares], fields.LIST, fields.expecting("[columns, rows] from 3")]
    """Squares along both sides."""
    square_mm: fields.Length
    """Side of a square, measured over many squares with a caliper [mm]."""
    marker_mm: fields.Length
    """Side of a marker with its black border [mm]."""
    dictionary: fields.Text = "DICT_4X4_250"
    """Markers, by OpenCV's name."""
    legacy_pattern: bool = False
    """true for boards from before OpenCV 4.6 and of calib.io with an even number of rows."""
    height_mm: fields.Number = 0.0
    """Height of the printed face above the table: the board's thickness [mm]."""
    square_error: _Error = 1e-4
    """Standard deviation of square_mm, as a share of it."""
    height_error_mm: _Error = 0.01
    """Standard deviation of height_mm [mm]."""


class BallTargetConfig(fields.Frozen):
    """A polished bearing ball that is fixed on the stage."""

    radius_mm: fields.Length
    """Radius [mm]."""
    radius_error_mm: _Error = 0.001
    """Standard deviation of it [mm]."""


class PlateTargetConfig(fields.Frozen):
    """A matt white plate that lies flat on the stage, its middle on the rotary axis."""

    size_mm: fields.Size
    """Sides along X and Y at rotation 0 [mm]."""
    height_mm: fields.Number = 0.0
    """Height of its upper face above the table [mm]."""


class TargetsConfig(fields.FileConfig):
    """What was on the stage when a rig was calibrated."""

    format: Literal["lightopt-targets/1"]
    """Kind and version of this file: lightopt-targets/1."""
    board: BoardTargetConfig | None = None
    """The board; absent if none is used."""
    ball: BallTargetConfig | None = None
    """The ball; absent if none is used."""
    plate: PlateTargetConfig | None = None
    """The plate; absent if none is used."""
    panel_size_error_mm: _Error | None = 0.1
    """Standard deviation of the rig file's panel sizes [mm]; null if they are not known."""
    reading_error_deg: _Error = READING_ERROR_DEG
    """Standard deviation of the stage's readings [deg]."""
