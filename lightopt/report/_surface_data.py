"""A coloured surface as text for a page: what viewer.js unpacks.

A head in JSON, and base64 of a zlib stream of, little-endian and in this order: the faces' corners as int32, the
vertices as int16 in steps of ``step_mm`` from the middle of the bounding box, and one uint8 per face and layer.
Corners and vertices are written column after column, each value as the difference from the one before, which packs
well.
"""

from __future__ import annotations

import base64
import json
import zlib

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Float64
from lightopt.report._surface import ColouredSurface
from lightopt.report._surface_still import eye_distance

_STEPS = 32767


def surface_head(surface: ColouredSurface) -> str:
    """What the viewer has to know before it unpacks the data, JSON without ``<``."""
    head = {
        "triangles": len(surface.triangles),
        "vertices": len(surface.vertices),
        "step_mm": _step(surface),
        "distance_mm": eye_distance(surface),
        "up": surface.up.tolist(),
        "toward": surface.toward.tolist(),
        "layers": [[kind.colour for kind in layer.classes] for layer in surface.layers],
    }
    return json.dumps(head)


def surface_data(surface: ColouredSurface) -> str:
    """The surface in base64."""
    places = np.rint((surface.vertices - _middle(surface)) / _step(surface)).astype(np.int16)
    data = b"".join(
        [
            _differences(surface.triangles.astype(np.int32)).astype("<i4").tobytes(),
            _differences(places).astype("<i2").tobytes(),
            *(layer.of_face.tobytes() for layer in surface.layers),
        ]
    )
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")


def _differences(values: NDArray[np.signedinteger]) -> NDArray[np.signedinteger]:
    # int16 wraps round, here and in the viewer, and so comes back right
    columns = np.ascontiguousarray(values.T)
    return np.diff(columns, axis=1, prepend=np.zeros((3, 1), columns.dtype))


def _middle(surface: ColouredSurface) -> Float64:
    return 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))


def _step(surface: ColouredSurface) -> float:
    half = 0.5 * float((surface.vertices.max(axis=0) - surface.vertices.min(axis=0)).max())
    return max(half, 1e-9) / _STEPS
