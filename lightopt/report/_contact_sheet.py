"""All images of a set on one page: rows of postures, columns of lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from PIL import Image

from lightopt.core.errors import InputError, counted
from lightopt.core.transforms import Posture
from lightopt.images import ImageEntry, ImageSet, ImageSetWriter, Manifest, read_image_set, sheet_name
from lightopt.report import _drawing as drawings, _images as pictures
from lightopt.report._drawing import CAP_HEIGHT, FAINT, LINE_HEIGHT, SOFT, Drawing, fit_text, text_width
from lightopt.report._images import SATURATED_COLOUR, Thumbnail, check_png_path, write_picture

EMPTY = "#f1f3f5"
MARGIN, GAP = 36, 18
TITLE, HEAD, TEXT = 32, 20, 15  # sizes of text [px]
LINE = round(LINE_HEIGHT * TEXT)  # distance of lines of small text [px]

# sides of a thumbnail [px]: many columns make them smaller, until they could not be told apart any more
LARGEST, SMALLEST = 420, 240
SHEET_WIDTH = 4000  # width that all thumbnails of a row may share before they become smaller [px]


def add_contact_sheets(
    folder: str | Path, *, exposures: Sequence[float], title: str, overwrite: bool = False
) -> tuple[Path, ...]:
    """Draw a contact sheet for each exposure into an image set's folder, and list it in the manifest.

    A file that the manifest lists is always replaced, another one only with `overwrite`. Raises as
    :func:`contact_sheet`.
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


