"""Masks of defects as COCO and YOLO have them: boxes, run lengths, outlines."""

from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Index


def box_of(pixels: Index, width: int) -> tuple[int, int, int, int]:
    """Left column, top row, columns and rows of the box around pixels.

    pixels: Raveled indices, shape (k,)
    width: Of the image
    """
    row, column = np.divmod(pixels, width)
    left, top = int(column.min()), int(row.min())
    return left, top, int(column.max()) - left + 1, int(row.max()) - top + 1


def run_lengths(pixels: Index, height: int, width: int) -> dict[str, Any]:
    """COCO's uncompressed run lengths: down the columns, beginning with pixels that are not in the mask."""
    row, column = np.divmod(pixels, width)
    place = np.sort(column * height + row)
    starts = place[np.diff(place, prepend=-2) > 1]
    ends = place[np.diff(place, append=height * width + 1) > 1] + 1
    edges = np.stack([starts, ends], axis=1).ravel()
    counts = np.diff(edges, prepend=0, append=height * width)
    return {"size": [height, width], "counts": counts.tolist()}


def pixels_of(runs: dict[str, Any]) -> Index:
    """Raveled indices of the pixels of run lengths, ascending: the inverse of :func:`run_lengths`."""
    (height, width), counts = runs["size"], runs["counts"]
    inside = np.repeat(np.arange(len(counts)) % 2 == 1, counts)
    return np.flatnonzero(inside.reshape(width, height).T)


def outlines(pixels: Index, width: int) -> list[list[float]] | None:
    """Polygons along the edges of pixels, as x, y, x, y, …; None for a mask with holes, which they cannot show."""
    left, top, columns, rows = box_of(pixels, width)
    mask = np.zeros((rows + 2, columns + 2), np.bool_)
    row, column = np.divmod(pixels, width)
    mask[row - top + 1, column - left + 1] = True
    after = _edges(mask)
    polygons: list[list[float]] = []
    while after:
        start = min(after)
        corner, heading, polygon, area = start, (1, 0), list[tuple[int, int]](), 0
        while True:
            nexts = after[corner]
            # where two pixels touch at a corner only, each has a polygon of its own: turn right
            right = (corner[0] - heading[1], corner[1] + heading[0])
            towards = right if right in nexts else nexts[0]
            nexts.remove(towards)
            if not nexts:
                del after[corner]
            step = (towards[0] - corner[0], towards[1] - corner[1])
            if step != heading or not polygon:
                polygon.append(corner)
            area += corner[0] * towards[1] - towards[0] * corner[1]
            corner, heading = towards, step
            if corner == start:
                break
        if area < 0:
            return None
        polygons.append([float(x) for a, b in polygon for x in (a + left - 1, b + top - 1)])
    return polygons


def _edges(mask: Bool) -> dict[tuple[int, int], list[tuple[int, int]]]:
    # edges of the pixels of a mask with an empty border, clockwise in the image: from each corner (x, y) to the next
    after: dict[tuple[int, int], list[tuple[int, int]]] = {}
    sides = (((-1, 0), (0, 0), (1, 0)), ((0, 1), (1, 0), (1, 1)), ((1, 0), (1, 1), (0, 1)), ((0, -1), (0, 1), (0, 0)))
    for (down, right), begin, end in sides:
        edge = mask & ~np.roll(mask, (-down, -right), (0, 1))
        for y, x in np.argwhere(edge).tolist():
            after.setdefault((x + begin[0], y + begin[1]), []).append((x + end[0], y + end[1]))
    return after
