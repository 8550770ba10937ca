"""The files of an optimisation: result.json, ranking.csv, rigs with the new angles, images and overlap maps."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.config import PartConfig, RigConfig, load_rig
from lightopt.core.transforms import Posture
from lightopt.design._additions import Appendix
from lightopt.design._options import OptimizeOptions
from lightopt.design._previous_result import REPORT_NAME, RESULT_NAME, RIG_NAME, begin_writing, end_writing
from lightopt.design._result import SetResult, ranking_csv, result_dict
from lightopt.design._rig_file import rig_texts
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.images import (
    Overlap,
    find_overlaps,
    make_folder,
    overlap_map_name,
    read_image_set,
    write_bytes_atomic,
    write_overlap_map,
    write_png,
    write_text_atomic,
)
from lightopt.rendering import RenderOptions, render_image_set

RANKING_NAME = "ranking.csv"
IMAGES_NAME = "images"


@dataclass(frozen=True, kw_only=True)
class Written:
    """The files of an optimisation.

    Attributes
    ----------
    result, ranking
        result.json and ranking.csv.
    rigs
        Rig files with the new angles, and the postures that each is for.
    images
        Folders of image sets.
    files
        Of the appendix.
    overlaps
        Saturated regions of these images, in the order of the postures.
    report
        The report; None where none was wanted.
    """

    result: Path
    ranking: Path
    rigs: tuple[tuple[Path, tuple[Posture, ...]], ...]
    images: tuple[Path, ...]
    files: tuple[Path, ...]
    overlaps: tuple[Overlap, ...]
    report: Path | None


def write_outputs(
    folder: Path,
    rig: RigConfig,
    part: PartConfig,
    results: tuple[SetResult, ...],
    candidates: Candidates,
    thresholds: LevelThresholds,
    *,
    offered: Candidates,
    provenance: Mapping[str, Any],
    options: OptimizeOptions,
    appendix: Appendix,
    force: bool,
    warn: Callable[[str], None],
    page: Callable[[Mapping[str, Any], Sequence[Overlap]], str] | None = None,
) -> Written:
    """Write all files, result.json last: where it is, the others are complete.

    With `force`, an earlier result.json goes first, then all that it lists.

    Parameters
    ----------
    folder
        Made where it does not exist.
    rig, part
        As they were read.
    results, candidates, thresholds
        What was found.
    offered
        The positions that there were to choose from.
    provenance
        From :func:`lightopt.core.provenance.provenance`.
    options
        As they were asked for.
    appendix
        Further sections and files.
    force
        Replace files that are there and differ.
    warn
        Called with warnings of the rendering.
    page
        Makes the report of what result.json will say and of the overlaps; None for no report.

    Raises
    ------
    InputError
        The folder cannot be written, or holds other results and `force` is False.
    """
    make_folder(folder)
    rigs = tuple(
        (folder / path, postures, text)
        for path, postures, text in rig_texts(rig, results, candidates, folder=folder)
    )
    names = [*appendix.files, *([] if page is None else [REPORT_NAME])]
    several = len(candidates.names) > 1
    sets = _image_sets(rigs, appendix.exposures) if options.images else ()
    listed = _listed(folder, rigs, sets, overlaps=several) | {"files": [{"file": name} for name in names]}
    ours = begin_writing(folder, listed, force=force)
    ranking = folder / RANKING_NAME
    write_text_atomic(ranking, ranking_csv(results, candidates), overwrite=force)
    for path, _, text in rigs:
        make_folder(path.parent)
        write_text_atomic(path, text, overwrite=force)
    for name, content in appendix.files.items():
        _write(folder / name, content, force)
    overlaps: list[Overlap] = []
    for images in sets:
        _render(images, part, options, force, warn)
        if several:
            overlaps += _overlaps(images, force)
    document = {
        "format": "lightopt-optimum/1",
        "provenance": dict(provenance),
        "thresholds": {
            "black": thresholds.black,
            "shaded_below": thresholds.shade,
            "saturated_from": thresholds.saturation,
        },
        "candidates": [
            {"light": name, "positions_deg": [list(at) for at in angles]}
            for name, angles in zip(offered.names, offered.angles, strict=True)
        ],
        "left_out": [vars(out) for out in offered.left_out],
        "results": result_dict(results, candidates),
        **appendix.sections,
        "rigs": listed["rigs"],
        "files": listed["files"],
        "images": listed["images"],
        "overlaps": [
            {**where, **overlap.as_dict()}
            for where, overlap in zip(listed["overlaps"], overlaps, strict=True)
        ],
    }
    report = None if page is None else folder / REPORT_NAME
    if page is not None and report is not None:
        write_text_atomic(report, page(document, overlaps), overwrite=force or ours)
    result = folder / RESULT_NAME
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    write_text_atomic(result, text, overwrite=force)
    end_writing(folder)
    return Written(
        result=result,
        ranking=ranking,
        rigs=tuple((path, postures) for path, postures, _ in rigs),
        images=tuple(images.folder for images in sets),
        files=tuple(folder / name for name in appendix.files),
        overlaps=tuple(overlaps),
        report=report,
    )


def _write(path: Path, content: str | bytes | NDArray[np.uint8], force: bool) -> None:
    make_folder(path.parent)
    if isinstance(content, str):
        write_text_atomic(path, content, overwrite=force)
    elif isinstance(content, bytes):
        write_bytes_atomic(path, content, overwrite=force)
    else:
        write_png(path, content, metadata={}, overwrite=force)


@dataclass(frozen=True, kw_only=True)
class _Images:
    """An image set to come: of one rig, all its postures being taken with the same exposures."""

    folder: Path
    rig: Path
    postures: tuple[Posture, ...]
    exposures: tuple[float, ...]


def _image_sets(
    rigs: Sequence[tuple[Path, tuple[Posture, ...], str]], exposures: Mapping[Posture, tuple[float, ...]]
) -> tuple[_Images, ...]:
    # images, images-2, …: an image set has every posture at every exposure
    sets: list[_Images] = []
    for path, postures, _ in rigs:
        groups: dict[tuple[float, ...], list[Posture]] = {}
        for posture in postures:
            groups.setdefault(exposures.get(posture, (1.0,)), []).append(posture)
        for number, (levels, some) in enumerate(groups.items(), start=1):
            name = IMAGES_NAME if number == 1 else f"{IMAGES_NAME}-{number}"
            sets.append(_Images(folder=path.parent / name, rig=path, postures=tuple(some), exposures=levels))
    return tuple(sets)


def _listed(
    folder: Path,
    rigs: Sequence[tuple[Path, tuple[Posture, ...], str]],
    sets: Sequence[_Images],
    *,
    overlaps: bool,
) -> dict[str, list[dict[str, Any]]]:
    # the files to come, as result.json lists them
    homes = [(path.parent.relative_to(folder), postures) for path, postures, _ in rigs]
    pictured = [(images.folder.relative_to(folder), images) for images in sets]
    return {
        "rigs": [
            {"file": (home / RIG_NAME).as_posix(), "postures": [p.as_dict() for p in postures]}
            for home, postures in homes
        ],
        "images": [
            {"folder": home.as_posix(), "exposures": list(images.exposures)} for home, images in pictured
        ],
        "overlaps": [
            {"map": (home / overlap_map_name(posture, exposure)).as_posix()}
            for home, images in pictured
            for posture in images.postures
            for exposure in images.exposures
            if overlaps
        ],
    }


def _render(
    images: _Images,
    part: PartConfig,
    options: OptimizeOptions,
    force: bool,
    warn: Callable[[str], None],
) -> None:
    render_image_set(
        load_rig(images.rig),
        part,
        images.folder,
        options=RenderOptions(
            postures=images.postures,
            exposures=images.exposures,
            points=options.points,
            shadows=options.shadows,
            patch_budget=options.patch_budget,
            defects=False,
            threads=options.threads,
        ),
        force=force,
        warn=warn,
    )


def _overlaps(images: _Images, force: bool) -> list[Overlap]:
    # in the order in which they are listed
    found = {
        (overlap.posture, overlap.exposure): overlap
        for overlap in find_overlaps(read_image_set(images.folder))
    }
    overlaps = [found[posture, exposure] for posture in images.postures for exposure in images.exposures]
    for overlap in overlaps:
        write_overlap_map(
            overlap, images.folder / overlap_map_name(overlap.posture, overlap.exposure), overwrite=force
        )
    return overlaps
