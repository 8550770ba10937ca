"""All images of a set on one page: rows of postures, columns of lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from lightopt.core.errors import InputError, counted
from lightopt.images import ImageEntry, ImageSet, ImageSetWriter, Manifest, read_image_set, sheet_name
from lightopt.report import _pictures as pictures

if TYPE_CHECKING:
    from PIL import Image

EMPTY = "#f1f3f5"
MARGIN, GAP = 36, 18
TITLE, HEAD, TEXT = 32, 20, 15  # sizes of text [px]
TOP, LEFT, BOTTOM = 150, 150, 110  # room above the first row, before the first column and below the last row [px]
CAPTION = 44  # room below each image [px]
LEAST_WIDTH = 800  # of a sheet [px]

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

    exposure: Which exposure to show; the longest of the set by default.
    title: Instead of the names of the part's and the rig's file.
    Raises InputError: The set is empty or has no such exposure, an image is missing or damaged, the file cannot be
        written, or one of other content is there and `overwrite` is False.
    """
    path = pictures.check_png_path(path)
    sheet = _sheet(image_set, _exposure(image_set, exposure), title or _names(image_set.manifest))
    return pictures.write_picture(path, sheet, overwrite=overwrite)


@pictures.fixed_style()
def _sheet(image_set: ImageSet, exposure: float, title: str) -> Image.Image:
    from matplotlib.figure import Figure

    entries = [entry for entry in image_set.images if entry.exposure == exposure]
    lights = list(dict.fromkeys(entry.light for entry in entries))
    postures = list(dict.fromkeys(entry.posture for entry in entries))
    limit = max(SMALLEST, min(LARGEST, SHEET_WIDTH // len(lights)))
    thumbnails = {(one.posture, one.light): (one, entry_thumbnail(image_set, one, limit)) for one in entries}
    rows, columns = np.max([small.picture.shape[:2] for _, small in thumbnails.values()], axis=0).tolist()
    columns = max(columns, SMALLEST)  # narrow images still need room for the caption
    # cells have whole pixels, so that pictures lie pixel on pixel
    used = LEFT + len(lights) * (columns + GAP) - GAP
    width, height = max(used + MARGIN, LEAST_WIDTH), TOP + len(postures) * (rows + CAPTION + GAP) + BOTTOM
    figure = Figure(figsize=(width / pictures.DPI, height / pictures.DPI), dpi=pictures.DPI)
    place = {"left": LEFT / width, "right": used / width, "bottom": (BOTTOM + CAPTION + GAP) / height}
    place |= {"top": 1.0 - TOP / height, "wspace": GAP / columns, "hspace": (CAPTION + GAP) / rows}
    cells = figure.subplots(len(postures), len(lights), squeeze=False, gridspec_kw=place)
    at: dict[str, Any] = {"x": MARGIN / width, "va": "top", "ha": "left"}
    most = (width - 2 * MARGIN) // TEXT  # characters of a line of small text, more or less
    heading = pictures.shortened(title, most // 2)
    figure.suptitle(heading, y=1.0 - MARGIN / height, fontsize=TITLE * pictures.POINT, color=pictures.INK, **at)
    small_text: dict[str, Any] = {"fontsize": TEXT * pictures.POINT, "color": pictures.SOFT}
    number = f"{counted(len(lights), 'light')} × {counted(len(postures), 'posture')}"
    facts = _facts(image_set.manifest, number, exposure)
    figure.text(y=1.0 - (MARGIN + 1.6 * TITLE) / height, s=facts, **at, **small_text)
    figure.text(y=(BOTTOM - GAP) / height, s=_legend(image_set.manifest), **at, **small_text)
    several = {one for one in lights if len({light_position(e) for e in entries if e.light == one}) > 1}
    for cell, (posture, light) in zip(cells.flat, ((p, one) for p in postures for one in lights), strict=True):
        cell.set(xticks=[], yticks=[], facecolor=EMPTY)
        cell.spines[:].set_visible(False)
        if posture == postures[0]:
            own = next(entry for entry in entries if entry.light == light)
            where = "several positions" if light in several else light_position(own)
            name = pictures.shortened(light, columns // HEAD * 3 // 2)
            cell.set_title(f"{name}\n{where}", loc="left", fontsize=TEXT * pictures.POINT, color=pictures.INK)
        if light == lights[0]:
            angles = f"θⱼ {degrees(posture.elevation_deg)}\nφⱼ {degrees(posture.rotation_deg)}"
            cell.set_ylabel(
                angles, fontsize=HEAD * pictures.POINT, color=pictures.INK, rotation=0.0, ha="right", va="top", y=1.0
            )
        if (posture, light) not in thumbnails:
            cell.text(0.5, 0.5, "no image", ha="center", transform=cell.transAxes, **small_text)
            continue
        entry, small = thumbnails[posture, light]
        cell.imshow(small.picture, interpolation="nearest")
        text = saturation_text(small) + f"\n{light_position(entry)}" * (light in several)
        colour = pictures.hex_colour(pictures.SATURATED_COLOUR) if small.saturated else pictures.SOFT
        cell.set_xlabel(text, loc="left", fontsize=TEXT * pictures.POINT, color=colour)
    return pictures.figure_image(figure)


def _facts(manifest: Manifest, number: str, exposure: float) -> str:
    sensor = f"{manifest.bit_depth} bit, saturated from level {manifest.saturated_from:g}"
    black = [f"black level {manifest.black_level:g}"] if manifest.black_level else []
    return "   ·   ".join([manifest.kind, number, f"exposure {exposure:g}", sensor, *black])


def _legend(manifest: Manifest) -> str:
    return (
        f"Grey: level {manifest.black_level:g} to {manifest.max_level}, linear, averaged over cells of pixels.\n"
        "Red: saturated pixels in a cell, from a single one to all of them.\n"
        "Below each image: saturated pixels of the full image, and their share of all its pixels."
    )


def entry_thumbnail(image_set: ImageSet, entry: ImageEntry, limit: int) -> pictures.Thumbnail:
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


def saturation_text(thumbnail: pictures.Thumbnail) -> str:
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