@drawings.fixed_style()
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

    path: The PNG to make or to replace, in a folder that exists; it is returned.
    exposure: Which exposure to show; the longest of the set by default.
    title: Instead of the names of the part's and the rig's file.
    overwrite: Whether a file of other content may be replaced.
    Raises InputError: The set is empty or has no such exposure, an image is missing or damaged, the file cannot be
        written, or one of other content is there and `overwrite` is False.
    """
    path = check_png_path(path)
    shown = _exposure(image_set, exposure)
    sheet = _Sheet(image_set, shown, title or _names(image_set.manifest))
    return write_picture(path, sheet.draw(), overwrite=overwrite)


class _Sheet:
    """Which image stands where, and the sizes of it all [px]; an image is missing where the set has none."""

    def __init__(self, image_set: ImageSet, exposure: float, title: str) -> None:
        entries = [entry for entry in image_set.images if entry.exposure == exposure]
        self.manifest, self.exposure, self.title = image_set.manifest, exposure, title
        self.lights = tuple(dict.fromkeys(entry.light for entry in entries))
        self.postures = tuple(dict.fromkeys(entry.posture for entry in entries))
        self.entries = {(entry.posture, entry.light): entry for entry in entries}
        limit = max(SMALLEST, min(LARGEST, SHEET_WIDTH // len(self.lights)))
        self.thumbnails = {key: entry_thumbnail(image_set, entry, limit) for key, entry in self.entries.items()}
        rows, columns = np.max([t.picture.shape[:2] for t in self.thumbnails.values()], axis=0).tolist()
        # narrow images still need room for the caption
        self.cell = max(columns, text_width("8,888,888 px saturated (88.88 %)", TEXT)), rows
        heads = [text_width(line, HEAD) for posture in self.postures for line in _posture_lines(posture)]
        self.left = MARGIN + max([*heads, text_width("posture", TEXT)]) + 2 * GAP
        self.top = MARGIN + round(LINE_HEIGHT * (TITLE + HEAD)) + 2 * LINE + 2 * GAP + GAP // 2
        self.caption = (2 if any(len(self.positions(light)) > 1 for light in self.lights) else 1) * LINE + 10

    def positions(self, light: str) -> list[ImageEntry]:
        """An image for each position at which the light stood."""
        own = [entry for (_, name), entry in self.entries.items() if name == light]
        return list({(e.light_elevation_deg, e.light_azimuth_deg): e for e in own}.values())

    def corner(self, row: int, column: int) -> tuple[int, int]:
        """Upper left corner of a cell."""
        return self.left + column * (self.cell[0] + GAP), self.top + row * (self.cell[1] + self.caption + GAP)

    def draw(self) -> Image.Image:
        """The whole sheet."""
        facts = self._facts()
        right, bottom = self.corner(len(self.postures), len(self.lights))
        text = MARGIN + max(text_width(self.title, TITLE), text_width(facts, TEXT), 620)
        legend = 4 * LINE + 2 * GAP
        drawing = Drawing(max(right - GAP, min(text, 1600)) + MARGIN, bottom - GAP + legend + MARGIN)
        room = drawing.width - 2 * MARGIN
        y = MARGIN + CAP_HEIGHT * TITLE
        drawing.text(MARGIN, y, fit_text(self.title, TITLE, room), size=TITLE)
        drawing.text(MARGIN, y + LINE + 10, fit_text(facts, TEXT, room), size=TEXT, colour=SOFT)
        self._draw_heads(drawing)
        for row, posture in enumerate(self.postures):
            for column, light in enumerate(self.lights):
                self._draw_cell(drawing, self.corner(row, column), posture, light)
        _draw_legend(drawing, self.manifest)
        return drawing.image()

    def _facts(self) -> str:
        manifest = self.manifest
        number = f"{counted(len(self.lights), 'light')} × {counted(len(self.postures), 'posture')}"
        sensor = f"{manifest.bit_depth} bit, saturated from level {manifest.saturated_from:g}"
        black = [f"black level {manifest.black_level:g}"] if manifest.black_level else []
        return "   ·   ".join([manifest.kind, number, f"exposure {self.exposure:g}", sensor, *black])

    def _draw_heads(self, drawing: Drawing) -> None:
        rule = self.top - GAP // 2
        _draw_rule(drawing, rule, FAINT)
        below, above = rule - 10, rule - 10 - LINE
        drawing.text(MARGIN, below, "posture", size=TEXT, colour=SOFT)
        for column, light in enumerate(self.lights):
            x, _ = self.corner(0, column)
            drawing.text(x, above, fit_text(light, HEAD, self.cell[0]), size=HEAD)
            first, *others = self.positions(light)
            where = f"elevation {degrees(first.light_elevation_deg)}, azimuth {degrees(first.light_azimuth_deg)}"
            if others:
                where = f"{1 + len(others)} positions"
            elif text_width(where, TEXT) > self.cell[0]:
                where = light_position(first)
            drawing.text(x, below, where, size=TEXT, colour=SOFT)
        for row, posture in enumerate(self.postures):
            _, y = self.corner(row, 0)
            if row:
                _draw_rule(drawing, y - GAP // 2, EMPTY)
            for i, line in enumerate(_posture_lines(posture)):
                baseline = y + CAP_HEIGHT * HEAD + 4 + i * (LINE_HEIGHT * HEAD + 4)
                drawing.text(MARGIN, baseline, line, size=HEAD)

    def _draw_cell(self, drawing: Drawing, corner: tuple[int, int], posture: Posture, light: str) -> None:
        (x, y), (width, height) = corner, self.cell
        if (posture, light) not in self.entries:
            drawing.rectangle((x, y, x + width, y + height), fill=EMPTY)
            drawing.text(x + width / 2, y + height / 2, "no image", size=TEXT, colour=SOFT, align="center")
            return
        thumbnail = self.thumbnails[posture, light]
        rows, columns = thumbnail.picture.shape[:2]
        drawing.picture(thumbnail.picture, x, y + (height - rows) // 2)
        if columns < width:  # a narrow image is framed, lest its black run into nothing
            drawing.rectangle((x, y, x + width - 1, y + height - 1), outline=FAINT, width=1.0)
        baseline = y + height + 8 + CAP_HEIGHT * TEXT
        colour = drawings.hex_colour(SATURATED_COLOUR) if thumbnail.saturated else SOFT
        drawing.text(x, baseline, saturation_text(thumbnail), size=TEXT, colour=colour)
        if len(self.positions(light)) > 1:
            note = light_position(self.entries[posture, light])
            drawing.text(x, baseline + LINE, note, size=TEXT, colour=SOFT)


def entry_thumbnail(image_set: ImageSet, entry: ImageEntry, limit: int) -> Thumbnail:
    """An image of a set as the camera delivered it, made small; neither side longer than `limit` [px]."""
    image = image_set.load(entry)
    share = image.levels * np.float32(entry.held_exposure / image_set.manifest.full_scale)
    return pictures.thumbnail(share, image.saturated, limit=limit)


def degrees(angle: float) -> str:
    """An angle [°] with a true minus sign."""
    return f"{angle:.6g}°".replace("-", "−")


def light_position(entry: ImageEntry) -> str:
    """Elevation and azimuth of an image's light, short."""
    return f"θ {degrees(entry.light_elevation_deg)}, φ {degrees(entry.light_azimuth_deg)}"


