"""What the panels of the drawing of conventions are drawn with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightopt.report._canvas import Canvas
from lightopt.report._labels import Box
from lightopt.report._rig_elements import Pen
from lightopt.report._typeface import sub
from lightopt.report._view import fit_view

Float64 = NDArray[np.float64]

E_THETA, E_PHI = sub("e", "θ"), sub("e", "φ")
THETA_J, PHI_J = sub("θ", "j"), sub("φ", "j")


def fit_pen(canvas: Canvas, box: Box, points: Float64, *, elevation: float, azimuth: float) -> Pen:
    """A pen for a view from (elevation, azimuth) [°] that shows all points [mm] in a box."""
    view = fit_view(points, elevation=np.radians(elevation), azimuth=np.radians(azimuth), box=_shrunk(box))
    return Pen(canvas, view, [])


def _shrunk(box: Box) -> Box:
    return box[0] + 40, box[1] + 26, box[2] - 40, box[3] - 20


def named_arrow(
    pen: Pen, start: Float64, tip: Float64, name: str, colour: str, *, width: float = 2.6
) -> None:
    """Draw an arrow and its name at the tip."""
    pen.arrow(np.stack([start, tip]), colour, width)
    pen.label(name, tip, colour, away_from=start)
