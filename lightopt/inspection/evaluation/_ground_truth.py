"""Ground truth: which defects are on the part of an image set, and which pixels show them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lightopt.config import PartConfig, load_part
from lightopt.core.arrays import Float32, Float64, Int32
from lightopt.core.errors import InputError
from lightopt.core.provenance import file_sha256
from lightopt.core.transforms import Posture
from lightopt.defects import PlacedDefect, mark_surface
from lightopt.estimate.registration import Placement
from lightopt.images import ImageSet
from lightopt.inspection._results import InspectedPosture, InspectionResult
from lightopt.inspection.prediction._registered_set import world_to_mesh_file
from lightopt.scene import defect_facts


@dataclass(frozen=True)
class TruthSource:
    """The source of ground truth for a set of images."""

    # whose defects are on the part; None where the set has labels, or it was rendered without defects
    part: PartConfig | None = None
    warnings: tuple[str, ...] = ()


def truth_source(image_set: ImageSet, part: PartConfig) -> TruthSource:
    """The source that determines which defects are on the part of a set.

    Its labels; else, of a set that lightopt rendered, that there are none; else the part file that it was taken by,
    which is `part`, or lies beside it with the content that it had. A set without the name of its part file, or taken
    by this file before it was edited, has the defects that `part` names.

    part: That the images are inspected by.
    """
    manifest = image_set.manifest
    if isinstance(manifest.extra.get("defects"), list):
        labelled = {entry.posture for entry in image_set.geometry}
        lacking = {entry.posture: None for entry in image_set.images if entry.posture not in labelled}
        if lacking:
            raise _labels_missing(image_set, lacking)
        return TruthSource()
    if manifest.kind == "simulated" and manifest.lightopt is not None:
        return TruthSource()
    own = manifest.part
    unchanged = own is not None and own.sha256 == part.source.sha256
    if own is not None and not unchanged and own.file != part.source.path.name:
        beside = part.source.path.parent / own.file
        if not beside.is_file() or file_sha256(beside) != own.sha256:
            raise InputError(
                f"{image_set.folder}: no ground truth for this part: the images have no labels, and were "
                f"captured with {own.file}, which is not beside {part.source.path} or has changed since; put it there, "
                "or inspect without ground truth"
            )
        part, unchanged = load_part(beside), True
    if part.defects:
        return TruthSource(part)
    if own is not None and unchanged:
        good = f"ground truth: {own.file}, with which the set was captured, lists no defects; the part counts as good"
        return TruthSource(part, warnings=(good,))
    raise InputError(
        f"{image_set.folder}: no ground truth for this part: the images have no labels, as lightopt "
        f"render writes them, and {part.source.path}, which has changed since the capture, lists no defects; give the "
        "part file whose defects: are those of the part in the images, or inspect without ground truth"
    )


def truth_sources(sets: Sequence[ImageSet], part: PartConfig) -> list[TruthSource]:
    """The sources of ground truth of several sets, by :func:`truth_source`.

    Raises InputError: the problems of all sets together.
    """
    problems: list[str] = []

    def source(image_set: ImageSet) -> TruthSource:
        try:
            return truth_source(image_set, part)
        except InputError as error:
            problems.extend(error.messages)
            return TruthSource()

    sources = [source(image_set) for image_set in sets]
    if problems:
        raise InputError(*problems)
    return sources


def true_labels(
    image_set: ImageSet, result: InspectionResult, *, known: Sequence[PlacedDefect]
) -> tuple[Sequence[Mapping[str, Any]], list[Int32], Literal["images", "part file", "no defects"]]:
    """The labels of a set; of one without labels those of known defects where the inspection found the part.

    Returns of each defect what :func:`lightopt.scene.defect_facts` gives, per posture the index of the defect that each
    pixel shows, −1 for none, shape (H, W), and whether the set was rendered with them or they are cast.

    known: defects of the part, in the frame of the inspection's nominal scene (:func:`lightopt.scene.place_defects`);
        empty where it has none.
    """
    listed = image_set.manifest.extra.get("defects")
    if isinstance(listed, list):
        return listed, [_stored(image_set, posture) for posture in result.postures], "images"
    arrays = [_cast(posture, result, known) for posture in result.postures]
    facts = defect_facts(known, result.nominal.placement)
    return facts, arrays, "part file" if known else "no defects"


def _stored(image_set: ImageSet, posture: InspectedPosture) -> Int32:
    entries = [g for g in image_set.geometry if g.posture == posture.view.posture]
    channels = image_set.load_geometry(entries[0]) if entries else {}
    if "defect" not in channels:
        raise _labels_missing(image_set, [posture.view.posture])
    labels = channels["defect"]
    if labels.shape != posture.labels.shape:
        raise InputError(
            f"{image_set.path(entries[0].exr)}: labels of {labels.shape[1]} × {labels.shape[0]} px for images of "
            f"{posture.labels.shape[1]} × {posture.labels.shape[0]} px"
        )
    return labels.astype(np.int32)


def _labels_missing(image_set: ImageSet, postures: Iterable[Posture]) -> InputError:
    return InputError(
        f"{image_set.folder}: no labels of defects for {', '.join(f'posture {p}' for p in postures)}, though the "
        "manifest lists defects; expected a geometry EXR with a channel defect; render the set anew"
    )


def _cast(posture: InspectedPosture, result: InspectionResult, known: Sequence[PlacedDefect]) -> Int32:
    # what the prediction's rays met, taken back to where the part's file has it
    geometry, nominal = posture.view.prediction.images.geometry, result.nominal
    placement, file = result.placement or Placement(), nominal.placement
    row, column = np.nonzero(geometry.hit)

    def to_mesh_file(vectors: Float32, *, direction: bool) -> Float64:
        own = vectors[row, column].astype(np.float64)
        return world_to_mesh_file(own, nominal, placement, posture.view.posture, direction=direction)

    points = to_mesh_file(geometry.points, direction=False) @ file.rotation.T + file.translation
    normals = to_mesh_file(geometry.normals, direction=True) @ file.rotation.T
    labels = np.full(geometry.hit.shape, -1, np.int32)
    marks = mark_surface(known, points, normals)
    if marks is not None:
        labels[row[marks.index], column[marks.index]] = marks.label
    return labels