def saturation_text(thumbnail: Thumbnail) -> str:
    """How many pixels of the full image are saturated."""
    if not thumbnail.saturated:
        return "0 px saturated"
    percent = 100.0 * thumbnail.saturated / thumbnail.pixels
    text = f"{percent:.2f}" if percent >= 0.01 else "< 0.01"
    return f"{thumbnail.saturated:,} px saturated ({text} %)"


def _exposure(image_set: ImageSet, requested: float | None) -> float:
    known = sorted({entry.exposure for entry in image_set.images})
    if not known:
        raise InputError(f"{image_set.folder}: the image set lists no images; nothing to put on a contact sheet")
    if requested is None:
        return known[-1]
    # 1/3 typed as 0.3333333333 is the same exposure
    found = [value for value in known if math.isclose(value, requested, rel_tol=1e-6)]
    if not found:
        there = ", ".join(f"{e:g}" for e in known)
        raise InputError(f"exposure: {image_set.folder} has no images at {requested:g}; it has {there}")
    return found[0]


def _names(manifest: Manifest) -> str:
    part, rig = (source and PurePosixPath(source.file).stem for source in (manifest.part, manifest.rig))
    return " on ".join(name for name in (part, rig) if name) or "Image set"


def _posture_lines(posture: Posture) -> tuple[str, str]:
    theta, phi = drawings.sub("θ", "j"), drawings.sub("φ", "j")
    return f"{theta} {degrees(posture.elevation_deg)}", f"{phi} {degrees(posture.rotation_deg)}"


def _draw_rule(drawing: Drawing, y: float, colour: str) -> None:
    drawing.line(np.array([(MARGIN, y), (drawing.width - MARGIN - 1, y)]), colour=colour, width=1.0)


def _draw_legend(drawing: Drawing, manifest: Manifest) -> None:
    y = drawing.height - MARGIN - 4 * LINE
    _draw_rule(drawing, y, FAINT)
    levels = f"level {manifest.black_level:g} to {manifest.max_level}"
    averaged = "averaged over cells of pixels"
    ramp = np.linspace(0.0, 1.0, 180)[:, None]
    tint = pictures.shade_of_saturation(ramp)
    grey, red = np.repeat(255.0 * ramp, 3, axis=1), tint * np.array(SATURATED_COLOUR) + (1.0 - tint) * 128.0
    # each with a long text and one for narrow sheets
    long_grey = f"grey: {levels} shown linearly as black to white (screen values 0 to 255), {averaged}"
    long_red = "red: share of saturated pixels in a cell, from a single one to all of them"
    bars = (
        (grey, long_grey, f"grey: {levels}, linear, {averaged}"),
        (red, long_red, "red: saturated pixels in a cell, from one to all"),
    )
    height = round(CAP_HEIGHT * TEXT) + 4
    top = y + GAP - 2
    room = drawing.width - 2 * MARGIN
    for colours, *texts in bars:
        bar = np.broadcast_to(np.floor(colours + 0.5), (height, len(ramp), 3)).astype(np.uint8)
        drawing.picture(bar, MARGIN, top)
        beside = room - len(ramp) - GAP
        text = next((t for t in texts if text_width(t, TEXT) <= beside), fit_text(texts[-1], TEXT, beside))
        drawing.text(MARGIN + len(ramp) + GAP, top + height - 2, text, size=TEXT, colour=SOFT)
        top += LINE + 6
    text = "Below each image: saturated pixels of the full image, and their share of all its pixels."
    drawing.text(MARGIN, top + height - 2, fit_text(text, TEXT, room), size=TEXT, colour=SOFT)
