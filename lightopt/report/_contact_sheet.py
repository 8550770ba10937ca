"""All images of a set on one page: rows of postures, columns of lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from PIL import Image, ImageDraw

from lightopt.core.errors import InputError, counted
from lightopt.images import ImageEntry, ImageSet, ImageSetWriter, Manifest, read_image_set, sheet_name
from lightopt.report._canvas import check_png_path, write_picture
from lightopt.report._sheet_layout import (
    GAP,
    MARGIN,
    SheetLayout,
    SheetTable,
    SheetType,
    degrees,
    lay_out,
    light_position,
    row_head,
    sheet_table,
    thumbnail_limit,
)
from lightopt.report._thumbnail import SATURATED_COLOUR, Thumbnail, shade_of_saturation, thumbnail
from lightopt.report._typeface import Typeface

INK, SOFT, FAINT = "#1c1f24", "#5c636e", "#d4d8de"
RED = "#{:02x}{:02x}{:02x}".format(*SATURATED_COLOUR)
PAPER, EMPTY = "#ffffff", "#f1f3f5"


def add_contact_sheets(
    folder: str | Path, *, exposures: Sequence[float], title: str, overwrite: bool = False
) -> tuple[Path, ...]:
    """Draw a contact sheet for each exposure into an image set's folder, and list it in the manifest.

    Parameters
    ----------
    folder
        Of the set.
    exposures
        That the set has images of.
    title
        Of the sheets.
    overwrite
        Whether a file that the manifest does not list may be replaced; one that it lists always may.

    Returns
    -------
    tuple of pathlib.Path
        The files written, in the order of the exposures.

    Raises
    ------
    InputError
        As :func:`contact_sheet`.
    """
    image_set = read_image_set(folder, verify=False)  # a sheet that was lost or changed is made anew
    writer = ImageSetWriter(folder, image_set.manifest)
    sheets: list[Path] = []
    for exposure in exposures:
        name = sheet_name(exposure)
        ours = overwrite or name in image_set.manifest.files
        path = Path(folder) / name
        sheets.append(contact_sheet(image_set, path, exposure=exposure, title=title, overwrite=ours))
        writer.add_file(name, path.read_bytes())
    return tuple(sheets)


def contact_sheet(
    image_set: ImageSet,
    path: str | Path,
    *,
    exposure: float | None = None,
    title: str | None = None,
    overwrite: bool = True,
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
        Instead of the names of the part's and the rig's file.
    overwrite
        Whether a file of other content may be replaced.

    Returns
    -------
    pathlib.Path
        The file written.

    Raises
    ------
    InputError
        When the set is empty or has no such exposure, an image is missing or damaged, the file cannot be written,
        or one of other content is there and `overwrite` is False.
    """
    path = check_png_path(path)
    shown = _exposure(image_set, exposure)
    table = sheet_table(image_set, shown)
    limit = thumbnail_limit(table)
    thumbnails = {key: entry_thumbnail(image_set, entry, limit) for key, entry in table.entries.items()}
    type_ = SheetType(title=Typeface(32), head=Typeface(21), text=Typeface(16))
    heading = title or _names(image_set.manifest)
    facts = _facts(image_set.manifest, table, shown)
    layout = lay_out(table, thumbnails, type_, heading, facts)
    image = Image.new("RGB", (layout.width, layout.height), PAPER)
    _paint_heading(image, type_, heading, facts)
    _paint_heads(image, type_, table, layout)
    for row, posture in enumerate(table.postures):
        for column, light in enumerate(table.lights):
            key = (posture, light)
            corner = layout.corner(row, column)
            note = (
                light_position(table.entries[key])
                if key in table.entries and len(table.angles(light)) > 1
                else ""
            )
            _paint_cell(image, type_, corner, layout.cell, thumbnails.get(key), note)
    _paint_legend(image, type_, image_set.manifest)
    return write_picture(path, image, overwrite=overwrite)


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


def entry_thumbnail(image_set: ImageSet, entry: ImageEntry, limit: int) -> Thumbnail:
    """An image of a set as the camera delivered it, made small; neither side longer than `limit` [px]."""
    image = image_set.load(entry)
    share = image.levels * np.float32(entry.held_exposure / image_set.manifest.full_scale)
    return thumbnail(share, image.saturated, limit=limit)


