"""The files of the overlaps of an image set: the maps, and all figures as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lightopt.core.provenance import provenance
from lightopt.images._overlap import Overlap, overlap_map_name, write_overlap_map
from lightopt.images._reader import ImageSet
from lightopt.images._result_folder import ResultFolder


def write_overlaps(overlaps: Sequence[Overlap], images: ImageSet, folder: Path, *, force: bool) -> list[Path]:
    """Write the maps and at last ``overlap.json``; returns their paths.

    Parameters
    ----------
    overlaps
        From :func:`find_overlaps`.
    images
        The set that they are of.
    folder
        Made where it does not exist.
    force
        Whether files of the overlaps of other images are replaced.

    Raises
    ------
    InputError
        The folder holds overlaps of other images, and `force` is False; or a file cannot be written.
    """
    maps = {overlap_map_name(one.posture, one.exposure): one for one in overlaps}
    result = ResultFolder(
        folder,
        provenance({"image_sets": [images.fingerprint]}, {}),
        name="overlap.json",
        format="lightopt-overlap/1",
        what="overlaps",
        also=tuple(maps),
        force=force,
    )
    for name, one in maps.items():
        write_overlap_map(one, result.place(name), overwrite=True)
    figures = result.finish({"overlaps": [one.as_dict() for one in overlaps]})
    return [*(folder / name for name in maps), figures]
