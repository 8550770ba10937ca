"""Corner lists: points of a board that another program found in images, as JSON."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._board import BoardView

FORMAT = "lightopt-corners/1"


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