def _names(manifest: Manifest) -> str:
    part, rig = (source and PurePosixPath(source.file).stem for source in (manifest.part, manifest.rig))
    return " on ".join(name for name in (part, rig) if name) or "Image set"


def _facts(manifest: Manifest, table: SheetTable, exposure: float) -> str:
    facts = [
        manifest.kind,
        f"{counted(len(table.lights), 'light')} × {counted(len(table.postures), 'posture')}",
        f"exposure {exposure:g}",
        f"{manifest.bit_depth} bit, saturated from level {manifest.saturated_from:g}",
    ]
    if manifest.black_level:
        facts.append(f"black level {manifest.black_level:g}")
    return "   ·   ".join(facts)


def _paint_heading(image: Image.Image, type_: SheetType, heading: str, facts: str) -> None:
    room = image.width - 2 * MARGIN
    y = MARGIN + type_.title.cap_height
    type_.title.paint(image, MARGIN, y, type_.title.fit(heading, room), fill=INK)
    y += type_.text.line_height + 10
    type_.text.paint(image, MARGIN, y, type_.text.fit(facts, room), fill=SOFT)


def _paint_heads(image: Image.Image, type_: SheetType, table: SheetTable, layout: SheetLayout) -> None:
    draw = ImageDraw.Draw(image)
    rule = layout.top - GAP // 2
    draw.line([(MARGIN, rule), (image.width - MARGIN - 1, rule)], fill=FAINT, width=1)
    below, above = rule - 10, rule - 10 - type_.text.line_height
    type_.text.paint(image, MARGIN, below, "posture", fill=SOFT)
    for column, light in enumerate(table.lights):
        x, _ = layout.corner(0, column)
        type_.head.paint(image, x, above, type_.head.fit(light, layout.cell[0]), fill=INK)
        angles = table.angles(light)
        entry = next(e for (_, name), e in table.entries.items() if name == light)
        where = f"elevation {degrees(entry.light_elevation_deg)}, azimuth {degrees(entry.light_azimuth_deg)}"
        if type_.text.width(where) > layout.cell[0]:
            where = light_position(entry)
        where = where if len(angles) == 1 else f"{len(angles)} positions"
        type_.text.paint(image, x, below, where, fill=SOFT)
    for row, posture in enumerate(table.postures):
        _, y = layout.corner(row, 0)
        if row:
            draw.line([(MARGIN, y - GAP // 2), (image.width - MARGIN - 1, y - GAP // 2)], fill=EMPTY, width=1)
        for i, line in enumerate(row_head(posture)):
            baseline = y + type_.head.cap_height + 4 + i * (type_.head.line_height + 4)
            type_.head.paint(image, MARGIN, baseline, line, fill=INK)


def _paint_cell(
    image: Image.Image,
    type_: SheetType,
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
    type_.text.paint(
        image, x, baseline, saturation_text(thumbnail), fill=RED if thumbnail.saturated else SOFT
    )
    if note:
        type_.text.paint(image, x, baseline + type_.text.line_height, note, fill=SOFT)


def saturation_text(thumbnail: Thumbnail) -> str:
    """How many pixels of the full image are saturated."""
    if not thumbnail.saturated:
        return "0 px saturated"
    percent = 100.0 * thumbnail.saturated / thumbnail.pixels
    text = f"{percent:.2f}" if percent >= 0.01 else "< 0.01"
    return f"{thumbnail.saturated:,} px saturated ({text} %)"


def _paint_legend(image: Image.Image, type_: SheetType, manifest: Manifest) -> None:
    bar_width, bar_height = 180, type_.text.cap_height + 4
    y = image.height - MARGIN - 4 * type_.text.line_height
    ImageDraw.Draw(image).line([(MARGIN, y), (image.width - MARGIN - 1, y)], fill=FAINT, width=1)
    ramp = np.linspace(0.0, 1.0, bar_width)
    tint = shade_of_saturation(ramp)[:, None]
    middle = 128.0
    bars = (
        (np.repeat(255.0 * ramp[:, None], 3, axis=1), _grey_text(manifest)),
        (
            tint * np.array(SATURATED_COLOUR) + (1.0 - tint) * middle,
            [
                "red: share of saturated pixels in a cell, from a single one to all of them",
                "red: saturated pixels in a cell, from one to all",
            ],
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
