from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lightopt.geometry import TriangleMesh
from lightopt.scene._camera import PinholeCamera, pixel_footprint, project

_WINDOW_MARGIN_PX = 2


@dataclass(frozen=True, kw_only=True)
class Framing:
    """Where a part lies in the image.

    Attributes
    ----------
    left, top, right, bottom: Bounding box of the part's vertices in the image [px]; NaN where part of it is behind the
        camera
    excess: By how much it leaves the image at the left, top, right and bottom, 0 where it does not [px]
    nearest, farthest: Depth of the part's vertices along the optical axis [mm]
    footprint: Side of a pixel's footprint at the nearest and at the farthest depth [mm]
    """

    left: float
    top: float
    right: float
    bottom: float
    excess: tuple[float, float, float, float]
    nearest: float
    farthest: float
    footprint: tuple[float, float]

    @property
    def outside(self) -> bool:
        """Whether no part of the bounding box is in the image."""
        width, height = self.right - self.left, self.bottom - self.top
        left, top, right, bottom = self.excess
        return self.farthest <= 0.0 or left >= width or right >= width or top >= height or bottom >= height

    @property
    def inside(self) -> bool:
        """Whether the whole bounding box is in the image."""
        return self.nearest > 0.0 and max(self.excess) == 0.0


def frame_part(camera: PinholeCamera, mesh: TriangleMesh) -> Framing:
    """Where the part lies in the image; camera and mesh in the same frame."""
    columns, rows, depth = project(camera, mesh.vertices)
    nearest, farthest = float(depth.min()), float(depth.max())
    if nearest > 0.0:
        left, right = float(columns.min()), float(columns.max())
        top, bottom = float(rows.min()), float(rows.max())
    else:
        left = right = top = bottom = float("nan")
    excess = (-left, -top, right - camera.width, bottom - camera.height)
    return Framing(
        left=left,
        top=top,
        right=right,
        bottom=bottom,
        excess=tuple(max(0.0, e) for e in excess),  # pyright: ignore[reportArgumentType]
        nearest=nearest,
        farthest=farthest,
        footprint=(pixel_footprint(camera, nearest), pixel_footprint(camera, farthest)),
    )


def screen_window(camera: PinholeCamera, mesh: TriangleMesh) -> tuple[int, int, int, int]:
    """Columns and rows [left, top, right, bottom) outside which no ray of the camera can meet the part.

    The corners of the part's bounding box bound its image, since a pinhole keeps straight lines straight; a distorted
    lens does not, and gets the whole image.
    """
    whole = (0, 0, camera.width, camera.height)
    if not camera.distortion.is_zero:
        return whole
    low, high = mesh.bounds
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    columns, rows, depth = project(camera, corners)
    if depth.min() <= 0.0:
        return whole
    left = max(0, int(np.floor(columns.min())) - _WINDOW_MARGIN_PX)
    top = max(0, int(np.floor(rows.min())) - _WINDOW_MARGIN_PX)
    right = min(camera.width, int(np.ceil(columns.max())) + _WINDOW_MARGIN_PX)
    bottom = min(camera.height, int(np.ceil(rows.max())) + _WINDOW_MARGIN_PX)
    return left, top, max(left, right), max(top, bottom)
