"""Which defects are on the part of a set of images, by what the set itself says; told before any work."""

from __future__ import annotations

from dataclasses import dataclass

from lightopt.config import PartConfig, load_part
from lightopt.core.errors import InputError
from lightopt.core.provenance import file_sha256
from lightopt.images import ImageSet


@dataclass(frozen=True)
class TruthSource:
    """What says which defects are on the part of a set.

    Attributes
    ----------
    part
        Whose defects are on it; None where the set's labels say it, or it was rendered without defects.
    words
        What a person should know of it.
    """

    part: PartConfig | None = None
    words: tuple[str, ...] = ()


def truth_source(image_set: ImageSet, part: PartConfig) -> TruthSource:
    """What says which defects are on the part of a set.

    Its labels; else, of a set that lightopt rendered, that there are none; else the part file that it was taken by,
    which is `part`, or lies beside it with the content that it had. A set that does not say what it was taken by, or
    by this file before it was edited, has the defects that `part` names.

    Parameters
    ----------
    image_set
        The images.
    part
        That it is inspected by.

    Raises
    ------
    InputError
        Nothing says it, or labels are listed and their images are not.
    """
    manifest = image_set.manifest
    if isinstance(manifest.extra.get("defects"), list):
        told = {entry.posture for entry in image_set.geometry}
        lacking = {entry.posture: None for entry in image_set.images if entry.posture not in told}
        if lacking:
            raise InputError(
                f"{image_set.folder}: no labels of defects for {', '.join(f'posture {p}' for p in lacking)}, though "
                "the manifest lists defects; expected a geometry EXR with a channel defect; render the set anew"
            )
        return TruthSource()
    if manifest.kind == "simulated" and manifest.lightopt is not None:
        return TruthSource()
    own = manifest.part
    if own is not None and own.sha256 != part.source.sha256 and own.file != part.source.path.name:
        beside = part.source.path.parent / own.file
        if not beside.is_file() or file_sha256(beside) != own.sha256:
            raise InputError(
                f"{image_set.folder}: nothing is known of defects on this part: the images have no labels, and were "
                f"taken by {own.file}, which does not lie beside {part.source.path} as it was then; put it there, or "
                "leave --truth out"
            )
        return _by_own(load_part(beside), own.file)
    if own is not None and own.sha256 == part.source.sha256:
        return _by_own(part, own.file)
    if not part.defects:
        raise InputError(
            f"{image_set.folder}: nothing is known of defects on this part: the images have no labels, as lightopt "
            f"render writes them, and {part.source.path}, by which they were not taken as it is now, names no defects; "
            "give the part file whose defects: are those of the part in the images, or leave --truth out"
        )
    return TruthSource(part)


def _by_own(part: PartConfig, name: str) -> TruthSource:
    if part.defects:
        return TruthSource(part)
    return TruthSource(
        part, words=(f"--truth: {name}, by which it was taken, names no defects: held to be a good part",)
    )
