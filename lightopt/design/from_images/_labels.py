"""Where samples have defects, and which pixels are of the part: masks beside a manifest, geometry of rendered sets."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Int32
from lightopt.core.errors import InputError, counted
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.images import ImageSet, posture_folder, read_exr, read_png

_TOUCHING = np.ones((3, 3), np.bool_)
_PICTURES = (".png", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff")


def read_labels(
    one: ImageSet, postures: Sequence[Posture], shape: tuple[int, ...], problems: list[str], run: RunContext
) -> tuple[Int32, tuple[str, ...]]:
    """Labels of a set's postures, and names of its defects: those of its masks, else those that it was rendered with.

    Adds to `problems` what is wrong with the masks. Warns of pictures that are neither images nor masks.

    Raises InputError: The labels of a rendered set are missing or damaged.
    """
    masks = [one.path(f"masks/{posture_folder(posture)}.png") for posture in postures]
    if len(postures) == 1 and not masks[0].is_file():
        masks = [one.path("mask.png")]
    _check_names(one, masks, postures[0], problems, run)
    if any(path.is_file() for path in masks):
        return _masked(masks, postures, shape, problems)
    return _rendered(one, postures, shape)


def read_mask(path: Path, shape: tuple[int, ...], problems: list[str]) -> Bool:
    """Where a PNG is not 0; nowhere, and a problem, if it is of another size than the images."""
    mask = read_png(path)
    if mask.shape == shape:
        return mask > 0
    problems.append(f"{path}: a mask of {_size(mask.shape)} for images of {_size(shape)}; expected the same size")
    return np.zeros(shape, np.bool_)


def part_pixels(sets: Sequence[ImageSet], posture: Posture, shape: tuple[int, ...]) -> Bool | None:
    """The part's pixels by the first geometry image of a posture; None where no set has one.

    Raises InputError: It has no depth, or is of another size than the images.
    """
    instead = "render the set anew, or give a mask of the part with option 'region'"
    for one in sets:
        for entry in one.geometry:
            if entry.posture == posture:
                return _channel(one.path(entry.exr), "Z", shape, instead) > 0.0
    return None


def _check_names(one: ImageSet, masks: Sequence[Path], posture: Posture, problems: list[str], run: RunContext) -> None:
    # a mask of another name would make a defective sample a good one
    listed = [path for name, _ in one.manifest.listed_files if (path := one.path(name)).is_file()]
    known = {_identity(path) for path in (*listed, *filter(Path.is_file, masks))}
    expected = masks[0].relative_to(one.folder).as_posix()
    beside = [path for path in one.folder.glob("*") if path.suffix.lower() in _PICTURES]
    for path in sorted([*beside, *one.path("masks").glob("*")]):
        if not path.is_file() or path.name.startswith(".") or _identity(path) in known:
            continue
        if path.parent != one.folder:
            name = f"masks/{posture_folder(posture)}.png"
            problems.append(f"{path}: the set has no such posture; expected a name such as {name}")
        elif "mask" in path.stem.lower():
            problems.append(f"{path}: no mask of the set; expected the name {expected}; rename or remove the file")
        else:
            run.warn(f"{path}: not used: the manifest does not list it, and a mask has the name {expected}")


def _identity(path: Path) -> tuple[int, int]:
    # of a file, whose name some file systems know in several cases
    facts = path.stat()
    return facts.st_dev, facts.st_ino


def _masked(
    masks: Sequence[Path], postures: Sequence[Posture], shape: tuple[int, ...], problems: list[str]
) -> tuple[Int32, tuple[str, ...]]:
    labels = np.full((len(postures), *shape), -1, np.int32)
    names: list[str] = []
    before = len(problems)
    for own, path, posture in zip(labels, masks, postures, strict=True):
        if path.is_file():
            labelled: Any = ndimage.label(read_mask(path, shape, problems), _TOUCHING)
            found, count = labelled
            own[:] = np.where(found > 0, found - 1 + len(names), -1)
            where = f"{posture} " if len(postures) > 1 else ""
            names += [f"{where}{i + 1}" for i in range(count)]
    if not names and len(problems) == before:
        path = next(filter(Path.is_file, masks))
        problems.append(f"{path}: 0 everywhere; expected a mask that is not 0 on defects, or none for a good sample")
    return labels, tuple(names)


def _rendered(one: ImageSet, postures: Sequence[Posture], shape: tuple[int, ...]) -> tuple[Int32, tuple[str, ...]]:
    labels = np.full((len(postures), *shape), -1, np.int32)
    listed: Any = one.manifest.extra.get("defects")
    if not isinstance(listed, list) or not listed:
        return labels, ()
    defects = cast("list[Any]", listed)
    instead = "render the set anew, or add masks"
    entries = {entry.posture: entry for entry in one.geometry}
    for own, posture in zip(labels, postures, strict=True):
        if posture not in entries:
            raise InputError(
                f"{one.folder}: the manifest lists defects, but no geometry of posture {posture} shows where they are; "
                f"{instead}"
            )
        path = one.path(entries[posture].exr)
        numbers = _channel(path, "defect", shape, instead)
        if not (numbers >= -1.0).all() or numbers.max() > len(defects) - 1:
            wrong = f"found {numbers.min():g} to {numbers.max():g}"
            raise InputError(
                f"{path}: channel defect: expected -1 to {len(defects) - 1}, as the manifest "
                f"lists {counted(len(defects), 'defect')}, {wrong}; {instead}"
            )
        own[:] = numbers.astype(np.int32)
    named = (defect.get("name") if isinstance(defect, dict) else None for defect in defects)
    return labels, tuple(str(name or i + 1) for i, name in enumerate(named))


def _channel(path: Path, name: str, shape: tuple[int, ...], instead: str) -> Float32:
    # of a geometry image
    channels = read_exr(path)
    if name not in channels:
        raise InputError(f"{path}: expected a channel {name}, found {', '.join(channels)}; {instead}")
    found = channels[name]
    if found.shape != shape:
        raise InputError(f"{path}: geometry of {_size(found.shape)} for images of {_size(shape)}; {instead}")
    return found


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} × {shape[0]} px"
