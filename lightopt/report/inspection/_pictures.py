"""Pictures of an inspection: defects over what the camera saw, the image without highlights, a ball at each defect."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from lightopt import inspection
from lightopt.core.arrays import Bool, Float64, Int32
from lightopt.report._page import Block, Gallery, Picture, SurfaceView
from lightopt.report._pictures import font_file, hex_colour, png_bytes, shrunk, write_picture
from lightopt.report._surface import SurfaceLayer, standing_surface, surface_classes

BOX_MARGIN_PX = 3
LABEL_SIZE, LABEL_GAP_PX = 15, 3
CAP_HEIGHT = 0.73  # of the font, per em
# numbers are at least this share of the picture's width, lines of boxes about this: a wide picture is looked at from
# afar
LABEL_SHARE, LINE_SHARE = 1 / 43, 1 / 800

# lighter, to be read on black
LABEL_COLOURS: Final[Mapping[inspection.Kind, tuple[int, int, int]]] = {
    "shape": (255, 120, 100),
    "stain": (130, 185, 255),
    "unknown": (255, 195, 70),
}

OVERLAY_PX, SMALL_PX = 1600, 480  # no side of a picture in the report is longer
COLUMN_PX = 896  # a picture of smaller images is made larger by whole factors up to the width that the page gives it


def defect_overlay(path: Path, posture: inspection.InspectedPosture, defects: Sequence[inspection.FoundDefect]) -> Path:
    """Write the picture that :func:`overlay_image` makes as PNG, as large as the images, into a folder that exists."""
    return write_picture(path, overlay_image(posture, defects)[0])


def overlay_image(
    posture: inspection.InspectedPosture, defects: Sequence[inspection.FoundDefect], *, enlarge: int = 1
) -> tuple[Image.Image, inspection.GreyPicture]:
    """The posture's image without highlights, with the outlines and numbers of its defects; and what is beneath them.

    Red for shape, blue for stain, orange where neither could be determined, from whichever posture it was. Where no
    such image was made, the least level of each pixel. Pixels are made squares of `enlarge`; lines and numbers are as
    the picture's width asks for.
    """
    if posture.synthetic is not None:
        level, mask = posture.synthetic.level, posture.synthetic.mask
    else:
        level, mask = np.minimum(posture.view.level, posture.view.limit).min(axis=0), posture.view.part
    shown = inspection.grey_picture(level, mask)
    rgb = np.repeat(shown.grey[..., None], 3, axis=2)
    found = {id(detection): defect for defect in defects for detection in defect.detections}
    for index, detection in enumerate(posture.detections):
        region = posture.labels == index + 1
        inner: Bool = np.asarray(ndimage.binary_erosion(region), np.bool_)
        rgb[region & ~inner] = inspection.KIND_COLOURS[found[id(detection)].best.kind]
    image = enlarged(Image.fromarray(rgb), enlarge)
    draw, line = ImageDraw.Draw(image), max(1, round(LINE_SHARE * image.width))
    size = max(LABEL_SIZE, round(LABEL_SHARE * image.width))
    font = ImageFont.truetype(font_file(), size)
    for detection in posture.detections:
        defect = found[id(detection)]
        left, top, right, bottom = (enlarge * side for side in detection.box_px)
        m = BOX_MARGIN_PX * enlarge
        kind, number = defect.best.kind, str(defect.number)
        draw.rectangle(
            [left - m, top - m, right + m - 1, bottom + m - 1], outline=inspection.KIND_COLOURS[kind], width=line
        )
        at = _label_place(image, font, number, (left - m, top - m, right + m))
        border: dict[str, Any] = {"stroke_width": max(2, size // 7), "stroke_fill": "#000000"}
        draw.text(at, number, font=font, anchor="ls", fill=LABEL_COLOURS[kind], **border)
    return image, shown


def enlarged(image: Image.Image, times: int) -> Image.Image:
    return image.resize((times * image.width, times * image.height), Image.Resampling.NEAREST)


def _label_place(
    image: Image.Image, font: ImageFont.FreeTypeFont, text: str, box: tuple[int, int, int]
) -> tuple[float, float]:
    # left end and baseline: beside the box, on its other side where there is no room, and never beyond the picture
    left, top, right = box
    width, height = font.getlength(text) + LABEL_GAP_PX, CAP_HEIGHT * font.size
    x = right + LABEL_GAP_PX if right + LABEL_GAP_PX + width <= image.width else left - width
    baseline = min(max(top + height, height + LABEL_GAP_PX), image.height - LABEL_GAP_PX)
    return min(max(x, LABEL_GAP_PX), image.width - width), baseline


def image_blocks(result: inspection.InspectionResult) -> list[Block]:
    """A picture of each posture, and of those that have one the image without highlights and its uncertainty."""
    blocks: list[Block] = []
    for posture in result.postures:
        where = posture.view.posture
        times = _times(posture.view.part.shape[::-1], COLUMN_PX)
        picture, shown = overlay_image(posture, result.defects, enlarge=times)
        beneath = (
            "the image without highlights, black off the part and at its edges, which are not judged"
            if posture.synthetic is not None
            else "the least level over the lights, black off the part"
        )
        caption = (
            f"Posture {where}: red for a defect of shape, blue for a stain, orange for an unknown kind; the background "
            f"is {beneath}; {shown.legend}."
        )
        alt = f"Posture {where}: the part with its defects outlined and numbered"
        blocks.append(Picture(png=_small(picture, OVERLAY_PX), alt=alt, caption=caption))
    rows = [(f"posture {p.view.posture}", pictures) for p in result.postures if (pictures := _synthetic(p))]
    if rows:
        blocks.append(Gallery(header=["without highlights", "its uncertainty"], rows=rows))
    return blocks


def _synthetic(posture: inspection.InspectedPosture) -> list[Picture | None]:
    image = posture.synthetic
    if image is None:
        return []
    pictures: list[Picture | None] = []
    for what, level in (("without highlights", image.level), ("uncertainty", image.deviation)):
        shown = inspection.grey_picture(level, image.mask)
        picture = Image.fromarray(shown.grey).convert("RGB")
        png = _small(enlarged(picture, _times(picture.size, SMALL_PX)), SMALL_PX)
        pictures.append(Picture(png=png, alt=f"Posture {posture.view.posture}: {what}", caption=shown.legend))
    return pictures


def _times(size: tuple[int, ...], limit: int) -> int:
    return max(1, limit // max(size))


def _small(image: Image.Image, limit: int) -> bytes:
    if max(image.size) <= limit:
        return png_bytes(image)
    return png_bytes(shrunk(np.asarray(image, np.uint8), limit=limit))


PART_COLOUR = "#c9ced6"
WORDS: Final[Mapping[inspection.Kind, str]] = {"shape": "shape", "stain": "stain", "unknown": "unknown kind"}

# a ball's radius is at least this share of the part's size, so that the smallest defect is seen from afar
LEAST_SHARE = 0.015

RINGS, SECTORS = 8, 12


def marked_part(result: inspection.InspectionResult, name: str) -> SurfaceView:
    """The part as its file has it on the stage, to turn."""
    mesh, place = result.nominal.mesh, result.nominal.placement
    size = float(np.linalg.norm(mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)))
    vertices: list[Float64] = [np.asarray(mesh.vertices, np.float64)]
    triangles: list[Int32] = [np.asarray(mesh.faces, np.int32)]
    classes = [np.zeros(len(mesh.faces), np.uint8)]
    ball, faces = _ball()
    count = len(mesh.vertices)
    for defect in result.defects:
        middle = place.rotation @ np.array(defect.best.position) + place.translation
        radius = max(0.5 * defect.size[0], LEAST_SHARE * size)
        vertices.append(middle + radius * ball)
        triangles.append(faces + np.int32(count))
        classes.append(np.full(len(faces), 1 + list(WORDS).index(defect.best.kind), np.uint8))
        count += len(ball)
    kinds = [("the part", PART_COLOUR), *((WORDS[kind], hex_colour(inspection.KIND_COLOURS[kind])) for kind in WORDS)]
    amounts = ["", *(str(sum(defect.best.kind == kind for defect in result.defects)) for kind in WORDS)]
    legend = surface_classes(kinds, amounts)
    layer = SurfaceLayer(name="defects", classes=legend, of_face=np.concatenate(classes))
    shape = np.concatenate(vertices), np.concatenate(triangles)
    return SurfaceView(
        surface=standing_surface(*shape, (layer,), result.nominal.camera),
        alt=f"{name} with a ball at each of its defects",
        caption=f"{name} at posture (0°, 0°), Z up. A ball has the length of its defect as diameter, but "
        f"at least {2.0 * LEAST_SHARE * size:.2g} mm.",
    )


def _ball() -> tuple[Float64, Int32]:
    # unit sphere of rings from pole to pole
    down = np.linspace(0.0, math.pi, RINGS + 1)[:, None]
    around = np.linspace(0.0, 2.0 * math.pi, SECTORS, endpoint=False)[None, :]
    points = np.stack(
        np.broadcast_arrays(np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)), axis=-1
    ).reshape(-1, 3)
    ring, sector = (a.ravel() for a in np.meshgrid(np.arange(RINGS), np.arange(SECTORS), indexing="ij"))
    after = (sector + 1) % SECTORS
    a, b = ring * SECTORS + sector, ring * SECTORS + after
    c, d = a + SECTORS, b + SECTORS
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return points, faces.astype(np.int32)
