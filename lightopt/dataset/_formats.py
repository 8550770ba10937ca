"""A dataset in the words of others: folders of MVTec AD, COCO and YOLO with their masks, the split, the datasheet."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Index, UInt8
from lightopt.core.errors import counted
from lightopt.dataset._draws import SPLITS, STACK, Setup
from lightopt.dataset._folder import INVISIBLE, TRAIN_DEFECTS, DatasetFolder
from lightopt.dataset._visibility import MIN_IMAGES
from lightopt.images import csv_text
from lightopt.scene import at_rest_warnings

Record = Mapping[str, Any]
_MASKS = f"/{TRAIN_DEFECTS}/masks/"


def image_name(view: str, number: int, defects: Sequence[Record], split: str) -> str:
    """Name of an image: in a view's folders as MVTec AD has them, or apart.

    Apart are images that show no defect of those they have, and defects of the split train: in a test, they would share
    their poses with the good pieces that a detector has learnt from.
    """
    if not defects:
        return f"{view}/images/{'train' if split == 'train' else 'test'}/good/{number:06}.png"
    kinds = sorted({one["kind"] for one in defects if is_visible(one, view)})
    if not kinds:
        return f"{view}/{INVISIBLE}/{number:06}.png"
    folder = f"{TRAIN_DEFECTS}/images" if split == "train" else "images/test"
    return f"{view}/{folder}/{kinds[0] if len(kinds) == 1 else 'combined'}/{number:06}.png"


def mask_name(image: str) -> str | None:
    """Name of the mask of an image; None for an image without visible defects."""
    where, _, name = image.rpartition("/")
    if where.endswith(("/good", f"/{INVISIBLE}")):
        return None
    where = where.replace("/images/test/", "/images/ground_truth/").replace(f"/{TRAIN_DEFECTS}/images/", _MASKS)
    return f"{where}/{name.replace('.png', '_mask.png')}"


def yolo_name(image: str) -> str | None:
    """Name of the labels of an image; None for an image that YOLO is not given."""
    if f"/{INVISIBLE}/" in image:
        return None
    return image.replace("/images/", "/labels/").replace(".png", ".txt")


def is_visible(defect: Record, view: str) -> bool:
    return defect["visibility"][view]["visible"]


def yolo_text(defects: Sequence[Record], view: str, kinds: Sequence[str], width: int, height: int) -> str:
    """The labels of an image: class, centre and size of each visible defect as shares of the image's sides."""
    lines: list[str] = []
    for one in defects:
        if is_visible(one, view):
            left, top, columns, rows = one["box_px"]
            shares = (left + 0.5 * columns) / width, (top + 0.5 * rows) / height, columns / width, rows / height
            lines.append(f"{kinds.index(one['kind'])} {' '.join(f'{share:.6f}' for share in shares)}\n")
    return "".join(lines)


def write_formats(folder: DatasetFolder, setup: Setup, samples: Sequence[Record]) -> list[str]:
    """Write COCO's and YOLO's lists of each view, and the table of samples; returns the names of the files."""
    views, texts = setup.views, dict[str, str]()
    for view in views:
        for split in SPLITS:
            own = [one for one in samples if one["split"] == split]
            coco = _coco(setup, own, view)
            texts[f"{view}/coco-{split}.json"] = json.dumps(coco, ensure_ascii=False, separators=(",", ":")) + "\n"
            images = (one["files"][view] for one in own if yolo_name(one["files"][view]) is not None)
            texts[f"{view}/{split}.txt"] = "".join(f"./{name.removeprefix(f'{view}/')}\n" for name in images)
        names = "".join(f"  {number}: {kind}\n" for number, kind in enumerate(setup.kinds))
        texts[f"{view}/data.yaml"] = "".join(f"{split}: {split}.txt\n" for split in SPLITS) + f"names:\n{names}"
    header = ("sample", "pose", "elevation_deg", "rotation_deg", "split", "defects", "kinds", *views)
    rows: list[Sequence[object]] = [header]
    for one in samples:
        found = [defect["kind"] for defect in one["defects"]]
        posture = one["posture"]
        place = (one["pose"], posture["elevation_deg"], posture["rotation_deg"])
        files = (one["files"][view] for view in views)
        rows.append((one["sample"], *place, one["split"], len(found), " ".join(sorted(set(found))), *files))
    texts["samples.csv"] = csv_text(rows)
    for name, text in texts.items():
        folder.write_text(name, text)
    return list(texts)


