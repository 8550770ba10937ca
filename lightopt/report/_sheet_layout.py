"""What stands on a contact sheet and where."""

from __future__ import annotations

from dataclasses import dataclass

from lightopt.core.transforms import Posture
from lightopt.images import ImageEntry, ImageSet
from lightopt.report._thumbnail import Thumbnail
from lightopt.report._typeface import Typeface, sub

MARGIN, GAP = 36, 18
LARGEST, SMALLEST = 420, 240
"""Sides of a thumbnail [px]: many columns make them smaller, until they could not be told apart any more."""

SHEET_WIDTH = 4000
"""Width that all thumbnails of a row may share before they become smaller [px]."""


@dataclass(frozen=True)
class SheetType:
    """The sizes of text."""

    title: Typeface
    head: Typeface
    text: Typeface


@dataclass(frozen=True)
class SheetTable:
    """Which image stands where; None where the set has none."""

    lights: tuple[str, ...]
    postures: tuple[Posture, ...]
    entries: dict[tuple[Posture, str], ImageEntry]

    def angles(self, light: str) -> set[tuple[float, float]]:
        """Elevations and azimuths [°] at which the light stood."""
        return {
            (e.light_elevation_deg, e.light_azimuth_deg)
            for (_, name), e in self.entries.items()
            if name == light
        }


@dataclass(frozen=True)
class SheetLayout:
    """Where things stand [px]."""

    left: int
    top: int
    cell: tuple[int, int]
    caption: int
    width: int
    height: int

    def corner(self, row: int, column: int) -> tuple[int, int]:
        """Upper left corner of a thumbnail's cell."""
        return (
            self.left + column * (self.cell[0] + GAP),
            self.top + row * (self.cell[1] + self.caption + GAP),
        )


def thumbnail_limit(table: SheetTable) -> int:
    """Longest side of the thumbnails [px]."""
    return max(SMALLEST, min(LARGEST, SHEET_WIDTH // len(table.lights)))


def sheet_table(image_set: ImageSet, exposure: float) -> SheetTable:
    """The images of a set at one exposure, in the set's order."""
    entries = [entry for entry in image_set.images if entry.exposure == exposure]
    return SheetTable(
        lights=tuple(dict.fromkeys(entry.light for entry in entries)),
        postures=tuple(dict.fromkeys(entry.posture for entry in entries)),
        entries={(entry.posture, entry.light): entry for entry in entries},
    )


def light_position(entry: ImageEntry) -> str:
    """Elevation and azimuth of an image's light, short."""
    return f"θ {degrees(entry.light_elevation_deg)}, φ {degrees(entry.light_azimuth_deg)}"


def degrees(angle: float) -> str:
    """An angle [°] with a true minus sign."""
    return f"{angle:.6g}°".replace("-", "−")


def row_head(posture: Posture) -> tuple[str, str]:
    """Two lines that name a posture."""
    return (
        f"{sub('θ', 'j')} {degrees(posture.elevation_deg)}",
        f"{sub('φ', 'j')} {degrees(posture.rotation_deg)}",
    )


def lay_out(
    table: SheetTable,
    thumbnails: dict[tuple[Posture, str], Thumbnail],
    type_: SheetType,
    heading: str,
    facts: str,
) -> SheetLayout:
    """Find the sheet's size and the place of its cells."""
    cell_width = max(t.picture.shape[1] for t in thumbnails.values())
    cell_height = max(t.picture.shape[0] for t in thumbnails.values())
    # narrow images still need room for the caption
    cell_width = max(cell_width, type_.text.width("8,888,888 px saturated (88.88 %)"))
    heads = [type_.head.width(line) for posture in table.postures for line in row_head(posture)]
    left = MARGIN + max([*heads, type_.text.width("posture")]) + 2 * GAP
    top = MARGIN + type_.title.line_height + type_.text.line_height + 2 * GAP
    top += type_.head.line_height + type_.text.line_height + GAP // 2
    moving = any(len(table.angles(light)) > 1 for light in table.lights)
    caption = (2 if moving else 1) * type_.text.line_height + 10
    columns, rows = len(table.lights), len(table.postures)
    table_width = left + columns * (cell_width + GAP) - GAP
    text_width = MARGIN + max(type_.title.width(heading), type_.text.width(facts), 620)
    legend = 4 * type_.text.line_height + 2 * GAP
    return SheetLayout(
        left=left,
        top=top,
        cell=(cell_width, cell_height),
        caption=caption,
        width=max(table_width, min(text_width, 1600)) + MARGIN,
        height=top + rows * (cell_height + caption + GAP) - GAP + legend + MARGIN,
    )
