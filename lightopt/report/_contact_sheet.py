"""All images of a set on one page: rows of postures, columns of lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from PIL import Image, ImageDraw

from lightopt.errors import InputError
from lightopt.images import ImageEntry, ImageSet, Manifest
from lightopt.report._canvas import check_png_path, write_picture
from lightopt.report._thumbnail import SATURATED_COLOUR, Thumbnail, shade_of_saturation, thumbnail
from lightopt.report._typeface import Typeface, sub
from lightopt.transforms import Posture

__all__ = ["contact_sheet"]

INK, SOFT, FAINT = "#1c1f24", "#5c636e", "#d4d8de"
RED = "#{:02x}{:02x}{:02x}".format(*SATURATED_COLOUR)
PAPER, EMPTY = "#ffffff", "#f1f3f5"

MARGIN, GAP = 36, 18
LARGEST, SMALLEST = 420, 240
"""Sides of a thumbnail [px]: many columns make them smaller, until they could not be told apart any more."""

SHEET_WIDTH = 4000
"""Width that all thumbnails of a row may share before they become smaller [px]."""


@dataclass(frozen=True)
class _Type:
    title: Typeface
    head: Typeface
    text: Typeface


@dataclass(frozen=True)
class _Table:
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
class _Layout:
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


def contact_sheet(
    image_set: ImageSet, path: str | Path, *, exposure: float | None = None, title: str | None = None
) -> Path:
    """Draw all images of a set at one exposure into one labelled PNG, saturated pixels marked.

    Rows are postures, columns are lights, both in the set's order. Images are averaged down; a cell that contains
    saturated pixels is tinted red by their share, and their exact number stands below the image.

    Parameters
    ----------
    image_set
        From :func:`lightopt.images.read_image_set`.
    path
        The PNG to make or to replace, in a folder that exists.
    exposure
        Which exposure to show; the longest of the set by default.
    title
        Instead of the names of part and rig.

    Returns
    -------
    pathlib.Path
        The file written.

    Raises
    ------
    InputError
        When the set is empty or has no such exposure, an image is missing or damaged, or the file cannot be written.
    """
    path = check_png_path(path)
    shown = _exposure(image_set, exposure)
    table = _table(image_set, shown)
    limit = max(SMALLEST, min(LARGEST, SHEET_WIDTH // len(table.lights)))
    thumbnails = {key: _load(image_set, entry, limit) for key, entry in table.entries.items()}
    type_ = _Type(title=Typeface(32), head=Typeface(21), text=Typeface(16))
    heading = title or _names(image_set.manifest)
    facts = _facts(image_set.manifest, table, shown)
    layout = _lay_out(table, thumbnails, type_, heading, facts)
    image = Image.new("RGB", (layout.width, layout.height), PAPER)
    _paint_heading(image, type_, heading, facts)
    _paint_heads(image, type_, table, layout)
    for row, posture in enumerate(table.postures):
        for column, light in enumerate(table.lights):
            key = (posture, light)
            corner = layout.corner(row, column)
            note = (
                _position(table.entries[key]) if key in table.entries and len(table.angles(light)) > 1 else ""
            )
            _paint_cell(image, type_, corner, layout.cell, thumbnails.get(key), note)
    _paint_legend(image, type_, image_set.manifest)
    return write_picture(path, image)


def _exposure(image_set: ImageSet, asked: float | None) -> float:
    known = sorted({entry.exposure for entry in image_set.images})
    if not known:
        raise InputError(
            f"{image_set.folder}: the image set lists no images; nothing to put on a contact sheet"
        )
    if asked is None:
        return known[-1]
    # 1/3 typed as 0.3333333333 is the same exposure
    found = [value for value in known if math.isclose(value, asked, rel_tol=1e-6)]
    if not found:
        raise InputError(
            f"exposure: {image_set.folder} has no images at {asked:g}; it has {', '.join(f'{e:g}' for e in known)}"
        )
    return found[0]


def _table(image_set: ImageSet, exposure: float) -> _Table:
    entries = [entry for entry in image_set.images if entry.exposure == exposure]
    return _Table(
        lights=tuple(dict.fromkeys(entry.light for entry in entries)),
        postures=tuple(dict.fromkeys(entry.posture for entry in entries)),
        entries={(entry.posture, entry.light): entry for entry in entries},
    )


def _load(image_set: ImageSet, entry: ImageEntry, limit: int) -> Thumbnail:
    image = image_set.load(entry)
    share = image.levels * np.float32(entry.exposure / image_set.manifest.full_scale)
    return thumbnail(share, image.saturated, limit=limit)


def _names(manifest: Manifest) -> str:
    part, rig = (source and PurePosixPath(source.file).stem for source in (manifest.part, manifest.rig))
    return " on ".join(name for name in (part, rig) if name) or "Image set"


def _facts(manifest: Manifest, table: _Table, exposure: float) -> str:
    facts = [
        manifest.kind,
        f"{_count(len(table.lights), 'light')} × {_count(len(table.postures), 'posture')}",
        f"exposure {exposure:g}",
        f"{manifest.bit_depth} bit, saturated from level {manifest.saturated_from:g}",
    ]
    if manifest.black_level:
        facts.append(f"black level {manifest.black_level:g}")
    return "   ·   ".join(facts)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _position(entry: ImageEntry) -> str:
    return f"θ {_degrees(entry.light_elevation_deg)}, φ {_degrees(entry.light_azimuth_deg)}"


def _degrees(angle: float) -> str:
    return f"{angle:.6g}°".replace("-", "−")


def _row_head(posture: Posture) -> tuple[str, str]:
    return (
        f"{sub('θ', 'j')} {_degrees(posture.elevation_deg)}",
        f"{sub('φ', 'j')} {_degrees(posture.rotation_deg)}",
    )


def _lay_out(
    table: _Table,
    thumbnails: dict[tuple[Posture, str], Thumbnail],
    type_: _Type,
    heading: str,
    facts: str,
) -> _Layout:
    cell_width = max(t.picture.shape[1] for t in thumbnails.values())
    cell_height = max(t.picture.shape[0] for t in thumbnails.values())
    # narrow images still need room for the caption
    cell_width = max(cell_width, type_.text.width("8,888,888 px saturated (88.88 %)"))
    heads = [type_.head.width(line) for posture in table.postures for line in _row_head(posture)]
    left = MARGIN + max([*heads, type_.text.width("posture")]) + 2 * GAP
    top = MARGIN + type_.title.line_height + type_.text.line_height + 2 * GAP
    top += type_.head.line_height + type_.text.line_height + GAP // 2
    moving = any(len(table.angles(light)) > 1 for light in table.lights)
    caption = (2 if moving else 1) * type_.text.line_height + 10
    columns, rows = len(table.lights), len(table.postures)
    table_width = left + columns * (cell_width + GAP) - GAP
    text_width = MARGIN + max(type_.title.width(heading), type_.text.width(facts), 620)
    legend = 4 * type_.text.line_height + 2 * GAP
    return _Layout(
        left=left,
        top=top,
        cell=(cell_width, cell_height),
        caption=caption,
        width=max(table_width, min(text_width, 1600)) + MARGIN,
        height=top + rows * (cell_height + caption + GAP) - GAP + legend + MARGIN,
    )


def _paint_heading(image: Image.Image, type_: _Type, heading: str, facts: str) -> None:
    room = image.width - 2 * MARGIN
    y = MARGIN + type_.title.cap_height
    type_.title.paint(image, MARGIN, y, type_.title.fit(heading, room), fill=INK)
    y += type_.text.line_height + 10
    type_.text.paint(image, MARGIN, y, type_.text.fit(facts, room), fill=SOFT)


def _paint_heads(image: Image.Image, type_: _Type, table: _Table, layout: _Layout) -> None:
    draw = ImageDraw.Draw(image)
    rule = layout.top - GAP // 2
    draw.line([(MARGIN, rule), (image.width - MARGIN, rule)], fill=FAINT, width=1)
    below, above = rule - 10, rule - 10 - type_.text.line_height
    type_.text.paint(image, MARGIN, below, "posture", fill=SOFT)
    for column, light in enumerate(table.lights):
        x, _ = layout.corner(0, column)
        type_.head.paint(image, x, above, type_.head.fit(light, layout.cell[0]), fill=INK)
        angles = table.angles(light)
        entry = next(e for (_, name), e in table.entries.items() if name == light)
        where = (
            f"elevation {_degrees(entry.light_elevation_deg)}, azimuth {_degrees(entry.light_azimuth_deg)}"
        )
        if type_.text.width(where) > layout.cell[0]:
            where = _position(entry)
        where = where if len(angles) == 1 else f"{len(angles)} positions"
        type_.text.paint(image, x, below, where, fill=SOFT)
    for row, posture in enumerate(table.postures):
        _, y = layout.corner(row, 0)
        if row:
            draw.line([(MARGIN, y - GAP // 2), (image.width - MARGIN, y - GAP // 2)], fill=EMPTY, width=1)
        for i, line in enumerate(_row_head(posture)):
            baseline = y + type_.head.cap_height + 4 + i * (type_.head.line_height + 4)
            type_.head.paint(image, MARGIN, baseline, line, fill=INK)


def _paint_cell(
    image: Image.Image,
    type_: _Type,
    corner: tuple[int, int],
    cell: tuple[int, int],
    thumbnail: Thumbnail | None,
    note: str,
) -> None:
    x, y = corner
    baseline = y + cell[1] + 8 + type_.text.cap_height
    if thumbnail is None:
        ImageDraw.Draw(image).rectangle([x, y, x + cell[0] - 1, y + cell[1] - 1], fill=EMPTY)
        type_.text.paint(image, x + cell[0] / 2, y + cell[1] / 2, "no image", fill=SOFT, align="centre")
        return
    rows, columns = thumbnail.picture.shape[:2]
    image.paste(Image.fromarray(thumbnail.picture), (x, y + (cell[1] - rows) // 2))
    if columns < cell[0]:  # a narrow image is framed, lest its black run into nothing
        ImageDraw.Draw(image).rectangle([x, y, x + cell[0] - 1, y + cell[1] - 1], outline=FAINT)
    type_.text.paint(image, x, baseline, _caption(thumbnail), fill=RED if thumbnail.saturated else SOFT)
    if note:
        type_.text.paint(image, x, baseline + type_.text.line_height, note, fill=SOFT)


def _caption(thumbnail: Thumbnail) -> str:
    if not thumbnail.saturated:
        return "0 px saturated"
    percent = 100.0 * thumbnail.saturated / thumbnail.pixels
    text = f"{percent:.2f}" if percent >= 0.01 else "< 0.01"
    return f"{thumbnail.saturated:,} px saturated ({text} %)"


def _paint_legend(image: Image.Image, type_: _Type, manifest: Manifest) -> None:
    bar_width, bar_height = 180, type_.text.cap_height + 4
    y = image.height - MARGIN - 4 * type_.text.line_height
    ImageDraw.Draw(image).line([(MARGIN, y), (image.width - MARGIN, y)], fill=FAINT, width=1)
    ramp = np.linspace(0.0, 1.0, bar_width)
    tint = shade_of_saturation(ramp)[:, None]
    middle = 128.0
    bars = (
        (np.repeat(255.0 * ramp[:, None], 3, axis=1), _grey_text(manifest)),
        (
            tint * np.array(SATURATED_COLOUR) + (1.0 - tint) * middle,
            ["red: share of saturated pixels in a cell, from a single one to all of them"],
        ),
    )
    baseline = y + GAP + type_.text.cap_height
    room = image.width - 2 * MARGIN - bar_width - GAP
    for colours, texts in bars:
        bar = np.broadcast_to(np.floor(colours + 0.5), (bar_height, bar_width, 3)).astype(np.uint8)
        image.paste(Image.fromarray(bar), (MARGIN, baseline - bar_height + 2))
        text = next((t for t in texts if type_.text.width(t) <= room), texts[-1])
        type_.text.paint(image, MARGIN + bar_width + GAP, baseline, type_.text.fit(text, room), fill=SOFT)
        baseline += type_.text.line_height + 6
    text = "Below each image: saturated pixels of the full image, and their share of all its pixels."
    type_.text.paint(image, MARGIN, baseline, type_.text.fit(text, image.width - 2 * MARGIN), fill=SOFT)


def _grey_text(manifest: Manifest) -> Sequence[str]:
    levels = f"level {manifest.black_level:g} to {manifest.max_level}"
    return [
        f"grey: {levels} shown linearly as black to white (screen values 0 to 255), averaged over cells of pixels",
        f"grey: {levels}, linear, averaged over cells of pixels",
    ]