def _coco(setup: Setup, samples: Sequence[Record], view: str) -> dict[str, Any]:
    (width, height), kinds = setup.size, setup.kinds
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for one in samples:
        number = one["sample"] + 1
        name = one["files"][view].removeprefix(f"{view}/")
        images.append({"id": number, "file_name": name, "width": width, "height": height, "pose": one["pose"]})
        for defect in one["defects"]:
            pixels, visible = pixels_of(defect["mask"]), is_visible(defect, view)
            shape = outlines(pixels, width) if visible else None
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": number,
                    "category_id": kinds.index(defect["kind"]) + 1,
                    "bbox": defect["box_px"],
                    "area": len(pixels),
                    "segmentation": defect["mask"] if shape is None else shape,
                    # what evaluations and loss functions leave out
                    "iscrowd": int(not visible),
                    "name": defect["name"],
                    "size_mm": defect["size_mm"],
                    "visibility": defect["visibility"],
                }
            )
    categories = [{"id": i, "name": kind, "supercategory": "defect"} for i, kind in enumerate(kinds, 1)]
    info = {"description": f"{setup.part.name} on {setup.rig.name}, {view}, seed {setup.options.seed}", "version": "1"}
    return {"info": info, "images": images, "annotations": annotations, "categories": categories}


def datasheet(setup: Setup, samples: Sequence[Record], omitted: int) -> str:
    """The datasheet of a dataset, as Markdown: what is in it, what was randomised, what is shared, what labels mean."""

    def limits(pair: Sequence[float]) -> str:
        return f"{pair[0]:.4g} to {pair[1]:.4g}"

    rig, part, options, ranges, factors = setup.rig, setup.part, setup.options, setup.ranges, setup.factors
    reach, dust, views = ranges.pose, ranges.dust, (STACK, *setup.views)
    tilt = f", tilt ± {reach.tilt_deg:g}°, height ± {reach.lift_mm:g} mm" if reach.tilt_deg or reach.lift_mm else ""
    gains = "; ".join(f"{name} {limits(pair)}" for name, pair in factors.gains.items())
    surface, sensor = part.surface, rig.camera.sensor
    waves = () if surface is None else surface.waves
    waviness = "; ".join(f"{slope:g}°, {length:g} mm" for slope, length in waves) or "none"
    electrons = f", {sensor.electrons_per_level:g} electrons per level" if sensor.electrons_per_level else ""
    particles = f"{dust.particles[0]} to {dust.particles[1]} particles of {limits(dust.size_mm)} mm"
    randomised = [
        ("placement of the part", "pose", f"± {reach.shift_mm:g} mm along X and Y, ± {reach.rotation_deg:g}°{tilt}"),
        ("waviness of the surface", "pose", waviness),
        ("width of the lobe", "pose", f"× {limits(factors.sigma)}"),
        ("diffuse light (R_d)", "sample", f"× {limits(factors.R_d)}"),
        ("specular light (R_s)", "sample", f"× {limits(factors.R_s)}"),
        ("gains", "sample", f"× {gains}"),
        ("share of samples with defects", "sample", f"{ranges.defective:g}"),
        ("defects", "sample", f"{ranges.defects[0]} to {ranges.defects[1]}; place, direction, size and slope of each"),
        ("dust", "sample", f"{particles}, R_d {limits(dust.R_d)}"),
        *(("motion of the part", "nothing", text) for text in at_rest_warnings(setup.scene, options.exposure)),
        ("noise", "image", f"read noise of {sensor.read_noise_levels:g} levels{electrons}"),
    ]
    by_split = Counter((one["split"], bool(one["defects"])) for one in samples)
    defects = [defect for one in samples for defect in one["defects"]]
    kinds = sorted({defect["kind"] for defect in defects})
    shown = {
        (kind, view): sum(d["kind"] == kind and is_visible(d, view) for d in defects)
        for kind in kinds
        for view in views
    }
    scale = f", {sensor.bit_depth} bits scaled to 8" if sensor.bit_depth > 8 else ""
    poses = len({one["pose"] for one in samples})
    shared = (
        f"Up to {ranges.samples_per_pose} samples share a pose: its rendered levels, waviness and width of the lobe. "
        "The samples of a pose are in one split. Their defects are rendered by ray casting in the pixels that show "
        "them; dust, factors and noise are applied to linear levels. Light that a defect reflects onto the part is "
        "left out. The fixed pattern of the sensor is that of one camera."
    )
    labels = (
        "A mask has the pixels that any part of the defect lies in. A defect is visible in an image, or in all of a "
        "sample (stack), where the matched-filter statistic is expected to reach the threshold of "
        f"{options.false_alarms:g} false alarms per posture; in a stack, {MIN_IMAGES} images must show it where so "
        "many are lit. Invisible defects are marked: `iscrowd: 1` in COCO, no mask in ground_truth, no box for YOLO. "
        f"Images without a visible defect of those on the piece are in `{INVISIBLE}/`, which readers of MVTec AD and "
        f"YOLO do not see; those with visible defects in the split train are in `{TRAIN_DEFECTS}/`, which readers of "
        "MVTec AD do not see."
    )
    lines = [
        f"# Dataset of {part.name} on {rig.name}",
        "",
        f"Rendered by lightopt, seed {options.seed}: {counted(len(samples), 'sample')} in {counted(poses, 'pose')}. A "
        f"sample is one piece in one posture: one image per light{scale}"
        + (", and one image fused from these without highlights." if options.fusion else "."),
        "",
        "| split | good samples | samples with defects |",
        "|---|---|---|",
        *(f"| {split} | {by_split[split, False]} | {by_split[split, True]} |" for split in SPLITS),
        "",
        "## Randomised",
        "",
        "| what | drawn for each | limits |",
        "|---|---|---|",
        *(f"| {what} | {each} | {text} |" for what, each, text in randomised),
        "",
        "Values are even between their limits, sizes by their logarithm. Places of defects are even by area where the "
        "image shows the whole defect, off silhouettes, creases and grazing views."
        + (f" For {omitted} defects there was no such place; they are left out." if omitted else ""),
        "",
        "## Shared",
        "",
        shared,
        "",
        "## Labels",
        "",
        labels,
        "",
        f"| kind | defects | visible in: {' | '.join(views)} |",
        f"|---|---|{'---|' * len(views)}",
    ]
    for kind in kinds:
        total = sum(one["kind"] == kind for one in defects)
        lines.append(f"| {kind} | {total} | {' | '.join(str(shown[kind, view]) for view in views)} |")
    return "\n".join(lines) + "\n"


def union(defects: Sequence[Record], view: str, size: tuple[int, int]) -> UInt8:
    """Mask of the visible defects of an image: 255 and 0, shape (H, W)."""
    width, height = size
    mask = np.zeros((height, width), np.uint8)
    for one in defects:
        if is_visible(one, view):
            mask.reshape(-1)[pixels_of(one["mask"])] = 255
    return mask


def box_of(pixels: Index, width: int) -> tuple[int, int, int, int]:
    """Left column, top row, columns and rows of the box around pixels of raveled indices, shape (k,)."""
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
